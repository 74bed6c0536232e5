"""Set-point generators of a simulated drive: hold, ramp, trapezoidal profile, cyclic and stepwise positions.

Positions in counts, speeds in counts/s, as floats; a generator moves the demand by one step of the drive's own clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol


@dataclass(slots=True)
class Demand:
    """What the servo is asked for."""

    position: float = 0.0
    velocity: float = 0.0


class Generator(Protocol):
    """Moves the demand."""

    done: bool
    """Whether it has arrived: nothing moves any more until the next command."""

    def step(self, demand: Demand, dt: float) -> None:
        """Advances by dt seconds."""


class Standstill:
    """Stays where the demand is."""

    done = True

    def step(self, demand: Demand, dt: float) -> None:
        """Advances by dt seconds."""
        demand.velocity = 0.0


class Ramp:
    """Slows down to rest.

    Args:
        deceleration: counts/s^2.
    """

    def __init__(self, deceleration: float) -> None:
        self._deceleration = deceleration
        self.done = False

    def step(self, demand: Demand, dt: float) -> None:
        """Advances by dt seconds."""
        before = demand.velocity
        demand.velocity = math.copysign(max(abs(before) - self._deceleration * dt, 0.0), before)
        demand.position += 0.5 * (before + demand.velocity) * dt
        self.done = demand.velocity == 0.0


class Profile:
    """Trapezoidal speed to a target.

    Args:
        target: counts.
        speed: counts/s.
        acceleration: counts/s^2.
        deceleration: counts/s^2.
    """

    def __init__(self, target: float, *, speed: float, acceleration: float, deceleration: float) -> None:
        self.target = target
        self._speed, self._acceleration, self._deceleration = speed, acceleration, deceleration
        self.done = False

    def step(self, demand: Demand, dt: float) -> None:
        """Advances by dt seconds."""
        to_go = self.target - demand.position
        # the speed from which one can still stop in time, in steps of dt
        half = 0.5 * self._deceleration * dt
        braking = math.sqrt(half * half + 2 * self._deceleration * abs(to_go)) - half
        wanted = math.copysign(min(self._speed, braking), to_go)
        faster = abs(wanted) > abs(demand.velocity)
        limit = (self._acceleration if faster else self._deceleration) * dt
        velocity = demand.velocity + min(max(wanted - demand.velocity, -limit), limit)
        if abs(to_go) <= max(abs(velocity) * dt, 0.5) and abs(velocity) <= 2 * self._deceleration * dt:
            demand.position, demand.velocity, self.done = self.target, 0.0, True
        else:
            demand.position, demand.velocity = demand.position + velocity * dt, velocity


class Homing:
    """Seeks a stop, recognised by the motor's current, and moves off it again; or takes the place for what it is.

    Args:
        side: direction of the stop, 1 or -1; 0 does not move.
        speed: counts/s.
        acceleration: counts/s^2.
        offset: how far to move off the stop, counts.
        stop: where the motor is while its current indicates a stop; None while it does not.
    """

    def __init__(
        self, side: int, *, speed: float, acceleration: float, offset: float, stop: Callable[[], float | None]
    ) -> None:
        self.done = side == 0
        self._side, self._speed, self._acceleration, self._offset = side, speed, acceleration, offset
        self._stop = stop
        self._back: Profile | None = None

    def step(self, demand: Demand, dt: float) -> None:
        """Advances by dt seconds."""
        if self._back:
            self._back.step(demand, dt)
            self.done = self._back.done
        elif self.done:
            return
        elif (at := self._stop()) is not None:
            demand.position, demand.velocity, a = at, 0.0, self._acceleration
            self._back = Profile(at - self._side * self._offset, speed=self._speed, acceleration=a, deceleration=a)
        else:
            demand.velocity = self._side * min(self._speed, abs(demand.velocity) + self._acceleration * dt)
            demand.position += demand.velocity * dt


class CyclicMotion:
    """Follows targets, reaching each within the interpolation time; a time of 0 jumps (maxon's position mode).

    A time other than the SYNC period makes speed steps within each period, as on the drive.
    """

    def __init__(self) -> None:
        self.done = True
        self._left = self._rate = 0.0
        self.target: float | None = None

    def aim(self, target: float, demand: Demand, period: float) -> None:
        """Takes a new target [counts] to be reached in `period` seconds."""
        self.target, self._left, self.done = target, period, period == 0.0
        if period:
            self._rate = (target - demand.position) / period
        else:
            demand.position, demand.velocity = target, 0.0

    def step(self, demand: Demand, dt: float) -> None:
        """Advances by dt seconds."""
        if self._left > 1e-9:
            part = min(dt, self._left)
            demand.position += self._rate * part
            demand.velocity = self._rate
            self._left -= part
        else:
            demand.velocity, self.done = 0.0, True
