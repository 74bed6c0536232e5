"""Closest points, normals and distances of a union of convex shapes, point by point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import float64, typeof

from drake_hand.compiled import njit
from drake_hand.model.object import Geometry

_KINDS = {"sphere": 0, "capsule": 1, "cylinder": 2, "box": 3, "mesh": 4}
MOST_TOGETHER = 16
"""Triangles in a group, at most."""
_ON_SURFACE_M = 1e-9
"""m; of a point this near to a surface neither its side nor its direction can be told from where it is."""


class ShapeArrays(NamedTuple):
    """A union of convex shapes, in the frame of the body they are fixed to."""

    kind: np.ndarray
    """(G,) index into sphere, capsule, cylinder, box, mesh."""
    R: np.ndarray
    """(G, 3, 3)."""
    p: np.ndarray
    """(G, 3) m."""
    size: np.ndarray
    """(G, 3) as `Geometry.size`."""
    first_group: np.ndarray
    """(G + 1,) a mesh's first group of triangles that lie together."""
    groups: np.ndarray
    """(K + 1,) the first triangle of each group."""
    around: np.ndarray
    """(K, 2, 3) lowest and highest corner of a box around each group, m."""
    faces: np.ndarray
    """(T, 16) triangles: normal n and n.a (m); a corner a and the sides u and v from it (m); u.u, u.v, v.v (m^2)."""
    first_edge: np.ndarray
    """(G + 1,) a mesh's first sharp edge."""
    edges: np.ndarray
    """(E, 2, 3) ends of those, m."""
    low: np.ndarray
    """(3,) of the box around all of it, m."""
    high: np.ndarray
    """(3,) m."""
    middle: np.ndarray
    """(G, 3) of the ball around each shape, m."""
    reach: np.ndarray
    """(G,) its radius, m."""
    boxes: np.ndarray
    """(G, 2, 3) lowest and highest corner of the box around each shape, m."""


def no_shapes() -> ShapeArrays:
    """The arrays of none, of the same types."""

    def floats(*shape: int) -> np.ndarray:
        return np.zeros(shape)

    ints = np.zeros(0, dtype=np.int64)
    return ShapeArrays(
        ints, floats(0, 3, 3), floats(0, 3), floats(0, 3), ints, ints, floats(0, 2, 3), floats(0, 16), ints,
        floats(0, 2, 3), floats(3), floats(3), floats(0, 3), floats(0), floats(0, 2, 3),
    )  # fmt: skip


SOLID = typeof(no_shapes())
"""Type of `ShapeArrays` for the signatures of kernels."""


def solid(geometries: tuple[Geometry, ...]) -> ShapeArrays:
    """The arrays of some shapes."""
    grouped = [_together(g.vertices[g.faces]) if g.kind == "mesh" else [] for g in geometries]
    groups = [group for of_shape in grouped for group in of_shape]
    corners = [group.reshape(-1, 3) for group in groups]
    middle = np.stack([g.box_O.mean(axis=0) for g in geometries])
    reach = [np.linalg.norm(_extreme(g) - m, axis=1).max() for g, m in zip(geometries, middle, strict=True)]
    boxes = np.stack([[g.box_O.min(axis=0), g.box_O.max(axis=0)] for g in geometries])
    return ShapeArrays(
        kind=np.array([_KINDS[g.kind] for g in geometries]),
        R=np.stack([np.ascontiguousarray(g.X_OG[:3, :3], dtype=float) for g in geometries]),
        p=np.stack([np.asarray(g.X_OG[:3, 3], dtype=float) for g in geometries]),
        size=np.array([(*g.size, 0.0, 0.0, 0.0)[:3] for g in geometries], dtype=float),
        first_group=np.cumsum([0] + [len(of_shape) for of_shape in grouped]),
        groups=np.cumsum([0] + [len(group) for group in groups]),
        around=np.array([[p.min(axis=0), p.max(axis=0)] for p in corners]).reshape(-1, 2, 3),
        faces=_faces(np.concatenate([np.zeros((0, 3, 3)), *groups])),
        first_edge=np.cumsum([0] + [len(g.sharp_edges) for g in geometries]),
        edges=np.ascontiguousarray(np.concatenate([g.sharp_edges for g in geometries])),
        low=boxes[:, 0].min(axis=0),
        high=boxes[:, 1].max(axis=0),
        middle=middle,
        reach=np.array(reach, dtype=float),
        boxes=np.ascontiguousarray(boxes),
    )


