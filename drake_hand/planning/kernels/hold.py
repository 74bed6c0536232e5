"""Whether contacts hold the object, with all fingers and without each.

What cannot spare a finger is a dead end, however firmly it holds, so the margins without each of them are always asked
too.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64

from drake_hand.compiled import njit
from drake_hand.contact.compliance import DAMPING_M
from drake_hand.contact.kernels.equilibrium import margin
from drake_hand.contact.kernels.rolling import dexterous, jacobian, least_squares, touch
from drake_hand.planning.kernels.steady import spring_at, steady
from drake_hand.planning.kernels.world import LOAD, WORLD, scratch
from drake_hand.plans.tolerances import TWIST_RAD

COUNTED_MARGIN_N = 0.3
"""Margin up to which more is better, N."""
COUNTED_FIRMNESS = 3
"""The same of the stiffness of holds, in times that which is asked for."""
SERVO_ROOM_RAD = math.radians(0.5)
"""Kept from joint limits by forces, for what else is added to commands."""
GIVES_WAY_N = -1e-9
"""Margin of contacts that balance the object, but would not bring it back: they come nearest of those that fail, N."""
NO_HOLD_N = -1e3
"""Margin of contacts that no force makes a hold of: too few, or a tip that can hardly be moved in some direction, N."""
LEAST_EFFORT_NM = 1e-9
"""Of a joint at its limit, Nm: next to none."""


@njit()
def contact_at(w, load, f, q, X, s):
    """Takes finger f's contact with the object at X (3, 4) into the scratch's set of contacts.

    With it the efforts that its servos have left when its pad is pressed in: none where they cannot be commanded there.
    """
    at = touch(w.chains, w.object, f, q, X, s.p, s.R, s.foot)
    r = w.chains.radius[f]
    for i in range(3):
        s.N[f, i] = -at[6 + i]
        s.P[f, i] = at[i] - r * at[6 + i]
    jacobian(w.chains, f, s.p, s.R, s.P[f, 0], s.P[f, 1], s.P[f, 2], s.JP[f])
    if not load.kinematic:
        c, able, d = w.chains, True, load.compression
        least_squares(s.JP[f], c.joints[f], d * s.N[f, 0], d * s.N[f, 1], d * s.N[f, 2], DAMPING_M, s.rate)
        for j in range(c.joints[f]):
            up, down = c.upper[f, j] - q[j] - s.rate[j], q[j] + s.rate[j] - c.lower[f, j]
            able &= up > 0.0 and down > 0.0
            for way, room in enumerate((up, down)):
                most = load.stiffness[f, j] * (room - SERVO_ROOM_RAD)
                s.effort[f, way, j] = max(min(load.effort[f, j], most), LEAST_EFFORT_NM)
        if not able:
            s.effort[f] = LEAST_EFFORT_NM
        spring_at(w, load, f, X, at, s)
    return at


@njit()
def twists(w, f, q, before, turned, s):
    """Twists the pad of finger f, whose contact was taken last, on; see `contact.spin`.

    From posture `before` to q (m,) its object has turned by a rotation vector.
    """
    c, n = w.chains, s.N[f]
    x, y, z = -turned[0], -turned[1], -turned[2]
    for a in range(c.first[f], c.first[f + 1]):
        if not c.prismatic[a]:
            step = c.multiplier[a] * (q[c.source[a]] - before[c.source[a]])
            x += step * s.R[a, 0, 2]
            y += step * s.R[a, 1, 2]
            z += step * s.R[a, 2, 2]
    s.spin[f] = min(max(s.spin[f] + (x * n[0] + y * n[1] + z * n[2]) / TWIST_RAD, -1.0), 1.0)


@njit()
def centre_of_mass(w, X, out):
    """Writes where the mass centre (3,) of an object at X (3, 4) is."""
    o = w.p_OCom
    for i in range(3):
        out[i] = X[i, 3] + X[i, 0] * o[0] + X[i, 1] * o[1] + X[i, 2] * o[2]


@njit()
def held(w, load, mask, X, s, enough):
    """The margin with which the contacts taken so far hold the object at X (3, 4).

    It is the preload that each of them can be given, less the one wanted, N, or `GIVES_WAY_N`, or `NO_HOLD_N`;
    kinematically, from 0 to one half the better the normals are opposed, where the contacts are enough, else how many
    are missing.

    Of a margin that is more than `enough` only that is told, not how much.
    """
    count, nx, ny, nz = 0, 0.0, 0.0, 0.0
    for f in range(len(mask)):
        if mask[f]:
            count += 1
            nx += s.N[f, 0]
            ny += s.N[f, 1]
            nz += s.N[f, 2]
    if count < load.min_contacts:
        return float(count - load.min_contacts) if load.kinematic else NO_HOLD_N
    if load.kinematic:
        return 0.5 * (1.0 - math.sqrt(nx * nx + ny * ny + nz * nz) / max(count, 1))
    for f in range(len(mask)):
        if mask[f] and not dexterous(s.JP[f], w.chains.joints[f], load.dexterity):
            return NO_HOLD_N
    com = s.force
    centre_of_mass(w, X, com)
    found = margin(
        s.tableau,
        s.basis,
        s.pivoted,
        s.P,
        s.N,
        mask,
        com,
        load.force_W,
        load.friction,
        load.torsion_radius,
        0.0,
        s.JP,
        s.effort,
        s.drag,
        s.spin,
        load.spin_arm,
        load.preload + enough,
    )
    if found >= load.preload and not steady(w, load, mask, com, s, 1.0):
        return GIVES_WAY_N
    return found - load.preload


@njit()
def _as_firm(w, load, mask, found, s):
    """The margin that `held` found last, or less where contacts hold no more than just; s.force is as it left it."""
    for times in range(2, COUNTED_FIRMNESS + 1):
        if not steady(w, load, mask, s.force, s, float(times)):
            return min(found, COUNTED_MARGIN_N * (times - 1) / COUNTED_FIRMNESS)
    return found


@njit(
    (
        WORLD,
        LOAD,
        float64[:, :, ::1],
        float64[:, :, ::1],
        boolean[:, ::1],
        float64[:, ::1],
        float64[:, :, ::1],
        float64[:, :, ::1],
    )
)
def held_without(w, load, X, q0, touching, margins, p_OP, n_W):
    """Writes margins (N, n + 1) of sets of contacts: without each finger, and in the last column with all.

    The last is exact up to `COUNTED_MARGIN_N`; of the others, whether they are negative and how much then. Fingers that
    do not touch, and all where even all together do not hold, have that of all. Contact points in O and outward normals
    in W (N, n, 3) are written too.
    """
    s = scratch(w)
    n = q0.shape[1]
    mask = np.zeros(n, dtype=np.bool_)
    for i in range(len(q0)):
        for f in range(n):
            mask[f] = touching[i, f]
            if mask[f]:
                at = contact_at(w, load, f, q0[i, f], X[i], s)
                for k in range(3):
                    p_OP[i, f, k], n_W[i, f, k] = at[3 + k], at[6 + k]
        margins[i, n] = held(w, load, mask, X[i], s, COUNTED_MARGIN_N)
        if margins[i, n] > 0.0 and not load.kinematic:
            margins[i, n] = _as_firm(w, load, mask, margins[i, n], s)
        for f in range(n):
            margins[i, f] = margins[i, n]
            if touching[i, f] and margins[i, n] >= 0.0:
                mask[f] = False
                margins[i, f] = held(w, load, mask, X[i], s, 0.0)
                mask[f] = True
