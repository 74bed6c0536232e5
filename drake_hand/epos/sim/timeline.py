"""Timeline of simulated drives: JSON lines of status words and positions at each SYNC, and of what happened between.

The first line is a `Header`; a line with ``status`` is a `Row`, at a SYNC or (``sync`` null) where none came for a
while; every other line is a `TimelineEvent`. Times are bus times, s since the epoch.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.drive import SimulatedDrive

_FLUSH_ROWS = 50


class Header(msgspec.Struct, kw_only=True):
    """Order of the columns."""

    joints: list[str]
    nodes: list[int]
    types: list[str]


class Row(msgspec.Struct, kw_only=True):
    """All drives at one moment; positions in counts."""

    t: float
    sync: int | None
    status: list[int]
    position: list[float]
    demand: list[float]


class TimelineEvent(msgspec.Struct, kw_only=True):
    """What happened at a drive (or to all: joint empty)."""

    t: float
    event: str
    """``state``, ``emcy``, ``boot``, ``fault`` (one was injected) or ``mark`` (boot, enabled, motion)."""
    joint: str
    what: str


class Timeline:
    """Writes the lines; nothing without a file."""

    def __init__(self, file: Path | None, drives: Drives) -> None:
        self._out = file.open("wb") if file else None
        self._rows = 0
        self._syncs = 0
        self._encoder = msgspec.json.Encoder()
        self._write(
            Header(joints=list(drives.joints), nodes=list(drives.nodes), types=[str(d.type) for d in drives.drives])
        )

    def _write(self, line: msgspec.Struct) -> None:
        if self._out:
            self._out.write(self._encoder.encode(line) + b"\n")

    def row(self, t: float, simulated: Sequence[SimulatedDrive], *, synced: bool) -> None:
        """All drives at time t."""
        self._syncs += synced
        if self._out is None:
            return
        self._write(
            Row(
                t=t,
                sync=self._syncs if synced else None,
                status=[s.machine.statusword() for s in simulated],
                position=[round(s.axis.motor.position, 2) for s in simulated],
                demand=[round(s.axis.demand.position, 2) for s in simulated],
            )
        )
        self._rows += 1
        if self._rows % _FLUSH_ROWS == 0:
            self._out.flush()

    def event(self, t: float, event: str, joint: str, what: str) -> None:
        """Something happened."""
        self._write(TimelineEvent(t=t, event=event, joint=joint, what=what))
        if self._out:
            self._out.flush()

    def close(self) -> None:
        """Ends the file."""
        if self._out:
            self._out.close()
            self._out = None
