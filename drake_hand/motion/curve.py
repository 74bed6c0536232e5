"""`Curve`: a leg as smooth functions of its parameter, and the limits its time law has to keep."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from drake_hand.motion.trajectory import poses, quaternions
from drake_hand.planning.path import Leg, Path

INERTIA_SHARE = 0.005
"""Largest force along one axis that moving the object may take in plans with contact forces, in weights (torque: in
weights x 10 mm). Those forces balance gravity; this leaves most of the certificate's tolerance to them."""

_G, _TORQUE_LENGTH = 9.81, 0.01
_GRID = 201


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of the coordinates of `Curve.rates`: nq joints, then the object's momentum."""

    speed: np.ndarray
    """(nq + 6,) rad/s; the momentum has none."""
    acceleration: np.ndarray
    """(nq + 6,) rad/s^2, N, Nm; the last six are infinite in plans without forces."""
    mass: float
    p_OCom: np.ndarray
    I_OCom: np.ndarray

    @classmethod
    def of(cls, path: Path) -> Limits:
        """The hand's limits; the object's inertia goes with the mass the task gives it."""
        body = path.object
        mass = path.task.physics.object_mass_kg or body.mass
        force = INERTIA_SHARE * mass * _G if any(leg.f_W for leg in path.legs) else np.inf
        return cls(
            speed=np.concatenate([path.hand.speed, np.full(6, np.inf)]),
            acceleration=np.concatenate([path.hand.acceleration, [force] * 3, [force * _TORQUE_LENGTH] * 3]),
            mass=mass,
            p_OCom=body.p_OCom,
            I_OCom=body.I_OCom * mass / body.mass,
        )


class Curve:
    """A leg as functions of s in [0, 1]: C2 splines through its knots, forces and offsets linear between them."""

    def __init__(self, leg: Leg, limits: Limits) -> None:
        self.leg, self.limits, self.nq = leg, limits, leg.q.shape[1]
        self._s = np.linspace(0.0, 1.0, len(leg.q))
        x = np.hstack([leg.q, quaternions(leg.X_WO[:, :3, :3]), leg.X_WO[:, :3, 3]])
        self._x = CubicSpline(self._s, x)
        self._points = {name: CubicSpline(self._s, p) for name, p in leg.p_OP.items()}
        self.moves = bool(np.ptp(x, axis=0).max() > 1e-9)

    def coordinates(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k, nq + 7) joints, unit quaternion and position, and their derivatives in s."""
        x, dx = self._x(s), self._x(s, 1)
        quaternion = slice(self.nq, self.nq + 4)
        norm = np.linalg.norm(x[:, quaternion], axis=1, keepdims=True)
        x[:, quaternion] /= norm
        u = x[:, quaternion]
        dx[:, quaternion] = (dx[:, quaternion] - u * np.sum(u * dx[:, quaternion], axis=1, keepdims=True)) / norm
        return x, dx

    def contacts(self, s: np.ndarray) -> dict[str, np.ndarray]:
        """``p_OP <finger>``, ``f_W <finger>`` (k, 3) and ``q_offset`` (k, nq), those the leg has.

        Forces are linear between the leg's knots: that keeps them inside their cones and in balance.
        """
        rows = {f"p_OP {name}": spline(s) for name, spline in self._points.items()}
        loads = {f"f_W {name}": f for name, f in (self.leg.f_W or {}).items()}
        loads |= {"q_offset": self.leg.q_offset} if self.leg.q_offset is not None else {}
        return rows | {name: make_interp_spline(self._s, load, k=1)(s) for name, load in loads.items()}

    @cached_property
    def momentum(self) -> CubicSpline:
        """(6) linear and angular momentum of the object per unit of ds/dt."""
        s = np.linspace(0.0, 1.0, max(_GRID, 4 * len(self._s)))
        x, dx, ddx = (self._x(s, order)[:, self.nq :] for order in range(3))
        X, V, _ = poses(x, dx, ddx)
        R, w = X[:, :3, :3], V[:, :3]
        linear = self.limits.mass * (V[:, 3:] + np.cross(w, R @ self.limits.p_OCom))
        angular = np.einsum("kij,jl,kml,km->ki", R, self.limits.I_OCom, R, w)
        return CubicSpline(s, np.hstack([linear, angular]))

    def rates(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k, nq + 6) first and second derivatives in s of the joints and of the integral of `momentum`.

        With that integral as a coordinate, force and torque on the object, d(momentum ds/dt)/dt, are an acceleration
        like a joint's.
        """
        first = np.hstack([self._x(s, 1)[:, : self.nq], self.momentum(s)])
        second = np.hstack([self._x(s, 2)[:, : self.nq], self.momentum(s, 1)])
        return first, second

    def sampled(self, s: np.ndarray) -> np.ndarray:
        """(k, nq + 6) the coordinates whose derivatives are `rates`."""
        return np.hstack([self._x(s)[:, : self.nq], self.momentum.antiderivative()(s)])
