"""Free fingers on their way: clear of object, palm and one another, in batches.

The others stand still, or are left out because they are on their way as well.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float64, int64

from drake_hand.compiled import njit
from drake_hand.planning.kernels.clear import apart, clear_alone, off_object, off_palm, place
from drake_hand.planning.kernels.transit import lift, straight
from drake_hand.planning.kernels.world import WORLD, scratch

_FINGER = (WORLD, int64, float64[:, ::1], float64[:, ::1], boolean[::1])
"""A finger, the object's pose (3, 4), and the hand (n, m) with those of its fingers (n,) that stand."""


@njit()
def _stand(w, q, standing, s):
    """Places the fingers that stand still, at q (n, m)."""
    for j in range(len(q)):
        if standing[j]:
            place(w, j, q[j], s)


@njit((*_FINGER, float64[:, ::1], float64, boolean[::1]))
def clear_at(w, f, X, others, standing, q, least, ok):
    """Writes whether finger f, its tip too, is clear of everything by so much at q (N, m).

    The object is at X (3, 4), the fingers that stand (n,) at `others` (n, m).
    """
    s = scratch(w)
    _stand(w, others, standing, s)
    for i in range(len(q)):
        ok[i] = clear_alone(w, f, q[i], False, X, s, least)


@njit((*_FINGER, float64[:, ::1], float64[:, ::1], float64[:, :, ::1], boolean[::1]))
def lifts(w, f, X, others, standing, q, rises, ways, ok):
    """Writes paths (N, LIFT_KNOTS, m) of finger f off contacts at q (N, m) by rises (N, 3), and which are clear."""
    s = scratch(w)
    _stand(w, others, standing, s)
    for i in range(len(q)):
        ok[i] = lift(w, f, q[i], rises[i], 1.0, X, ways[i], s)


@njit((*_FINGER, float64[::1], float64[::1], float64, boolean[::1]))
def goes_straight(w, f, X, others, standing, a, b, step, ok):
    """Writes (1,) whether finger f is clear along the straight path from a to b (m,) in joint space."""
    s = scratch(w)
    _stand(w, others, standing, s)
    ok[0] = straight(w, f, a, b, X, step, np.zeros(len(a)), s)


@njit((WORLD, float64[:, ::1], float64[:, :, ::1], boolean[::1], boolean, float64, boolean[::1]))
def go_at_once(w, X, q, moving, with_tips, least, ok):
    """Writes (1,) whether hands q (N, n, m) are clear by so much, as far as fingers that move (n,) are concerned.

    Their tips may touch the object, unless asked otherwise.
    """
    s = scratch(w)
    n = len(moving)
    ok[0] = True
    for k in range(len(q)):
        for f in range(n):
            if moving[f] or k == 0:
                place(w, f, q[k, f], s)
        for f in range(n):
            if moving[f]:
                ok[0] &= off_palm(w, f, s, least) and off_object(w, f, X, s, with_tips, least)
            for j in range(f):
                ok[0] &= not (moving[f] or moving[j]) or apart(w, f, j, s, least)
        if not ok[0]:
            return
