"""Commands about plans: plan, check, show, plot."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.output import error_answer, naming, print_json, print_table, progress_display
from drake_hand.errors import InputError
from drake_hand.files import require_folder, resolve, write_atomic
from drake_hand.plans.plan import Certificate, Plan, Worst
from drake_hand.plans.task import SUFFIX

if TYPE_CHECKING:
    from drake_hand.api import PlanResult


def plan(
    task: str,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    html: Path | None = None,
    seed: Annotated[int | None, Parameter(validator=Number(gte=0))] = None,
    time_limit: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
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
        html: also write a standalone page to watch it.
        seed: instead of the task's.
        time_limit: seconds, instead of the task's.
        json: print one JSON object on stdout.
    """
    from drake_hand import api

    output = output or Path(Path(task).name.removesuffix(SUFFIX) + ".plan.json")
    if output.suffix != ".json":
        raise InputError("plan files end in .json", key="--output", found=output, expected=output.with_suffix(".json"))
    for written in (output, html):
        if written:
            require_folder(written)
    with naming(resolve(task, "tasks", SUFFIX)), progress_display(quiet=json) as progress:
        result = api.solve(task, progress=progress, seed=seed, time_limit=time_limit)
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
    _print_parts(found)
    if found.certificate:
        _print_certificate(found.certificate)
    print(f"certified: {len(found.parts)} parts, {result.regrasps} regrasps, {found.duration:.1f} s of motion")
    print(_times(result))
    print(f"wrote {output}" + (f" and {html}" if html else ""))
    return 0


def check(file: Path, /, *, json: bool = False) -> int:
    """Prove a plan again, from its file alone.

    Exit status: 0 certified, 1 not certified (says what fails, and where), 2 not a plan, or edited since it was made.

    ```console
    $ drake-hand check spin.plan.json
    ```

    Args:
        file: the plan file.
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
        _print_certificate(certificate)
        print("certified" if certified else "NOT certified")
    if edited:
        print(f"drake-hand: {edited}", file=sys.stderr)
        return edited.exit_status
    return 0 if certified else 1


def show(file: Path, /, *, html: Path | None = None) -> None:
    """Watch a plan in the browser: play, pause, scrub, the mode and its timeline beside the hand.

    ```console
    $ drake-hand show spin.plan.json
    $ drake-hand show spin.plan.json --html spin.html
    ```

    Args:
        file: the plan file.
        html: write a standalone page there instead of serving it.
    """
    from drake_hand import api
    from drake_hand.view.show import serve

    with naming(file):
        page = api.show(Plan.load(file))
    if html:
        write_atomic(html, page)
        print(f"wrote {html}")
    else:
        serve(page, lambda url: print(f"{file.name} is at {url} (Ctrl-C ends)", flush=True))


def plot(file: Path, /, *, output: Annotated[Path, Parameter(name=["--output", "-o"])]) -> None:
    """Draw a plan as figures: modes, joints and speeds against limits, object, contacts, forces.

    ```console
    $ drake-hand plot spin.plan.json -o figures
    $ drake-hand plot spin.run.npz -o figures
    ```

    Args:
        file: the plan file, or the record of a run of `execute`.
        output: the folder for the PNG files.
    """
    from drake_hand.epos import record
    from drake_hand.model.hand import Hand
    from drake_hand.view.figures import draw_plan
    from drake_hand.view.run_figures import draw_run

    if file.name.endswith(record.SUFFIX):
        files = draw_run(record.RunRecord.load(file), output)
    else:
        subject = Plan.load(file)
        files = draw_plan(subject, Hand.load(subject.task.hand), output)
    for written in files:
        print(f"wrote {written}")


def _times(result: PlanResult) -> str:
    """Where the time went; the stages add up to the whole, the certificate comes after it."""
    stages = {name: s for name, s in result.stages_s.items() if name != "certificate"}
    stages["other"] = result.plan_s - sum(stages.values())
    times = ", ".join(f"{name} {s:.2f}" for name, s in stages.items())
    return f"planned in {result.plan_s:.2f} s ({times}), then proved in {result.stages_s['certificate']:.2f} s"


def _edited(subject: Plan, file: Path) -> InputError | None:
    """The error of a plan whose certificate is about another content."""
    if subject.certificate is None:
        return None
    if not subject.certificate.intact:
        return InputError(
            "certificate was changed after it was made",
            file=file,
            key="certificate.digest",
            found=subject.certificate.digest,
            expected=f"{subject.certificate.sealed().digest} (the digest of what it says now)",
        )
    if subject.certificate.plan_hash == subject.hash:
        return None
    return InputError(
        "plan was changed after it was certified",
        file=file,
        key="certificate.plan_hash",
        found=subject.certificate.plan_hash,
        expected=f"{subject.hash} (the hash of what the file holds now)",
    )


def _print_parts(subject: Plan) -> None:
    print_table(
        "Parts",
        ["#>", "mode", "start s>", "end s>", "event"],
        [(i, p.mode, f"{p.t[0]:.2f}", f"{p.t[-1]:.2f}", ", ".join(p.events)) for i, p in enumerate(subject.parts)],
    )


def _print_certificate(certificate: Certificate) -> None:
    def place(w: Worst) -> str:
        when = f"{w.time_s:.3f} s" if w.time_s is not None else ""
        return ", ".join(x for x in (when, f"part {w.part}" if w.part is not None else "", w.where) if x)

    print_table(
        f"Certificate ({certificate.samples} samples)",
        ["", "worst>", "limit>", "", "where"],
        [
            (name, "-" if w.value is None else w.value, w.limit, "ok" if w.ok else "FAILS", place(w))
            for name, w in certificate.worst.items()
        ],
    )
    if certificate.worst["force_margin"].value is None:
        print("hold: kinematic - the plan closes the loops; no contact forces were planned or checked")
    for failure in certificate.failures:
        print(f"fails: {failure}")
