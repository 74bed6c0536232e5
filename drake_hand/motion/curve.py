"""`Curve`: a leg as smooth functions of its parameter, and the limits its time law has to keep."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.plans.path import Leg, Path
from drake_hand.plans.tolerances import STANDARD_GRAVITY, TORQUE_LENGTH_M
from drake_hand.plans.trajectory import poses_with_rates, quaternions, rotations

INERTIA_SHARE = 0.005
"""Largest force along one axis that moving the object may take in plans with contact forces, in weights (torque: in
weights x 10 mm). Those forces balance gravity; this leaves most of the certificate's tolerance to them."""

_GRID_POINTS = 201


@dataclass(frozen=True, kw_only=True)
class RateLimits:
    """Limits of the coordinates of `Curve.rates`: nq joints, and the object's momentum in plans with forces."""

    speed: np.ndarray
    """(nq,) or (nq + 6,) rad/s; the momentum has none."""
    acceleration: np.ndarray
    """(nq,) or (nq + 6,) rad/s^2, N, Nm."""
    mass: float
    p_OCom: np.ndarray
    I_OCom: np.ndarray

    @property
    def weight(self) -> float:
        """Weight of the object on Earth, N."""
        return self.mass * STANDARD_GRAVITY

    @classmethod
    def of(cls, path: Path) -> RateLimits:
        """The hand's limits; the object's inertia is scaled to the mass that the task gives it."""
        body = path.object
        mass = path.task.physics.object_mass_kg or body.mass
        speed, acceleration = path.hand.speed, path.hand.acceleration
        if any(leg.f_W for leg in path.legs) and path.task.options.timing != "fast":
            force = INERTIA_SHARE * mass * STANDARD_GRAVITY
            speed = np.concatenate([speed, np.full(6, np.inf)])
            acceleration = np.concatenate([acceleration, np.full(3, force), np.full(3, force * TORQUE_LENGTH_M)])
        return cls(
            speed=speed,
            acceleration=acceleration,
            mass=mass,
            p_OCom=body.p_OCom,
            I_OCom=body.I_OCom * mass / body.mass,
        )


@dataclass(frozen=True, kw_only=True)
class Touched:
    """Where fingertips touch a polyhedron: at edges contact points turn aside, or jump, and no spline follows them."""

    hand: Hand
    surface: Surface

    @classmethod
    def of(cls, path: Path) -> Touched | None:
        """None where splines do."""
        polyhedral = any(g.kind == "mesh" for g in path.object.geometries)
        return cls(hand=path.hand, surface=Surface.of(path.object)) if polyhedral else None

    def point(self, finger: str, x: np.ndarray) -> np.ndarray:
        """(k, 3) in O, of joints, quaternion and position (k, nq + 7)."""
        found = self.hand.finger(finger)
        p_WC = FingerKinematics.of(self.hand, found).fk(x[:, found.columns])[0]
        R_WO = rotations(x[:, -7:-3])
        return self.surface.closest(np.einsum("kji,kj->ki", R_WO, p_WC - x[:, -3:]))[0]


