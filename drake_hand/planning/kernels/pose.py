"""Poses (3, 4) that turn and shift.

Paths of the object are made and followed row by row inside compiled code, where no library of rotations can be called.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float64

from drake_hand.compiled import njit


@njit()
def log(A, B, w):
    """Writes the rotation vector (3,) of B A^T, for poses A, B (3, 4) less than half a turn apart."""
    for i in range(3):
        w[i] = 0.0
    trace = 0.0
    for i in range(3):
        for k in range(3):
            trace += B[i, k] * A[i, k]
    for k in range(3):
        w[0] += B[2, k] * A[1, k] - B[1, k] * A[2, k]
        w[1] += B[0, k] * A[2, k] - B[2, k] * A[0, k]
        w[2] += B[1, k] * A[0, k] - B[0, k] * A[1, k]
    sin = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2) / 2
    angle = math.atan2(sin, (trace - 1) / 2)
    scale = 0.5 if sin < 1e-12 else 0.5 * angle / sin
    for i in range(3):
        w[i] *= scale


@njit()
def turned(A, w, v, share, out):
    """Writes the pose a share of the path on from A (3, 4) under rotation vector w and translation v."""
    x, y, z = share * w[0], share * w[1], share * w[2]
    t2 = x * x + y * y + z * z
    t = math.sqrt(t2)
    a = 1.0 - t2 / 6 if t < 1e-4 else math.sin(t) / t
    b = 0.5 - t2 / 24 if t < 1e-4 else (1.0 - math.cos(t)) / t2
    E = (
        (1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y),
        (b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x),
        (b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)),
    )
    for i in range(3):
        for j in range(3):
            out[i, j] = E[i][0] * A[0, j] + E[i][1] * A[1, j] + E[i][2] * A[2, j]
        out[i, 3] = A[i, 3] + share * v[i]


@njit((float64[:, :, ::1], float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1], float64[:, :, ::1]))
def poses_beside(X, turn, shift, s, off, out):
    """Writes poses (N, 3, 4) at progress s (N,) along a path, with offsets (N, 6); see `ObjectPath.beside`.

    The path is given by its poses X (K + 1, 3, 4) and by rotation vector and translation (K, 3) from each to the next.
    """
    none, nominal = np.zeros(3), np.zeros((3, 4))
    for k in range(len(s)):
        i = min(max(math.floor(s[k]), 0), max(len(X) - 2, 0))
        turned(X[i], turn[i], shift[i], s[k] - i, nominal)
        turned(nominal, off[k, :3], none, 1.0, out[k])
        for j in range(3):
            out[k, j, 3] += off[k, 3 + j]
