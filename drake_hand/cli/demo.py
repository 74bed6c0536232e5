"""`drake-hand demo`: everything at once, from the bundled task to simulated drives."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from drake_hand.cli import plans
from drake_hand.cli.output import progress_display
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
    if status := _one_by_one({"Plan a full turn of the pencil": lambda: plans.plan("spin", output=file, html=page)}, 1):
        return status
    with _beside("simulate", file, "--html", physics) as replay:
        steps: dict[str, Callable[[], int | None]] = {
            "Prove it again, from its file alone": lambda: plans.check(file),
            "Play it on simulated drives": lambda: drives_execute.execute(
                file, drives="kanguera", simulate=True, log=run
            ),
            "Draw the plan": lambda: plot(file, output=output / "figures"),
            "Draw the run": lambda: plot(run, output=output / "figures" / "run"),
            "Replay it in physics": lambda: _answer(replay),
        }
        if status := _one_by_one(steps, 2):
            return status
    print(f"\nopen {page} in a browser to watch the plan, {physics} to watch physics")
    return 0


def _one_by_one(steps: dict[str, Callable[[], int | None]], first: int) -> int:
    """Takes the steps in turn; the status of the one that fails, 0 if none does."""
    for number, (title, step) in enumerate(steps.items(), start=first):
        print(f"\n[{number}/6] {title}\n", flush=True)
        if status := step():
            return status
    return 0


@contextmanager
def _beside(*words: str | Path) -> Iterator[subprocess.Popen]:
    """A command that runs beside others, in a process that gives way to them."""
    command = [sys.executable, "-c", "from drake_hand.cli import main; main()", *map(str, words)]
    process = subprocess.Popen(["nice", *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _answer(process: subprocess.Popen) -> int:
    """Prints what a command says, once it is done."""
    from drake_hand.planning.search import Progress

    with progress_display(quiet=False) as progress:
        progress(Progress(stage="physics"))
        out, err = process.communicate()
    print(out, end="")
    print(err, end="", file=sys.stderr)
    return process.returncode
