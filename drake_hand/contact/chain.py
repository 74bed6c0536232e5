"""Batched kinematics of one finger in plain numpy: forward, Jacobian, inverse, over 10^4 to 10^6 rows at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from drake_hand.model.hand import Axis, Finger, Hand

_BLOCK_ROWS = 4096
"""Rows worked on at once in `FingerKinematics.ik`: their arrays stay in the processor's cache."""

# Batches are long and vectors short: arrays have the batch last in memory, so that numpy runs over rows of N numbers.
# What is handed out is a transposed view with the batch first.


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product over the last axis; several times faster than np.cross on many short vectors."""
    a1, a2, a3 = a[..., 0], a[..., 1], a[..., 2]
    b1, b2, b3 = b[..., 0], b[..., 1], b[..., 2]
    out = np.empty((3, *np.broadcast_shapes(a1.shape, b1.shape)))
    out[0], out[1], out[2] = a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1
    return np.moveaxis(out, 0, -1)


def skew(a: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) whose product with b is a x b, for vectors a (..., 3)."""
    out = np.zeros((*a.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = a[..., 2], -a[..., 1], a[..., 0]
    return out


def material_jacobian(J: np.ndarray, Jw: np.ndarray, lever_W: np.ndarray) -> np.ndarray:
    """Jacobian of the tip's material at the contact P, a lever r nhat short of the tip centre C: v_P = v_C + lever x w.

    Args:
        J: (N, 3, m) of C.
        Jw: (N, 3, m) of the tip's orientation.
        lever_W: (N, 3) from P to C, m.

    Returns:
        (N, 3, m).
    """
    return J + cross(lever_W[:, None], Jw.transpose(0, 2, 1)).transpose(0, 2, 1)


def solve_least_squares(A: np.ndarray, b: np.ndarray, damping: float | np.ndarray = 0.0) -> np.ndarray:
    """Minimum-norm x of A x = b, batched: x = A^T (A A^T + damping^2 I)^-1 b by the 3x3 adjugate.

    Args:
        A: (N, 3, m).
        b: (N, 3).
        damping: (N,) or one for all; keeps x bounded near singularities (damped least squares; Wampler 1986).

    Returns:
        (N, m); a singular row without damping gives large numbers, never an exception.
    """
    r0, r1, r2 = np.ascontiguousarray(A.transpose(1, 2, 0))
    m00, m11, m22 = ((r * r).sum(axis=0) + damping**2 for r in (r0, r1, r2))
    m01, m02, m12 = (r0 * r1).sum(axis=0), (r0 * r2).sum(axis=0), (r1 * r2).sum(axis=0)
    c00, c11, c22 = m11 * m22 - m12 * m12, m00 * m22 - m02 * m02, m00 * m11 - m01 * m01
    c01, c02, c12 = m02 * m12 - m01 * m22, m01 * m12 - m02 * m11, m01 * m02 - m00 * m12
    det = m00 * c00 + m01 * c01 + m02 * c02
    det[np.abs(det) < 1e-30] = 1e-30
    b0, b1, b2 = b.T
    y0, y1, y2 = c00 * b0 + c01 * b1 + c02 * b2, c01 * b0 + c11 * b1 + c12 * b2, c02 * b0 + c12 * b1 + c22 * b2
    return ((r0 * y0 + r1 * y1 + r2 * y2) / det).T


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
    def of(cls, hand: Hand, finger: Finger, *, margin: float = 0.0) -> FingerKinematics:
        """The kinematics of one finger of a hand, with the hand's joint limits.

        Args:
            hand: the hand.
            finger: one of its fingers.
            margin: kept from the limits, rad (m), but never more than a tenth of a joint's range.
        """
        lower, upper = hand.q_lower[finger.columns], hand.q_upper[finger.columns]
        kept = np.minimum(margin, 0.1 * (upper - lower))
        return cls(finger, lower + kept, upper - kept)

    @cached_property
    def _links(self) -> list[tuple[Axis, np.ndarray, np.ndarray, np.ndarray]]:
        """Each axis with R and p from the joint before, frames turned by U so that every joint moves along its z."""
        out, before = [], np.eye(3)
        for axis in self.finger.axes:
            U = Rotation.align_vectors(axis.axis[None], [[0.0, 0.0, 1.0]])[0].as_matrix()
            out.append((axis, before.T @ axis.X_PJ[:3, :3] @ U, before.T @ axis.X_PJ[:3, 3], U))
            before = U
        return out

    def _sweep(self, q: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Origin (3, N) and orientation (3, 3, N) of every joint after its motion, its axis as third column."""
        R, p = np.eye(3)[:, :, None], np.zeros((3, 1))
        ps, Rs = [], []
        for axis, R_AB, p_AB, _ in self._links:
            x = axis.multiplier * q[:, axis.source] + axis.offset
            p = p + p_AB @ R
            R = R_AB.T @ R
            if axis.prismatic:
                p = p + R[:, 2] * x
                R = np.broadcast_to(R, (3, 3, len(x)))
            else:
                c, s = np.cos(x), np.sin(x)
                turned = np.empty((3, 3, len(x)))
                turned[:, 0] = R[:, 0] * c + R[:, 1] * s
                turned[:, 1] = R[:, 1] * c - R[:, 0] * s
                turned[:, 2] = R[:, 2]
                R = turned
            ps.append(p)
            Rs.append(R)
        return ps, Rs

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frames of all moving joints (after their motion).

        Args:
            q: (N, m) rad.

        Returns:
            p_WJ (n_axes, N, 3) in m and R_WJ (n_axes, N, 3, 3).
        """
        ps, Rs = self._sweep(q)
        p = np.stack([np.broadcast_to(p, (3, len(q))) for p in ps])
        R = np.stack([U @ R for R, (_, _, _, U) in zip(Rs, self._links, strict=True)])
        return p.transpose(0, 2, 1), R.transpose(0, 3, 1, 2)

    def _tip(self, p: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """p_WC (3, N) and R_WT (3, 3, N) from the last joint's frame."""
        X_JT, U = self.finger.X_JT, self._links[-1][3]
        return p + (U.T @ X_JT[:3, 3]) @ R, (U.T @ X_JT[:3, :3]).T @ R

    def fk(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tip frame.

        Args:
            q: (N, m) rad.

        Returns:
            p_WC (N, 3) in m, R_WT (N, 3, 3).
        """
        ps, Rs = self._sweep(q)
        p, R = self._tip(ps[-1], Rs[-1])
        return p.T, R.transpose(2, 0, 1)

    def jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Tip frame and its geometric Jacobians.

        Args:
            q: (N, m) rad.

        Returns:
            p_WC (N, 3), R_WT (N, 3, 3), J (N, 3, m) with v_WC = J v, Jw (N, 3, m) with w_WT = Jw v.
        """
        ps, Rs = self._sweep(q)
        p_WC, R_WT = self._tip(ps[-1], Rs[-1])
        J, Jw = np.zeros((2, 3, q.shape[1], len(q)))
        for (axis, *_), p, R in zip(self._links, ps, Rs, strict=True):
            a_W = axis.multiplier * R[:, 2]
            if axis.prismatic:
                J[:, axis.source] += a_W
            else:
                J[:, axis.source] += cross(a_W.T, (p_WC - p).T).T
                Jw[:, axis.source] += a_W
        return p_WC.T, R_WT.transpose(2, 0, 1), J.transpose(2, 0, 1), Jw.transpose(2, 0, 1)

    def bias(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations at vdot = 0: Jdot v and Jwdot v (N, 3) each, in m/s^2 and rad/s^2.

        Args:
            q: (N, m) rad.
            v: (N, m) rad/s.
        """
        ps, Rs = self._sweep(q)
        p_WC = self._tip(ps[-1], Rs[-1])[0].T
        w, alpha, a, origin = np.zeros((4, *p_WC.shape))

        def carry(a: np.ndarray, arm: np.ndarray) -> np.ndarray:
            return a + cross(alpha, arm) + cross(w, cross(w, arm))

        for (axis, *_), p, R in zip(self._links, ps, Rs, strict=True):
            a, origin = carry(a, p.T - origin), p.T
            rate_W = (R[:, 2] * (axis.multiplier * v[:, axis.source])).T
            if axis.prismatic:
                a = a + 2 * cross(w, rate_W)
            else:
                alpha, w = alpha + cross(w, rate_W), w + rate_W
        return carry(a, p_WC - origin), alpha

    @cached_property
    def _seeds(self) -> tuple[np.ndarray, cKDTree]:
        """Joint grid and the tip positions it reaches: where inverse kinematics starts from."""
        m = len(self.lower)
        n = max(4, round(4000 ** (1 / m)))
        grid = [np.linspace(lo, hi, n + 2)[1:-1] for lo, hi in zip(self.lower, self.upper, strict=True)]
        q = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, m)
        return q, cKDTree(self.fk(q)[0])

    @cached_property
    def _cells(self) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
        """Space around the seeds in cubes: first centre (3,), edge, counts (3,), and two seeds per cube (..., 2, m).

        The first is the nearest; the second is the nearest in another posture (the same tip with the finger bent the
        other way), or the first again where there is none.
        """
        q, tree = self._seeds
        corner, edge = tree.mins, float((tree.maxes - tree.mins).max()) / 15
        counts = np.ceil((tree.maxes - corner) / edge).astype(int) + 1
        centres = corner + edge * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
        seeds = q[np.repeat(tree.query(centres)[1][:, None], 2, axis=1)]
        distance, nearest = tree.query(centres, min(48, len(q)), distance_upper_bound=2 * edge)
        near = np.flatnonzero(np.isfinite(distance[:, 0]))
        others = q[np.minimum(nearest[near], len(q) - 1)]
        other = np.abs((others - others[:, :1]) / (self.upper - self.lower)).max(axis=-1) > 0.15
        other &= np.isfinite(distance[near])
        found = other.any(axis=1)
        seeds[near[found], 1] = others[found, other[found].argmax(axis=1)]
        return corner, edge, counts, seeds

    def ik(
        self, p_WC: np.ndarray, q0: np.ndarray | None = None, *, tolerance: float = 1e-6, iterations: int = 12
    ) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles that bring the tip centre to given points: damped Gauss-Newton within limits.

        Args:
            p_WC: (N, 3) targets in m.
            q0: (N, m) start; if not given, the nearest of a grid of reachable points, and where that fails the nearest
                in another posture.
            tolerance: residual in m below which a row is left alone.
            iterations: at most.

        Returns:
            q (N, m) within the limits, residual (N,) in m. A row beyond reach keeps a large residual.
        """
        if q0 is not None:
            return self._descend(p_WC, np.clip(q0, self.lower, self.upper), tolerance, iterations)
        corner, edge, counts, seeds = self._cells
        cube = np.clip(np.rint((p_WC - corner) / edge).astype(int), 0, counts - 1)
        first, second = seeds[np.ravel_multi_index(cube.T, counts)].transpose(1, 0, 2)
        q, residual = self._descend(p_WC, first, tolerance, iterations)
        again = np.flatnonzero((residual > tolerance) & (first != second).any(axis=1))
        q2, residual2 = self._descend(p_WC[again], second[again], tolerance, iterations)
        better = residual2 < residual[again]
        q[again[better]], residual[again[better]] = q2[better], residual2[better]
        return q, residual

    def _descend(
        self, p_WC: np.ndarray, q0: np.ndarray, tolerance: float, iterations: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """`ik` from given starts within the limits."""
        q, residual = np.empty_like(q0), np.empty(len(q0))
        for start in range(0, len(q0), _BLOCK_ROWS):
            rows = slice(start, start + _BLOCK_ROWS)
            q[rows], residual[rows] = self._descend_block(p_WC[rows], q0[rows], tolerance, iterations)
        return q, residual

    def _descend_block(
        self, p_WC: np.ndarray, q0: np.ndarray, tolerance: float, iterations: int
    ) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = self.lower[:, None], self.upper[:, None]
        x, target = np.array(q0.T, order="C"), np.array(p_WC.T, order="C")
        q, residual = np.empty_like(x), np.empty(len(q0))
        active, last = np.arange(len(q0)), np.full(len(q0), np.inf)
        for i in range(iterations + 1):
            p, _, J, _ = self.jacobian(x.T)
            e = target - p.T
            error = np.sqrt((e * e).sum(axis=0))
            # A row that is beyond reach, or held by its limits, stops getting better.
            todo = (error > tolerance) & ((error < 0.9 * last) | (i < 3)) & (i < iterations)
            q[:, active[~todo]], residual[active[~todo]] = x[:, ~todo], error[~todo]
            if not todo.any():
                break
            if not todo.all():
                active, x, target, e, error = active[todo], x[:, todo], target[:, todo], e[:, todo], error[todo]
                J = J.transpose(1, 2, 0)[..., todo].transpose(2, 0, 1)
            # Damping that fades with the error keeps the last steps quadratic near singular poses (Sugihara 2011).
            damping = 1e-5 + 0.2 * error
            step = solve_least_squares(J, e.T, damping).T
            # Joints held at a limit that the step would cross are taken out, so that the others can finish.
            stuck = ((x <= lower) & (step < 0)) | ((x >= upper) & (step > 0))
            held = np.flatnonzero(stuck.any(axis=0))
            if len(held):
                J = J[held] * ~stuck.T[held, None, :]
                step[:, held] = solve_least_squares(J, e.T[held], damping[held]).T
            step *= np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=0), 1e-12))
            x, last = np.clip(x + step, lower, upper), error
        return q.T, residual
