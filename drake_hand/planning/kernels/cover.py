"""A few spheres that cover many triangles: a greedy choice, each time the sphere that adds most.

The fewest spheres are hard to find (it is set cover); the greedy choice is not far from them, and is made once per
link.
"""

from __future__ import annotations

import numpy as np
from numba import float64

from drake_hand.compiled import njit


@njit()
def _inside(p, r, triangle):
    """Whether the corners of a triangle (3, 3), and so all of it, are in a sphere."""
    for k in range(3):
        x, y, z = triangle[k, 0] - p[0], triangle[k, 1] - p[1], triangle[k, 2] - p[2]
        if x * x + y * y + z * z > r * r:
            return False
    return True


@njit((float64[:, :, ::1], float64[::1], float64[:, ::1], float64[::1]))
def choose(triangles, worth, p, r):
    """Which of spheres with centres p (S, 3) and radii r (S,) to take, until they cover what any of them does.

    Returns:
        Their indices, and which of the triangles (T, 3, 3), each worth something, are left.
    """
    T, S = len(triangles), len(p)
    covers = np.zeros((T, S), dtype=np.bool_)
    adds = np.zeros(S)
    for t in range(T):
        for s in range(S):
            if _inside(p[s], r[s], triangles[t]):
                covers[t, s] = True
                adds[s] += worth[t]
    left = np.ones(T, dtype=np.bool_)
    chosen = np.empty(min(S, T), dtype=np.int64)
    n, least = 0, 0.5 * worth.min() if T else 0.0
    while S and left.any():
        best = np.argmax(adds)
        if adds[best] < least:
            break
        chosen[n] = best
        n += 1
        for t in range(T):
            if left[t] and covers[t, best]:
                left[t] = False
                for s in range(S):
                    if covers[t, s]:
                        adds[s] -= worth[t]
        adds[best] = -1.0
    return chosen[:n], left
