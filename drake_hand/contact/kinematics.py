"""Contact kinematics at position, velocity and acceleration level: the object's motion in, the fingers' motion out.

Each finger is its own little robot once the object's motion is given (the paper's key idea). Its submodel says what its
tip has to do; q and v are the whole state, the contact point on the surface follows from them.

Frames: W wrist, O object, T fingertip with the tip centre C as origin. P = C - r nhat is the contact point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_hand.contact.chain import FingerKinematics, cross, material_jacobian, solve_least_squares
from drake_hand.contact.submodel import Model, Submodel
from drake_hand.contact.surface import Surface


@dataclass(frozen=True, kw_only=True)
class ObjectMotion:
    """Pose, twist and spatial acceleration of the object, a row per instant."""

    X_WO: np.ndarray
    """(N, 4, 4)."""
    V_WO: np.ndarray
    """(N, 6) angular velocity, then velocity of O, both in W, rad/s and m/s."""
    A_WO: np.ndarray
    """(N, 6) angular acceleration, then acceleration of O, both in W, rad/s^2 and m/s^2."""

    @classmethod
    def at_rest(cls, X_WO: np.ndarray) -> ObjectMotion:
        """The object standing still at the given poses (N, 4, 4)."""
        still = np.zeros((len(X_WO), 6))
        return cls(X_WO=X_WO, V_WO=still, A_WO=still)


@dataclass(frozen=True, kw_only=True)
class Positions:
    """Joint angles, and the tip centre they put into the object's frame."""

    q: np.ndarray
    """(N, m) rad, within the limits."""
    p_OC: np.ndarray
    """(N, 3) m."""
    residual: np.ndarray
    """(N,) how far the tip centre is from where it was asked to be, m."""


@dataclass(frozen=True, kw_only=True)
class Velocities:
    """Joint rates, and the rate at which the tip centre moves in the object's frame."""

    v: np.ndarray
    """(N, m) rad/s."""
    pdot_OC: np.ndarray
    """(N, 3) m/s."""
    residual: np.ndarray
    """(N,) what of the demanded velocity the finger cannot give, m/s; above rounding only in a singular pose."""


@dataclass(frozen=True, kw_only=True)
class Accelerations:
    """Joint accelerations, and the second derivative of the tip centre in the object's frame."""

    vdot: np.ndarray
    """(N, m) rad/s^2."""
    pddot_OC: np.ndarray
    """(N, 3) m/s^2."""
    residual: np.ndarray
    """(N,) what of the demanded acceleration the finger cannot give, m/s^2."""


