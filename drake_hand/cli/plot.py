"""`drake-hand plot`: a plan, or the record of a run, as figures."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from drake_hand.cli.output import naming, progress_display
from drake_hand.files import require_folder, require_place
from drake_hand.plans.plan import Plan


def plot(
    plan_or_run: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    formats: Annotated[str, Parameter(name="--format")] = "png",
    gif: Path | None = None,
    replay: bool = False,
) -> None:
    """Draw a plan as figures for print: those of the paper, and modes, joints, object, contacts, forces, margin.

    All are 85 mm wide. fig11 to fig16 are those of Caurin & Pedro (2009).

    ```console
    $ drake-hand plot spin.plan.json -o figures
    $ drake-hand plot spin.plan.json -o figures --format svg,pdf --gif spin.gif
    $ drake-hand plot carry.plan.json -o figures --replay
    $ drake-hand plot spin.run.npz -o figures
    ```

    Args:
        plan_or_run: the plan file, or the record of a run of `execute`.
        output: the folder for the files.
        formats: of svg, pdf and png, separated by commas.
        gif: also write the plan as an animation.
        replay: also replay the plan in physics, and draw the error of the object over time, in both engines.
    """
    import numpy as np

    from drake_hand.epos import record
    from drake_hand.model.hand import Hand
    from drake_hand.view.course import Course
    from drake_hand.view.figures import draw_plan
    from drake_hand.view.run_figures import draw_run
    from drake_hand.view.sketch import write_gif

    require_place(output)
    if gif:
        require_folder(gif)
    kinds = [kind.strip() for kind in formats.split(",")]
    if plan_or_run.name.endswith(record.RECORD_SUFFIX):
        files = draw_run(record.RunRecord.load(plan_or_run), output, formats=kinds)
    else:
        subject = Plan.load(plan_or_run)
        hand = Hand.load(subject.task.hand)
        files = draw_plan(subject, hand, output, formats=kinds)
        if gif:
            course = Course.of(subject, hand, np.linspace(0, subject.duration, 200))
            with progress_display(quiet=False) as progress:
                write_gif(subject, course, gif, progress=progress)
            files.append(gif)
        if replay:
            with naming(plan_or_run):
                files += _draw_replays(subject, output, kinds)
    for written in files:
        print(f"wrote {written}")


def _draw_replays(plan: Plan, folder: Path, formats: list[str]) -> list[Path]:
    """Draws the errors of one run as planned in every engine that is installed."""
    from drake_hand.physics.engine import EngineName
    from drake_hand.physics.runs import simulate
    from drake_hand.view.replay_figures import draw_replay_errors
    from drake_hand.view.style import save

    engines: list[EngineName] = ["drake", "mujoco"] if find_spec("mujoco") else ["drake"]
    if len(engines) == 1:
        print("only in Drake: pip install 'drake_hand[mujoco]' for the other engine", file=sys.stderr)
    with progress_display(quiet=False) as progress:
        runs = {str(engine): simulate(plan, engine=engine, progress=progress).runs[0] for engine in engines}
    return save(draw_replay_errors(plan, runs), folder, "replay_errors", formats)
