"""Motor and position servo of a simulated drive: second-order lag under a torque limit.

    x'' = clip(w^2 (r - x) - 2 zeta w x' - h, +-a_max) + l,    h' = (l - h) / T_i

where l is what the joint does to the motor, nothing unless the hand is in physics.
Without feed-forward, so that at steady speed the motor trails its demand by `LAG_S` seconds: the tracking error to
expect.
"""

from __future__ import annotations

import math

from drake_hand.epos.sim.motion import Demand

NATURAL_RAD_S = 2 * math.pi * 25
DAMPING_RATIO = 0.7
LAG_S = 2 * DAMPING_RATIO / NATURAL_RAD_S
"""Lag behind the demand at steady speed, 8.9 ms."""
MAX_ACCELERATION_RAD_S2 = 40_000.0
"""Torque limit over inertia: 4 mNm over twice the rotor's inertia of 0.5e-7 kg m^2."""
ROTOR_INERTIA_KG_M2, TORQUE_CONSTANT_NM_PER_A = 1.0e-7, 19.7e-3
INTEGRAL_S = 0.01
"""Time in which the servo's integral part takes over a load."""
STICTION_NM = 0.6e-3
"""Load [Nm] that the unpowered motor and its gear withstand: fingers that weigh 13 mNm stay, those that press yield.
An assumption."""
COAST_S = 0.02
"""Time constant with which the unpowered motor slows down."""


class Motor:
    """Position and speed at the encoder, in counts and counts/s.

    Args:
        counts_per_turn: quadrature counts.
        position: where it starts.
    """

    def __init__(self, counts_per_turn: int, position: float = 0.0) -> None:
        self.position = position
        self.velocity = 0.0
        self.current_ma = 0.0
        self.stuck = False
        """Fault: the axis does not move whatever the torque."""
        self.slip = 0.0
        """Fault: counts/s by which the motor runs away from its demand."""
        self.load = 0.0
        """What the joint does to the motor, counts/s^2."""
        self._held = 0.0
        """Of the load, what the servo's integral part holds by now."""
        self.origin = 0.0
        """What the encoder shows where the joint's own scale has its zero."""
        self.stops = (-math.inf, math.inf)
        """Where the joint's mechanical stops are, counts on that scale."""
        self._turn = counts_per_turn
        self._friction = STICTION_NM / ROTOR_INERTIA_KG_M2 * counts_per_turn / (2 * math.pi)
        self._limit = MAX_ACCELERATION_RAD_S2 * counts_per_turn / (2 * math.pi)

    @property
    def still(self) -> bool:
        """Whether it is at rest, to a count in a second."""
        return abs(self.velocity) < 1.0

    def count_from(self, position: float) -> None:
        """The encoder shows another position from now on; nothing moves."""
        self.origin += position - self.position
        self.position = position

    def step(self, demand: Demand, dt: float, powered: bool) -> None:
        """Advances by dt seconds."""
        if powered:
            error = demand.position - self.position - self.velocity * dt
            wanted = NATURAL_RAD_S * (NATURAL_RAD_S * error - 2 * DAMPING_RATIO * self.velocity)
            self._held += (self.load - self._held) * min(dt / INTEGRAL_S, 1.0)
            drive = min(max(wanted - self._held, -self._limit), self._limit)
            acceleration = drive + self.load
        else:
            drive = self._held = 0.0
            held = min(abs(self.load), self._friction)
            acceleration = self.load - math.copysign(held, self.load) - self.velocity / COAST_S
        self.current_ma = 1e3 * ROTOR_INERTIA_KG_M2 / TORQUE_CONSTANT_NM_PER_A * drive * 2 * math.pi / self._turn
        if self.stuck:
            self.velocity = 0.0
        elif self.slip and powered:
            self.velocity = demand.velocity + self.slip
            self.position += self.velocity * dt
        else:
            self.velocity += acceleration * dt
            self.position += self.velocity * dt
        low, high = (s + self.origin for s in self.stops)
        if not low <= self.position <= high:
            self.position, self.velocity = min(max(self.position, low), high), 0.0
