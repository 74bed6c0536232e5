"""Clearances of one hand, finger by finger: from the object, from what stands still and from one another.

Nothing is asked more often. Most of what is asked is far apart, so a sphere around each group is looked at first, and
the spheres in it, or the points of its hull, are put in place only where that one is near.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64

from drake_hand.compiled import njit
from drake_hand.contact.kernels.geometry import SOLID, closest, closest_of, outside_box
from drake_hand.contact.kernels.rolling import frames
from drake_hand.planning.kernels.hulls import gap
from drake_hand.planning.kernels.world import END, FINGERS, OBJECT, PALM, WORLD, scratch

FEW_SPHERES = 12
"""Of a group: so few are asked one by one; of more, it is asked first whether the group is clear of the object."""
IN_W = np.eye(4)[:3].copy()
"""The pose of what is given in W."""
SUNK_M = 2e-5
"""How deep poses of an object that lies on the table may be in it, m: a fifth of what the certificate allows."""


@njit()
def _carried(p, R, x, out):
    for i in range(3):
        out[i] = p[i] + R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2]


@njit()
def place(w, f, q, s):
    """Puts the frames and groups of spheres of finger f where they are at q (m,)."""
    c = w.cover
    frames(w.chains, f, q, s.p_placed, s.R_placed)
    for i in range(3):
        s.low[f, i], s.high[f, i] = np.inf, -np.inf
    for g in range(c.first[f], c.first[f + 1]):
        a, at = c.axis[g], s.groups[g]
        _carried(s.p_placed[a], s.R_placed[a], c.p[g], at)
        s.spread[g] = False
        for i in range(3):
            s.low[f, i], s.high[f, i] = min(s.low[f, i], at[i] - c.r[g]), max(s.high[f, i], at[i] + c.r[g])


@njit()
def _spread(c, g, s):
    """Puts the spheres of a placed group, or the points of its hull, where they are."""
    if not s.spread[g]:
        a, h = c.axis[g], c.hull[g]
        if h >= 0:
            for k in range(c.hulls.first[h], c.hulls.first[h + 1]):
                _carried(s.p_placed[a], s.R_placed[a], c.hulls.p[k], s.hulls[k])
        for k in range(c.spheres[g], c.spheres[g + 1]):
            _carried(s.p_placed[a], s.R_placed[a], c.p_sphere[k], s.spheres[k])
        s.spread[g] = True


@njit()
def _hulls_apart(a, p, i, b, q, j, X, s, least):
    """Whether hull i of a, its points at p in W, keeps clear of hull j of b, its points at q in a frame at X (3, 4)."""
    need = a.r[i] + b.r[j] + least
    return gap(p, a.first[i], a.first[i + 1], q, b.first[j], b.first[j + 1], X, need, s.simplex) >= need


@njit()
def off_object(w, f, X, s, with_tip, least):
    """Whether placed finger f is clear of the object at X (3, 4), its tip too if asked."""
    c, b = w.cover, w.object
    for g in range(c.first[f], c.first[f + 1]):
        if c.tip[g] and not with_tip:
            continue
        x, y, z = into(X, s.groups[g])
        need = c.r[g] + least
        if outside_box(b.low, b.high, x, y, z) >= need:
            continue
        if c.hull[g] >= 0:
            for j in range(len(b.kind)):
                m, reach = b.middle[j], need + b.reach[j]
                if (x - m[0]) ** 2 + (y - m[1]) ** 2 + (z - m[2]) ** 2 >= reach * reach:
                    continue
                _spread(c, g, s)
                if not _hulls_apart(c.hulls, s.hulls, c.hull[g], w.object_hulls, w.object_hulls.p, j, X, s, least):
                    return False
            continue
        many = c.spheres[g + 1] - c.spheres[g] > FEW_SPHERES
        if many and closest(b, x, y, z, need)[6] >= need:
            continue
        _spread(c, g, s)
        for k in range(c.spheres[g], c.spheres[g + 1]):
            need = c.r_sphere[k] + least
            x, y, z = into(X, s.spheres[k])
            if outside_box(b.low, b.high, x, y, z) < need and closest(b, x, y, z, need)[6] < need:
                return False
    return True


@njit()
def into(X, p):
    """A point of W in the frame of the object at X (3, 4)."""
    dx, dy, dz = p[0] - X[0, 3], p[1] - X[1, 3], p[2] - X[2, 3]
    return (
        X[0, 0] * dx + X[1, 0] * dy + X[2, 0] * dz,
        X[0, 1] * dx + X[1, 1] * dy + X[2, 1] * dz,
        X[0, 2] * dx + X[1, 2] * dy + X[2, 2] * dz,
    )


@njit()
def _above(t, p):
    """How far a point of W is above the table."""
    return t.up[0] * p[0] + t.up[1] * p[1] + t.up[2] * p[2] - t.height


@njit()
def off_palm(w, f, s, least):
    """Whether placed finger f is clear of what stands still, the table too."""
    c, b = w.cover, w.palm
    for g in range(c.first[f], c.first[f + 1]):
        p = s.groups[g]
        if _above(w.table, p) < c.r[g] + least:
            _spread(c, g, s)
            for k in range(c.spheres[g], c.spheres[g + 1]):
                if _above(w.table, s.spheres[k]) < c.r_sphere[k] + least:
                    return False
            if c.hull[g] >= 0:
                for k in range(c.hulls.first[c.hull[g]], c.hulls.first[c.hull[g] + 1]):
                    if _above(w.table, s.hulls[k]) < least:
                        return False
        if outside_box(b.low, b.high, p[0], p[1], p[2]) >= c.r[g] + least:
            continue
        for h in range(len(b.kind)):
            need = c.r[g] + least
            if not c.still[g, h] or closest_of(b, h, p[0], p[1], p[2], need)[6] >= need:
                continue
            _spread(c, g, s)
            own = c.hull[g]
            if own >= 0 and not _hulls_apart(c.hulls, s.hulls, own, w.palm_hulls, w.palm_hulls.p, h, IN_W, s, least):
                return False
            for k in range(c.spheres[g], c.spheres[g + 1]):
                need, x = c.r_sphere[k] + least, s.spheres[k]
                if (
                    outside_box(b.low, b.high, x[0], x[1], x[2]) < need
                    and closest_of(b, h, x[0], x[1], x[2], need)[6] < need
                ):
                    return False
    return True


@njit()
def _groups_apart(c, g, h, s, least):
    """Whether two placed groups that are near each other are clear; at least one is a hull."""
    if c.hull[g] < 0:
        g, h = h, g
    _spread(c, g, s)
    _spread(c, h, s)
    if c.hull[h] >= 0:
        return _hulls_apart(c.hulls, s.hulls, c.hull[g], c.hulls, s.hulls, c.hull[h], IN_W, s, least)
    a, end = c.hulls.first[c.hull[g]], c.hulls.first[c.hull[g] + 1]
    for k in range(c.spheres[h], c.spheres[h + 1]):
        need = c.r_sphere[k] + least
        if gap(s.hulls, a, end, s.spheres, k, k + 1, IN_W, need, s.simplex) < need:
            return False
    return True


@njit()
def apart(w, i, j, s, least):
    """Whether two placed fingers are clear of each other."""
    c = w.cover
    for g in range(c.first[i], c.first[i + 1]):
        a, beside = s.groups[g], 0.0
        for x in range(3):
            beside += max(s.low[j, x] - a[x], a[x] - s.high[j, x], 0.0) ** 2
        if beside >= (c.r[g] + least) ** 2:
            continue
        for h in range(c.first[j], c.first[j + 1]):
            b, reach = s.groups[h], c.r[g] + c.r[h] + least
            if (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2 >= reach * reach:
                continue
            if c.hull[g] >= 0 or c.hull[h] >= 0:
                if not _groups_apart(c, g, h, s, least):
                    return False
                continue
            _spread(c, g, s)
            _spread(c, h, s)
            for k in range(c.spheres[g], c.spheres[g + 1]):
                x, rx = s.spheres[k], c.r_sphere[k] + least
                for m in range(c.spheres[h], c.spheres[h + 1]):
                    y, reach = s.spheres[m], rx + c.r_sphere[m]
                    if (x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 + (x[2] - y[2]) ** 2 < reach * reach:
                        return False
    return True


@njit()
def _on_table(t, X):
    """Whether the object at X (3, 4) is on or above the table: as `Table.gap`."""
    level = X[0, 3] * t.up[0] + X[1, 3] * t.up[1] + X[2, 3] * t.up[2] - t.height + SUNK_M
    x = X[0, 0] * t.up[0] + X[1, 0] * t.up[1] + X[2, 0] * t.up[2]
    y = X[0, 1] * t.up[0] + X[1, 1] * t.up[1] + X[2, 1] * t.up[2]
    z = X[0, 2] * t.up[0] + X[1, 2] * t.up[1] + X[2, 2] * t.up[2]
    for v in t.feet:
        lean = v[3] * x + v[4] * y + v[5] * z
        sunk = v[6] * math.sqrt(max(1.0 - lean * lean, 0.0)) + v[7]
        if v[0] * x + v[1] * y + v[2] * z + level < sunk:
            return False
    return True


@njit()
def object_off_palm(w, X, s, least):
    """Whether the object at X (3, 4) is clear of what stands still; it may touch the table."""
    o, b = w.object, w.palm
    if not _on_table(w.table, X):
        return False
    for j in range(len(o.kind)):
        m = o.middle[j]
        x = X[0, 3] + X[0, 0] * m[0] + X[0, 1] * m[1] + X[0, 2] * m[2]
        y = X[1, 3] + X[1, 0] * m[0] + X[1, 1] * m[1] + X[1, 2] * m[2]
        z = X[2, 3] + X[2, 0] * m[0] + X[2, 1] * m[1] + X[2, 2] * m[2]
        if outside_box(b.low, b.high, x, y, z) >= o.reach[j] + least:
            continue
        for h in range(len(b.kind)):
            n, reach = b.middle[h], o.reach[j] + b.reach[h] + least
            if (x - n[0]) ** 2 + (y - n[1]) ** 2 + (z - n[2]) ** 2 >= reach * reach:
                continue
            if not _hulls_apart(w.palm_hulls, w.palm_hulls.p, h, w.object_hulls, w.object_hulls.p, j, X, s, least):
                return False
    return True


@njit()
def clear_alone(w, f, q, touching_tip, X, s, least):
    """Places finger f and tells whether it is clear of palm, object and all other placed fingers."""
    place(w, f, q, s)
    if not off_palm(w, f, s, least) or not off_object(w, f, X, s, not touching_tip, least):
        return False
    free = True
    for j in range(len(w.chains.radius)):
        free = free and (j == f or apart(w, f, j, s, least))
    return free


@njit()
def collides(w, q, touching, X, s):
    """What collides with the object at X (3, 4) and the fingers at q, those that wait already placed."""
    n = len(touching)
    for f in range(n):
        if touching[f]:
            place(w, f, q[f], s)
            if not off_palm(w, f, s, w.clearance):
                return PALM, f
        if not off_object(w, f, X, s, not touching[f], w.clearance):
            return OBJECT, f
    for f in range(n):
        for j in range(f):
            if (touching[f] or touching[j]) and not apart(w, f, j, s, w.clearance):
                return FINGERS, f
    if not object_off_palm(w, X, s, w.clearance):
        return PALM, -1
    return END, -1


@njit((WORLD, float64[:, :, ::1], float64[:, :, ::1], boolean[:, ::1], boolean[::1]))
def clear(w, X, q0, touching, ok):
    """Writes whether whole hands (N, n, m) are clear of everything, the object at X (N, 3, 4)."""
    s = scratch(w)
    n = q0.shape[1]
    for i in range(len(q0)):
        for f in range(n):
            place(w, f, q0[i, f], s)
        reason, _ = collides(w, q0[i], touching[i], X[i], s)
        ok[i] = reason == END
        for f in range(n):
            for j in range(f):
                ok[i] &= touching[i, f] or touching[i, j] or apart(w, f, j, s, w.clearance)
            if ok[i] and not touching[i, f]:
                ok[i] = off_palm(w, f, s, w.clearance)


@njit((SOLID, float64[:, ::1], float64, float64[::1]))
def distances(b, p, near, out):
    """Writes the signed distance of points (N, 3) from a solid; of those farther than `near`, a lower bound."""
    for i in range(len(p)):
        out[i] = closest(b, p[i, 0], p[i, 1], p[i, 2], near)[6]
