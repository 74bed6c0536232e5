"""`drake-hand demo`: everything at once, from the bundled task to simulated drives."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from drake_hand.cli import plans
from drake_hand.cli.output import progress_display
from drake_hand.files import make_folder
from drake_hand.plans.progress import Progress

PLAN_PAGE, PHYSICS = "spin.html", "spin-physics.html"
STEP_COUNT = 6


def demo(*, output: Annotated[Path, Parameter(name=["--output", "-o"])] = Path("out")) -> int:
    """Plan, check, simulate, draw and execute the bundled pencil rotation; writes plan, pages, figures and record.

    ```console
    $ drake-hand demo
    $ drake-hand demo -o /tmp/demo
    ```

    Args:
        output: the folder to write to.
    """
    make_folder(output)
    with closing(_steps(output)) as steps:
        for number, (title, step) in enumerate(steps, start=1):
            print(f"\n[{number}/{STEP_COUNT}] {title}\n", flush=True)
            if status := step():
                return status
    print(f"\nopen {output / PLAN_PAGE} in a browser to watch the plan, {output / PHYSICS} to watch physics")
    return 0


def _steps(output: Path) -> Generator[tuple[str, Callable[[], int | None]], None, None]:
    """What is done in turn; physics is computed in parallel to all that follows the plan."""
    from drake_hand.cli import drives_execute
    from drake_hand.cli.plot import plot

    file, run = output / "spin.plan.json", output / "spin.run.npz"
    yield "Plan a full turn of the pencil", lambda: plans.plan("spin", output=file, html=output / PLAN_PAGE)
    with _beside("simulate", file, "--html", output / PHYSICS) as replay:
        yield "Certify it again, from its file alone", lambda: plans.check(file)
        yield (
            "Play it on simulated drives",
            lambda: drives_execute.execute(file, drives="kanguera", simulate=True, on_interrupt="off", log=run),
        )
        yield "Draw the plan", lambda: plot(file, output=output / "figures")
        yield "Draw the run", lambda: plot(run, output=output / "figures" / "run")
        yield "Replay it in physics", lambda: _answer(replay)


@contextmanager
def _beside(*words: str | Path) -> Iterator[subprocess.Popen]:
    """A command that runs in parallel to others, in a process of lower priority."""
    command = [sys.executable, "-c", "from drake_hand.cli import main; main()", *map(str, words)]
    process = subprocess.Popen(["nice", *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _answer(process: subprocess.Popen) -> int:
    """Prints what a command says, once it is done."""
    with progress_display(quiet=False) as progress:
        progress(Progress(stage="physics"))
        out, err = process.communicate()
    print(out, end="")
    print(err, end="", file=sys.stderr)
    return process.returncode
