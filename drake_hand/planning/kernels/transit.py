"""Contacts within reach, and the paths of a free finger to them: lift, travel, land.

A contact that no free path leads to is worth nothing: gaits that were found without looking at these paths collided on
them. Heights of the lift are tried from the lowest, stop-overs only where no straight path is clear.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64, int64

from drake_hand.compiled import njit
from drake_hand.contact.kernels.rolling import frames, jacobian, least_squares, tip, touch
from drake_hand.planning.kernels.clear import clear_alone, off_object, off_palm, place
from drake_hand.planning.kernels.world import END, OBJECT, PALM, REACH, SEEDS, WORLD, scratch

LIFT_JUMP_RAD = math.radians(20.0)
"""Joint step beyond which a lift is no longer one path."""
LIFT_KNOTS = 9
"""Of a lift or a landing."""
TIP_LOOKS, TIP_GAP_M = 4, 1.5e-4
"""How many times finer the tip is looked at on a travel, and its least gap there, m: more than a contact has."""


@njit()
def reach_for(c, f, x, y, z, q, tolerance, iterations, s):
    """Brings the tip centre of finger f to (x, y, z), from q (m,) in place; returns the distance left, m."""
    m = c.joints[f]
    last, error = np.inf, np.inf
    for k in range(iterations + 1):
        frames(c, f, q, s.p, s.R)
        px, py, pz = tip(c, f, s.p, s.R)
        ex, ey, ez = x - px, y - py, z - pz
        error = math.sqrt(ex * ex + ey * ey + ez * ez)
        if error <= tolerance or (error > 0.9 * last and k >= 3) or k == iterations:
            return error
        last = error
        jacobian(c, f, s.p, s.R, px, py, pz, s.J)
        damping = 1e-5 + 0.2 * error
        least_squares(s.J, m, ex, ey, ez, damping, s.rate)
        stuck = False
        for j in range(m):
            if (q[j] <= c.lower[f, j] and s.rate[j] < 0) or (q[j] >= c.upper[f, j] and s.rate[j] > 0):
                stuck = True
                s.J[0, j] = s.J[1, j] = s.J[2, j] = 0.0
        if stuck:
            least_squares(s.J, m, ex, ey, ez, damping, s.rate)
        most = 1e-12
        for j in range(m):
            most = max(most, abs(s.rate[j]))
        scale = min(1.0, 0.5 / most)
        for j in range(m):
            q[j] = min(max(q[j] + scale * s.rate[j], c.lower[f, j]), c.upper[f, j])
    return error


@njit(
    (
        WORLD,
        int64,
        SEEDS,
        float64[:, ::1],
        float64[:, ::1],
        float64[:, ::1],
        float64[:, ::1],
        float64[:, ::1],
        float64[:, ::1],
        int64[::1],
    )
)
def contacts(w, f, seeds, points, normals, X, q, p_W, n_W, why):
    """Postures (N, m) of finger f whose tip touches surface points (N, 3) of the object at X (3, 4).

    Its links are clear of the object and of what stands still: so are, with the Allegro, a tenth to a fifth of the
    contacts on a cube to which tips can be brought. Where the first posture found is not, the second seed's is tried.

    Args:
        w: the world.
        f: finger.
        seeds: of the finger.
        points: (N, 3) in O, m.
        normals: (N, 3) outward, in O.
        X: (3, 4).
        q: (N, m) written: rad.
        p_W: (N, 3) written: contact points, m.
        n_W: (N, 3) written: outward normals.
        why: (N,) written: what keeps the finger from it, `END` where nothing does.
    """
    s = scratch(w)
    c, r = w.chains, w.chains.radius[f]
    cell = np.zeros(3, np.int64)
    for i in range(len(points)):
        for k in range(3):
            n_W[i, k] = X[k, 0] * normals[i, 0] + X[k, 1] * normals[i, 1] + X[k, 2] * normals[i, 2]
            p_W[i, k] = X[k, 3] + X[k, 0] * points[i, 0] + X[k, 1] * points[i, 1] + X[k, 2] * points[i, 2]
        x, y, z = p_W[i, 0] + r * n_W[i, 0], p_W[i, 1] + r * n_W[i, 1], p_W[i, 2] + r * n_W[i, 2]
        near = True
        for k, v in enumerate((x, y, z)):
            cell[k] = math.floor((v - seeds.corner[k]) / seeds.edge + 0.5)
            near &= -1 <= cell[k] <= seeds.counts[k]
            cell[k] = min(max(cell[k], 0), seeds.counts[k] - 1)
        why[i] = REACH
        for k in range(2):
            if near and why[i] != END:
                start = seeds.q[cell[0], cell[1], cell[2], k]
                for j in range(c.joints[f]):
                    q[i, j] = start[j]
                # Where the nearest posture of a fine grid is far away, nothing reaches.
                frames(c, f, q[i], s.p, s.R)
                a, b, d = tip(c, f, s.p, s.R)
                if (a - x) ** 2 + (b - y) ** 2 + (d - z) ** 2 > 4 * seeds.edge**2:
                    break
                if reach_for(c, f, x, y, z, q[i], 1e-6, 12, s) < 1e-5:
                    place(w, f, q[i], s)
                    why[i] = END
                    if not off_object(w, f, X, s, False, w.clearance):
                        why[i] = OBJECT
                    elif not off_palm(w, f, s, w.clearance):
                        why[i] = PALM


@njit()
def lift(w, f, q, n, height, X, way, s):
    """Writes the path (LIFT_KNOTS, m) of finger f from its contact at q (m,) straight along n (3,), times a height.

    Returns:
        Whether it is continuous and clear; the others have to be placed. Its end is clear of the object, tip and all.
    """
    c, m, last = w.chains, w.chains.joints[f], len(way) - 1
    frames(c, f, q, s.p, s.R)
    x, y, z = tip(c, f, s.p, s.R)
    for j in range(m):
        way[0, j] = q[j]
    for k in range(1, last + 1):
        h = height * k / last
        for j in range(m):
            way[k, j] = way[k - 1, j] + (way[k - 1, j] - way[k - 2, j] if k > 1 else 0.0)
            way[k, j] = min(max(way[k, j], c.lower[f, j]), c.upper[f, j])
        if reach_for(c, f, x + h * n[0], y + h * n[1], z + h * n[2], way[k], 1e-6, 12, s) > 2e-5:
            return False
        for j in range(m):
            if abs(way[k, j] - way[k - 1, j]) > LIFT_JUMP_RAD:
                return False
    for k in range(last, -1, -1):
        if not clear_alone(w, f, way[k], k < last, X, s, w.clearance if k == last else w.clearance / 2):
            return False
    return True


@njit()
def straight(w, f, a, b, X, step, q, s):
    """Whether finger f is clear along the straight path from a to b (m,) in joint space, the others placed."""
    m, most = w.chains.joints[f], 0.0
    for j in range(m):
        most = max(most, abs(b[j] - a[j]))
    n = max(2, math.ceil(most / step))
    for k in range(n + 1):
        # From the middle outwards: what is in the way mostly is there.
        i = n // 2 + (k + 1) // 2 * (1 if k % 2 else -1)
        if 0 <= i <= n:
            for j in range(m):
                q[j] = a[j] + (b[j] - a[j]) * i / n
            if not clear_alone(w, f, q, False, X, s, w.clearance / 2):
                return False
    for i in range(1, TIP_LOOKS * n):  # between those, the tip may go round a corner
        for j in range(m):
            q[j] = a[j] + (b[j] - a[j]) * i / (TIP_LOOKS * n)
        if touch(w.chains, w.object, f, q, X, s.p, s.R, s.foot)[9] < w.chains.radius[f] + TIP_GAP_M:
            return False
    return True


@njit()
def _departures(w, f, X, others, old, touches, rises, upright, up, able, s):
    """Places other fingers, and writes paths (D, LIFT_KNOTS, m) off the present contact, and which (D,) are clear."""
    for j in range(len(others)):
        if j != f:
            place(w, j, others[j], s)
    if not touches:
        able[0] = True
        for j in range(len(old)):
            up[0, LIFT_KNOTS - 1, j] = old[j]
        return
    for d in range(len(rises)):
        if d == upright and able[:upright].any():
            break
        able[d] = lift(w, f, old, rises[d], 1.0, X, up[d], s)


@njit()
def _to_stops(w, f, X, up, able, stops, step, reached, q, s):
    """Writes the first departure (V,) after which each stop-over (V, m) is reached straight; -1 where none."""
    for v in range(len(stops)):
        reached[v] = -1
        if clear_alone(w, f, stops[v], False, X, s, w.clearance):
            for d in range(len(able)):
                if able[d] and straight(w, f, up[d, LIFT_KNOTS - 1], stops[v], X, step, q, s):
                    reached[v] = d
                    break


@njit(
    (
        WORLD,
        int64,
        float64[:, ::1],
        float64[:, ::1],
        float64[::1],
        boolean,
        float64[:, ::1],
        int64,
        float64[:, ::1],
        float64[:, :, ::1],
        float64[:, ::1],
        float64,
        int64[:, ::1],
    )
)
def transits(w, f, X, others, old, touches, rises, upright, new, landings, stops, step, found):
    """Looks for paths of finger f from where it is to contacts, all else at rest.

    Args:
        w: the world.
        f: finger.
        X: (3, 4) object pose.
        others: (n, m) posture of the hand.
        old: (m,) where the finger is ...
        touches: ... in contact, so that it lifts first, or not.
        rises: (D, 3) ways off the contact, m ...
        upright: ... of which those after so many count only where none before is clear; likewise of landings.
        new: (N, m) where it goes ...
        landings: (N, L, 3) ... and ways off the contacts there, m, that it comes by.
        stops: (V, m) stop-overs, to go round by.
        step: between checks, rad.
        found: (N, 3) written: index of the rise, of the landing, and of the stop-over + 1; -1 where none.
    """
    s = scratch(w)
    D, m = len(rises), others.shape[1]
    up, down, q = np.zeros((D, LIFT_KNOTS, m)), np.zeros((LIFT_KNOTS, m)), np.zeros(m)
    able, reached = np.zeros(D, np.bool_), np.full(len(stops), -2)
    _departures(w, f, X, others, old, touches, rises, upright, up, able, s)
    asked = False
    for i in range(len(new)):
        found[i, 0] = found[i, 1] = found[i, 2] = -1
        lands = False
        for h in range(landings.shape[1]):
            if h == upright and lands:
                break
            if not lift(w, f, new[i], landings[i, h], 1.0, X, down, s):
                continue
            lands = True
            for d in range(D):
                if able[d] and straight(w, f, up[d, LIFT_KNOTS - 1], down[LIFT_KNOTS - 1], X, step, q, s):
                    found[i, 0], found[i, 1], found[i, 2] = d, h, 0
                    break
            if found[i, 0] < 0 and not asked:
                _to_stops(w, f, X, up, able, stops, step, reached, q, s)
                asked = True
            for v in range(len(stops)):
                near = found[i, 0] < 0 and reached[v] >= 0
                if near and straight(w, f, stops[v], down[LIFT_KNOTS - 1], X, step, q, s):
                    found[i, 0], found[i, 1], found[i, 2] = reached[v], h, v + 1
            if found[i, 0] >= 0:
                break


@njit(
    (
        WORLD,
        int64,
        float64[:, ::1],
        float64[:, ::1],
        float64[::1],
        boolean,
        float64[:, ::1],
        int64,
        float64[:, ::1],
        float64,
        int64[::1],
    )
)
def retreats(w, f, X, others, old, touches, rises, upright, stops, step, found):
    """Looks for paths of finger f to free postures `stops` (V, m), where it may wait.

    The other arguments are those of `transits`; `found` (V,) is written: index of the rise, -1 where there is none.
    """
    s = scratch(w)
    D, m = len(rises), others.shape[1]
    up, able = np.zeros((D, LIFT_KNOTS, m)), np.zeros(D, np.bool_)
    _departures(w, f, X, others, old, touches, rises, upright, up, able, s)
    _to_stops(w, f, X, up, able, stops, step, found, np.zeros(m), s)


@njit((WORLD, int64, float64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64[:, ::1]))
def lift_path(w, f, X, others, q, rise, way):
    """Writes the path (LIFT_KNOTS, m) of a lift by (3,); see `lift`. What is in the way is not reported."""
    s = scratch(w)
    for j in range(len(others)):
        if j != f:
            place(w, j, others[j], s)
    lift(w, f, q, rise, 1.0, X, way, s)
