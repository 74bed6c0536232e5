"""What single contacts can bring about, and which sets of them can therefore not hold the object.

Forces that balance the object work against every motion of it as much as its weight does. What each contact can do
against one is found once; a set whose contacts together cannot is no hold, and no program has to be solved for it.
"""

from __future__ import annotations

import numpy as np
from numba import float64, int64

from drake_hand.compiled import njit
from drake_hand.contact.kernels.equilibrium import COLUMNS, contact_columns
from drake_hand.planning.kernels.hold import centre_of_mass, contact_at
from drake_hand.planning.kernels.world import LOAD, WORLD, scratch

LEAST_LOAD_PER_N = 1e-9
"""Share of its servos' efforts that a newton takes, where it takes next to none."""


@njit((WORLD, LOAD, int64, float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1]))
def most_along(w, load, f, q, X, wrenches, most):
    """Writes the most that contacts of finger f, pressed with the preload at least, bring about along some wrenches.

    Args:
        w: the world.
        load: what it takes to hold the object.
        f: finger.
        q: (N, m) rad.
        X: (3, 4) object pose.
        wrenches: (6, K) directions: force, and torque about the centre of mass over `TORQUE_LENGTH_M`.
        most: (N, K) written: the largest inner product with them, N; negative where a contact can only do the opposite.
    """
    s = scratch(w)
    K = wrenches.shape[1]
    along, high, T = np.zeros(K), np.zeros(K), s.tableau
    for i in range(len(q)):
        contact_at(w, load, f, q[i], X, s)
        centre_of_mass(w, X, s.force)
        contact_columns(
            T, 6, 1, 0, s.P[f], s.N[f], s.force, load.friction, load.torsion_radius, 0.0, s.JP[f], s.effort[f],
            s.drag[f], s.spin[f], load.spin_arm[f],
        )  # fmt: skip
        high[:] = -np.inf
        most[i] = 0.0
        for x in range(COLUMNS):
            inverse = 1.0 / max(T[7, x], LEAST_LOAD_PER_N)
            along[:] = 0.0
            for a in range(6):
                factor = T[a, x]
                for k in range(K):
                    along[k] += factor * wrenches[a, k]
            for k in range(K):
                high[k] = max(high[k], along[k])
                most[i, k] = max(most[i, k], along[k] * inverse)
        for k in range(K):
            if high[k] < 0.0:
                most[i, k] = load.preload * high[k]


@njit((float64[:, ::1], int64[:, ::1], float64[::1], float64[::1]))
def fall_short(most, rows, need, short):
    """Writes how much sets of contacts, rows (N, n) of `most` (A, K) or -1, fall short of `need` (K,) at worst (N,)."""
    left = np.zeros(len(need))
    for i in range(len(rows)):
        left[:] = need
        for row in rows[i]:
            if row >= 0:
                for k in range(len(need)):
                    left[k] -= most[row, k]
        short[i] = left.max()
