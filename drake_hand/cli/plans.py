"""Commands about plans: plan, check, simulate."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.output import error_answer, naming, print_json, print_table, progress_display
from drake_hand.cli.verdict import print_certificate, print_plan
from drake_hand.errors import InputError, NoPlanFound
from drake_hand.files import resolve, write_atomic
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import SUFFIX


def plan(
    task: str,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    html: Path | None = None,
    seed: int | None = None,
    time_limit: float | None = None,
    everything: Annotated[bool, Parameter(name="--all")] = False,
    json: bool = False,
) -> int:
    """Find a certified plan for a task.

    Exit status: 0 certified, 1 no plan (says which mode, finger, constraint and pose blocked), 2 wrong input.

    ```console
    $ drake-hand plan spin -o spin.plan.json --html spin.html
    $ drake-hand plan my.task.yaml --seed 3 --time-limit 20 --json
    ```

    Args:
        task: a bundled name (spin, paper, twirl, carry) or a task file.
        output: the plan file; TASK.plan.json here if not given.
        html: also write a standalone page to watch it, or to see what blocked.
        seed: instead of the task's.
        time_limit: seconds, instead of the task's.
        everything: print every part and every figure of the certificate.
        json: print one JSON object on stdout.
    """
    from drake_hand import api

    output = output or Path(Path(task).name.removesuffix(SUFFIX) + ".plan.json")
    if output.suffix != ".json":
        raise InputError("plan files end in .json", key="--output", found=output, expected=output.with_suffix(".json"))
    with naming(resolve(task, "tasks", SUFFIX)), progress_display(quiet=json) as progress:
        try:
            result = api.solve(task, progress=progress, seed=seed, time_limit=time_limit)
        except NoPlanFound as e:
            if html:  # instead of the page of an older plan
                write_atomic(html, api.show_failure(task, e))
            raise
    found = result.plan
    page = api.show(found) if html else None
    found.save(output)
    if html and page:
        write_atomic(html, page)
    if json:
        print_json(
            {
                "status": "certified",
                "modes": found.modes,
                "regrasps": result.regrasps,
                "duration_s": found.duration,
                "plan_s": result.plan_s,
                "stages_s": result.stages_s,
                "output": str(output),
            }
        )
        return 0
    print_plan(found, regrasps=result.regrasps, everything=everything)
    stages = ", ".join(f"{name} {s:.3g} s" for name, s in result.stages_s.items())
    print(f"planned in {result.plan_s:.3g} s ({stages})")
    print(f"wrote {output}" + (f" and {html}" if html else ""))
    return 0


def check(file: Path, /, *, everything: Annotated[bool, Parameter(name="--all")] = False, json: bool = False) -> int:
    """Prove a plan again, from its file alone.

    Exit status: 0 certified, 1 not certified (says what fails, and where), 2 not a plan, or edited since it was made.

    ```console
    $ drake-hand check spin.plan.json
    $ drake-hand check spin.plan.json --all
    ```

    Args:
        file: the plan file.
        everything: print every figure of the certificate.
        json: print one JSON object on stdout.
    """
    from drake_hand import api

    subject = Plan.load(file)
    with naming(file), progress_display(quiet=json) as progress:
        certificate = api.check(subject, progress=progress)
    edited = _edited(subject, file)
    certified = certificate.certified and edited is None
    if json:
        answer = msgspec.to_builtins(certificate) | {"certified": certified}
        print_json(answer | (error_answer(edited) if edited else {}))
    else:
        print_certificate(msgspec.structs.replace(certificate, certified=certified), subject, everything=everything)
    if edited:
        print(f"drake-hand: {edited}", file=sys.stderr)
        return edited.exit_status
    return 0 if certified else 1


def simulate(
    file: Path,
    /,
    *,
    html: Path | None = None,
    runs: Annotated[int, Parameter(validator=Number(gte=1))] = 1,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    json: bool = False,
) -> int:
    """Replay a plan in physics: does the object stay in the hand, and where does it end?

    One run is as planned; of more, every one has its own friction, mass, stiffness (20 %) and start pose (1 mm, 2 deg).
    A run succeeds if the object is not dropped and ends within 3 mm and 8 deg of the plan.
    Exit status: 0 no run dropped the object, 1 one did, 2 wrong input.

    ```console
    $ drake-hand simulate spin.plan.json --html spin-physics.html
    $ drake-hand simulate spin.plan.json --runs 20 --json
    ```

    Args:
        file: the plan file.
        html: also write a page of the unperturbed run: what was planned faint, contact forces as arrows.
        runs: how many.
        seed: of the perturbations.
        json: print one JSON object on stdout.
    """
    from drake_hand.physics.replay import simulate as replay
    from drake_hand.view.replay import render_replay

    subject = Plan.load(file)
    with naming(file), progress_display(quiet=json) as progress:
        pages: list[str] = []
        watch = (lambda run, record: pages.append(render_replay(subject, run, record))) if html else None
        result = replay(subject, runs=runs, seed=seed, watch=watch, progress=progress)
    if json:
        print_json(msgspec.to_builtins(result))
    else:
        print_table(
            f"Physics ({result.contact} contact, friction {result.friction:g})",
            ["run>", "", "position mm>", "tilt deg>", "rotation deg>", "rotated deg>", "slip mm>"],
            [
                (
                    i,
                    "dropped" if r.dropped else "ok" if r.success else "off",
                    *(r.position_error_mm, r.tilt_error_deg, r.rotation_error_deg, r.rotated_deg, r.slip_mm),
                )
                for i, r in enumerate(result.runs)
            ],
        )
        print(f"success rate {result.success_rate:.0%}, {result.realtime_factor:.2g} x real time")
    if html:
        write_atomic(html, pages[0])
        if not json:
            print(f"wrote {html}")
    return 1 if result.dropped else 0


def _edited(subject: Plan, file: Path) -> InputError | None:
    """The error of a plan whose certificate is about another content."""
    if subject.certificate is None or subject.certificate.plan_hash == subject.hash:
        return None
    return InputError(
        "plan was changed after it was certified",
        file=file,
        key="certificate.plan_hash",
        found=subject.certificate.plan_hash,
        expected=f"{subject.hash} (the hash of what the file holds now)",
    )
