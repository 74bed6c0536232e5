"""Spheres around round shapes: none of it is left out, and little of what is beside it is taken in."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from drake_hand.contact.surface import Surface
from drake_hand.model.object import Geometry
from drake_hand.planning.link_shapes import _cover


@pytest.mark.parametrize("kind", ["cylinder", "capsule", "sphere"])
def test_all_of_the_surface_is_covered(kind):
    X, r = np.eye(4), 0.008
    X[:3, :3], X[:3, 3] = Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_matrix(), [0.01, -0.02, 0.03]
    g = Geometry(kind=kind, X_OG=X, size=(r, 0.03)[: 1 if kind == "sphere" else 2])
    centres, radii = _cover(g)
    points = trimesh.sample.sample_surface(g.to_trimesh(), 20_000, seed=1)[0]
    depth = (radii - np.linalg.norm(points[:, None] - centres, axis=2)).max(axis=1)
    assert depth.min() > -1e-6
    if kind != "cylinder":  # at whose rim it is more
        beyond = radii + Surface((g,)).closest(centres)[2]
        assert beyond.max() < 0.05 * r
