"""Compiled kinematics of fingers: frames and Jacobians as in `chain.py`, where they touch, how contacts roll.

The formulas of `chain.py`, row by row instead of in batches; tested equal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import typeof

from drake_hand.compiled import njit
from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kernels.geometry import closest

DAMPING_M_PER_RAD = 1e-4
"""Of the least-squares solutions, m per rad."""
_ROUNDING_M = 1e-9
"""More than distances are rounded by, m."""


class Chains(NamedTuple):
    """The fingers of a hand as arrays: n fingers of at most m commanded joints, their axes one finger after another."""

    first: np.ndarray
    """(n + 1,) a finger's first axis."""
    R: np.ndarray
    """(A, 3, 3) orientation of each axis' frame in the one before; every joint moves along its z."""
    p: np.ndarray
    """(A, 3) m."""
    source: np.ndarray
    """(A,) commanded joint of the finger that moves it ..."""
    multiplier: np.ndarray
    """(A,) ... so many times ..."""
    offset: np.ndarray
    """(A,) ... from here, rad or m."""
    prismatic: np.ndarray
    """(A,) bool."""
    tip: np.ndarray
    """(n, 3) tip centre in the last joint's frame, m."""
    radius: np.ndarray
    """(n,) m."""
    joints: np.ndarray
    """(n,) number of commanded joints."""
    lower: np.ndarray
    """(n, m) rad."""
    upper: np.ndarray
    """(n, m) rad."""


def chains(kinematics: list[FingerKinematics]) -> Chains:
    """The arrays of a hand's fingers."""
    m = max(len(k.lower) for k in kinematics)
    links = [link for k in kinematics for link in k._links]
    lower, upper = np.zeros((2, len(kinematics), m))
    for i, k in enumerate(kinematics):
        lower[i, : len(k.lower)], upper[i, : len(k.upper)] = k.lower, k.upper
    return Chains(
        first=np.cumsum([0] + [len(k._links) for k in kinematics]),
        R=np.stack([R for _, R, _, _ in links]),
        p=np.stack([p for _, _, p, _ in links]),
        source=np.array([a.source for a, *_ in links]),
        multiplier=np.array([a.multiplier for a, *_ in links], dtype=float),
        offset=np.array([a.offset for a, *_ in links], dtype=float),
        prismatic=np.array([a.prismatic for a, *_ in links], dtype=np.bool_),
        tip=np.stack([k._links[-1][3].T @ k.finger.X_JT[:3, 3] for k in kinematics]),
        radius=np.array([k.finger.radius for k in kinematics], dtype=float),
        joints=np.array([len(k.lower) for k in kinematics]),
        lower=lower,
        upper=upper,
    )


def no_fingers() -> Chains:
    """The arrays of none, of the same types."""

    def floats(*shape: int) -> np.ndarray:
        return np.zeros(shape)

    ints, flags = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
    return Chains(
        ints, floats(0, 3, 3), floats(0, 3), ints, floats(0), floats(0), flags, floats(0, 3), floats(0), ints,
        floats(0, 0), floats(0, 0),
    )  # fmt: skip


CHAINS = typeof(no_fingers())
"""Type of `Chains` for the signatures of kernels."""


@njit()
def frames(c, f, q, p, R):
    """Writes origins (A, 3) and orientations (A, 3, 3) of the joints of finger f at q (m,) into the finger's rows."""
    first = c.first[f]
    for a in range(first, c.first[f + 1]):
        x = c.multiplier[a] * q[c.source[a]] + c.offset[a]
        A, t = c.R[a], c.p[a]
        if a == first:
            for i in range(3):
                p[a, i] = t[i]
                for j in range(3):
                    R[a, i, j] = A[i, j]
        else:
            B = R[a - 1]
            for i in range(3):
                p[a, i] = p[a - 1, i] + B[i, 0] * t[0] + B[i, 1] * t[1] + B[i, 2] * t[2]
                for j in range(3):
                    R[a, i, j] = B[i, 0] * A[0, j] + B[i, 1] * A[1, j] + B[i, 2] * A[2, j]
        if c.prismatic[a]:
            for i in range(3):
                p[a, i] += R[a, i, 2] * x
        else:
            cos, sin = math.cos(x), math.sin(x)
            for i in range(3):
                u, v = R[a, i, 0], R[a, i, 1]
                R[a, i, 0], R[a, i, 1] = u * cos + v * sin, v * cos - u * sin


@njit()
def tip(c, f, p, R):
    """Tip centre of finger f from its frames."""
    a, t = c.first[f + 1] - 1, c.tip[f]
    return (
        p[a, 0] + R[a, 0, 0] * t[0] + R[a, 0, 1] * t[1] + R[a, 0, 2] * t[2],
        p[a, 1] + R[a, 1, 0] * t[0] + R[a, 1, 1] * t[1] + R[a, 1, 2] * t[2],
        p[a, 2] + R[a, 2, 0] * t[0] + R[a, 2, 1] * t[1] + R[a, 2, 2] * t[2],
    )


