"""Ctrl-C ends a command once, whatever it interrupts.

Compiled code may swallow a `KeyboardInterrupt`, or raise another error in its place; cleaning up takes a moment, in
which people press Ctrl-C again. A library that is interrupted while it is being imported prints its stack (extension
modules) or takes its own imports to be missing (trimesh): its import is completed first.
"""

from __future__ import annotations

import signal
import sys
import time
from importlib.machinery import ExtensionFileLoader, SourceFileLoader
from types import FrameType

_APART_S = 1.0
"""Ctrl-C sooner after the last is the same wish."""
_LATER_S = 0.02
"""Until it is tried again where it may not be raised."""
_LOADERS, _LOAD = (SourceFileLoader, ExtensionFileLoader), ("create_module", "exec_module")
"""Who runs a module's code, and in which methods."""
_last_s: float | None = None
"""When it was last heard, by `time.monotonic`."""
_waits = False
"""Whether it was heard during an import, and is still to be raised."""


def heed() -> None:
    """From now on Ctrl-C raises `KeyboardInterrupt`, at most once a second; for the process of a command."""
    signal.signal(signal.SIGINT, _hear)


def ignore() -> None:
    """From now on nothing disturbs the end of the process."""
    if _last_s is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def heard() -> bool:
    """Whether Ctrl-C was pressed."""
    return _last_s is not None


def insist() -> None:
    """Where a long job may safely end.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed, and swallowed.
    """
    if heard():
        raise KeyboardInterrupt


def _hear(_: int, frame: FrameType | None) -> None:
    global _last_s, _waits
    sys.unraisablehook = _unsaid
    now = time.monotonic()
    again, _last_s = not _waits and _last_s is not None and now - _last_s < _APART_S, now
    if again:
        return
    _waits = _imports_library(frame)
    if not _waits:
        raise KeyboardInterrupt
    signal.signal(signal.SIGALRM, _hear_again)
    signal.setitimer(signal.ITIMER_REAL, _LATER_S)


def _hear_again(_: int, __: FrameType | None) -> None:
    signal.raise_signal(signal.SIGINT)  # to whoever hears it now


def _unsaid(_: object) -> None:
    """Of Ctrl-C in a destructor or in a callback of compiled code, where it cannot be raised, Python prints a stack."""


def _imports_library(frame: FrameType | None) -> bool:
    """Whether a module that is not of this package is being imported."""
    while frame is not None:
        loader = frame.f_locals.get("self") if frame.f_code.co_name in _LOAD else None
        if isinstance(loader, _LOADERS) and not loader.name.startswith("drake_hand"):
            return True
        frame = frame.f_back
    return False
