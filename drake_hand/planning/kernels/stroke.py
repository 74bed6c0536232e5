"""Strokes: hands that carry the object along paths of their own, and how far single contacts would roll.

Every row has a path of its own, because room is often found a little off the nominal one. Steps are integrated at their
midpoint and corrected for drift: what adds up over hundreds of them would be a gap or slip to the certificate.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64, int64

from drake_hand.compiled import njit
from drake_hand.contact.kernels.geometry import edge_distance
from drake_hand.contact.kernels.rolling import jacobian, least_squares, rates, tip, touch
from drake_hand.planning.kernels.clear import collides, into, off_object, off_palm, place
from drake_hand.planning.kernels.hold import contact_at, held, twists
from drake_hand.planning.kernels.pose import log, turned
from drake_hand.planning.kernels.world import BALANCE, EDGE, END, LIMIT, LOAD, SINGULAR, WORLD, scratch

SINGULAR_SLIP_M = 2e-6
"""What a finger may slip, or lose contact, from one pose to the next before it counts as singular, m."""
MOST_STEP_RAD = 0.15
"""Joint step from one pose to the next beyond which it does, rad ..."""
MOST_STEP_CHANGE_RAD = 0.02
"""... and how much the step may change within one."""
MOST_DRIFT_M = 2e-5
"""Drift in one step beyond which the surface is not smooth there, m."""
MOST_ROLLED_M, MOST_ROLLED_RATIO = 2e-4, 3.0
"""How far a contact point may go in one step: so far, m, and so many times as far as the tip."""


@njit()
def _jumps(before, A, after, B):
    """Whether a contact point goes farther on the object than it rolls: from one side of a hollow to the other.

    Its tip touches both there, and moves on smoothly.
    """
    x0, y0, z0 = into(A, before)
    x1, y1, z1 = into(B, after)
    tip_way = math.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2 + (z1 - z0) ** 2)
    way = math.sqrt((after[3] - before[3]) ** 2 + (after[4] - before[4]) ** 2 + (after[5] - before[5]) ** 2)
    return way > MOST_ROLLED_M + MOST_ROLLED_RATIO * tip_way


@njit()
def roll_step(w, f, q, fixed, A, B, twist, mid, s):
    """Carries the contact of finger f at q (m,) from object pose A to B (3, 4), in place.

    A contact that rolls without slipping keeps the material points of tip and object at equal velocity (Montana 1988;
    Murray, Li & Sastry 1994, ch. 5); in the paper's pivot model the tip centre stays where it is in O. Either way the
    finger's rates follow from the object's twist: a midpoint step of them, then what it drifted off is taken back.
    `fixed` (3,) is where a pivoting tip centre stays in O. `twist` (6,) and `mid` (3, 4) are those of the step.

    Returns:
        What ends the contact, or `END`.
    """
    c, m = w.chains, w.chains.joints[f]
    turn, shift = twist[:3], twist[3:]
    before = touch(c, w.object, f, q, A, s.p, s.R, s.foot)
    at = before
    rates(c, f, s.p, s.R, at, A, turn, shift, w.pivot, s.J, s.rate)
    for j in range(m):
        s.half[j] = q[j] + s.rate[j] / 2
    at = touch(c, w.object, f, s.half, mid, s.p, s.R, s.foot)
    for j in range(m):
        s.half[j] = s.rate[j]
    missed = rates(c, f, s.p, s.R, at, mid, turn, shift, w.pivot, s.J, s.rate)
    bend = 0.0
    for j in range(m):
        bend = max(bend, abs(s.rate[j] - s.half[j]))
        s.half[j] = q[j] + s.rate[j]
    at = touch(c, w.object, f, s.half, B, s.p, s.R, s.foot)
    if w.pivot:
        x = B[0, 3] + B[0, 0] * fixed[0] + B[0, 1] * fixed[1] + B[0, 2] * fixed[2] - at[0]
        y = B[1, 3] + B[1, 0] * fixed[0] + B[1, 1] * fixed[1] + B[1, 2] * fixed[2] - at[1]
        z = B[2, 3] + B[2, 0] * fixed[0] + B[2, 1] * fixed[1] + B[2, 2] * fixed[2] - at[2]
    else:
        gap = c.radius[f] - at[9]
        x, y, z = gap * at[6], gap * at[7], gap * at[8]
    jacobian(c, f, s.p, s.R, at[0], at[1], at[2], s.J)
    least_squares(s.J, m, x, y, z, 1e-4, s.rate)
    ex, ey, ez, most = x, y, z, 0.0
    for j in range(m):
        ex -= s.J[0, j] * s.rate[j]
        ey -= s.J[1, j] * s.rate[j]
        ez -= s.J[2, j] * s.rate[j]
        s.half[j] += s.rate[j]
        most = max(most, abs(s.half[j] - q[j]))
        if s.half[j] < c.lower[f, j] or s.half[j] > c.upper[f, j]:
            return LIMIT
    missed += math.sqrt(ex * ex + ey * ey + ez * ez)
    if bend > MOST_STEP_CHANGE_RAD or most > MOST_STEP_RAD or missed > SINGULAR_SLIP_M:
        return SINGULAR
    if math.sqrt(x * x + y * y + z * z) > MOST_DRIFT_M or edge_distance(w.object, at[3], at[4], at[5], w.edge) < w.edge:
        return EDGE
    if _jumps(before, A, at, B):
        return EDGE
    for j in range(m):
        q[j] = s.half[j]
    return END


@njit()
def roll_on(w, f, q, fixed, A, B, twist, pose, mid, s):
    """`roll_step` in as many substeps as the world asks for."""
    log(A, B, twist)
    for i in range(3):
        twist[3 + i] = B[i, 3] - A[i, 3]
    n = w.substeps
    for i in range(6):
        twist[i] /= n
    for k in range(n):
        turned(A, twist, twist[3:], float(k), pose[0])
        turned(A, twist, twist[3:], k + 1.0, pose[1])
        turned(A, twist, twist[3:], k + 0.5, mid)
        why = roll_step(w, f, q, fixed, pose[0], pose[1], twist, mid, s)
        if why != END:
            return why
    return END


@njit()
def _held_on_the_way(w, load, touching, q, X, a, b, turn, s):
    """Whether contacts hold the object at pose b of a path X (K, 3, 4), q (K, n, m); a is where that was asked last."""
    log(X[a], X[b], turn)
    for f in range(len(touching)):
        if touching[f]:
            contact_at(w, load, f, q[b, f], X[b], s)
            twists(w, f, q[b, f], q[a, f], turn, s)
    return held(w, load, touching, X[b], s, 0.0) >= 0


@njit(
    (
        WORLD,
        LOAD,
        float64[:, :, :, ::1],
        int64[::1],
        float64[:, :, ::1],
        boolean[:, ::1],
        int64,
        float64[:, :, :, ::1],
        int64[::1],
        int64[::1],
        int64[::1],
    )
)
def strokes(w, load, X, K, q0, touching, every, q, length, why, who):
    """Carries hands that hold the object along paths of their own, as far as that goes.

    Args:
        w: the world.
        load: what it takes to hold the object.
        X: (N, most + 1, 3, 4) object poses, the first is where it is.
        K: (N,) steps of each path.
        q0: (N, n, m) postures; fingers that do not touch stay there.
        touching: (N, n) bool.
        every: balance is tested every so many steps, and at the last.
        q: (N, most + 1, n, m) written: postures at the poses.
        length: (N,) written: steps that can be made.
        why: (N,) written: what ends each.
        who: (N,) written: the finger it is about, or -1.
    """
    N, n = q0.shape[:2]
    s = scratch(w)
    twist, pose, mid, fixed = np.zeros(6), np.zeros((2, 3, 4)), np.zeros((3, 4)), np.zeros((n, 3))
    for i in range(N):
        q[i, 0] = q0[i]
        length[i], why[i], who[i] = 0, END, -1
        s.spin[:] = 0.0
        for f in range(n):
            place(w, f, q0[i, f], s)
            if touching[i, f]:
                x, y, z = tip(w.chains, f, s.p_placed, s.R_placed)
                s.half[:] = 0.0
                s.force[0], s.force[1], s.force[2] = x, y, z
                fixed[f, 0], fixed[f, 1], fixed[f, 2] = into(X[i, 0], s.force)
        for k in range(1, K[i] + 1):
            q[i, k] = q[i, k - 1]
            A, B = X[i, k - 1], X[i, k]
            reason, guilty = END, -1
            for f in range(n):
                if touching[i, f]:
                    reason = roll_on(w, f, q[i, k, f], fixed[f], A, B, twist, pose, mid, s)
                    if reason != END:
                        guilty = f
                        break
            if reason == END:
                reason, guilty = collides(w, q[i, k], touching[i], B, s)
            if reason == END and (k % every == 0 or k == K[i]):
                if not _held_on_the_way(w, load, touching[i], q[i], X[i], length[i], k, twist, s):
                    reason = BALANCE
                else:
                    length[i] = k
            if reason != END:
                why[i], who[i] = reason, guilty
                untested = reason != BALANCE and k - 1 > length[i]
                if untested and _held_on_the_way(w, load, touching[i], q[i], X[i], length[i], k - 1, twist, s):
                    length[i] = k - 1
                break


@njit((WORLD, int64[::1], float64[:, ::1], float64[:, :, :, ::1], int64[::1], int64[::1]))
def ahead(w, finger, q0, X, steps, length):
    """Writes how many coarse steps single contacts (N, m) of fingers (N,) roll along paths X (N, most + 1, 3, 4).

    An estimate to rank by: joint limits, edges and collisions with object and palm end it, accuracy does not.
    """
    s = scratch(w)
    c = w.chains
    twist, fixed = np.zeros(6), np.zeros(3)
    q = np.zeros(q0.shape[1])
    for i in range(len(finger)):
        q[:] = q0[i]
        f = finger[i]
        m = c.joints[f]
        length[i] = 0
        at = touch(c, w.object, f, q, X[i, 0], s.p, s.R, s.foot)
        s.force[0], s.force[1], s.force[2] = at[0], at[1], at[2]
        fixed[0], fixed[1], fixed[2] = into(X[i, 0], s.force)
        for k in range(1, steps[i] + 1):
            A, B = X[i, k - 1], X[i, k]
            log(A, B, twist)
            for j in range(3):
                twist[3 + j] = B[j, 3] - A[j, 3]
            rates(c, f, s.p, s.R, at, A, twist[:3], twist[3:], w.pivot, s.J, s.rate)
            fits = True
            for j in range(m):
                q[j] += s.rate[j]
                fits &= c.lower[f, j] <= q[j] <= c.upper[f, j] and abs(s.rate[j]) < 3 * MOST_STEP_RAD
            if not fits:
                break
            at = touch(c, w.object, f, q, B, s.p, s.R, s.foot)
            if w.pivot:
                x = B[0, 3] + B[0, 0] * fixed[0] + B[0, 1] * fixed[1] + B[0, 2] * fixed[2] - at[0]
                y = B[1, 3] + B[1, 0] * fixed[0] + B[1, 1] * fixed[1] + B[1, 2] * fixed[2] - at[1]
                z = B[2, 3] + B[2, 0] * fixed[0] + B[2, 1] * fixed[1] + B[2, 2] * fixed[2] - at[2]
            else:
                gap = c.radius[f] - at[9]
                x, y, z = gap * at[6], gap * at[7], gap * at[8]
            if x * x + y * y + z * z > 9e-6 or edge_distance(w.object, at[3], at[4], at[5], w.edge) < w.edge:
                break
            jacobian(c, f, s.p, s.R, at[0], at[1], at[2], s.J)
            least_squares(s.J, m, x, y, z, 1e-4, s.rate)
            for j in range(m):
                q[j] = min(max(q[j] + s.rate[j], c.lower[f, j]), c.upper[f, j])
            at = touch(c, w.object, f, q, B, s.p, s.R, s.foot)
            if abs(at[9] - c.radius[f]) > 1e-3:
                break
            place(w, f, q, s)
            if not off_object(w, f, B, s, False, w.clearance) or not off_palm(w, f, s, w.clearance):
                break
            length[i] = k