@dataclass(frozen=True)
class SubmodelKinematics:
    """One finger in one submodel: the paper's functional block (Figs. 6-8 and 10).

    Rolling comes in two models: ``pivot``, the paper's, holds the tip centre fixed on the expanded surface, so that it
    acts as a spherical joint; ``rolling`` keeps the material points of tip and object at the contact at equal
    velocity (Montana 1988; Murray, Li & Sastry 1994, ch. 5).
    """

    finger: FingerKinematics
    surface: Surface
    submodel: Submodel
    model: Model = "rolling"

    def positions(self, X_WO: np.ndarray, tip: np.ndarray, q0: np.ndarray | None = None) -> Positions:
        """Inverse kinematics at position level (paper, Eqs. 2 and 3).

        Args:
            X_WO: (N, 4, 4) object poses.
            tip: (N, 3) tip centre in m: p_WC of a free finger, else p_OC on the expanded surface. Sliding
                coordinates (s1, s2) become p_OC by `Surface.move` with the tip's radius.
            q0: (N, m) joint angles to start from, rad.
        """
        p_WC = tip if self.submodel is Submodel.FREE else _apply(X_WO, tip)
        q, residual = self.finger.ik(p_WC, q0)
        return Positions(q=q, p_OC=_into(X_WO, self.finger.fk(q)[0]), residual=residual)

    def velocities(self, q: np.ndarray, motion: ObjectMotion, imposed: np.ndarray | None = None) -> Velocities:
        """Inverse kinematics at velocity level (paper, Eq. 4): minimum-norm rates of the joints.

        Args:
            q: (N, m) rad.
            motion: of the object, N rows.
            imposed: a free finger's v_WC (N, 3) in m/s, or a sliding finger's rates of (s1, s2) (N, 2) in m/s along the
                tangents of the expanded surface; rest if not given. Nothing is imposed on a rolling finger.
        """
        now = _Instant(self, q, motion)
        demand = now.demand
        if self.submodel is Submodel.FREE:
            demand = np.zeros_like(demand) if imposed is None else imposed
        elif self.submodel is Submodel.SLIDE and imposed is not None:
            t1, t2 = self.surface.tangents(now.nhat_O)
            demand = demand + _rotate(now.R_WO, t1 * imposed[:, :1] + t2 * imposed[:, 1:])
        v, residual = _solve(now.constraint, demand)
        return Velocities(v=v, pdot_OC=now.relative(v), residual=residual)

    def accelerations(
        self, q: np.ndarray, v: np.ndarray, motion: ObjectMotion, imposed: np.ndarray | None = None
    ) -> Accelerations:
        """Inverse kinematics at acceleration level: the constraint of `velocities`, differentiated.

        Args:
            q: (N, m) rad.
            v: (N, m) rad/s, as from `velocities`.
            motion: of the object, N rows.
            imposed: a free finger's acceleration of C in W (N, 3), or the second derivatives of (s1, s2) (N, 2), m/s^2;
                zero if not given.
        """
        now = _Instant(self, q, motion)
        w, alpha, a = now.w, motion.A_WO[:, :3], motion.A_WO[:, 3:]
        pdot_OC = now.relative(v)
        pdot_W = _rotate(now.R_WO, pdot_OC)
        bias, bias_w = self.finger.bias(q, v)
        # Acceleration of C were its motion in O uniform.
        carried = a + cross(alpha, now.arm) + cross(w, cross(w, now.arm)) + 2 * cross(w, pdot_W)
        demand = carried - bias
        if self.submodel is Submodel.FREE:
            demand = -bias if imposed is None else imposed - bias
        elif self.rolls:
            # d/dt of v_C - w_T x r n = v_O + w x (P - O); P travels over both surfaces, so its own velocity counts.
            r = self.finger.finger.radius
            ndot = cross(w, now.lever) / r + _rotate(now.R_WO, self._normal_rate(now, pdot_OC))
            v_P = now.carried + pdot_W - r * ndot
            demand = a + cross(alpha, now.arm - now.lever) + cross(w, v_P - motion.V_WO[:, 3:])
            demand += cross(np.einsum("nij,nj->ni", now.tip[2], v), r * ndot) + cross(bias_w, now.lever) - bias
        elif self.submodel is Submodel.SLIDE:
            t1, t2 = self.surface.tangents(now.nhat_O)
            t1dot, t2dot = self.surface.tangent_rates(now.nhat_O, self._normal_rate(now, pdot_OC))
            pddot_OC = t1dot * _dot(t1, pdot_OC) + t2dot * _dot(t2, pdot_OC)
            if imposed is not None:
                pddot_OC += t1 * imposed[:, :1] + t2 * imposed[:, 1:]
            demand = demand + _rotate(now.R_WO, pddot_OC)
        vdot, residual = _solve(now.constraint, demand)
        relative = _unrotate(now.R_WO, np.einsum("nij,nj->ni", now.tip[1], vdot) + bias - carried)
        return Accelerations(vdot=vdot, pddot_OC=relative, residual=residual)

    @property
    def rolls(self) -> bool:
        """Whether the tip truly rolls: neither free nor sliding, nor the pivot of the paper."""
        return self.submodel is Submodel.ROLL and self.model == "rolling"

    def _normal_rate(self, now: _Instant, pdot_OC: np.ndarray) -> np.ndarray:
        """Rate of nhat_O (N, 3) when C moves over the expanded surface."""
        return np.einsum("nij,nj->ni", self.surface.curvature(now.p_OC), pdot_OC)


