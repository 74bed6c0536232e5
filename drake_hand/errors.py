"""The exception tree: what went wrong, where, and which exit status it means."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import msgspec

INTERRUPTED = 130
"""Exit status of a command that Ctrl-C ended, as in shells: 128 and the number of the signal."""


class DrakeHandError(Exception):
    """Base of all errors a user may see; the command line prints it in one message, without a traceback."""

    exit_status = 1


class InputError(DrakeHandError, ValueError):
    """A file or argument is wrong. Exit status 2.

    Args:
        message: what is wrong, in one sentence.
        file: the file that holds the wrong value.
        key: where in the file, dotted (``options.hold``).
        found: the value that was found.
        expected: what would have been right.
        line: of the file.
    """

    exit_status = 2

    def __init__(
        self,
        message: str,
        *,
        file: Path | str | None = None,
        key: str | None = None,
        found: object = None,
        expected: object = None,
        line: int | None = None,
    ) -> None:
        self.message, self.file, self.key, self.found, self.expected = message, file, key, found, expected
        self.line = line
        lines = [message]
        lines += [f"  file:     {file}" + (f", line {line}" if line else "")] if file is not None else []
        lines += [f"  key:      {key}"] if key is not None else []
        lines += [f"  found:    {found}"] if found is not None else []
        lines += [f"  expected: {expected}"] if expected is not None else []
        super().__init__("\n".join(lines))

    def within(self, file: Path | str | None) -> InputError:
        """The same error with a file named; this one if it names a file already."""
        if self.file is not None or file is None:
            return self
        return type(self)(
            self.message, file=file, key=self.key, found=self.found, expected=self.expected, line=self.line
        )

    @property
    def brief(self) -> str:
        """All of it on one line, for lists of problems."""
        known = {"in": self.file, "key": self.key, "found": self.found, "expected": self.expected}
        details = "; ".join(f"{word} {value}" for word, value in known.items() if value is not None)
        return f"{self.message} ({details})" if details else self.message


class MissingFile(InputError, FileNotFoundError):
    """There is no such file, and no bundled one of that name. Exit status 2."""


class Evidence(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """How far planning got and what blocked it there. What is not known, or not to blame, is left out."""

    mode: str | None = None
    """Code of the mode it happened in."""
    finger: str | None = None
    """Whose constraint it is, where it is one finger's."""
    constraint: str | None = None
    """What is violated, by name."""
    where: str | None = None
    """Joint or pair of bodies."""
    amount: float | None = None
    """By how much: m; of a joint limit rad."""
    X_WO: list[list[float]] | None = None
    """(4, 4) the object's pose."""
    progress: float | None = None
    """Share of the motion that was reached; None where no search began."""
    expansions: int | None = None
    """States looked at."""
    modes: list[str] = []
    """Codes of the modes found, in order."""
    at_limit: list[str] = []
    """Joints of the finger that are at a limit."""
    violations: list[str] = []
    """Everything that is violated, in words, the worst first."""


class NoPlanFound(DrakeHandError):
    """There is no plan, or none was found in time; says which mode, finger, constraint and pose blocked.

    Args:
        reason: one sentence naming mode, finger, constraint and object pose.
        status: ``infeasible`` or ``timeout``.
        evidence: the same, and more, for programs.
    """

    def __init__(
        self,
        reason: str,
        *,
        status: Literal["infeasible", "timeout"] = "infeasible",
        evidence: Evidence | None = None,
    ) -> None:
        self.reason, self.status, self.evidence = reason, status, evidence or Evidence()
        super().__init__(reason)

    @property
    def progress(self) -> float:
        """Share of the motion that was reached; below 0 where no search began, to compare failures by."""
        return -1.0 if self.evidence.progress is None else self.evidence.progress


class DriveError(DrakeHandError):
    """A drive or the CAN bus does not do what it has to; says which drive (joint and node) and what."""


class DriveTimeout(DriveError, TimeoutError):
    """A drive does not answer, or no frame gets out."""


def nearest(name: object, known: Iterable[str]) -> str:
    """Names the known words, the nearest to `name` first: the ``expected`` of an unknown-name error."""
    known = list(known)
    close = difflib.get_close_matches(str(name), known, n=1, cutoff=0.5)
    listing = ", ".join(known)
    return f"did you mean '{close[0]}'? known: {listing}" if close else f"one of: {listing}"
