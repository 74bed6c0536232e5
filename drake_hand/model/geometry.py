"""`Geometry`: one convex collision shape, and reading it from the XML of a URDF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from xml.etree import ElementTree as ET

import numpy as np

from drake_hand.model.xml import Source, read_origin

if TYPE_CHECKING:
    import trimesh


Pieces = Callable[[Path, tuple[float, float, float]], Sequence[tuple[np.ndarray, np.ndarray]]]
"""From a mesh file and its scale to convex pieces: (V, 3) vertices and (F, 3) outward faces of each."""


SHARP_EDGE_RAD = np.radians(30.0)
"""Edges of meshes at which the surface turns by less are the facets of something smooth."""


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """One convex collision geometry, in its frame G (O is the object's frame, or a link's)."""

    kind: Literal["sphere", "capsule", "cylinder", "box", "mesh"]
    X_OG: np.ndarray
    """(4, 4)."""
    size: tuple[float, ...] = ()
    """sphere (radius,); cylinder and capsule (radius, length along z, caps excluded); box (x, y, z); mesh ()."""
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(V, 3) of a mesh, in G: its convex hull."""
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=int))
    """(F, 3) triangles, counter-clockwise seen from outside."""

    @cached_property
    def corners(self) -> np.ndarray:
        """(K, 3) points in G whose bounding box is the geometry's."""
        if self.kind == "mesh":
            return self.vertices
        if self.kind == "box":
            half = np.asarray(self.size) / 2
        else:
            r = self.size[0]
            cap = {"sphere": r, "capsule": r, "cylinder": 0.0}[self.kind]
            half = np.array([r, r, cap + (self.size[1] / 2 if len(self.size) > 1 else 0.0)])
        return np.stack([half, -half])

    @cached_property
    def sharp_edges(self) -> np.ndarray:
        """(E, 2, 3) ends in G of a mesh's edges at which its surface turns by `SHARP_EDGE_RAD` or more."""
        if self.kind != "mesh":
            return np.zeros((0, 2, 3))
        import trimesh

        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        return self.vertices[mesh.face_adjacency_edges[mesh.face_adjacency_angles >= SHARP_EDGE_RAD]].reshape(-1, 2, 3)

    @cached_property
    def box_O(self) -> np.ndarray:
        """(8, 3) corners of a box around the shape, in O."""
        low, high = self.corners.min(axis=0), self.corners.max(axis=0)
        points = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        return points @ self.X_OG[:3, :3].T + self.X_OG[:3, 3]

    def to_trimesh(self) -> trimesh.Trimesh:
        """The shape as a closed triangle mesh in frame O."""
        import trimesh

        if self.kind == "mesh":
            mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        elif self.kind == "box":
            mesh = trimesh.creation.box(self.size)
        elif self.kind == "sphere":
            mesh = trimesh.creation.icosphere(subdivisions=3, radius=self.size[0])
        elif self.kind == "cylinder":
            mesh = trimesh.creation.cylinder(radius=self.size[0], height=self.size[1], sections=64)
        else:
            mesh = trimesh.creation.capsule(radius=self.size[0], height=self.size[1], count=(32, 32))
            mesh.apply_translation(-mesh.bounds.mean(axis=0))
        return mesh.apply_transform(self.X_OG)


def read_collision(element: ET.Element, source: Source, pieces: Pieces) -> list[Geometry]:
    """Convex geometries of a ``<collision>`` element of a URDF.

    Drake's ``<drake:capsule>`` and ``<drake:ellipsoid>`` are understood; an ellipsoid becomes a mesh.

    Args:
        element: the ``<collision>``.
        source: where it is from.
        pieces: what a mesh file is made of.

    Raises:
        InputError: no known shape, wrong numbers, or a mesh file that is missing or unreadable.
    """
    X_OG = read_origin(element.find("origin"), source)
    geometry = element.find("geometry")
    shape = geometry[0] if geometry is not None and len(geometry) else None
    kind = "" if shape is None else shape.tag.rpartition("}")[2]
    if shape is None or kind not in ("sphere", "cylinder", "capsule", "box", "ellipsoid", "mesh"):
        raise source.error("unknown shape", kind or "nothing", "sphere, cylinder, capsule, box, ellipsoid or mesh")
    if kind == "mesh":
        scale = source.numbers(" ".join((shape.get("scale", "1").split() * 3)[:3]), 3)
        parts = pieces(source.find_mesh(shape.get("filename", "")), (float(scale[0]), float(scale[1]), float(scale[2])))
        return [Geometry(kind="mesh", X_OG=X_OG, vertices=v, faces=f) for v, f in parts]

    def get(name: str, n: int = 1) -> np.ndarray:
        return source.numbers(shape.get(name), n, positive=True)

    if kind == "ellipsoid":
        return [ellipsoid(np.array([get(k)[0] for k in "abc"]), X_OG)]
    size = {
        "sphere": lambda: get("radius"),
        "box": lambda: get("size", 3),
    }.get(kind, lambda: np.append(get("radius"), get("length")))()
    return [Geometry(kind=kind, X_OG=X_OG, size=tuple(float(v) for v in size))]  # type: ignore[arg-type]


def ellipsoid(semi_axes: np.ndarray, X_OG: np.ndarray) -> Geometry:
    """An ellipsoid as a convex mesh of 642 vertices."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    return Geometry(
        kind="mesh", X_OG=X_OG, vertices=np.asarray(ball.vertices) * semi_axes, faces=np.asarray(ball.faces)
    )
