"""`drake-hand plot`: a plan, or the record of a run, as figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from drake_hand.plans.plan import Plan


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
