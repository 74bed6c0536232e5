"""Whether fingers can go to where they are in another state, one after the other, so that the object is always held.

All sets of fingers that may have gone are gone through depth first; what cannot be reached is not worked out.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float64

from drake_hand.compiled import njit
from drake_hand.planning.kernels.hold import contact_at, held
from drake_hand.planning.kernels.world import LOAD, WORLD, scratch


@njit()
def _holds(w, load, gone, lifted, q, touching, X, mask, s):
    """Whether the object is held when the fingers whose bits are set have gone from q[0] to q[1], one lifted or -1."""
    for f in range(len(mask)):
        k = gone >> f & 1
        mask[f] = touching[k, f] and f != lifted
        if mask[f]:
            contact_at(w, load, f, q[k, f], X, s)
    return held(w, load, mask, X, s, 0.0) >= 0.0


@njit((WORLD, LOAD, float64[:, :, ::1], float64[:, :, :, ::1], boolean[:, :, ::1], boolean[::1]))
def orderly(w, load, X, q, touching, able):
    """Writes for which rows (N,) there is an order, whatever the fingers' ways may collide with.

    Args:
        w: the world.
        load: what it takes to hold the object.
        X: (N, 3, 4) object poses.
        q: (N, 2, n, m) postures before and after; before, the object is held.
        touching: (N, 2, n) bool.
        able: (N,) written.
    """
    s = scratch(w)
    n = q.shape[2]
    mask, seen, stack = np.zeros(n, dtype=np.bool_), np.zeros(1 << n, dtype=np.bool_), np.zeros(1 << n, dtype=np.int64)
    for i in range(len(X)):
        astray = 0
        for f in range(n):
            differs = touching[i, 0, f] != touching[i, 1, f]
            for j in range(q.shape[3]):
                differs |= q[i, 0, f, j] != q[i, 1, f, j]
            astray |= int(differs) << f
        seen[:] = False
        able[i], top, stack[0] = False, 1, 0
        while top and not able[i]:
            top -= 1
            gone = stack[top]
            able[i] = gone == astray
            for f in range(n):
                after = gone | 1 << f
                if not astray >> f & 1 or after == gone or seen[after]:
                    continue
                if touching[i, 0, f] and not _holds(w, load, gone, f, q[i], touching[i], X[i], mask, s):
                    continue
                seen[after] = True
                if _holds(w, load, after, -1, q[i], touching[i], X[i], mask, s):
                    stack[top] = after
                    top += 1
