"""Compiled forms of what the planner asks millions of times: finger frames, closest points, one step of rolling.

The same formulas as in `chain.py`, `surface.py` and `rolling.py`, row by row instead of in batches; tested equal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drake_hand.compiled import njit
from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.object import Geometry

_KINDS = {"sphere": 0, "capsule": 1, "cylinder": 2, "box": 3, "mesh": 4}
DAMPING = 1e-4
"""Of the least-squares solutions, m per rad, as in `rolling`."""


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


class Solid(NamedTuple):
    """A union of convex shapes, in the frame of the body they are fixed to."""

    kind: np.ndarray
    """(G,) index into sphere, capsule, cylinder, box, mesh."""
    R: np.ndarray
    """(G, 3, 3)."""
    p: np.ndarray
    """(G, 3) m."""
    size: np.ndarray
    """(G, 3) as `Geometry.size`."""
    first: np.ndarray
    """(G + 1,) a mesh's first triangle."""
    corners: np.ndarray
    """(T, 3, 3) of the triangles, m."""
    normals: np.ndarray
    """(T, 3)."""
    low: np.ndarray
    """(3,) of the box around all of it, m."""
    high: np.ndarray
    """(3,) m."""


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


def solid(geometries: tuple[Geometry, ...]) -> Solid:
    """The arrays of some shapes."""
    corners = [g.vertices[g.faces] if g.kind == "mesh" else np.zeros((0, 3, 3)) for g in geometries]
    T = np.concatenate(corners)
    normals = np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0])
    box = np.concatenate([g.box_O for g in geometries])
    return Solid(
        kind=np.array([_KINDS[g.kind] for g in geometries]),
        R=np.stack([np.ascontiguousarray(g.X_OG[:3, :3], dtype=float) for g in geometries]),
        p=np.stack([np.asarray(g.X_OG[:3, 3], dtype=float) for g in geometries]),
        size=np.array([(*g.size, 0.0, 0.0, 0.0)[:3] for g in geometries], dtype=float),
        first=np.cumsum([0] + [len(c) for c in corners]),
        corners=np.ascontiguousarray(T),
        normals=np.ascontiguousarray(normals / np.linalg.norm(normals, axis=1, keepdims=True)),
        low=box.min(axis=0),
        high=box.max(axis=0),
    )


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
def least_squares(J, m, bx, by, bz, damping, x):
    """Writes the damped least-norm solution (m,) of J x = b."""
    d = damping * damping
    m00, m11, m22, m01, m02, m12 = d, d, d, 0.0, 0.0, 0.0
    for j in range(m):
        a, b, c = J[0, j], J[1, j], J[2, j]
        m00 += a * a
        m11 += b * b
        m22 += c * c
        m01 += a * b
        m02 += a * c
        m12 += b * c
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
def closest(s, x, y, z, near):
    """The surface point nearest to (x, y, z) in the body's frame.

    Returns:
        Foot, outward normal and signed distance, as `Surface.closest`: seven numbers. Where the distance is more than
        `near` it is only a lower bound, and foot and normal may be anything.
    """
    best = closest_of(s, 0, x, y, z, near)
    for g in range(1, len(s.kind)):
        found = closest_of(s, g, x, y, z, min(near, best[6]))
        if found[6] < best[6]:
            best = found
    return best


@njit()
def closest_of(s, g, x, y, z, near):
    """As `closest`, of shape g alone."""
    R, t = s.R[g], s.p[g]
    dx, dy, dz = x - t[0], y - t[1], z - t[2]
    px = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
    py = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
    pz = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    kind, size = s.kind[g], s.size[g]
    if kind == 0:
        a, b, c, u, v, w, d = _round(px, py, pz, 0.0, size[0])
    elif kind == 1:
        a, b, c, u, v, w, d = _round(px, py, pz, size[1] / 2, size[0])
    elif kind == 2:
        a, b, c, u, v, w, d = _cylinder(px, py, pz, size[0], size[1] / 2)
    elif kind == 3:
        a, b, c, u, v, w, d = _box(px, py, pz, size[0] / 2, size[1] / 2, size[2] / 2)
    else:
        a, b, c, u, v, w, d = _mesh(px, py, pz, s, s.first[g], s.first[g + 1], near)
    return (
        t[0] + R[0, 0] * a + R[0, 1] * b + R[0, 2] * c,
        t[1] + R[1, 0] * a + R[1, 1] * b + R[1, 2] * c,
        t[2] + R[2, 0] * a + R[2, 1] * b + R[2, 2] * c,
        R[0, 0] * u + R[0, 1] * v + R[0, 2] * w,
        R[1, 0] * u + R[1, 1] * v + R[1, 2] * w,
        R[2, 0] * u + R[2, 1] * v + R[2, 2] * w,
        d,
    )


