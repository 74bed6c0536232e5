"""`Object`: the free rigid body to be manipulated, with its convex collision geometries. Needs no Drake."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """One convex collision geometry, in its frame G (O is the object's frame)."""

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


@dataclass(frozen=True, kw_only=True)
class Object:
    """One free rigid body."""

    name: str
    file: Path
    link: str
    mass: float
    geometries: tuple[Geometry, ...]
