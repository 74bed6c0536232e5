"""Spheres around a shape: none of it is left out, and little of what is beside it is taken in."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from drake_hand.model.object import Geometry
from drake_hand.planning.cover import cover

BEYOND, MOST = 1e-3, 150


def made(kind: str) -> Geometry:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_matrix(), [0.01, -0.02, 0.03]
    if kind == "mesh":  # a wedge: edges far sharper than a right angle
        hull = trimesh.convex.convex_hull([[0, 0, 0], [0.03, 0, 0], [0, 0.012, 0], [0, 0, 0.02], [0.03, 0.004, 0.02]])
        return Geometry(kind="mesh", X_OG=X, vertices=np.asarray(hull.vertices), faces=np.asarray(hull.faces))
    size = {"box": (0.012, 0.015, 0.04), "cylinder": (0.008, 0.03), "capsule": (0.008, 0.03), "sphere": (0.01,)}[kind]
    return Geometry(kind=kind, X_OG=X, size=size)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["mesh", "box", "cylinder", "capsule", "sphere"])
def test_all_of_the_surface_is_covered(kind):
    g = made(kind)
    p, r = cover(g, beyond=BEYOND, most=MOST)
    points = trimesh.sample.sample_surface(g.to_trimesh(), 20_000, seed=1)[0]
    depth = (r - np.linalg.norm(points[:, None] - p, axis=2)).max(axis=1)
    assert depth.min() > -1e-6
    assert len(r) <= MOST


@pytest.mark.parametrize("kind", ["mesh", "box"])
def test_edges_are_not_blunted(kind):
    """Spheres of one size, centred 4 mm under each face, once reached 4 to 8 mm beyond: fingertips had no room."""
    g = made(kind)
    p, r = cover(g, beyond=BEYOND, most=1000)
    hull = g.to_trimesh()
    beyond = r - trimesh.proximity.signed_distance(hull, p)
    assert beyond.max() < 2.0 * BEYOND


def test_fewer_spheres_reach_further():
    g = made("box")
    (_, fine), (_, coarse) = (cover(g, beyond=BEYOND, most=most) for most in (150, 20))
    assert len(coarse) <= 20 < len(fine)