def _faces(T: np.ndarray) -> np.ndarray:
    """(T, 16) of triangles (T, 3, 3), see `ShapeArrays.faces`."""
    a, u, v = T[:, 0], T[:, 1] - T[:, 0], T[:, 2] - T[:, 0]
    n = np.cross(u, v)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    dots = [np.einsum("ti,ti->t", x, y) for x, y in ((n, a), (u, u), (u, v), (v, v))]
    return np.ascontiguousarray(np.column_stack([n, dots[0], a, u, v, *dots[1:]]))


def _together(T: np.ndarray) -> list[np.ndarray]:
    """Triangles (T, 3, 3) in groups that lie together, halved across their longest side until they are small."""
    if len(T) <= MOST_TOGETHER:
        return [T]
    middle = T.mean(axis=1)
    order = np.argsort(middle[:, np.ptp(middle, axis=0).argmax()], kind="stable")
    half = len(T) // 2
    return _together(T[order[:half]]) + _together(T[order[half:]])


def _extreme(g: Geometry) -> np.ndarray:
    """(K, 3) points in the body's frame; a ball around them is around the shape."""
    return g.vertices @ g.X_OG[:3, :3].T + g.X_OG[:3, 3] if g.kind == "mesh" else g.box_O


@njit()
def _off_box(low, high, x, y, z):
    """The square of how far a point is from a box between two corners (3,)."""
    dx = max(low[0] - x, x - high[0], 0.0)
    dy = max(low[1] - y, y - high[1], 0.0)
    dz = max(low[2] - z, z - high[2], 0.0)
    return dx * dx + dy * dy + dz * dz


@njit()
def outside_box(low, high, x, y, z):
    """How far a point is from a box between two corners (3,)."""
    return math.sqrt(_off_box(low, high, x, y, z))


@njit()
def _nearest_box(boxes, a, b, x, y, z):
    """The first of boxes a to b, (any, 2, 3), that is nearest to a point."""
    best, nearest = a, np.inf
    for k in range(a, b):
        off = _off_box(boxes[k, 0], boxes[k, 1], x, y, z)
        if off < nearest:
            best, nearest = k, off
    return best


@njit(inline=True)
def closest(s, x, y, z, near):
    """The surface point nearest to (x, y, z) in the body's frame.

    Returns:
        Foot, outward normal and signed distance, seven numbers; some nearest point where there are several. Where the
        distance is more than `near` it is only a lower bound, and foot and normal may be anything.
    """
    n = len(s.kind)
    begin = _nearest_box(s.boxes, 0, n, x, y, z) if n > 1 and near == np.inf else 0
    fx, fy, fz, nx, ny, nz, best = x, y, z, 0.0, 0.0, 1.0, near * (1.0 + 1e-12)
    for i in range(n):
        g = begin if i == 0 else i - (i <= begin)
        off = _off_box(s.boxes[g, 0], s.boxes[g, 1], x, y, z) if n > 1 else 0.0
        if off > 0.0 and off >= best * abs(best):
            continue
        a, b, c, u, v, w, d = closest_of(s, g, x, y, z, min(near, best))
        if d < best or n == 1:
            fx, fy, fz, nx, ny, nz, best = a, b, c, u, v, w, d
    return fx, fy, fz, nx, ny, nz, best


