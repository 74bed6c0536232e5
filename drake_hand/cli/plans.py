"""Commands about plans: plan, check."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.output import error_answer, naming, print_json, progress_display
from drake_hand.cli.verdict import print_certificate, print_plan
from drake_hand.errors import InputError, NoPlanFound
from drake_hand.files import require_folder, resolve, write_atomic
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import TASK_SUFFIX

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
    better: bool = False,
    replay: Literal["drake", "mujoco"] | None = None,
    everything: Annotated[bool, Parameter(name="--all")] = False,
    json: bool = False,
) -> int:
    """Find a certified plan for a task.

    Exit status: 0 certified, 1 no plan (names the mode, finger, constraint and pose that blocked), 2 invalid input.
    If there is no plan, the part that was found is written to TASK.partial.plan.json, not certified, for inspection.

    ```console
    $ drake-hand plan spin -o spin.plan.json --html spin.html
    $ drake-hand plan my.task.yaml --seed 3 --time-limit 20 --json
    $ drake-hand plan my.task.yaml --better --time-limit 300
    $ drake-hand plan my.task.yaml --replay mujoco
    ```

    Args:
        task: a bundled name (spin, paper, twirl, carry) or a task file.
        output: the plan file; TASK.plan.json here if not given.
        html: also write a standalone page that shows the plan, or why there is none.
        seed: overrides the task's.
        time_limit: in seconds; overrides the task's.
        better: look on until the time limit, or Ctrl-C, and keep the plan with the fewest regrasps; of equals, that in
            which an error at the start grows least.
        replay: replay what is certified in this engine, and look on where it drops the object or ends 3 mm or 8 deg
            off; mujoco needs `pip install 'drake_hand[mujoco]'`.
        everything: print every part and every figure of the certificate.
        json: print one JSON object on stdout.
    """
    from drake_hand import api

    output = output or Path(Path(task).name.removesuffix(TASK_SUFFIX) + ".plan.json")
    if output.suffix != ".json":
        raise InputError("plan files end in .json", key="--output", found=output, expected=output.with_suffix(".json"))
    for written in (output, html):
        if written:
            require_folder(written)
    with naming(resolve(task, "tasks", TASK_SUFFIX)), progress_display(quiet=json) as progress:
        try:
            result = api.solve(task, progress=progress, seed=seed, time_limit=time_limit, better=better, replay=replay)
        except NoPlanFound as e:
            unfinished = api.unfinished(e)
            if html:  # instead of the page of an older plan
                write_atomic(html, api.show(unfinished, failure=e) if unfinished else api.show_failure(task, e))
            if unfinished:
                _keep(unfinished, output)
            raise
    from drake_hand.verify.pieces import pieces

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
                "pieces": [asdict(piece) for piece in pieces(found)],
                "plan_s": result.plan_s,
                "stages_s": result.stages_s,
                "compared": result.compared,
                "replay": _replay(result),
                "output": str(output),
            }
        )
        return 0
    print_plan(found, regrasps=result.regrasps, everything=everything)
    print(_times(result))
    if result.replayed:
        before = f"; {result.lost} before it {'was' if result.lost == 1 else 'were'} not" if result.lost else ""
        print(f"{result.replayed.outcome}{before}")
    if better:
        print(f"the best of {result.compared} certified plan" + "s" * (result.compared != 1))
    print(f"wrote {output}" + (f" and {html}" if html else ""))
    return 0


def _keep(unfinished: Plan, output: Path) -> None:
    """Writes the partial plan next to where the plan would be, and says so."""
    file = output.with_name(output.name.removesuffix(".json").removesuffix(".plan") + ".partial.plan.json")
    unfinished.save(file)
    why = "certified, but lost in physics" if unfinished.certified else "not certified, as far as planning got"
    print(f"wrote {file}: {why}", file=sys.stderr)


def check(file: Path, /, *, everything: Annotated[bool, Parameter(name="--all")] = False, json: bool = False) -> int:
    """Certify a plan again, from its file alone.

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


def _times(result: PlanResult) -> str:
    """Where the time went; the stages add up to the whole, certificate and replay come after it."""
    stages = {name: s for name, s in result.stages_s.items() if name not in ("certificate", "replay")}
    stages["other"] = result.plan_s - sum(stages.values())
    times = ", ".join(f"{name} {s:.2f}" for name, s in stages.items())
    replayed = f" and replayed in {result.stages_s['replay']:.2f} s" if result.replayed else ""
    proved = f"then certified in {result.stages_s['certificate']:.2f} s{replayed}"
    return f"planned in {result.plan_s:.2f} s ({times}), {proved}"


def _replay(result: PlanResult) -> dict[str, Any] | None:
    """The figures of `simulate`, and how many plans before it physics lost."""
    if result.replayed is None:
        return None
    keys = ("dropped", "position_error_mm", "tilt_error_deg", "rotation_error_deg", "rotated_deg", "slip_mm")
    figures = {key: getattr(result.replayed.run, key) for key in keys}
    return {"engine": result.replayed.engine, "lost_before": result.lost, **figures}


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
            expected=f"{subject.certificate.sealed().digest} (the digest of its present content)",
        )
    if subject.certificate.plan_hash == subject.hash:
        return None
    return InputError(
        "plan was changed after it was certified",
        file=file,
        key="certificate.plan_hash",
        found=subject.certificate.plan_hash,
        expected=f"{subject.hash} (the hash of its present content)",
    )