@njit()
def _outward(px, py, pz, fx, fy, fz):
    nx, ny, nz = px - fx, py - fy, pz - fz
    d = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / d, ny / d, nz / d, d


@njit()
def _round(px, py, pz, half, r):
    core = min(max(pz, -half), half)
    dz = pz - core
    d = math.sqrt(px * px + py * py + dz * dz)
    if d > 1e-12:
        u, v, w = px / d, py / d, dz / d
    else:
        u, v, w = (1.0, 0.0, 0.0) if half > 0.0 else (0.0, 0.0, 1.0)
    return u * r, v * r, core + w * r, u, v, w, d - r


@njit()
def _cylinder(px, py, pz, r, half):
    rho = math.hypot(px, py)
    u, v = (px / rho, py / rho) if rho > 1e-12 else (1.0, 0.0)
    side, cap = rho - r, abs(pz) - half
    sign = -1.0 if pz < 0.0 else 1.0
    if side <= 0.0 and cap <= 0.0:
        if cap > side:
            return px, py, sign * half, 0.0, 0.0, sign, cap
        return u * r, v * r, pz, u, v, 0.0, side
    on = min(rho, r)
    fx, fy, fz = u * on, v * on, min(max(pz, -half), half)
    nx, ny, nz, d = _outward(px, py, pz, fx, fy, fz)
    return fx, fy, fz, nx, ny, nz, d


@njit()
def _box(px, py, pz, a, b, c):
    ex, ey, ez = abs(px) - a, abs(py) - b, abs(pz) - c
    if ex <= 0.0 and ey <= 0.0 and ez <= 0.0:
        if ex >= ey and ex >= ez:
            s = -1.0 if px < 0.0 else 1.0
            return s * a, py, pz, s, 0.0, 0.0, ex
        if ey >= ez:
            s = -1.0 if py < 0.0 else 1.0
            return px, s * b, pz, 0.0, s, 0.0, ey
        s = -1.0 if pz < 0.0 else 1.0
        return px, py, s * c, 0.0, 0.0, s, ez
    fx, fy, fz = min(max(px, -a), a), min(max(py, -b), b), min(max(pz, -c), c)
    nx, ny, nz, d = _outward(px, py, pz, fx, fy, fz)
    return fx, fy, fz, nx, ny, nz, d


