"""`growth`: how an error of the object's pose at the start propagates through a plan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.output import naming, print_json, print_table, progress_display
from drake_hand.plans.plan import Plan
from drake_hand.plans.progress import Progress


def growth(
    file: Path,
    /,
    *,
    starts: Annotated[int, Parameter(validator=Number(gte=1))] = 6,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    engine: Literal["drake", "mujoco"] = "drake",
    json: bool = False,
) -> int:
    """Predict and simulate how an error of the object's pose at the start grows or shrinks, part by part.

    The object starts 1 mm and 2 deg off in random directions. An error of 1 is as large as that. The prediction is
    linear: springs along each contact's normal, and no slip along the surface.
    Exit status: 0 done, 1 a run dropped the object, 2 invalid input.

    ```console
    $ drake-hand growth spin.plan.json
    $ drake-hand growth spin.plan.json --engine mujoco --starts 20 --json
    ```

    Args:
        file: the plan file.
        starts: number of starts that are simulated.
        seed: for their directions.
        engine: physics engine; mujoco needs `pip install 'drake_hand[mujoco]'`.
        json: print one JSON object on stdout.
    """
    from drake_hand.physics.growth import grow

    subject = Plan.load(file)
    with naming(file), progress_display(quiet=json) as progress:

        def tell(fraction: float) -> None:
            progress(Progress(stage="simulating", fraction=fraction))

        found = grow(subject, starts=starts, seed=seed, engine=engine, progress=tell)
    dropped = any(g.simulated is None for g in found)
    if json:
        print_json({"engine": engine, "starts": starts, "parts": [msgspec.to_builtins(g) for g in found]})
        return int(dropped)
    print_table(
        f"error of a start that is 1 mm and 2 deg off ({engine}, {starts} starts)",
        ["part>", "mode", "end s>", "worst predicted>", "mean predicted>", "mean simulated>"],
        [(g.part, subject.parts[g.part].mode, g.time_s, g.worst, g.predicted, g.simulated or "dropped") for g in found],
    )
    return int(dropped)
