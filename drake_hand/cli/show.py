"""`drake-hand show` and `hand show`: a plan, a task or a hand in the browser."""

from __future__ import annotations

from pathlib import Path

from drake_hand.cli.output import naming, ways_to
from drake_hand.errors import InputError
from drake_hand.files import bundled, require_folder, write_atomic
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import TASK_SUFFIX, Task


def show(plan_or_task: str, /, *, html: Path | None = None, host: str = "127.0.0.1") -> None:
    """Watch a plan in the browser, or look at a task before there is a plan.

    A plan plays, pauses and scrubs, with the mode and its timeline; press ? in the page for its keys.
    A task shows the object at its start pose, the axis or path of each step, and the reach of the fingertips.

    ```console
    $ drake-hand show spin.plan.json
    $ drake-hand show spin.plan.json --html spin.html
    $ drake-hand show my.task.yaml
    $ drake-hand show spin.plan.json --host 0.0.0.0
    ```

    Args:
        plan_or_task: a plan file, a task file, or the name of a bundled task.
        html: write a standalone page there instead of serving it.
        host: address to serve it on; by default, only this computer can see it.
    """
    if html:
        require_folder(html)
    from drake_hand import api

    with naming(Path(plan_or_task)):
        if plan_or_task in bundled("tasks", TASK_SUFFIX) or plan_or_task.endswith((".yaml", ".yml")):
            page = str(api.look(Task.load(plan_or_task)))
        elif plan_or_task.endswith(".json") or Path(plan_or_task).exists():
            page = str(api.show(Plan.load(plan_or_task)))
        else:
            expected = "a plan (.json), a task (.yaml) or one of: " + ", ".join(bundled("tasks", TASK_SUFFIX))
            raise InputError("nothing to show", file=plan_or_task, found=plan_or_task, expected=expected)
    present(page, Path(plan_or_task).name, html, host)


def show_hand(hand: str, /, *, html: Path | None = None, host: str = "127.0.0.1") -> None:
    """Look at a hand: a slider per joint, the palm frame, and how far the fingertips reach.

    ```console
    $ drake-hand hand show kanguera
    $ drake-hand hand show my.hand.yaml --html hand.html
    ```

    Args:
        hand: a bundled name or a hand file.
        html: write a standalone page there instead of serving it.
        host: address to serve it on; by default, only this computer can see it.
    """
    if html:
        require_folder(html)
    from drake_hand import api
    from drake_hand.model.hand import Hand

    present(str(api.look(Hand.load(hand))), hand, html, host)


def present(page: str, name: str, html: Path | None, host: str) -> None:
    """Writes a page, or serves it and says where."""
    if html:
        write_atomic(html, page)
        print(f"wrote {html}")
        return
    from drake_hand.view.show import serve_page

    def announce(url: str) -> None:
        print(f"{name} is at {url} (Ctrl-C ends)", *ways_to(url), sep="\n", flush=True)

    serve_page(page, announce, host=host)
