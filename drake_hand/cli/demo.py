"""`drake-hand demo`: the whole way at once, from the bundled task to simulated drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from drake_hand.cli import plans


def demo(*, output: Annotated[Path, Parameter(name=["--output", "-o"])] = Path("out")) -> int:
    """Plan, check and draw the bundled pencil rotation; writes plan, page and figures.

    ```console
    $ drake-hand demo
    $ drake-hand demo -o /tmp/demo
    ```

    Args:
        output: the folder to write to.
    """
    file, page = output / "spin.plan.json", output / "spin.html"
    steps = {
        "Plan a full turn of the pencil": lambda: plans.plan("spin", output=file, html=page),
        "Prove it again, from its file alone": lambda: plans.check(file),
        "Draw it": lambda: plans.plot(file, output=output / "figures"),
    }
    for number, (title, step) in enumerate(steps.items(), start=1):
        print(f"\n[{number}/{len(steps)}] {title}\n", flush=True)
        if status := step():
            return status
    print(f"\nopen {page} in a browser to watch it")
    return 0
