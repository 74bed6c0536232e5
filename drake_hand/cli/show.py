"""`drake-hand show`: a plan in the browser."""

from __future__ import annotations

from pathlib import Path

from drake_hand.cli.output import naming
from drake_hand.files import write_atomic
from drake_hand.plans.plan import Plan


def show(file: Path, /, *, html: Path | None = None) -> None:
    """Watch a plan in the browser: play, pause, scrub, the mode and its timeline beside the hand.

    ```console
    $ drake-hand show spin.plan.json
    $ drake-hand show spin.plan.json --html spin.html
    ```

    Args:
        file: the plan file.
        html: write a standalone page there instead of serving it.
    """
    from drake_hand import api
    from drake_hand.view.show import serve

    with naming(file):
        page = api.show(Plan.load(file))
    if html:
        write_atomic(html, page)
        print(f"wrote {html}")
    else:
        serve(page, lambda url: print(f"{file.name} is at {url} (Ctrl-C ends)", flush=True))
