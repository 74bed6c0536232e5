"""`drake-hand demo`: everything at once, from the bundled task to simulated drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from drake_hand.cli import plans
from drake_hand.cli.simulate import simulate
from drake_hand.files import make_folder


def demo(*, output: Annotated[Path, Parameter(name=["--output", "-o"])] = Path("out")) -> int:
    """Plan, check, simulate, draw and execute the bundled pencil rotation; writes plan, pages, figures and record.

    ```console
    $ drake-hand demo
    $ drake-hand demo -o /tmp/demo
    ```

    Args:
        output: the folder to write to.
    """
    from drake_hand.cli import drives_execute
    from drake_hand.cli.plot import plot

    make_folder(output)
    file, run = output / "spin.plan.json", output / "spin.run.npz"
    page, physics = output / "spin.html", output / "spin-physics.html"
    steps = {
        "Plan a full turn of the pencil": lambda: plans.plan("spin", output=file, html=page),
        "Prove it again, from its file alone": lambda: plans.check(file),
        "Replay it in physics": lambda: simulate(file, html=physics),
        "Play it on simulated drives": lambda: drives_execute.execute(file, drives="kanguera", simulate=True, log=run),
        "Draw the plan": lambda: plot(file, output=output / "figures"),
        "Draw the run": lambda: plot(run, output=output / "figures" / "run"),
    }
    for number, (title, step) in enumerate(steps.items(), start=1):
        print(f"\n[{number}/{len(steps)}] {title}\n", flush=True)
        if status := step():
            return status
    print(f"\nopen {page} in a browser to watch the plan, {physics} to watch physics")
    return 0
