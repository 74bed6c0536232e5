"""`Mirror`: listens to the bus and decodes the commands and positions of the drives; never sends a frame.

It understands the PDO convention of `pdo` alone: targets and PVT records are commanded positions, TPDO1 is the measured
one. What was on the bus before it came it cannot know: joints are NaN until they are heard of, and a PVT motion it
joins midway is placed in time by the number of records its drive says are queued.
"""

from __future__ import annotations

import struct
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import can
import numpy as np

from drake_hand.epos import objects as o
from drake_hand.epos import pdo
from drake_hand.epos.bus import when
from drake_hand.epos.drives import Drive, Drives
from drake_hand.epos.record import RunRecord
from drake_hand.epos.sim.pvt import PvtRecord, cubic
from drake_hand.epos.state import BIT12, DriveState, decode_state
from drake_hand.errors import InputError

_RUN = 1 << 4
_BEHIND_S = 0.05
_CLEAR_QUEUE = bytes([0x2F]) + o.IP_BUFFER_CLEAR.index.to_bytes(2, "little") + bytes([o.IP_BUFFER_CLEAR.sub])


@dataclass(frozen=True, kw_only=True)
class HandPose:
    """Both hands at one moment; joints in the order of the drives, NaN where nothing is known."""

    t: float
    """Bus time, s."""
    commanded: np.ndarray
    """(n,) rad."""
    measured: np.ndarray
    """(n,) rad."""
    states: tuple[DriveState, ...] = ()
    """Of each drive, as last heard; UNKNOWN before."""
    current_ma: np.ndarray | None = None
    """(n,) of each motor, as last heard; 0 before; None in a replay."""

    @property
    def error(self) -> np.ndarray:
        """(n,) commanded minus measured, rad; NaN where one is not known."""
        return self.commanded - self.measured


class _Listener:
    """Command and feedback of one drive, in counts.

    Args:
        drive: which.
    """

    def __init__(self, drive: Drive) -> None:
        self._layout, self._type = pdo.LAYOUT[drive.type], drive.type
        self._per_rpm = drive.counts_per_turn / 60
        self.measured = self._target = np.nan
        self.current_ma = 0
        self.state = DriveState.UNKNOWN
        self._latched = 0
        self._word: int | None = None  # no SYNC heard yet: bit 4 may have risen before
        self._queue: deque[PvtRecord] = deque()
        self._started: float | None = None

    def told(self, data: bytes) -> None:
        """A command PDO."""
        word, *target = self._layout.command.unpack(data)
        self._latched = word
        if target:
            self._target = float(target[0])

    def queued(self, data: bytes) -> None:
        """A PVT record."""
        position, rpm, ms = pdo.unpack_record(data)
        self._queue.append(PvtRecord(position, rpm * self._per_rpm, ms * 1e-3))

    def cleared(self) -> None:
        """Its queue was emptied."""
        self._queue.clear()
        self._started = None

    def synced(self, t: float) -> None:
        """SYNC: the command latched before it acts; bit 4 starts the queue."""
        if self._word is not None and self._latched & ~self._word & _RUN and self._queue:
            self._started = t
        self._word = self._latched

    def says(self, data: bytes, t: float) -> None:
        """Its status PDO."""
        word, position, *used = self._layout.status.unpack(data)
        self.measured, self.state = float(position), decode_state(word, self._type)
        if self.state is not DriveState.OPERATION_ENABLED:
            self._started = None
        elif used and word & BIT12 and self._started is None and 0 < used[0] <= len(self._queue):
            while len(self._queue) > used[0]:
                self._queue.popleft()
            self._started = t

    def feels(self, data: bytes) -> None:
        """Its current PDO."""
        (self.current_ma,) = self._layout.current.unpack(data)

    def commanded(self, t: float) -> float:
        """The commanded position at bus time t; NaN if unknown or not enabled."""
        if self.state is not DriveState.OPERATION_ENABLED:
            return np.nan
        if self._started is None:
            return self._target
        while len(self._queue) > 1 and self._queue[0].time and t - self._started >= self._queue[0].time:
            self._started += self._queue[0].time
            self._queue.popleft()
        first = self._queue[0]
        if len(self._queue) > 1 and first.time:
            self._target = cubic(first, self._queue[1], t - self._started)[0]
        else:
            self._target = first.position
            if not first.time:
                self._queue.popleft()
                self._started = None
        return self._target


