"""The checker's own distances of points from the object: exact for every shape there is, compiled."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drake_hand.compiled import njit
from drake_hand.model.object import Object
from drake_hand.plans.tolerances import PATCH_M

_KINDS = ("sphere", "capsule", "cylinder", "box", "mesh")


@dataclass(frozen=True, kw_only=True)
class PackedObject:
    """The g convex shapes of an object, packed for the kernels."""

    kind: np.ndarray
    """(g,) index among the kinds."""
    size: np.ndarray
    """(g, 3) radius, half length; or half sides."""
    X_OG: np.ndarray
    """(g, 4, 4)."""
    corner: np.ndarray
    """(T, 3, 3) corners of the triangles of all meshes, in G, counter-clockwise seen from outside."""
    plane: np.ndarray
    """(T, 4) their outward unit normals, zero where a triangle has no area, and how far from G's origin they are."""
    first: np.ndarray
    """(g + 1,) each shape's first triangle."""
    ball: np.ndarray
    """(g, 4) a ball around each shape: its centre in G, and its radius."""

    @classmethod
    def of(cls, object_: Object) -> PackedObject:
        """Packs an object."""
        shapes = object_.geometries
        size = np.zeros((len(shapes), 3))
        for row, g in zip(size, shapes, strict=True):
            if g.kind == "box":
                row[:] = np.array(g.size) / 2
            elif g.kind != "mesh":
                row[0] = g.size[0]
                row[1] = g.size[1] / 2 if len(g.size) > 1 else 0.0
        corners = [g.vertices[g.faces].reshape(-1, 3, 3) for g in shapes]
        corner = np.ascontiguousarray(np.concatenate(corners), dtype=float)
        n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        area = np.linalg.norm(n, axis=1, keepdims=True)
        n = np.divide(n, area, out=np.zeros_like(n), where=area > 0)
        ball = np.zeros((len(shapes), 4))
        for row, g, own in zip(ball, shapes, corners, strict=True):
            if g.kind == "mesh":
                row[:3] = (own.min(axis=(0, 1)) + own.max(axis=(0, 1))) / 2
                row[3] = np.linalg.norm(own - row[:3], axis=2).max()
            else:
                row[3] = np.linalg.norm(g.size) / 2 if g.kind == "box" else g.size[0] + sum(g.size[1:]) / 2
        return cls(
            kind=np.array([_KINDS.index(g.kind) for g in shapes], dtype=np.int64),
            size=size,
            X_OG=np.array([g.X_OG for g in shapes], dtype=float),
            corner=corner,
            plane=np.column_stack([n, np.sum(n * corner[:, 0], axis=1)]),
            first=np.cumsum([0] + [len(c) for c in corners]),
            ball=ball,
        )

    def distance(self, p_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance of points p_O (..., 3) and the outward normal (..., 3) where they are nearest, in O."""
        flat = np.ascontiguousarray(p_O, dtype=float).reshape(-1, 3)
        out = np.empty((len(flat), 4))
        _distances(self.kind, self.size, self.X_OG, self.corner, self.plane, self.first, self.ball, flat, out)
        return out[:, 0].reshape(p_O.shape[:-1]), out[:, 1:].reshape(p_O.shape)

    def shape_operator(self, p_O: np.ndarray, n_O: np.ndarray) -> np.ndarray:
        """How the normal turns per distance that points p_O (k, 3) above the surface, normal n_O (k, 3), move.

        Over the patch a pad touches: at the edges of a mesh's facets the surface is no sharper than its facets differ.

        Returns:
            (k, 3, 3) symmetric, zero along the normal, 1/m.
        """
        e = np.eye(3)[np.argmin(np.abs(n_O), axis=1)]
        t = np.cross(e, n_O)
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        sides = np.stack([t, np.cross(n_O, t)], axis=1)
        way = np.exp(1j * np.pi / 3 * np.arange(6)).view(float).reshape(6, 2)
        normal = self.distance(p_O[:, None] + PATCH_M * (way @ sides))[1]
        H = (sides @ np.swapaxes(normal, 1, 2)) @ way / (3 * PATCH_M)
        return np.swapaxes(sides, 1, 2) @ ((H + np.swapaxes(H, 1, 2)) / 2) @ sides

    def bend(self, p_O: np.ndarray, n_O: np.ndarray, radius: float) -> np.ndarray:
        """How much the surface curves away from a sphere whose centre p_O (k, 3) lies above it, normal n_O (k, 3).

        Returns:
            (k,) product of 1 + radius x principal curvature: 1 where it is flat, 400 at most, at a corner.
        """
        # the normal turns by c / (1 + radius c) per distance that the sphere's centre moves
        turn = np.linalg.eigvalsh(self.shape_operator(p_O, n_O))
        return np.prod(1 / np.clip(1 - radius * turn, 0.05, 1.0), axis=1)


@njit()
def _triangle(x, y, z, a, b, c):
    """The point of a triangle nearest to (x, y, z) (Ericson, Real-Time Collision Detection, 5.1.5)."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for i, p in enumerate((x, y, z)):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 += ab * (p - a[i])
        d2 += ac * (p - a[i])
        d3 += ab * (p - b[i])
        d4 += ac * (p - b[i])
        d5 += ab * (p - c[i])
        d6 += ac * (p - c[i])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    u = v = 0.0
    if d1 <= 0 and d2 <= 0:
        pass
    elif d3 >= 0 and d4 <= d3:
        u = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        u = d1 / (d1 - d3)
    elif d6 >= 0 and d5 <= d6:
        v = 1.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        v = d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        v = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        u = 1.0 - v
    else:
        u, v = vb / (va + vb + vc), vc / (va + vb + vc)
    return (
        a[0] + u * (b[0] - a[0]) + v * (c[0] - a[0]),
        a[1] + u * (b[1] - a[1]) + v * (c[1] - a[1]),
        a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]),
    )


