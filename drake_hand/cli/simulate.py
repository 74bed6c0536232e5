"""`simulate`: a plan replayed in physics, and what became of the object."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.output import naming, print_json, print_table, progress_display
from drake_hand.files import write_atomic
from drake_hand.plans.plan import Plan


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
