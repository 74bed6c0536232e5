"""Processes as /proc shows them: who descends from whom, who is at work, who is left."""

import os
from contextlib import suppress
from pathlib import Path


def descendants(pid):
    """Ids of all that descend from a process."""
    found, todo = [], [pid]
    while todo:
        with suppress(OSError):  # it may have ended
            for file in Path("/proc", str(todo.pop()), "task").glob("*/children"):
                children = [int(p) for p in file.read_text().split()]
                found, todo = found + children, todo + children
    return found


def at_work(pid):
    """Those that descend from a process and have got beyond their imports, which take 2 s of processor time."""
    return [p for p in descendants(pid) if _cpu_s(p) > 3.0]


def alive(pids):
    """Those that run; one that has ended and was not yet asked for its status does not."""
    return [p for p in pids if (fields := _stat(p)) and fields[0] != "Z"]


def _cpu_s(pid):
    fields = _stat(pid)
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") if fields else 0.0


def _stat(pid):
    """Fields from the state on; none of a process that is gone."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return []
