"""The clock of a bus: the computer's own, or one that master and simulated drives share, so that both are in step."""

from __future__ import annotations

import math
import mmap
import os
import select
import struct
import time
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import can

_VALUES = struct.Struct("=ddd8s")
_NOW, _PLAN_TIME, _DUE, _PLAN = range(4)
"""Places of 8 bytes."""
_MISSED_S = 0.05
"""Of the computer's time, after which a ring of the bell that was missed is made up for."""
_AWAKE_S = 3e-4
"""Before something is due, its thread no longer sleeps: what sleeps wakes late."""


class Clock(Protocol):
    """What a master reads, s."""

    real: bool
    """Whether it runs by itself, so that a bus thread has to keep up with it."""
    hangs_s: float
    """Seconds of the computer's time without a SYNC after which the bus is given up."""

    def now(self) -> float:
        """The time."""

    def receive(self, bus: can.BusABC, seconds: float) -> can.Message | None:
        """The next frame, waited for so long at most."""

    def tell(self, plan: str, plan_time: float) -> None:
        """Lets the other end know where in a plan, known by its hash, the motion is."""


class OwnClock:
    """The computer's."""

    real, hangs_s = True, 1.0

    def now(self) -> float:
        """The time."""
        return time.monotonic()

    def receive(self, bus: can.BusABC, seconds: float) -> can.Message | None:
        """The next frame; after `seconds` less 0.3 ms at most, so that whoever waits for a time looks at the clock."""
        return bus.recv(max(0.0, seconds - _AWAKE_S))

    def tell(self, plan: str, plan_time: float) -> None:
        """Has no effect: there is no other end."""


OWN = OwnClock()


def clock_of(bus: can.BusABC) -> Clock:
    """The clock of a bus: its own where it has one (see `BusSpec.open`), or the computer's."""
    return getattr(bus, "clock", OWN)


class SharedClock:
    """A clock in a file that both ends map; one of them sets it, and rings a bell when the other's wait is over.

    Args:
        file: exists; see :meth:`create`.
    """

    real, hangs_s = False, 30.0

    def __init__(self, file: Path) -> None:
        with file.open("r+b") as f:
            shared = memoryview(mmap.mmap(f.fileno(), _VALUES.size))
            # struct writes zeros before a value, and the other end reads them; a view writes it at once
            self._values, self._words = shared.cast("d"), shared.cast("Q")
            self.channel = f.read()[_VALUES.size :].decode()
            """Of ``udp_multicast``: the bus that uses this clock."""
        self._bell = os.open(_bell(file), os.O_RDWR | os.O_NONBLOCK)

    @classmethod
    def create(cls, file: Path, channel: str = "") -> SharedClock:
        """Makes the file, of the bus on a channel of ``udp_multicast``, and begins at 0."""
        file.write_bytes(_VALUES.pack(0.0, math.nan, math.inf, b"") + channel.encode())
        os.mkfifo(_bell(file))
        return cls(file)

    def __del__(self) -> None:
        with suppress(AttributeError, OSError):
            os.close(self._bell)

    def now(self) -> float:
        """The time."""
        return self._get(_NOW)

    def receive(self, bus: can.BusABC, seconds: float) -> can.Message | None:
        """The next frame, waited for so long at most: however long that takes whoever sets the clock.

        Args:
            bus: one that can be waited for (``fileno``).
            seconds: of this clock.
        """
        due = self.now() + seconds
        self._put(_DUE, due)
        if self.now() < due:
            select.select([bus.fileno(), self._bell], [], [], _MISSED_S)
        with suppress(BlockingIOError):
            os.read(self._bell, 1)
        return bus.recv(0)

    def set(self, now: float) -> None:
        """Sets the time."""
        self._put(_NOW, now)
        if now >= self._get(_DUE):
            self._put(_DUE, math.inf)
            with suppress(BlockingIOError):
                os.write(self._bell, b"!")

    @property
    def waited_for(self) -> bool:
        """Whether the other end is in `receive`, and its time is not up yet."""
        return self._get(_DUE) < math.inf

    def tell(self, plan: str, plan_time: float) -> None:
        """Lets the other end know where in a plan, known by its hash, the motion is."""
        if not self.tells_of(plan):
            self._put(_PLAN_TIME, math.nan)
            self._words[_PLAN] = _word(plan)
        self._put(_PLAN_TIME, plan_time)

    def tells_of(self, plan: str) -> bool:
        """Whether the last message is about this plan, by its hash."""
        return self._words[_PLAN] == _word(plan)

    @property
    def plan_time(self) -> float:
        """The last message."""
        return self._get(_PLAN_TIME)

    def _get(self, place: int) -> float:
        return self._values[place]

    def _put(self, place: int, value: float) -> None:
        self._values[place] = value


def _word(plan: str) -> int:
    return int.from_bytes(plan[:8].encode(), "little")


def _bell(file: Path) -> Path:
    return file.with_name(file.name + ".bell")