@njit()
def _mesh(p, corner, plane, first, last, height, out):
    """Of a convex mesh. Nothing is nearer than the farthest plane, and where that plane's triangle is, all is said."""
    best = 0
    for t in range(first, last):
        n = plane[t]
        height[t - first] = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - n[3]
        if n[0] == 0 and n[1] == 0 and n[2] == 0:
            height[t - first] = -np.inf  # of a triangle without area
        if height[t - first] > height[best]:
            best = t - first
    for i in range(3):
        out[1 + i] = plane[first + best, i]
    out[0] = height[best]
    if out[0] <= 0:
        return
    least = np.inf
    for x in range(-1, last - first):
        t = best if x < 0 else x
        if height[t] < 0 or height[t] >= least:
            continue
        k = first + t
        x, y, z = _triangle(p[0], p[1], p[2], corner[k, 0], corner[k, 1], corner[k, 2])
        x, y, z = p[0] - x, p[1] - y, p[2] - z
        d = math.sqrt(x * x + y * y + z * z)
        if d < least:
            least = d
            out[0], out[1], out[2], out[3] = d, x / d, y / d, z / d
        if least <= height[best] * (1 + 1e-14):
            return


@njit()
def _shape(kind, size, p, out):
    """Distance and normal of a sphere, capsule, cylinder or box, in its own frame."""
    if kind <= 1:  # sphere, capsule
        z = min(max(p[2], -size[1]), size[1])
        d = math.sqrt(p[0] * p[0] + p[1] * p[1] + (p[2] - z) ** 2)
        out[0] = d - size[0]
        if d > 0:
            out[1], out[2], out[3] = p[0] / d, p[1] / d, (p[2] - z) / d
        else:
            out[1], out[2], out[3] = 1.0, 0.0, 0.0
    elif kind == 2:  # cylinder
        rho = math.sqrt(p[0] * p[0] + p[1] * p[1])
        x, y = (p[0] / rho, p[1] / rho) if rho > 0 else (1.0, 0.0)
        up = 1.0 if p[2] >= 0 else -1.0
        side, cap = rho - size[0], abs(p[2]) - size[1]
        if side > 0 and cap > 0:
            out[0] = math.sqrt(side * side + cap * cap)
            out[1], out[2], out[3] = side / out[0] * x, side / out[0] * y, cap / out[0] * up
        elif side >= cap:
            out[0], out[1], out[2], out[3] = side, x, y, 0.0
        else:
            out[0], out[1], out[2], out[3] = cap, 0.0, 0.0, up
    else:  # box
        beyond, most = 0.0, 0
        for i in range(3):
            over = abs(p[i]) - size[i]
            out[1 + i] = math.copysign(max(over, 0.0), p[i])
            beyond += max(over, 0.0) ** 2
            if over > abs(p[most]) - size[most]:
                most = i
        if beyond > 0:
            out[0] = math.sqrt(beyond)
            for i in range(3):
                out[1 + i] /= out[0]
        else:
            out[0] = abs(p[most]) - size[most]
            out[1 + most] = math.copysign(1.0, p[most])


@njit(
    "void(i8[::1], f8[:, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])"
)
def _distances(kind, size, X_OG, corner, plane, first, ball, p_O, out):
    """Rows (distance, normal) of points p_O from the union of all shapes."""
    p, one = np.empty(3), np.empty(4)
    height = np.empty(max(1, len(corner)))
    for k in range(len(p_O)):
        out[k, 0] = np.inf
        for g in range(len(kind)):
            for i in range(3):
                p[i] = 0.0
                for j in range(3):
                    p[i] += X_OG[g, j, i] * (p_O[k, j] - X_OG[g, j, 3])
            b = ball[g]
            away = math.sqrt((p[0] - b[0]) ** 2 + (p[1] - b[1]) ** 2 + (p[2] - b[2]) ** 2)
            if away - b[3] >= out[k, 0]:
                continue
            if kind[g] == 4:
                _mesh(p, corner, plane, first[g], first[g + 1], height, one)
            else:
                _shape(kind[g], size[g], p, one)
            if one[0] < out[k, 0]:
                out[k, 0] = one[0]
                for i in range(3):
                    out[k, 1 + i] = 0.0
                    for j in range(3):
                        out[k, 1 + i] += X_OG[g, i, j] * one[1 + j]