class Curve:
    """A leg as functions of s in [0, 1]: C2 splines through its knots, forces and offsets linear between them."""

    def __init__(self, leg: Leg, limits: RateLimits, touched: Touched | None = None) -> None:
        self.leg, self.limits, self.nq, self._touched = leg, limits, leg.q.shape[1], touched
        self._s = np.linspace(0.0, 1.0, len(leg.q))
        x = np.hstack([leg.q, quaternions(leg.X_WO[:, :3, :3]), leg.X_WO[:, :3, 3]])
        self._spline = _spline(self._s, np.hstack([x, *leg.p_OP.values()]))
        loads = {f"f_W {name}": f for name, f in (leg.f_W or {}).items()}
        loads |= {"q_offset": leg.q_offset} if leg.q_offset is not None else {}
        self._loads = np.hstack([np.zeros((len(leg.q), 0)), *loads.values()])
        ends = np.cumsum([0, *(load.shape[1] for load in loads.values())]).tolist()
        self._columns = {name: slice(a, b) for name, (a, b) in zip(loads, itertools.pairwise(ends), strict=True)}
        self.moves = bool(np.ptp(x, axis=0).max() > 1e-9)

    def coordinates(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Joints, unit quaternion and position (k, nq + 7), their derivatives in s, and the quantities of the contacts.

        That is ``p_OP <finger>``, ``f_W <finger>`` (k, 3) and ``q_offset`` (k, nq), those the leg has. Forces are
        linear between the leg's knots: that keeps them inside their cones and in balance.
        """
        rows, pose = self._spline(s), self.nq + 7
        x, dx = rows[:, :pose], self._spline(s, 1)[:, :pose]
        quaternion = slice(self.nq, self.nq + 4)
        norm = np.linalg.norm(x[:, quaternion], axis=1, keepdims=True)
        x[:, quaternion] /= norm
        u = x[:, quaternion]
        dx[:, quaternion] = (dx[:, quaternion] - u * np.sum(u * dx[:, quaternion], axis=1, keepdims=True)) / norm
        if self._touched and self.moves:
            points = {f"p_OP {f}": self._touched.point(f, x) for f in self.leg.p_OP}
        else:
            points = {f"p_OP {f}": rows[:, pose + 3 * i : pose + 3 * i + 3] for i, f in enumerate(self.leg.p_OP)}
        loads = linear(s, self._s, self._loads)
        return x, dx, points | {name: loads[:, columns] for name, columns in self._columns.items()}

    @cached_property
    def momentum(self) -> BSpline:
        """(6) linear and angular momentum of the object per unit of ds/dt."""
        s = np.linspace(0.0, 1.0, max(_GRID_POINTS, 4 * len(self._s)))
        x, dx, ddx = (self._spline(s, order)[:, self.nq : self.nq + 7] for order in range(3))
        X, V, _ = poses_with_rates(x, dx, ddx)
        R, w = X[:, :3, :3], V[:, :3]
        force = self.limits.mass * (V[:, 3:] + np.cross(w, R @ self.limits.p_OCom))
        angular = np.einsum("kij,jl,kml,km->ki", R, self.limits.I_OCom, R, w)
        return _spline(s, np.hstack([force, angular]))

    def rates(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k, m) first and second derivatives in s of the limited coordinates: joints and integral of `momentum`.

        Joint rates are those of the splines, which is what joints are commanded to do and what their limits are about.
        The kinematics of `drake_hand.contact.kinematics` give the rates that would keep every contact exactly: along a
        full turn of the pencil they are 5e-5 rad/s off these, and say nothing about free fingers.

        With that integral as a coordinate, force and torque on the object, d(momentum ds/dt)/dt, are an acceleration
        like a joint's. It is left out where the plan has no forces.
        """
        first, second = self._spline(s, 1)[:, : self.nq], self._spline(s, 2)[:, : self.nq]
        if len(self.limits.speed) == self.nq:
            return first, second
        return np.hstack([first, self.momentum(s)]), np.hstack([second, self.momentum(s, 1)])

    def limited(self, s: np.ndarray) -> np.ndarray:
        """(k, m) the coordinates whose derivatives are `rates`."""
        q = self._spline(s)[:, : self.nq]
        return q if len(self.limits.speed) == self.nq else np.hstack([q, self.momentum.antiderivative()(s)])


def linear(s: np.ndarray, knots: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(k, m) rows (n, m) at knots (n,), interpolated linearly."""
    i = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(knots) - 2)
    u = ((s - knots[i]) / (knots[i + 1] - knots[i]))[:, None]
    return rows[i] * (1 - u) + rows[i + 1] * u


def _spline(s: np.ndarray, rows: np.ndarray) -> BSpline:
    """C2 through all rows (not-a-knot); a parabola through three, a line through two."""
    return make_interp_spline(s, rows, k=min(3, len(s) - 1), check_finite=False)
