"""Rating of periodic gaits: rows of one base contact per finger, held at the base or at the end of a stroke.

What a finger can do alone was worked out before, so a row costs only what fingers have to do with one another: whether
they stay clear, and whether they hold the object with each of them lifted in turn.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float64, int64

from drake_hand.compiled import njit
from drake_hand.contact.kernels.stiffness import SPRING_ROWS
from drake_hand.planning.kernels.clear import apart, place
from drake_hand.planning.kernels.hold import held
from drake_hand.planning.kernels.world import LOAD, WORLD, scratch

_MORE_N = 1e-6
"""By which margins are followed beyond what matters, so that rounding does not matter."""
_POOLS = (int64[::1], float64[:, :, :, ::1], float64[:, :, :, ::1], float64[:, :, :, :, ::1],
          float64[:, :, :, :, ::1], float64[:, :, ::1])  # fmt: skip


@njit()
def _take(load, fingers, p, n, J, spring, press, row, stepped, without, s, mask):
    """Takes the contacts of a row: at the base those that have stepped back (bits), at the end the others."""
    for slot in range(len(fingers)):
        f, e = fingers[slot], 1 - ((stepped >> slot) & 1)
        mask[f] = slot != without
        for i in range(3):
            s.P[f, i], s.N[f, i] = p[slot, row[slot], e, i], -n[slot, row[slot], e, i]
            for j in range(s.JP.shape[2]):
                s.JP[f, i, j] = J[slot, row[slot], e, i, j]
        if not load.kinematic:
            for j in range(s.JP.shape[2]):
                s.effort[f, 0, j] = s.effort[f, 1, j] = load.effort[f, j]
            s.press[f] = press[slot, row[slot], e]
            for i in range(SPRING_ROWS):
                for j in range(3):
                    s.spring[f, i, j] = spring[slot, row[slot], e, i, j]


@njit()
def _margin(w, load, X, fingers, p, n, J, spring, press, row, stepped, without, s, mask, enough):
    """Of a row with some fingers stepped back (bits), without one slot (-1: with all); up to `enough`, see `held`."""
    _take(load, fingers, p, n, J, spring, press, row, stepped, without, s, mask)
    return held(w, load, mask, X, s, enough + _MORE_N)


@njit()
def _apart(w, fingers, q, row, s):
    """Whether the fingers of a row are clear of one another, each at its base or its end."""
    for end in range(2):
        for slot in range(len(fingers)):
            place(w, fingers[slot], q[slot, row[slot], end], s)
            for other in range(slot):
                if not apart(w, fingers[slot], fingers[other], s, w.clearance):
                    return False
    for slot in range(len(fingers)):
        place(w, fingers[slot], q[slot, row[slot], 0], s)
        for other in range(len(fingers)):
            if other != slot and not apart(w, fingers[slot], fingers[other], s, w.clearance):
                return False
        place(w, fingers[slot], q[slot, row[slot], 1], s)
    return True


@njit((WORLD, LOAD, float64[:, ::1], *_POOLS, int64[:, ::1], boolean, float64[::1]))
def margins_together(w, load, X, fingers, p, n, J, spring, press, rows, stepped, margin):
    """Writes the margins (R,) of rows (R, slots) of contacts with all fingers at the base, or all at the end."""
    s, mask = scratch(w), np.zeros(len(w.chains.radius), np.bool_)
    everyone = (1 << len(fingers)) - 1 if stepped else 0
    for i in range(len(rows)):
        margin[i] = _margin(w, load, X, fingers, p, n, J, spring, press, rows[i], everyone, -1, s, mask, np.inf)


@njit(
    (
        WORLD,
        LOAD,
        float64[:, ::1],
        *_POOLS,
        float64[:, :, :, ::1],
        int64[:, ::1],
        float64,
        float64[::1],
        int64[:, ::1],
    )
)
def widest(w, load, X, fingers, p, n, J, spring, press, q, rows, least, margin, last):
    """Rates rows of contacts by the least margin on their best order of steps: widest paths over sets of fingers.

    Args:
        w: the world.
        load: what it takes to hold the object.
        X: (3, 4) object pose.
        fingers: (S,) by slot.
        p: (S, P, 2, 3) contact points of the pools, at the base and at the end of the stroke.
        n: (S, P, 2, 3) outward normals.
        J: (S, P, 2, 3, m) Jacobians of the tips' material points.
        spring: (S, P, 2, 13, 3) the contacts' springs ...
        press: (S, P, 2) ... and what they are pressed with, N; see `steady`.
        q: (S, P, 2, m) postures.
        rows: (R, S) of the pools.
        least: what cannot reach this margin is not followed further.
        margin: (R,) written: -inf where fingers collide or `least` is out of reach.
        last: (R, 2^S) written: the last step on the best order to each set of fingers (bits) that have stepped back.
    """
    s, mask, S = scratch(w), np.zeros(len(w.chains.radius), np.bool_), len(fingers)
    everyone = (1 << S) - 1
    whole, width = np.zeros(everyone + 1), np.zeros(everyone + 1)
    for i in range(len(rows)):
        row = rows[i]
        margin[i] = -np.inf
        last[i] = -1
        whole[:] = np.nan
        width[:] = -np.inf
        most = np.inf
        for u in (0, everyone):
            whole[u] = _margin(w, load, X, fingers, p, n, J, spring, press, row, u, -1, s, mask, most)
            most = whole[0]
            if whole[u] < least:
                break
        if not (whole[everyone] >= least) or not _apart(w, fingers, q, row, s):
            continue
        width[0] = min(most, whole[everyone])
        for u in range(everyone):  # a set comes after all its subsets
            if width[u] < least or width[u] == -np.inf:
                continue
            for slot in range(S):
                v = u | (1 << slot)
                if v == u or width[u] <= width[v]:
                    continue
                value = min(
                    width[u], _margin(w, load, X, fingers, p, n, J, spring, press, row, u, slot, s, mask, width[u])
                )
                if value < least or value <= width[v]:
                    continue
                if np.isnan(whole[v]):
                    whole[v] = _margin(w, load, X, fingers, p, n, J, spring, press, row, v, -1, s, mask, width[0])
                value = min(value, whole[v])
                if value >= least and value > width[v]:
                    width[v], last[i, v] = value, slot
        margin[i] = width[everyone]