@njit()
def _mesh(px, py, pz, s, first, last, near):
    """Convex polyhedron: its highest plane decides inside, and bounds the distance from below."""
    best, height = first, -np.inf
    for t in range(first, last):
        a, n = s.corners[t, 0], s.normals[t]
        h = (px - a[0]) * n[0] + (py - a[1]) * n[1] + (pz - a[2]) * n[2]
        if h > height:
            height, best = h, t
    n = s.normals[best]
    if height <= 0.0 or height > near:
        return px - height * n[0], py - height * n[1], pz - height * n[2], n[0], n[1], n[2], height
    fx, fy, fz, least = 0.0, 0.0, 0.0, np.inf
    for k in range(first - 1, last):
        t = best if k < first else k
        T, n = s.corners[t], s.normals[t]
        h = (px - T[0, 0]) * n[0] + (py - T[0, 1]) * n[1] + (pz - T[0, 2]) * n[2]
        # Only faces that see the query can be nearest.
        if h <= 0.0 or h * h >= least:
            continue
        x, y, z = _triangle(px, py, pz, T)
        d = (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2
        if d < least:
            fx, fy, fz, least = x, y, z, d
    nx, ny, nz, d = _outward(px, py, pz, fx, fy, fz)
    return fx, fy, fz, nx, ny, nz, d


@njit()
def _triangle(px, py, pz, T):
    """Nearest point of a triangle (Ericson 2005, section 5.1.5)."""
    ax, ay, az = T[0, 0], T[0, 1], T[0, 2]
    ux, uy, uz = T[1, 0] - ax, T[1, 1] - ay, T[1, 2] - az
    vx, vy, vz = T[2, 0] - ax, T[2, 1] - ay, T[2, 2] - az
    wx, wy, wz = px - ax, py - ay, pz - az
    d1, d2 = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    if d1 <= 0.0 and d2 <= 0.0:
        return ax, ay, az
    bx, by, bz = wx - ux, wy - uy, wz - uz
    d3, d4 = ux * bx + uy * by + uz * bz, vx * bx + vy * by + vz * bz
    if d3 >= 0.0 and d4 <= d3:
        return T[1, 0], T[1, 1], T[1, 2]
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        k = d1 / (d1 - d3)
        return ax + k * ux, ay + k * uy, az + k * uz
    cx, cy, cz = wx - vx, wy - vy, wz - vz
    d5, d6 = ux * cx + uy * cy + uz * cz, vx * cx + vy * cy + vz * cz
    if d6 >= 0.0 and d5 <= d6:
        return T[2, 0], T[2, 1], T[2, 2]
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        k = d2 / (d2 - d6)
        return ax + k * vx, ay + k * vy, az + k * vz
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and (d4 - d3) >= 0.0 and (d5 - d6) >= 0.0:
        k = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return T[1, 0] + k * (vx - ux), T[1, 1] + k * (vy - uy), T[1, 2] + k * (vz - uz)
    k = 1.0 / (va + vb + vc)
    v, w = vb * k, vc * k
    return ax + v * ux + w * vx, ay + v * uy + w * vy, az + v * uz + w * vz


@njit()
def edge_distance(s, x, y, z):
    """How far a surface point is from the nearest edge of a primitive, m; inf where there is none."""
    least = np.inf
    for g in range(len(s.kind)):
        kind, size, R, t = s.kind[g], s.size[g], s.R[g], s.p[g]
        if kind != 2 and kind != 3:
            continue
        dx, dy, dz = x - t[0], y - t[1], z - t[2]
        px = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        py = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        pz = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if kind == 2:
            d = math.hypot(math.hypot(px, py) - size[0], abs(pz) - size[1] / 2)
        else:
            a, b, c = size[0] / 2 - abs(px), size[1] / 2 - abs(py), size[2] / 2 - abs(pz)
            low, high = min(a, b, c), max(a, b, c)
            d = math.hypot(low, a + b + c - low - high)
        least = min(least, d)
    return least


@njit()
def touch(c, s, f, q, X, p, R):
    """Where finger f at q (m,) is nearest to an object at X (3, 4).

    Returns:
        Tip centre in W, foot in O, outward normal in W, distance of the tip centre: ten numbers. The finger's frames
        are left in p, R.
    """
    frames(c, f, q, p, R)
    x, y, z = tip(c, f, p, R)
    dx, dy, dz = x - X[0, 3], y - X[1, 3], z - X[2, 3]
    fx, fy, fz, nx, ny, nz, d = closest(
        s,
        X[0, 0] * dx + X[1, 0] * dy + X[2, 0] * dz,
        X[0, 1] * dx + X[1, 1] * dy + X[2, 1] * dz,
        X[0, 2] * dx + X[1, 2] * dy + X[2, 2] * dz,
        np.inf,
    )
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
    least_squares(J, m, bx, by, bz, DAMPING, rate)
    for j in range(m):
        bx -= J[0, j] * rate[j]
        by -= J[1, j] * rate[j]
        bz -= J[2, j] * rate[j]
    return math.sqrt(bx * bx + by * by + bz * bz)
