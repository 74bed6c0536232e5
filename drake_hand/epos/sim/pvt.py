"""PVT queue of a simulated EPOS2: 64 records, cubic splines, warnings and errors (0x20C1, 0x20C4, 0x60C4)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from drake_hand.epos.objects import IP_DEPTH, IP_ERRORS
from drake_hand.epos.sim.motion import Demand

UNDERFLOW_WARNING, OVERFLOW_WARNING, VELOCITY_WARNING, ACCELERATION_WARNING = 1 << 0, 1 << 1, 1 << 2, 1 << 3
UNDERFLOW, OVERFLOW, VELOCITY, ACCELERATION = 1 << 8, 1 << 9, 1 << 10, 1 << 11
ENABLED, ACTIVE = 1 << 14, 1 << 15


@dataclass(slots=True)
class Limits:
    """Levels and limits the queue watches; speeds in counts/s, accelerations in counts/s^2."""

    underflow_level: int
    overflow_level: int
    speed_warning: float
    speed: float
    acceleration_warning: float
    acceleration: float


@dataclass(slots=True)
class PvtRecord:
    """Position [counts] and speed [counts/s] at a moment; seconds to the next record, 0 at the last."""

    position: float
    velocity: float
    time: float


def cubic(a: PvtRecord, b: PvtRecord, t: float) -> tuple[float, float]:
    """Position and speed t seconds into the cubic from a to b."""
    T = a.time
    d = (b.position - a.position) / T
    c2 = (3 * d - 2 * a.velocity - b.velocity) / T
    c3 = (a.velocity + b.velocity - 2 * d) / (T * T)
    return a.position + t * (a.velocity + t * (c2 + t * c3)), a.velocity + t * (2 * c2 + 3 * c3 * t)


def end_accelerations(a: PvtRecord, b: PvtRecord) -> tuple[float, float]:
    """Acceleration at both ends of the cubic from a to b, where it is largest."""
    T = a.time
    d = (b.position - a.position) / T
    return (6 * d - 4 * a.velocity - 2 * b.velocity) / T, (2 * a.velocity + 4 * b.velocity - 6 * d) / T


class PvtQueue:
    """FIFO of records and the generator that plays it."""

    def __init__(self) -> None:
        self.limits = Limits(4, 60, float("inf"), float("inf"), float("inf"), float("inf"))
        self.active = self.done = False
        self._records: deque[PvtRecord] = deque()
        self._enabled = False
        self._flags = 0
        self._into = 0.0

    @property
    def used(self) -> int:
        """Records queued, the one that is being left included."""
        return len(self._records)

    @property
    def accepts(self) -> bool:
        """Whether input is enabled."""
        return self._enabled

    @property
    def failed(self) -> bool:
        """Whether an error is set."""
        return bool(self._flags & IP_ERRORS)

    @property
    def status(self) -> int:
        """0x20C4:01."""
        word = self._flags
        if self.active and self.used < self.limits.underflow_level:
            word |= UNDERFLOW_WARNING
        if self.used > self.limits.overflow_level:
            word |= OVERFLOW_WARNING
        return word | (ENABLED if self._enabled else 0) | (ACTIVE if self.active else 0)

    def clear(self, enable: bool) -> None:
        """Empties the queue and its errors; then takes records, or not (0x60C4:06 = 1 or 0)."""
        self._records.clear()
        self._flags, self._enabled, self._into = 0, enable, 0.0

    def push(self, record: PvtRecord) -> None:
        """Takes a record, as far as it fits and input is enabled; sets warnings and errors."""
        if not self._enabled:
            return
        if len(self._records) >= IP_DEPTH:
            self._flags |= OVERFLOW
            return
        self._check(abs(record.velocity), self.limits.speed_warning, self.limits.speed, VELOCITY_WARNING, VELOCITY)
        if self._records and self._records[-1].time:
            peak = max(map(abs, end_accelerations(self._records[-1], record)))
            limits = self.limits
            self._check(peak, limits.acceleration_warning, limits.acceleration, ACCELERATION_WARNING, ACCELERATION)
        self._records.append(record)

    def _check(self, value: float, warn: float, limit: float, warning: int, error: int) -> None:
        self._flags |= (warning if value > warn else 0) | (error if value > limit else 0)

    def start(self) -> None:
        """Begins to play; too few records set the underflow error."""
        self.active, self.done, self._into = True, False, 0.0
        ends_at_once = bool(self._records) and not self._records[0].time
        if len(self._records) < 2 and not ends_at_once:
            self._flags |= UNDERFLOW

    def stop(self) -> None:
        """Leaves the motion: the queue stays, nothing plays it."""
        self.active = False

    def step(self, demand: Demand, dt: float) -> None:
        """Advances by dt seconds; on an error the demand keeps its speed, the fault reaction slows it down."""
        if not self.active:
            demand.velocity = 0.0
            return
        self._into += dt
        records = self._records
        while len(records) >= 2 and records[0].time and self._into >= records[0].time:
            self._into -= records[0].time
            records.popleft()
        if records and not records[0].time:
            demand.position, demand.velocity = records[0].position, 0.0
            records.popleft()
            self.active, self.done = False, True
        elif len(records) < 2:
            self._flags |= UNDERFLOW
            demand.position += demand.velocity * dt
        else:
            demand.position, demand.velocity = cubic(records[0], records[1], self._into)
