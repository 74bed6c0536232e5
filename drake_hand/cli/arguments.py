"""How the words of a command line become values, and what the shell may complete them to."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import cyclopts
from cyclopts import Token

from drake_hand.files import bundled

if TYPE_CHECKING:
    from cyclopts.completion import CompletionContext

_TAKEN: dict[str, tuple[str | None, tuple[str, ...]]] = {
    "task": ("tasks", (".task.yaml",)),
    "hand": ("hands", (".hand.yaml",)),
    "drives": ("drives", (".drives.yaml",)),
    "file": (None, (".plan.json",)),
    "plan": (None, (".plan.json",)),
    "plan_or_task": ("tasks", (".task.yaml", ".plan.json")),
    "plan_or_run": (None, (".plan.json", ".run.npz")),
    "sweep_file": (None, (".sweep.yaml",)),
    "run": (None, (".run.npz",)),
    "urdf": (None, (".urdf",)),
}
"""By name of the argument: kind of the bundled files it takes by name, and suffixes of the files it takes."""
_COMMANDS = {".task.yaml": "plan", ".plan.json": "show", ".run.npz": "plot", ".hand.yaml": "hand check"}
"""What one does first with a file."""


def exact(type_: Any, tokens: Sequence[Token]) -> Any:
    """Converts as cyclopts does, but takes 2.5 for no whole number, and nan and inf for no numbers.

    Raises:
        ValueError: such a word; cyclopts says where.
    """
    value = cyclopts.convert(type_, tokens)
    if type(value) is int and "." in tokens[0].value and value != float(tokens[0].value):
        raise ValueError(f"{tokens[0].value} is not a whole number")
    if type(value) is float and not math.isfinite(value):
        raise ValueError(f"{tokens[0].value} is not a finite number")
    return value


def offer(context: CompletionContext) -> Iterator[str]:
    """Bundled names an argument takes, and files of its kind (of any, if it has none) in the folder typed so far."""
    kind, suffixes = _TAKEN.get(context.argument.field_info.name, (None, ("",)))
    if kind:
        yield from bundled(kind, suffixes[0])
    elif Path not in (context.argument.hint, *get_args(context.argument.hint)):
        return
    folder = context.incomplete.rpartition("/")[0]
    for path in sorted(Path(folder).expanduser().iterdir() if Path(folder).is_dir() else ()):
        typed = f"{folder}/{path.name}" if folder or context.incomplete.startswith("/") else path.name
        if path.is_dir():
            yield f"{typed}/"
        elif path.name.endswith(suffixes):
            yield typed


def choices(argument: str) -> str | None:
    """What an argument takes, in words; None where its name says it all."""
    if argument not in _TAKEN:
        return None
    kind, suffixes = _TAKEN[argument]
    names = f", or one of: {', '.join(bundled(kind, suffixes[0]))}" if kind else ""
    return f"a file {' or '.join(f'NAME{suffix}' for suffix in suffixes)}{names}"


def command_for(word: str) -> str | None:
    """The command somebody wants who gives a task's name, or a file, alone."""
    if word in bundled("tasks", ".task.yaml"):
        return "plan"
    return next((command for suffix, command in _COMMANDS.items() if word.endswith(suffix)), None)
