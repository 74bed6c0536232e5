"""Distances of points from objects against SceneGraph's, and curvature against closed forms."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.verify.surface import PackedObject

SHAPES = {
    "sphere": '<sphere radius="0.02"/>',
    "capsule": '<drake:capsule radius="0.01" length="0.05"/>',
    "cylinder": '<cylinder radius="0.01" length="0.05"/>',
    "box": '<box size="0.02 0.03 0.05"/>',
    "ellipsoid": '<drake:ellipsoid a="0.01" b="0.02" c="0.03"/>',
}


def made(folder: Path, *shapes: str) -> Object:
    collisions = "".join(
        f'<collision><origin xyz="{0.01 * i} 0 {0.02 * i}" rpy="{0.3 * i} 0.5 0.2"/>'
        f"<geometry>{s}</geometry></collision>"
        for i, s in enumerate(shapes)
    )
    file = folder / "thing.urdf"
    file.write_text(
        f'<robot name="thing" xmlns:drake="http://drake.mit.edu"><link name="thing">{collisions}</link></robot>'
    )
    return Object.load(file)


@pytest.mark.parametrize("kinds", [*([k] for k in SHAPES), list(SHAPES)], ids=lambda k: "+".join(k))
def test_distances_and_normals_are_scene_graphs(kinds, tmp_path):
    object_ = made(tmp_path, *(SHAPES[k] for k in kinds))
    scene, solid = Scene(Hand.load("kanguera"), object_), PackedObject.of(object_)
    scene.set(scene.hand.q_home, np.eye(4))
    inspector = scene.scene_graph.model_inspector()
    own = {g for g in inspector.GetAllGeometryIds() if "thing" in inspector.GetName(g)}
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (400, 3))
    distance, normal = solid.distance(points)
    for p, d, n in zip(points, distance, normal, strict=True):
        found = [x for x in scene.query.ComputeSignedDistanceToPoint(p, np.inf) if x.id_G in own]
        nearest = min(found, key=lambda x: x.distance)
        assert d == pytest.approx(nearest.distance, abs=1e-9)
        if d > 1e-6:  # inside, the nearest of several faces may be any of them
            assert n == pytest.approx(nearest.grad_W, abs=1e-6)


def test_bend_is_one_plus_radius_times_curvature(tmp_path):
    r = 0.008
    for kind, p, n, expected in (
        ("sphere", [0, 0, 0.028], [0, 0, 1], (1 + r / 0.02) ** 2),
        ("cylinder", [0.018, 0, 0.01], [1, 0, 0], 1 + r / 0.01),
        ("cylinder", [0.002, 0, 0.033], [0, 0, 1], 1),
        ("box", [0.018, 0, 0], [1, 0, 0], 1),
        ("box", np.array([0.01, 0.015, 0]) + r * np.array([0.6, 0.8, 0]), [0.6, 0.8, 0], 20),
    ):
        file = tmp_path / "one.urdf"
        shape = f"<collision><geometry>{SHAPES[kind]}</geometry></collision>"
        file.write_text(f'<robot name="one"><link name="one">{shape}</link></robot>')
        solid = PackedObject.of(Object.load(file))
        bend = solid.bend(np.array([p], dtype=float), np.array([n], dtype=float), r)
        # over a patch of 1 mm, not at a point
        assert bend[0] == pytest.approx(expected, rel=1e-2)


def test_facets_are_no_edges(tmp_path):
    """A ball of facets bends nowhere like an edge (20) or a corner (400); checker and planner agree on the depth."""
    file, r, R = tmp_path / "ball.stl", 0.008, 0.03
    trimesh.creation.icosphere(5, R).export(file)
    ball = Object.load(file)
    n = np.random.default_rng(2).normal(size=(300, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    solid, surface = PackedObject.of(ball), Surface.of(ball)
    bend = solid.bend((R + r) * n, solid.distance((R + r) * n)[1], r)
    assert bend.max() < 16
    assert np.median(bend) == pytest.approx((1 + r / R) ** 2, rel=0.5)
    np.testing.assert_allclose(surface.bend((R + r) * n, r) ** 0.25, bend**0.25, rtol=0.1)


def test_a_fine_mesh_is_near_its_sphere(tmp_path):
    file = tmp_path / "ball.stl"
    trimesh.creation.icosphere(4, 0.03).export(file)
    solid = PackedObject.of(Object.load(file))
    points = np.random.default_rng(1).normal(size=(200, 3))
    points *= 0.04 / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.allclose(solid.distance(points)[0], 0.01, atol=3e-4)  # dense meshes are simplified on loading
