"""Distances between convex shapes that spheres cover badly: boxes and meshes, as hulls of points.

E. G. Gilbert, D. W. Johnson, S. S. Keerthi, "A fast procedure for computing the distance between complex objects in
three-dimensional space", IEEE Journal of Robotics and Automation 4(2), 1988. What is returned is the distance of two
parallel planes with the shapes on either side, so it is never more than the true one, however early one stops.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import float64, int64

from drake_hand.compiled import njit
from drake_hand.model.geometry import Geometry

_SIDES = 32
"""Of the prism around a cylinder: half a percent of its radius too large."""
_ACCURATE_M, _MOST_STEPS = 1e-6, 40
"""How near to the true distance is near enough, and after how many steps one stops in any case."""


class Hulls(NamedTuple):
    """Convex shapes: hulls of points, rounded off by a radius."""

    first: np.ndarray
    """(H + 1,) a hull's first point."""
    p: np.ndarray
    """(V, 3) m."""
    r: np.ndarray
    """(H,) m."""

    @classmethod
    def of(cls, geometries: tuple[Geometry, ...]) -> Hulls:
        """Those of some shapes, in the frame that they are posed in."""
        points = [_points(g) for g in geometries]
        return cls(
            first=np.cumsum([0] + [len(p) for p in points]),
            p=np.ascontiguousarray(np.concatenate([np.zeros((0, 3)), *points])),
            r=np.array([g.size[0] if g.kind in ("sphere", "capsule") else 0.0 for g in geometries], dtype=float),
        )


def _points(g: Geometry) -> np.ndarray:
    """(V, 3) those whose hull a shape is, rounded off, in the frame that it is posed in."""
    if g.kind == "box":
        return g.box_O
    if g.kind == "mesh":
        points = g.vertices
    elif g.kind == "sphere":
        points = np.zeros((1, 3))
    else:
        points = np.outer([-0.5, 0.5], [0.0, 0.0, g.size[1]])
    if g.kind == "cylinder":
        angle = np.arange(_SIDES) * 2 * np.pi / _SIDES
        rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_SIDES)]) * g.size[0] / np.cos(np.pi / _SIDES)
        points = (points[:, None] + rim).reshape(-1, 3)
    return points @ g.X_OG[:3, :3].T + g.X_OG[:3, 3]


@njit()
def _nearest(Y, n):
    """Of the hull of Y (n, 3), n up to 4, the point nearest to the origin; the last row is known to be part of it.

    Keeps the rows that it lies between, first.

    Returns:
        How many those are, and the point: three numbers. Four of them have the origin between them.
    """
    a = Y[n - 1]
    x, y, z = a[0], a[1], a[2]
    best, keep_b, keep_c = x * x + y * y + z * z, -1, -1
    for b in range(n - 1):
        e0, e1, e2 = Y[b, 0] - a[0], Y[b, 1] - a[1], Y[b, 2] - a[2]
        ee, ae = e0 * e0 + e1 * e1 + e2 * e2, a[0] * e0 + a[1] * e1 + a[2] * e2
        t = -ae / ee if ee > 0.0 else 0.0
        if 0.0 < t < 1.0:
            v0, v1, v2 = a[0] + t * e0, a[1] + t * e1, a[2] + t * e2
            size = v0 * v0 + v1 * v1 + v2 * v2
            if size < best:
                best, keep_b, keep_c, x, y, z = size, b, -1, v0, v1, v2
        for c in range(b):
            d0, d1, d2 = Y[c, 0] - a[0], Y[c, 1] - a[1], Y[c, 2] - a[2]
            dd, ed, ad = d0 * d0 + d1 * d1 + d2 * d2, e0 * d0 + e1 * d1 + e2 * d2, a[0] * d0 + a[1] * d1 + a[2] * d2
            det = ee * dd - ed * ed
            if det <= 1e-12 * ee * dd:
                continue
            t, u = (ad * ed - ae * dd) / det, (ae * ed - ad * ee) / det
            if t > 0.0 and u > 0.0 and t + u < 1.0:
                v0, v1, v2 = a[0] + t * e0 + u * d0, a[1] + t * e1 + u * d1, a[2] + t * e2 + u * d2
                size = v0 * v0 + v1 * v1 + v2 * v2
                if size < best:
                    best, keep_b, keep_c, x, y, z = size, b, c, v0, v1, v2
    if n == 4 and _around(Y):
        return 4, 0.0, 0.0, 0.0
    kept = 1
    if keep_b >= 0:
        last0, last1, last2 = a[0], a[1], a[2]
        b0, b1, b2 = Y[keep_b, 0], Y[keep_b, 1], Y[keep_b, 2]
        kept = 2
        if keep_c >= 0:  # c < b, so that what is overwritten is not needed any more
            Y[0, 0], Y[0, 1], Y[0, 2] = Y[keep_c, 0], Y[keep_c, 1], Y[keep_c, 2]
            kept = 3
        Y[kept - 2, 0], Y[kept - 2, 1], Y[kept - 2, 2] = b0, b1, b2
        Y[kept - 1, 0], Y[kept - 1, 1], Y[kept - 1, 2] = last0, last1, last2
    else:
        Y[0, 0], Y[0, 1], Y[0, 2] = a[0], a[1], a[2]
    return kept, x, y, z