@njit()
def jacobian(c, f, p, R, x, y, z, J):
    """Writes the Jacobian (3, m) of the tip's material at (x, y, z) in W, from the finger's frames."""
    J[:] = 0.0
    for a in range(c.first[f], c.first[f + 1]):
        s, k = c.source[a], c.multiplier[a]
        ux, uy, uz = k * R[a, 0, 2], k * R[a, 1, 2], k * R[a, 2, 2]
        if c.prismatic[a]:
            J[0, s] += ux
            J[1, s] += uy
            J[2, s] += uz
        else:
            dx, dy, dz = x - p[a, 0], y - p[a, 1], z - p[a, 2]
            J[0, s] += uy * dz - uz * dy
            J[1, s] += uz * dx - ux * dz
            J[2, s] += ux * dy - uy * dx


@njit()
def _gram(J, m, d):
    """J J^T + d I of J (3, m): its diagonal, and what is beside it in rows 01, 02, 12."""
    m00, m11, m22, m01, m02, m12 = d, d, d, 0.0, 0.0, 0.0
    for j in range(m):
        a, b, c = J[0, j], J[1, j], J[2, j]
        m00 += a * a
        m11 += b * b
        m22 += c * c
        m01 += a * b
        m02 += a * c
        m12 += b * c
    return m00, m11, m22, m01, m02, m12


@njit()
def least_squares(J, m, bx, by, bz, damping, x):
    """Writes the damped least-norm solution (m,) of J x = b."""
    m00, m11, m22, m01, m02, m12 = _gram(J, m, damping * damping)
    c00, c11, c22 = m11 * m22 - m12 * m12, m00 * m22 - m02 * m02, m00 * m11 - m01 * m01
    c01, c02, c12 = m02 * m12 - m01 * m22, m01 * m12 - m02 * m11, m01 * m02 - m00 * m12
    det = m00 * c00 + m01 * c01 + m02 * c02
    if abs(det) < 1e-30:
        det = 1e-30
    y0 = (c00 * bx + c01 * by + c02 * bz) / det
    y1 = (c01 * bx + c11 * by + c12 * bz) / det
    y2 = (c02 * bx + c12 * by + c22 * bz) / det
    for j in range(m):
        x[j] = J[0, j] * y0 + J[1, j] * y1 + J[2, j] * y2


@njit()
def dexterous(J, m, least):
    """Whether the singular values of J (3, m) are all at least so much; true where m < 3 joints leave one at zero."""
    if m < 3:
        return True
    m00, m11, m22, m01, m02, m12 = _gram(J, m, -least * least)
    minor = m00 * m11 - m01 * m01
    det = m00 * (m11 * m22 - m12 * m12) - m01 * (m01 * m22 - m12 * m02) + m02 * (m01 * m12 - m11 * m02)
    return m00 > 0.0 and minor > 0.0 and det > 0.0


@njit(inline=True)
def touch(c, s, f, q, X, p, R, foot):
    """Where finger f at q (m,) is nearest to an object at X (3, 4).

    `foot` (n, 3) is where each finger was nearest when asked last, in O, or far away: nothing farther than that point
    needs to be looked at. The finger's row is written.

    Returns:
        Tip centre in W, foot in O, outward normal in W, distance of the tip centre: ten numbers. The finger's frames
        are left in p, R.
    """
    frames(c, f, q, p, R)
    x, y, z = tip(c, f, p, R)
    dx, dy, dz = x - X[0, 3], y - X[1, 3], z - X[2, 3]
    px = X[0, 0] * dx + X[1, 0] * dy + X[2, 0] * dz
    py = X[0, 1] * dx + X[1, 1] * dy + X[2, 1] * dz
    pz = X[0, 2] * dx + X[1, 2] * dy + X[2, 2] * dz
    near = np.inf
    if len(s.faces) > 0:
        near = math.sqrt((px - foot[f, 0]) ** 2 + (py - foot[f, 1]) ** 2 + (pz - foot[f, 2]) ** 2) + _ROUNDING_M
    fx, fy, fz, nx, ny, nz, d = closest(s, px, py, pz, near)
    if len(s.faces) > 0:
        foot[f, 0], foot[f, 1], foot[f, 2] = fx, fy, fz
    return (
        x,
        y,
        z,
        fx,
        fy,
        fz,
        X[0, 0] * nx + X[0, 1] * ny + X[0, 2] * nz,
        X[1, 0] * nx + X[1, 1] * ny + X[1, 2] * nz,
        X[2, 0] * nx + X[2, 1] * ny + X[2, 2] * nz,
        d,
    )


@njit()
def rates(c, f, p, R, at, X, w, v, pivot, J, rate):
    """Writes the joint rates (m,) of a contact `at` (from `touch`) under the object's twist; returns what they miss."""
    m = c.joints[f]
    r = 0.0 if pivot else c.radius[f]
    x, y, z = at[0] - r * at[6], at[1] - r * at[7], at[2] - r * at[8]
    jacobian(c, f, p, R, x, y, z, J)
    dx, dy, dz = x - X[0, 3], y - X[1, 3], z - X[2, 3]
    bx = v[0] + w[1] * dz - w[2] * dy
    by = v[1] + w[2] * dx - w[0] * dz
    bz = v[2] + w[0] * dy - w[1] * dx
    least_squares(J, m, bx, by, bz, DAMPING_M_PER_RAD, rate)
    for j in range(m):
        bx -= J[0, j] * rate[j]
        by -= J[1, j] * rate[j]
        bz -= J[2, j] * rate[j]
    return math.sqrt(bx * bx + by * by + bz * bz)
