"""`simulate`: a plan replayed in physics, and what became of the object."""

from __future__ import annotations

import signal
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.output import naming, print_json, print_table, progress_display
from drake_hand.feedback.sensor import PoseSensor
from drake_hand.files import require_folder, write_atomic
from drake_hand.physics.engine import PushForce
from drake_hand.plans.plan import Plan

if TYPE_CHECKING:
    from drake_hand.physics.runs import Replay


def simulate(
    file: Path,
    /,
    *,
    html: Path | None = None,
    runs: Annotated[int, Parameter(validator=Number(gte=1))] = 1,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    engine: Literal["drake", "mujoco", "both"] = "drake",
    feedback: bool = False,
    sensor: Annotated[PoseSensor | None, Parameter(name="*")] = None,
    push: Annotated[PushForce | None, Parameter(name="*")] = None,
    json: bool = False,
) -> int:
    """Replay a plan in physics: does the object stay in the hand, and where does it end up?

    A single run is as planned; of several, each has its own friction, mass, stiffness (20 %) and start (1 mm, 2 deg).
    A run succeeds if the object is not dropped and ends within 3 mm and 8 deg of the plan.
    With --feedback, a simulated sensor measures the object's pose, and the commands are corrected accordingly.
    Ctrl-C ends the simulation within a second and reports the finished runs.
    Exit status: 0 no run dropped the object, 1 a run did, 2 invalid input, 130 interrupted.

    ```console
    $ drake-hand simulate spin.plan.json --html spin.html
    $ drake-hand simulate spin.plan.json --runs 20 --seed 1 --json
    $ drake-hand simulate spin.plan.json --engine both --feedback --latency-ms 50
    $ drake-hand simulate spin.plan.json --engine mujoco --feedback --runs 20 --push-n 2 --push-ms 50
    ```

    Args:
        file: the plan file.
        html: write a page of the unperturbed run; with both engines, of the first.
        runs: number of runs.
        seed: for the perturbations and the sensor noise.
        engine: physics engine; mujoco needs `pip install 'drake_hand[mujoco]'`.
        feedback: correct the commands with a simulated sensor of the object's pose.
        sensor: properties of the sensor.
        push: a force on the object, once per run, from a random direction.
        json: print one JSON object on stdout.
    """
    if html:
        require_folder(html)
    from drake_hand.physics.runs import Interrupted
    from drake_hand.physics.runs import simulate as replay
    from drake_hand.view.replay import render_replay

    subject = Plan.load(file)
    engines: list[Literal["drake", "mujoco"]] = ["drake", "mujoco"] if engine == "both" else [engine]
    results: list[Replay] = []
    pages: list[str] = []
    stopped: Interrupted | None = None
    with naming(file), progress_display(quiet=json) as progress:
        watch = (lambda run, record: pages.append(render_replay(subject, run, record))) if html else None
        try:
            for name in engines:
                seen_by = (sensor or PoseSensor()) if feedback else None
                results.append(
                    replay(
                        subject,
                        runs=runs,
                        seed=seed,
                        engine=name,
                        feedback=seen_by,
                        push=push,
                        watch=None if pages else watch,
                        progress=progress,
                    )
                )
        except Interrupted as e:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # what was finished is reported undisturbed
            stopped = e
            results += [e.replay] if e.replay else []
    if json:
        answers = [msgspec.to_builtins(result) for result in results]
        answer = answers[0] if len(engines) == 1 and answers else {"engine": engine, "replays": answers}
        print_json(answer | ({"interrupted": str(stopped)} if stopped else {}))
    else:
        for result in results:
            _print(result)
    if stopped:
        raise stopped
    if html:
        write_atomic(html, pages[0])
        if not json:
            print(f"wrote {html}")
    return 1 if any(result.dropped for result in results) else 0


def _print(result: Replay) -> None:
    how = "feedback" if result.feedback else "open loop"
    print_table(
        f"Physics ({result.engine}, {how}, {result.contact} contact, friction {result.friction:g})",
        ["run>", "", "position mm>", "tilt deg>", "rotation deg>", "rotated deg>", "slip mm>"],
        _rows(result),
    )
    print(f"success rate {result.success_rate:.0%}, {result.realtime_factor:.2g} x real time")
    if result.rooms:
        least = min(result.rooms, key=lambda room: room.room_mm)
        where = f"once the object is {least.room_mm:.2g} mm off, part {least.part}"
        print(f"smallest room: {least.finger} loses contact {where}")
    saturated = max((r.correction.saturated_s for r in result.runs if r.correction), default=0.0)
    if saturated:
        print(f"the correction was saturated for up to {saturated:.2g} s of a run")


def _rows(result: Replay) -> Iterable[tuple[Any, ...]]:
    for i, r in enumerate(result.runs):
        verdict = "dropped" if r.dropped else "ok" if r.success else "off"
        yield i, verdict, r.position_error_mm, r.tilt_error_deg, r.rotation_error_deg, r.rotated_deg, r.slip_mm