@njit()
def _volume(a, b, c):
    """Six times that of the tetrahedron of three points and the origin, with its sign."""
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


@njit()
def _around(Y):
    """Whether the origin is between four points Y (4, 3)."""
    a, b, c, d = (
        _volume(Y[1], Y[2], Y[3]),
        _volume(Y[0], Y[3], Y[2]),
        _volume(Y[0], Y[1], Y[3]),
        _volume(Y[0], Y[2], Y[1]),
    )
    return (a > 0 and b > 0 and c > 0 and d > 0) or (a < 0 and b < 0 and c < 0 and d < 0)


@njit()
def gap(P, p0, p1, Q, q0, q1, X, enough, Y):
    """Distance of the hull of points p0 to p1 of P, in W, from that of q0 to q1 of Q, in a frame at X (3, 4).

    Args:
        P: (any, 3) m.
        p0: first of its points.
        p1: one after the last.
        Q: (any, 3) m.
        q0: first of its points.
        q1: one after the last.
        X: (3, 4).
        enough: m.
        Y: (4, 3) to work in.

    Returns:
        m; a lower bound where that is at least `enough`; 0 or less where they overlap.
    """
    b = Q[q0]
    x = P[p0, 0] - (X[0, 0] * b[0] + X[0, 1] * b[1] + X[0, 2] * b[2] + X[0, 3])
    y = P[p0, 1] - (X[1, 0] * b[0] + X[1, 1] * b[1] + X[1, 2] * b[2] + X[1, 3])
    z = P[p0, 2] - (X[2, 0] * b[0] + X[2, 1] * b[1] + X[2, 2] * b[2] + X[2, 3])
    least, n = -np.inf, 0
    for _ in range(_MOST_STEPS):
        size = math.sqrt(x * x + y * y + z * z)
        if size < 1e-12:
            return 0.0
        near, i = np.inf, p0
        for k in range(p0, p1):
            d = P[k, 0] * x + P[k, 1] * y + P[k, 2] * z
            if d < near:
                near, i = d, k
        u0 = X[0, 0] * x + X[1, 0] * y + X[2, 0] * z
        u1 = X[0, 1] * x + X[1, 1] * y + X[2, 1] * z
        u2 = X[0, 2] * x + X[1, 2] * y + X[2, 2] * z
        far, j = -np.inf, q0
        for k in range(q0, q1):
            d = Q[k, 0] * u0 + Q[k, 1] * u1 + Q[k, 2] * u2
            if d > far:
                far, j = d, k
        b = Q[j]
        w = Y[n]
        for k in range(3):
            w[k] = P[i, k] - (X[k, 0] * b[0] + X[k, 1] * b[1] + X[k, 2] * b[2] + X[k, 3])
        least = max(least, (w[0] * x + w[1] * y + w[2] * z) / size)
        if least >= enough or size - least <= _ACCURATE_M:
            return least
        n, x, y, z = _nearest(Y, n + 1)
        if n == 4:
            return 0.0
    return least


@njit(
    (
        float64[:, :, ::1], int64[::1], float64[::1], float64[:, :, ::1], int64[::1], float64[::1], int64[:, ::1],
        float64[:, ::1], float64, float64[::1],
    )
)  # fmt: skip
def least_gaps(P, p_first, p_r, Q, q_first, q_r, pairs, X, far, out):
    """Lowers `out` (N,) to the least distance of pairs (K, 2) of hulls, where that is below `far`.

    The hulls of P (N, any, 3) are in W, those of Q (N or 1, any, 3) in a frame at X (3, 4).
    """
    Y = np.zeros((4, 3))
    for row in range(len(P)):
        p, q = P[row], Q[row if len(Q) > 1 else 0]
        for k in range(len(pairs)):
            i, j = pairs[k, 0], pairs[k, 1]
            r = p_r[i] + q_r[j]
            enough = min(far, out[row])
            d = gap(p, p_first[i], p_first[i + 1], q, q_first[j], q_first[j + 1], X, enough + r, Y) - r
            if d < enough:
                out[row] = d