class Mirror:
    """Decodes frames into poses.

    Args:
        drives: whose bus it is.
    """

    def __init__(self, drives: Drives) -> None:
        self._drives = drives
        self._listeners = [_Listener(d) for d in drives.drives]
        self._wiring: dict[int, tuple[_Listener, str]] = {}
        for listener, drive in zip(self._listeners, drives.drives, strict=True):
            layout = pdo.LAYOUT[drive.type]
            self._wiring[layout.command.cob_id(drive.node)] = listener, "command"
            self._wiring[layout.status.cob_id(drive.node)] = listener, "status"
            self._wiring[layout.current.cob_id(drive.node)] = listener, "current"
            if layout.record:
                self._wiring[layout.record.cob_id(drive.node)] = listener, "record"
                self._wiring[pdo.SDO_RX_BASE + drive.node] = listener, "sdo"

    def hear(self, cob: int, data: bytes, t: float) -> None:
        """Takes a frame off the bus; one that is too short is ignored.

        Args:
            cob: COB-ID.
            data: payload.
            t: when, bus time, s.
        """
        if cob == pdo.SYNC_COB:
            for listener in self._listeners:
                listener.synced(t)
            return
        if cob not in self._wiring:
            return
        listener, kind = self._wiring[cob]
        try:
            if kind == "command":
                listener.told(data)
            elif kind == "status":
                listener.says(data, t)
            elif kind == "current":
                listener.feels(data)
            elif kind == "record" and len(data) == 8:
                listener.queued(data)
            elif data[:4] == _CLEAR_QUEUE:
                listener.cleared()
        except struct.error:
            return

    def pose(self, t: float) -> HandPose:
        """Both hands at bus time t."""
        commanded = np.array([x.commanded(t) for x in self._listeners])
        measured = np.array([x.measured for x in self._listeners])
        return HandPose(
            t=t,
            commanded=self._joints(commanded),
            measured=self._joints(measured),
            states=tuple(x.state for x in self._listeners),
            current_ma=np.array([x.current_ma for x in self._listeners]),
        )

    def _joints(self, counts: np.ndarray) -> np.ndarray:
        """Joint angles; NaN where a drive they depend on was not heard."""
        unknown = np.isnan(counts)
        q = self._drives.joints_from_counts(np.where(unknown, 0.0, counts))
        blurred = np.abs(np.linalg.inv(self._drives.coupling)) @ unknown > 0
        return np.where(blurred, np.nan, q)


def poses_from_bus(bus: can.BusABC, mirror: Mirror, period_s: float) -> Iterator[HandPose]:
    """Poses from the bus as of the last frame, one each `period_s` seconds, until the caller stops asking.

    Only ``bus.recv`` is ever called.
    """
    t = due = time.time()
    while True:
        message = bus.recv(max(due - time.time(), 0.0))
        if message and not (message.is_error_frame or message.is_remote_frame or message.is_extended_id):
            t = when(message)
            mirror.hear(message.arbitration_id, bytes(message.data), t)
        # a machine too busy to keep up shows the newest it has, not what has been waiting
        if time.time() >= due and (message is None or time.time() - t < _BEHIND_S):
            yield mirror.pose(t)
            due = max(due + period_s, time.time())


def poses_from_record(record: RunRecord, period_s: float) -> Iterator[HandPose]:
    """Poses of a recorded run, in its own time.

    Raises:
        InputError: nothing was played in it.
    """
    if not len(record.t):
        raise InputError("the run ended before anything moved", key="run", expected="a record with motion")
    start, t = time.monotonic(), 0.0
    while t <= record.t[-1]:
        k = int(np.searchsorted(record.t, t, side="right")) - 1
        yield HandPose(t=t, commanded=record.commanded[max(k, 0)], measured=record.measured[max(k, 0)])
        time.sleep(max(period_s - (time.monotonic() - start - t), 0.0))
        t = time.monotonic() - start
