"""The clock of a bus: the computer's own, or one that master and simulated drives share, so that both are in step."""

from __future__ import annotations

import math
import mmap
import struct
import time
from pathlib import Path
from typing import Protocol

_VALUES = struct.Struct("<dd")
_POLL_S = 5e-4


class Clock(Protocol):
    """What a master reads, s."""

    hangs_s: float
    """Seconds of the computer's time without a SYNC after which the bus is given up."""

    def now(self) -> float:
        """The time."""

    def wait(self, seconds: float) -> float:
        """How long to wait, in the computer's time, before looking again whether so much has passed."""

    def tell(self, plan_time: float) -> None:
        """Lets the other end know where in the plan the motion is; NaN when it is in none."""


class OwnClock:
    """The computer's."""

    hangs_s = 1.0

    def now(self) -> float:
        """The time."""
        return time.monotonic()

    def wait(self, seconds: float) -> float:
        """As long."""
        return seconds

    def tell(self, plan_time: float) -> None:
        """Nobody listens."""


OWN = OwnClock()


class SharedClock:
    """A clock in a file that both ends map; one of them sets it.

    Args:
        file: exists; see :meth:`create`.
    """

    hangs_s = 30.0

    def __init__(self, file: Path) -> None:
        with file.open("r+b") as f:
            self._map = mmap.mmap(f.fileno(), _VALUES.size)

    @classmethod
    def create(cls, file: Path) -> SharedClock:
        """Makes the file and begins at 0."""
        file.write_bytes(_VALUES.pack(0.0, math.nan))
        return cls(file)

    def now(self) -> float:
        """The time."""
        return _VALUES.unpack_from(self._map)[0]

    def wait(self, seconds: float) -> float:
        """Until it is worth looking again: whoever sets the clock decides how fast it goes."""
        return min(seconds, _POLL_S)

    def set(self, now: float) -> None:
        """It is that late."""
        struct.pack_into("<d", self._map, 0, now)

    def tell(self, plan_time: float) -> None:
        """Lets the other end know where in the plan the motion is; NaN when it is in none."""
        struct.pack_into("<d", self._map, 8, plan_time)

    @property
    def plan_time(self) -> float:
        """What was told last."""
        return _VALUES.unpack_from(self._map)[1]