def slip_velocity(
    finger: FingerKinematics, surface: Surface, q: np.ndarray, v: np.ndarray, motion: ObjectMotion
) -> np.ndarray:
    """Velocity of the tip's material relative to the object's at the contact point, (N, 3) in W, m/s.

    Zero when rolling; along the surface when sliding; along the normal when contact is made or broken.

    Args:
        finger: whose tip it is.
        surface: of the object.
        q: (N, m) rad.
        v: (N, m) rad/s.
        motion: of the object, N rows.
    """
    now = _Instant(SubmodelKinematics(finger, surface, Submodel.ROLL), q, motion)
    return np.einsum("nij,nj->ni", now.constraint, v) - now.demand


@dataclass(frozen=True)
class _Instant:
    """What a finger and the object have in common at given q, batched, in W unless named otherwise."""

    block: SubmodelKinematics
    q: np.ndarray
    motion: ObjectMotion

    @cached_property
    def tip(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """p_WC, J, Jw."""
        p_WC, _, J, Jw = self.block.finger.jacobian(self.q)
        return p_WC, J, Jw

    @property
    def R_WO(self) -> np.ndarray:
        return self.motion.X_WO[:, :3, :3]

    @property
    def w(self) -> np.ndarray:
        """Angular velocity of the object."""
        return self.motion.V_WO[:, :3]

    @cached_property
    def arm(self) -> np.ndarray:
        """From O to C."""
        return self.tip[0] - self.motion.X_WO[:, :3, 3]

    @cached_property
    def p_OC(self) -> np.ndarray:
        return _unrotate(self.R_WO, self.arm)

    @cached_property
    def nhat_O(self) -> np.ndarray:
        return self.block.surface.closest(self.p_OC)[1]

    @cached_property
    def lever(self) -> np.ndarray:
        """From P to C."""
        return self.block.finger.finger.radius * _rotate(self.R_WO, self.nhat_O)

    @cached_property
    def carried(self) -> np.ndarray:
        """Velocity that C would have if it were fixed in the object."""
        return self.motion.V_WO[:, 3:] + cross(self.w, self.arm)

    def relative(self, v: np.ndarray) -> np.ndarray:
        """pdot_OC at joint rates v (N, m)."""
        return _unrotate(self.R_WO, np.einsum("nij,nj->ni", self.tip[1], v) - self.carried)

    @cached_property
    def constraint(self) -> np.ndarray:
        """A (N, 3, m): A v is the velocity of C, or of the tip's material at P where it rolls."""
        _, J, Jw = self.tip
        return material_jacobian(J, Jw, self.lever) if self.block.rolls else J

    @cached_property
    def demand(self) -> np.ndarray:
        """Velocity of the object's material at C, or at P where the tip rolls."""
        return self.carried - cross(self.w, self.lever) if self.block.rolls else self.carried


def _solve(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum-norm x (N, m) of A x = b and the length (N,) of the residual.

    A is inverted in closed form; rows where that fails, because the finger is singular there or has fewer than three
    joints, get the least-squares solution by singular values.
    """
    x = solve_least_squares(A, b)
    left = np.linalg.norm(np.einsum("nij,nj->ni", A, x) - b, axis=1)
    failed = ~(left <= 1e-9 * np.linalg.norm(b, axis=1))
    if failed.any():
        x[failed] = np.einsum("nij,nj->ni", np.linalg.pinv(A[failed], rcond=1e-6), b[failed])
        left[failed] = np.linalg.norm(np.einsum("nij,nj->ni", A[failed], x[failed]) - b[failed], axis=1)
    return x, left


def _rotate(R: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", R, a)


def _unrotate(R: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.einsum("nji,nj->ni", R, a)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, 1), to scale vectors by."""
    return np.einsum("ni,ni->n", a, b)[:, None]


def _apply(X: np.ndarray, p: np.ndarray) -> np.ndarray:
    return _rotate(X[:, :3, :3], p) + X[:, :3, 3]


def _into(X: np.ndarray, p: np.ndarray) -> np.ndarray:
    return _unrotate(X[:, :3, :3], p - X[:, :3, 3])
