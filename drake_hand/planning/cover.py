"""Spheres that cover a shape completely, and reach as little beyond it as possible.

A search computes millions of clearances. Between spheres each costs a square root. What the spheres reach beyond a
shape is room that the planner believes it lacks, so it is kept to a millimetre where few enough spheres achieve that.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from drake_hand.model.object import Geometry
from drake_hand.planning.kernels.cover import choose

if TYPE_CHECKING:
    import trimesh

_FINE_EDGE_RATIO = 2.5
"""Longest edge of the triangles that are covered one by one, over how far spheres may reach beyond the shape."""
_DEPTH_RATIOS = (1.0, 2.0, 4.0, 8.0)
"""Of centres under the surface, over the same."""
_DRAWN = 1500
"""About how many centres of each depth are enough for most of a shape."""
_COARSER_RATIOS = 1.2, 2.0
"""By how much, at least and at most, it grows at a time until the spheres are few enough."""
_MOST_TRIANGLES = 2000
"""About how many triangles there may be."""


def cover(g: Geometry, *, beyond: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Covers a convex shape.

    Args:
        g: the shape.
        beyond: how far spheres may reach beyond a box or a mesh, m; more where fewer would not do.
        most: spheres for one of these.

    Returns:
        Centres (S, 3) in the frame the shape is posed in, and radii (S,), m.
    """
    if g.kind not in ("box", "mesh"):
        return cover_round(g)
    mesh = replace(g, X_OG=np.eye(4)).to_trimesh()
    centres, radii = _cover_mesh(mesh.vertices.tobytes(), mesh.faces.tobytes(), beyond, most)
    return centres @ g.X_OG[:3, :3].T + g.X_OG[:3, 3], radii


def cover_round(g: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Covers a sphere, a cylinder or a capsule.

    Returns:
        As `cover`.
    """
    if g.kind == "sphere":
        centres, radii = np.zeros((1, 3)), np.array([g.size[0]])
    else:
        r, length = g.size
        n = max(1, int(np.ceil(length / (0.6 * r))))
        half = length / n / 2
        # The rim of a cylinder is covered from half a step inside; round ends have spheres of their own.
        end = length / 2 - (half if g.kind == "cylinder" else 0.0)
        z = np.linspace(-end, end, n if g.kind == "cylinder" else n + 1)
        centres, radii = np.column_stack([np.zeros((len(z), 2)), z]), np.full(len(z), np.hypot(r, half))
    return centres @ g.X_OG[:3, :3].T + g.X_OG[:3, 3], radii


@lru_cache(maxsize=256)
def _cover_mesh(vertices: bytes, faces: bytes, beyond: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Inscribed spheres, swollen by `beyond`. A triangle whose corners are in one of them is covered; all of them are.

    Fingers of a hand often have the same shapes, so they are kept.
    """
    import trimesh

    mesh = trimesh.Trimesh(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, dtype=int).reshape(-1, 3))
    beyond = max(beyond, float(np.sqrt(4 * mesh.area / _MOST_TRIANGLES)) / _FINE_EDGE_RATIO)
    while True:
        points, triangles = trimesh.remesh.subdivide_to_size(
            mesh.vertices, mesh.faces, _FINE_EDGE_RATIO * beyond, max_iter=30
        )
        found = _spheres(mesh, np.asarray(points)[triangles], beyond)
        if len(found[1]) <= most:
            return found
        beyond *= float(np.clip(np.sqrt(len(found[1]) / most), *_COARSER_RATIOS))


def _spheres(mesh: trimesh.Trimesh, triangles: np.ndarray, beyond: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii of spheres that cover triangles (T, 3, 3) of a mesh."""
    out, offset = np.asarray(mesh.face_normals), np.einsum("fi,fi->f", mesh.triangles[:, 0], mesh.face_normals)
    middle = triangles.mean(axis=1)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-15)[:, None]
    worth = area + 1e-3 * area.mean()

    def deep(rows: np.ndarray, fewer: int) -> tuple[np.ndarray, np.ndarray]:
        p = np.concatenate(
            [(middle[rows] - depth * beyond * normal[rows])[:: max(int(depth), 2, fewer)] for depth in _DEPTH_RATIOS]
        )
        r = (offset - p @ out.T).min(axis=1) + beyond
        return p[r > 2 * beyond], r[r > 2 * beyond]

    p, r = deep(np.arange(len(middle)), len(middle) // _DRAWN)
    some, left = choose(np.ascontiguousarray(triangles), worth, p, r)
    # where nothing deep reaches, spheres about single triangles do, whatever their size
    own = np.linalg.norm(triangles[left] - middle[left, None], axis=2).max(axis=1) + 1e-9
    centres, radii = (np.concatenate(x) for x in zip((middle[left], own), deep(np.flatnonzero(left), 1), strict=True))
    more, _ = choose(np.ascontiguousarray(triangles[left]), worth[left], centres, radii)
    return np.concatenate([p[some], centres[more]]), np.concatenate([r[some], radii[more]])
