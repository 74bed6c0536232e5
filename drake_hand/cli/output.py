"""What the commands print: one JSON object or tables on stdout; progress and errors on stderr."""

from __future__ import annotations

import dataclasses
import json
import os
import socket
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from drake_hand.cli import interrupt
from drake_hand.errors import DrakeHandError, InputError, NoPlanFound

TRACEBACK = "DRAKE_HAND_TRACEBACK"
"""Environment variable: set, an unexpected exception keeps its traceback."""
FILE_WIDTH_CHARS = 120
"""Of tables that go to a file or pipe."""
STAGES = {
    "start": "rating start poses",
    "grasp": "looking for grasps",
    "gait": "looking for a gait that repeats",
    "search": "searching",
    "shorten": "leaving out regrasps",
    "legs": "joining the motion",
    "forces": "balancing contact forces",
    "timing": "timing the motion",
    "certificate": "proving the plan",
    "replay": "replaying the plan",
    "physics": "simulating",
}
"""Stages of planning in words, while it is at work."""


def print_json(answer: dict[str, Any]) -> None:
    """Prints the one JSON object of a command run with ``--json``."""
    plain = msgspec.to_builtins(answer, enc_hook=lambda o: o.tolist() if hasattr(o, "tolist") else str(o))
    try:
        text = msgspec.json.encode(plain).decode()
    except UnicodeEncodeError:  # a file name that is not UTF-8
        text = json.dumps(plain)
    print(text, flush=True)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Prints a table; a column whose name ends in ``>`` is set flush right."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for name in columns:
        table.add_column(name.rstrip(">"), justify="right" if name.endswith(">") else "left", overflow="fold")
    for row in rows:
        table.add_row(*(f"{c:.4g}" if isinstance(c, float) else str(c) for c in row))
    # names such as contact[thumb tip on pencil] are no markup
    Console(width=None if sys.stdout.isatty() else FILE_WIDTH_CHARS, markup=False).print(table)


def report_error(e: DrakeHandError, as_json: bool) -> int:
    """Says what went wrong on stderr (and as the JSON object, if asked); returns the exit status."""
    print(f"drake-hand: {e}", file=sys.stderr)
    if as_json:
        print_json(error_answer(e))
    return e.exit_status


def error_answer(e: DrakeHandError) -> dict[str, Any]:
    """The JSON object of an error: ``status`` and ``reason``, and whatever else the error knows."""
    if isinstance(e, NoPlanFound):
        return {"status": e.status, "reason": e.reason, "evidence": e.evidence}
    if isinstance(e, InputError):
        names = ("file", "line", "key", "found", "expected")
        known = {k: str(v) for k in names if (v := getattr(e, k)) is not None}
        return {"status": "error", "reason": e.message, **known}
    return {"status": "error", "reason": str(e)}


def ways_to(url: str) -> list[str]:
    """Who sees a page that is served here, and how to get to it from another computer; a line each."""
    address = urlsplit(url)
    if address.hostname in ("0.0.0.0", "::"):
        return [f"seen by whoever reaches this computer: http://{socket.gethostname()}:{address.port}{address.path}"]
    if address.hostname not in ("127.0.0.1", "localhost", "::1"):
        return ["seen by whoever reaches this address"]
    return ["seen by this computer only (--host opens it to others)", *tunnel(url)]


def tunnel(url: str) -> list[str]:
    """What to type on one's own machine to see a page that only this one sees; nothing if this is one's own."""
    if not os.environ.get("SSH_CONNECTION"):
        return []
    port, there = urlsplit(url).port, f"{os.environ.get('USER', 'you')}@{socket.gethostname()}"
    return [f"from your own machine: ssh -L {port}:{urlsplit(url).hostname}:{port} {there}, then open {url} there"]


@contextmanager
def naming(file: Path) -> Iterator[None]:
    """Adds the file to errors that know what is wrong, but not where it was read."""
    try:
        yield
    except InputError as e:
        if e.file is not None:
            raise
        raise e.within(file) from e


@contextmanager
def progress_display(*, quiet: bool) -> Iterator[Callable[[Any], None]]:
    """Shows the progress of a long job on stderr, on a terminal only.

    Yields:
        A callback for a job's progress records: dataclasses with ``stage``, ``fraction`` done and numbers worth seeing
        (expansions, best bound), shown by name where they are not zero.
    """
    display = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        TaskProgressColumn(),
        TextColumn("{task.fields[detail]}"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=quiet or not sys.stderr.isatty(),
    )
    with display:
        bar = display.add_task("loading", total=None, detail="")
        shown = ""

        def update(record: Any) -> None:
            interrupt.insist()
            fields = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
            stage, fraction = fields.pop("stage"), fields.pop("fraction")
            fields.pop("elapsed_s", None)  # the display has its own clock
            detail = "  ".join(f"{k.replace('_', ' ')} {_brief(v)}" for k, v in fields.items() if v)
            nonlocal bar, shown
            if stage != shown:  # share and clock are of a stage: what one has done says nothing about the next
                shown = stage
                display.remove_task(bar)
                bar = display.add_task(STAGES.get(stage, stage), total=None, detail=detail)
            display.update(bar, total=1.0 if fraction else None, completed=fraction, detail=detail)

        yield update


def _brief(value: object) -> str:
    if isinstance(value, dict):
        return " ".join(f"{k} {_brief(v)}" for k, v in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)
