"""Slides: one finger moves over the object at rest, in contact all along, while the others hold.

Ways are given as points: a step of a task that names its way, and a search that tries some, go through the same checks.
"""

from __future__ import annotations

import math

from numba import boolean, float64, int64

from drake_hand.compiled import njit
from drake_hand.contact.kernels.geometry import edge_distance
from drake_hand.contact.kernels.rolling import touch
from drake_hand.planning.kernels.clear import clear_alone, place
from drake_hand.planning.kernels.hold import contact_at, held
from drake_hand.planning.kernels.stroke import MOST_STEP_RAD
from drake_hand.planning.kernels.transit import reach_for
from drake_hand.planning.kernels.world import BALANCE, EDGE, END, FINGERS, LIMIT, LOAD, SINGULAR, WORLD, scratch

_CONTACT_M = 1e-5
"""How far from its contact a tip may end up, m."""
LEAST_SLIP_SHARE = 0.3
"""Of the contact's way that the tip's material has to slide: one that rolls along has no direction of sliding."""
HARDLY_ANY_FRICTION = 1e-3
"""Coefficient of a sliding contact with next to no friction."""
FIRM_HOLD_N = 0.4
"""Normal force that all contacts can at least have at once while one slides, N: so much do theirs vary in physics."""
MOST_GAP_M = 4e-5
"""How far the tip may be off the surface halfway between two points, m: the certificate allows 1e-4."""
MOST_TURN_COS = math.cos(math.radians(20.0))
"""How far the surface may turn from one point to the next ..."""
MOST_RIDGE_COS = math.cos(math.radians(3.0))
"""... and where it is of facets: over a ridge the tip changes direction within less than a step, friction with it."""


@njit()
def _drags(w, load, f, before, q, X, touching, way, s):
    """What is wrong with finger f sliding from posture `before` to q, its contact by `way` [m]; or `END`."""
    contact_at(w, load, f, q, X, s)
    n, J = s.N[f], s.JP[f]
    for i in range(3):
        s.force[i] = 0.0
        for j in range(w.chains.joints[f]):
            s.force[i] += J[i, j] * (q[j] - before[j])
    normal, length = s.force[0] * n[0] + s.force[1] * n[1] + s.force[2] * n[2], 0.0
    for i in range(3):
        s.drag[f, i] = s.force[i] - normal * n[i]
        length += s.drag[f, i] * s.drag[f, i]
    length = math.sqrt(length)
    why = END if length > LEAST_SLIP_SHARE * way else SINGULAR
    last = length
    for share in (load.sliding_friction, HARDLY_ANY_FRICTION):
        if why == END:
            for i in range(3):
                s.drag[f, i] *= share / last
            last = share
            most = 0.0 if load.kinematic else max(load.preload, FIRM_HOLD_N - load.preload)
            if held(w, load, touching, X, s, most) < most:
                why = BALANCE
    s.drag[f] = 0.0
    return why


@njit(
    (
        WORLD,
        LOAD,
        int64,
        float64[:, ::1],
        float64[:, ::1],
        boolean[::1],
        float64[:, :, ::1],
        float64[:, :, ::1],
        float64[:, :, ::1],
        int64[::1],
        int64[::1],
    )
)
def slides(w, load, f, X, q0, touching, p_O, n_O, q, length, why):
    """Carries the contact of one finger over the surface, the object and all else at rest, as far as that goes.

    The object has to be held with all the friction that a sliding contact can have, and with hardly any; and with twice
    the preload of contacts that rest, or more where that is little: how hard the sliding one presses, and so drags,
    varies with the object's pose.

    Args:
        w: the world.
        load: what it takes to hold the object.
        f: finger.
        X: (3, 4) object pose.
        q0: (n, m) posture of the hand.
        touching: (n,) bool, the sliding finger too.
        p_O: (N, K + 1, 3) points on the surface, m; the first is where the finger touches.
        n_O: (N, K + 1, 3) outward normals there.
        q: (N, K + 1, m) written: postures of the finger at them.
        length: (N,) written: steps that can be made.
        why: (N,) written: what ends each.
    """
    s, c, r = scratch(w), w.chains, w.chains.radius[f]
    least = MOST_TURN_COS if w.substeps == 1 else MOST_RIDGE_COS
    for j in range(len(q0)):
        place(w, j, q0[j], s)
        if touching[j]:
            contact_at(w, load, j, q0[j], X, s)
    for i in range(len(p_O)):
        q[i, 0] = q0[f]
        length[i], why[i] = 0, END
        for k in range(1, p_O.shape[1]):
            p, n, last = p_O[i, k], n_O[i, k], n_O[i, k - 1]
            a = p_O[i, k - 1]
            way = math.sqrt((p[0] - a[0]) ** 2 + (p[1] - a[1]) ** 2 + (p[2] - a[2]) ** 2)
            turn = n[0] * last[0] + n[1] * last[1] + n[2] * last[2]
            if edge_distance(w.object, p[0], p[1], p[2], w.edge) < w.edge or turn < least:
                why[i] = EDGE
                break
            for x in range(3):
                s.force[x] = X[x, 3]
                for y in range(3):
                    s.force[x] += X[x, y] * (p[y] + r * n[y])
            q[i, k] = q[i, k - 1]
            if reach_for(c, f, s.force[0], s.force[1], s.force[2], q[i, k], 1e-7, 12, s) > _CONTACT_M:
                why[i] = LIMIT
                break
            for j in range(c.joints[f]):
                if abs(q[i, k, j] - q[i, k - 1, j]) > MOST_STEP_RAD:
                    why[i] = SINGULAR
                s.half[j] = (q[i, k, j] + q[i, k - 1, j]) / 2
            if abs(touch(c, w.object, f, s.half, X, s.p, s.R, s.foot)[9] - r) > MOST_GAP_M:
                why[i] = EDGE
            if why[i] == END and not clear_alone(w, f, q[i, k], True, X, s, w.clearance):
                why[i] = FINGERS
            if why[i] == END:
                why[i] = _drags(w, load, f, q[i, k - 1], q[i, k], X, touching, way, s)
            if why[i] != END:
                break
            length[i] = k
