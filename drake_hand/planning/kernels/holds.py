"""Holds: contacts of one finger, carried along one path of the object as far as each lasts.

A hold depends on one finger and the object's path alone. Tables of them are made once, and combined into grasps and
gaits; what fingers do to one another is asked of the combinations.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float64, int64

from drake_hand.compiled import njit
from drake_hand.contact.kernels.rolling import jacobian, tip, touch
from drake_hand.planning.kernels.clear import apart, into, off_object, off_palm, place
from drake_hand.planning.kernels.stroke import roll_on, roll_step
from drake_hand.planning.kernels.transit import LIFT_KNOTS, lift
from drake_hand.planning.kernels.world import END, FINGERS, LANDING, OBJECT, PALM, WORLD, scratch


@njit()
def _blocked(w, f, q, waits, X, s):
    """What finger f collides with at q (m,), but for its tip with the object; `END` where with nothing."""
    place(w, f, q, s)
    if not off_palm(w, f, s, w.clearance):
        return PALM
    if not off_object(w, f, X, s, False, w.clearance):
        return OBJECT
    for j in range(len(waits)):
        if waits[j] and j != f and not apart(w, f, j, s, w.clearance):
            return FINGERS
    return END


@njit(
    (
        WORLD,
        int64,
        float64[:, ::1],
        boolean[::1],
        float64[:, :, ::1],
        float64[:, ::1],
        float64[:, ::1],
        float64,
        float64[:, :, ::1],
        float64[:, :, ::1],
        float64[:, :, ::1],
        float64[:, :, :, ::1],
        int64[::1],
        int64[::1],
    )
)
def held_along(w, f, waiting, waits, X, q0, n0, height, q, p_WP, n_W, J_WP, length, why):
    """Carries contacts of finger f along a path, each as far as it lasts.

    Args:
        w: the world.
        f: finger.
        waiting: (n, m) postures of the fingers that stay where they are ...
        waits: (n,) ... which these are; the others are not there.
        X: (K, 3, 4) object poses.
        q0: (N, m) contacts at the first pose ...
        n0: (N, 3) ... and the outward normals there, in W.
        height: that the finger has to be able to land from, m; 0 where it is there already.
        q: (N, K, m) written: postures.
        p_WP: (N, K, 3) written: contact points.
        n_W: (N, K, 3) written: outward normals.
        J_WP: (N, K, 3, m) written: Jacobians of the tip's material point there.
        length: (N,) written: poses that the contact can be held.
        why: (N,) written: what ends it.
    """
    s = scratch(w)
    twist, pose, mid, fixed = np.zeros(6), np.zeros((2, 3, 4)), np.zeros((3, 4)), np.zeros(3)
    way = np.zeros((LIFT_KNOTS, q0.shape[1]))
    for j in range(len(waits)):
        if waits[j]:
            place(w, j, waiting[j], s)
    for i in range(len(q0)):
        length[i], why[i] = 0, END
        if height > 0.0 and not lift(w, f, q0[i], n0[i], height, X[0], way, s):
            why[i] = LANDING
            continue
        q[i, 0] = q0[i]
        place(w, f, q0[i], s)
        s.force[0], s.force[1], s.force[2] = tip(w.chains, f, s.p_placed, s.R_placed)
        fixed[0], fixed[1], fixed[2] = into(X[0], s.force)
        twist[:] = 0.0
        for k in range(len(X)):
            if k == 0:  # onto the surface
                reason = roll_step(w, f, q[i, 0], fixed, X[0], X[0], twist, X[0], s)
            else:
                q[i, k] = q[i, k - 1]
                reason = roll_on(w, f, q[i, k], fixed, X[k - 1], X[k], twist, pose, mid, s)
            if reason == END:
                reason = _blocked(w, f, q[i, k], waits, X[k], s)
            if reason != END:
                why[i] = reason
                break
            at = touch(w.chains, w.object, f, q[i, k], X[k], s.p, s.R, s.foot)
            r = w.chains.radius[f]
            jacobian(w.chains, f, s.p, s.R, at[0] - r * at[6], at[1] - r * at[7], at[2] - r * at[8], J_WP[i, k])
            for a in range(3):
                n_W[i, k, a] = at[6 + a]
                p_WP[i, k, a] = X[k, a, 3] + X[k, a, 0] * at[3] + X[k, a, 1] * at[4] + X[k, a, 2] * at[5]
            length[i] = k + 1
