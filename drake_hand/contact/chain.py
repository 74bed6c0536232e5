"""Batched kinematics of one finger in plain numpy: forward, Jacobian, inverse, over 10^4 to 10^6 rows at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from drake_hand.model.hand import Finger, Hand


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product over the last axis; several times quicker than np.cross on many short vectors."""
    a1, a2, a3 = a[..., 0], a[..., 1], a[..., 2]
    b1, b2, b3 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1], axis=-1)


def skew(a: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3) with skew(a) @ b = a x b."""
    out = np.zeros((*a.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = a[..., 2], -a[..., 1], a[..., 0]
    return out


def solve_least_squares(A: np.ndarray, b: np.ndarray, damping: float = 0.0) -> np.ndarray:
    """Minimum-norm x of A x = b, batched: x = A^T (A A^T + damping^2 I)^-1 b by the 3x3 adjugate.

    Args:
        A: (N, 3, m).
        b: (N, 3).
        damping: keeps x bounded near singularities (damped least squares; Wampler 1986).

    Returns:
        (N, m); a singular row without damping gives large numbers, never an exception.
    """
    M = A @ A.transpose(0, 2, 1)
    if damping:
        M[:, [0, 1, 2], [0, 1, 2]] += damping**2
    r0, r1, r2 = M[:, 0], M[:, 1], M[:, 2]
    c0, c1, c2 = cross(r1, r2), cross(r2, r0), cross(r0, r1)
    det = np.einsum("ni,ni->n", r0, c0)
    det = np.where(np.abs(det) < 1e-30, 1e-30, det)
    y = (c0 * b[:, :1] + c1 * b[:, 1:2] + c2 * b[:, 2:]) / det[:, None]
    return np.einsum("nij,ni->nj", A, y)


@dataclass(frozen=True)
class FingerKinematics:
    """Kinematics of a finger in its m commanded joints; coupled joints are folded in.

    C is the tip centre, T the tip frame with C as origin, W the wrist (palm) frame.
    """

    finger: Finger
    lower: np.ndarray
    """(m,) rad."""
    upper: np.ndarray

    @classmethod
    def of(cls, hand: Hand, finger: Finger) -> FingerKinematics:
        """The kinematics of one finger of a hand, with the hand's joint limits."""
        return cls(finger, hand.q_lower[finger.columns], hand.q_upper[finger.columns])

    @cached_property
    def _motions(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Per axis, R_PJ @ rotation(q) = A + sin(q) B + cos(q) C (Rodrigues), and p_PJ."""
        out = []
        for axis in self.finger.axes:
            R, a = axis.X_PJ[:3, :3], axis.axis
            aa = np.outer(a, a)
            if axis.prismatic:
                out.append((R, np.zeros((3, 3)), np.zeros((3, 3)), axis.X_PJ[:3, 3]))
            else:
                out.append((R @ aa, R @ skew(a), R @ (np.eye(3) - aa), axis.X_PJ[:3, 3]))
        return out

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frames of all moving joints (after their motion).

        Args:
            q: (N, m) rad.

        Returns:
            p_WJ (n_axes, N, 3) in m and R_WJ (n_axes, N, 3, 3).
        """
        N = len(q)
        R, p = np.broadcast_to(np.eye(3), (N, 3, 3)), np.zeros((N, 3))
        ps, Rs = [], []
        for axis, (A, B, C, p_PJ) in zip(self.finger.axes, self._motions, strict=True):
            x = axis.multiplier * q[:, axis.source] + axis.offset
            p = p + R @ p_PJ
            if axis.prismatic:
                R = R @ A
                p = p + (R @ axis.axis) * x[:, None]
            else:
                M = np.sin(x)[:, None, None] * B + np.cos(x)[:, None, None] * C
                M += A
                R = R @ M
            ps.append(p)
            Rs.append(R)
        return np.stack(ps), np.stack(Rs)

    def fk(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tip frame.

        Args:
            q: (N, m) rad.

        Returns:
            p_WC (N, 3) in m, R_WT (N, 3, 3).
        """
        p, R = self.frames(q)
        return p[-1] + R[-1] @ self.finger.X_JT[:3, 3], R[-1] @ self.finger.X_JT[:3, :3]

    def jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Tip frame and its geometric Jacobians.

        Args:
            q: (N, m) rad.

        Returns:
            p_WC (N, 3), R_WT (N, 3, 3), J (N, 3, m) with v_WC = J v, Jw (N, 3, m) with w_WT = Jw v.
        """
        p, R = self.frames(q)
        p_WC = p[-1] + R[-1] @ self.finger.X_JT[:3, 3]
        J, Jw = np.zeros((*q.shape, 3)), np.zeros((*q.shape, 3))
        for i, axis in enumerate(self.finger.axes):
            a_W = R[i] @ (axis.multiplier * axis.axis)
            if axis.prismatic:
                J[:, axis.source] += a_W
            else:
                J[:, axis.source] += cross(a_W, p_WC - p[i])
                Jw[:, axis.source] += a_W
        return p_WC, R[-1] @ self.finger.X_JT[:3, :3], J.transpose(0, 2, 1), Jw.transpose(0, 2, 1)

    def bias(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations at vdot = 0: Jdot v and Jwdot v (N, 3) each, in m/s^2 and rad/s^2.

        Args:
            q: (N, m) rad.
            v: (N, m) rad/s.
        """
        p, R = self.frames(q)
        p_WC = p[-1] + R[-1] @ self.finger.X_JT[:3, 3]
        w, alpha, a = np.zeros_like(p_WC), np.zeros_like(p_WC), np.zeros_like(p_WC)

        def carry(a: np.ndarray, arm: np.ndarray) -> np.ndarray:
            return a + cross(alpha, arm) + cross(w, cross(w, arm))

        origin = np.zeros_like(p_WC)
        for i, axis in enumerate(self.finger.axes):
            a, origin = carry(a, p[i] - origin), p[i]
            rate_W = R[i] @ (axis.multiplier * axis.axis) * v[:, axis.source, None]
            if axis.prismatic:
                a = a + 2 * cross(w, rate_W)
            else:
                alpha, w = alpha + cross(w, rate_W), w + rate_W
        a = carry(a, p_WC - origin)
        return a, alpha

    @cached_property
    def _seeds(self) -> tuple[np.ndarray, cKDTree]:
        """Joint grid and the tip positions it reaches: where inverse kinematics starts from."""
        m = len(self.lower)
        n = max(4, round(4000 ** (1 / m)))
        grid = [np.linspace(lo, hi, n + 2)[1:-1] for lo, hi in zip(self.lower, self.upper, strict=True)]
        q = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, m)
        return q, cKDTree(self.fk(q)[0])

    def ik(
        self, p_WC: np.ndarray, q0: np.ndarray | None = None, *, tolerance: float = 1e-6, iterations: int = 12
    ) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles that bring the tip centre to given points: damped Gauss-Newton within limits.

        Args:
            p_WC: (N, 3) targets in m.
            q0: (N, m) start; the nearest of a grid of reachable points if not given.
            tolerance: residual in m below which a row is left alone.
            iterations: at most.

        Returns:
            q (N, m) within the limits, residual (N,) in m. A row beyond reach keeps a large residual.
        """
        if q0 is None:
            seeds, tree = self._seeds
            q0 = seeds[tree.query(p_WC)[1]]
        q = np.clip(q0, self.lower, self.upper)
        residual = np.full(len(q), np.inf)
        active = np.arange(len(q))
        for _ in range(iterations):
            p, _, J, _ = self.jacobian(q[active])
            e = p_WC[active] - p
            error = np.sqrt(np.einsum("ni,ni->n", e, e))
            improved = error < 0.9 * residual[active]
            residual[active] = error
            todo = (error > tolerance) & (improved | (error > 1e-3))
            if not todo.any():
                break
            active, J, e, error = active[todo], J[todo], e[todo], error[todo]
            # Joints held at a limit that the step would cross are taken out, so that the others can finish.
            step = solve_least_squares(J, e, damping=1e-3)
            stuck = ((q[active] <= self.lower) & (step < 0)) | ((q[active] >= self.upper) & (step > 0))
            if stuck.any():
                J = np.where(stuck[:, None, :], 0.0, J)
                step = solve_least_squares(J, e, damping=1e-3)
            step *= np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
            q[active] = np.clip(q[active] + step, self.lower, self.upper)
        else:
            residual[active] = np.linalg.norm(p_WC[active] - self.fk(q[active])[0], axis=1)
        return q, residual
