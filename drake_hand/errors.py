"""The exception tree: what went wrong, where, and which exit status it means."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


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
    ) -> None:
        self.message, self.file, self.key, self.found, self.expected = message, file, key, found, expected
        lines = [message]
        lines += [f"  file:     {file}"] if file is not None else []
        lines += [f"  key:      {key}"] if key is not None else []
        lines += [f"  found:    {found}"] if found is not None else []
        lines += [f"  expected: {expected}"] if expected is not None else []
        super().__init__("\n".join(lines))


class NoPlanFound(DrakeHandError):
    """There is no plan, or none was found in time; says which mode, finger, constraint and pose blocked.

    Args:
        reason: one sentence naming mode, finger, constraint and object pose.
        status: ``infeasible`` or ``timeout``.
        evidence: machine-readable details (mode, finger, constraint, amount, pose, progress).
    """

    def __init__(self, reason: str, *, status: str = "infeasible", evidence: dict | None = None) -> None:
        self.reason, self.status, self.evidence = reason, status, evidence or {}
        super().__init__(reason)


class DriveError(DrakeHandError):
    """A drive or the CAN bus does not do what it has to; says which drive (joint and node) and what."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Names the known words, the nearest to `name` first: the ``expected`` of an unknown-name error."""
    known = list(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    listing = ", ".join(known)
    return f"did you mean '{close[0]}'? known: {listing}" if close else f"one of: {listing}"
