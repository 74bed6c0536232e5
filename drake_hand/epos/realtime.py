"""What keeps a bus in time, where the system allows: real-time priority (root or an rtprio limit), awake processors."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_BUS_PRIORITY, _REST_PRIORITY = 10, 5
_SWITCH_S = 5e-4
"""Longest time another thread keeps the interpreter from the bus thread."""
_LATENCY_FILE = Path("/dev/cpu_dma_latency")
"""Linux: while it is open, idle processors take at most so long to wake as was written, us (PM Quality Of Service)."""


def claim() -> bool:
    """Gives the calling thread real-time priority; whether that was allowed."""
    return _set(0, _BUS_PRIORITY)


def _set(thread: int, priority: int) -> bool:
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
        return True
    return False


@contextmanager
def quiet_interpreter() -> Iterator[None]:
    """While others depend on a bus thread, keeps the rest of this process from holding the interpreter for long.

    No garbage collection over what exists already (half a second, in a program that has loaded much); short turns; and
    real-time priority for every thread, since one that waits for a processor while it holds the interpreter would hold
    up the bus thread too.
    """
    switch = sys.getswitchinterval()
    raised = [thread for thread in _ordinary_threads() if _set(thread, _REST_PRIORITY)]
    gc.freeze()
    sys.setswitchinterval(_SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(switch)
        gc.unfreeze()
        for thread in raised:
            with suppress(OSError):
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def awake_processors() -> Iterator[None]:
    """Keeps idle processors from sleeping: to wake one takes a tenth of a millisecond, on a virtual machine several."""
    try:
        file = _LATENCY_FILE.open("wb", buffering=0)
    except OSError:
        yield
        return
    with file:
        file.write(bytes(4))
        yield


def _ordinary_threads() -> list[int]:
    """Threads of this process without real-time priority (Linux)."""
    found = []
    with suppress(OSError, AttributeError):
        for name in os.listdir("/proc/self/task"):
            with suppress(OSError):
                if os.sched_getscheduler(int(name)) == os.SCHED_OTHER:
                    found.append(int(name))
    return found