@njit(inline=True)
def closest_of(s, g, x, y, z, near):
    """As `closest`, of shape g alone."""
    off = 0.0
    if len(s.kind) > 1 or s.kind[g] == 4:
        off = outside_box(s.boxes[g, 0], s.boxes[g, 1], x, y, z)
        if off > 0.0 and off > near:
            return x, y, z, 0.0, 0.0, 1.0, off
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
        first, end = s.first_group[g], s.first_group[g + 1]
        a, b, c, u, v, w, d = _mesh(px, py, pz, s.faces, s.groups, s.around, first, end, near, off > 0.0)
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
    if side <= _ON_SURFACE_M and cap <= _ON_SURFACE_M:
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
    if ex <= _ON_SURFACE_M and ey <= _ON_SURFACE_M and ez <= _ON_SURFACE_M:
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
def _mesh(px, py, pz, faces, groups, around, first, end, near, outside):
    """Of a convex polyhedron, its groups of triangles from `first` to `end`, the nearest face that sees the query.

    Where none within reach does, its highest plane. `outside` where the query is known to be.
    """
    fx, fy, fz, least, face = 0.0, 0.0, 0.0, near * max(near, 0.0), -1
    begin = _nearest_box(around, first, end, px, py, pz) if near == np.inf else first
    for i in range(end - first):
        k = begin if i == 0 else first + i - (first + i <= begin)
        if _off_box(around[k, 0], around[k, 1], px, py, pz) >= least:
            continue
        for t in range(groups[k], groups[k + 1]):
            T = faces[t]
            h = px * T[0] + py * T[1] + pz * T[2] - T[3]
            if h <= -_ON_SURFACE_M or h * h >= least:  # of faces in one plane rounding may hide the right one
                continue
            a, b = _triangle(px, py, pz, T)
            x, y, z = T[4] + a * T[7] + b * T[10], T[5] + a * T[8] + b * T[11], T[6] + a * T[9] + b * T[12]
            d = (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2
            if d < least:
                fx, fy, fz, least, face = x, y, z, d, t
    if face >= 0:
        if least < _ON_SURFACE_M * _ON_SURFACE_M:
            T = faces[face]
            return fx, fy, fz, T[0], T[1], T[2], math.sqrt(least)
        nx, ny, nz, d = _outward(px, py, pz, fx, fy, fz)
        return fx, fy, fz, nx, ny, nz, d
    if outside and near >= 0.0:
        return px, py, pz, 0.0, 0.0, 1.0, near * (1.0 + 1e-12)
    best, height = groups[first], -np.inf
    for t in range(groups[first], groups[end]):
        T = faces[t]
        h = px * T[0] + py * T[1] + pz * T[2] - T[3]
        if h > height:
            height, best = h, t
            if h > near:
                break
    T = faces[best]
    beyond = height if height <= 0.0 else max(height, near * (1.0 + 1e-12))
    return px - height * T[0], py - height * T[1], pz - height * T[2], T[0], T[1], T[2], beyond


@njit()
def _triangle(px, py, pz, T):
    """Shares of the sides u, v of a triangle in its point nearest to the query (Ericson 2005, section 5.1.5)."""
    wx, wy, wz = px - T[4], py - T[5], pz - T[6]
    d1, d2 = T[7] * wx + T[8] * wy + T[9] * wz, T[10] * wx + T[11] * wy + T[12] * wz
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    d3, d4 = d1 - T[13], d2 - T[14]
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0
    d5, d6 = d1 - T[14], d2 - T[15]
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        k = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - k, k
    k = 1.0 / (va + vb + vc)
    return vb * k, vc * k


@njit()
def _segment(a, b, x, y, z):
    """How far a point is from the line between a and b (3,)."""
    along, length = 0.0, 0.0
    for i, v in enumerate((x, y, z)):
        along += (v - a[i]) * (b[i] - a[i])
        length += (b[i] - a[i]) ** 2
    share, d = min(max(along / length, 0.0), 1.0), 0.0
    for i, v in enumerate((x, y, z)):
        d += (v - a[i] - share * (b[i] - a[i])) ** 2
    return math.sqrt(d)


@njit()
def edge_distance(s, x, y, z, near):
    """How far a surface point is from the nearest sharp edge, m; `near` where none is nearer than that."""
    least = near
    for g in range(len(s.kind)):
        kind, size, R, t = s.kind[g], s.size[g], s.R[g], s.p[g]
        if kind != 2 and kind != 3 and s.first_edge[g] == s.first_edge[g + 1]:
            continue
        if outside_box(s.boxes[g, 0], s.boxes[g, 1], x, y, z) >= least:
            continue
        dx, dy, dz = x - t[0], y - t[1], z - t[2]
        px = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        py = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        pz = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if kind == 2:
            d = math.hypot(math.hypot(px, py) - size[0], abs(pz) - size[1] / 2)
        elif kind == 3:
            a, b, c = size[0] / 2 - abs(px), size[1] / 2 - abs(py), size[2] / 2 - abs(pz)
            low, high = min(a, b, c), max(a, b, c)
            d = math.hypot(low, a + b + c - low - high)
        else:
            d = np.inf
            for e in range(s.first_edge[g], s.first_edge[g + 1]):
                d = min(d, _segment(s.edges[e, 0], s.edges[e, 1], px, py, pz))
        least = min(least, d)
    return least


@njit((SOLID, float64[:, ::1], float64[:, ::1]))
def closest_each(s, p, out):
    """Writes foot, outward normal and signed distance of the surface points nearest to points (N, 3), seven numbers."""
    for i in range(len(p)):
        found = closest(s, p[i, 0], p[i, 1], p[i, 2], np.inf)
        for k in range(7):
            out[i, k] = found[k]
