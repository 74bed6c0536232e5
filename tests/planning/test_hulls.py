"""Links that are boxes or meshes: distances of their hulls are SceneGraph's, in batches as in kernels."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from drake_hand.contact.surface import Surface
from drake_hand.model.geometry import Geometry
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.collision import CLEARANCE_M, Clearance
from drake_hand.planning.kernels import clear
from drake_hand.planning.kernels.hulls import Hulls, least_gaps
from drake_hand.planning.kernels.world import scratch
from drake_hand.planning.state import by_finger

HANDS = Path(__file__).parents[2] / "urdf" / "hands"
WEDGE = [[0, 0, 0], [0.03, 0, 0], [0, 0.012, 0], [0, 0, 0.02], [0.03, 0.004, 0.02]]


def wedge() -> Geometry:
    hull = trimesh.convex.convex_hull(WEDGE)
    return Geometry(kind="mesh", X_OG=np.eye(4), vertices=np.asarray(hull.vertices), faces=np.asarray(hull.faces))


def distance(a: Hulls, b: Hulls, X: list[np.ndarray]) -> float:
    placed, out = (a.p @ X[0][:3, :3].T + X[0][:3, 3])[None].copy(), np.array([np.inf])
    pairs, frame = np.zeros((1, 2), dtype=np.int64), X[1][:3].copy()
    least_gaps(placed, a.first, a.r, b.p[None], b.first, b.r, pairs, frame, 1.0, out)
    return float(out[0])


def poses(count: int):
    """Of two shapes near each other, some with parallel faces and edges."""
    rng = np.random.default_rng(0)
    for k in range(count):
        R = [Rotation.random(random_state=2 * k + i).as_matrix() for i in range(2)]
        if k % 3 == 0:
            R = [Rotation.from_euler("z", rng.uniform(0, 3) * (k % 2)).as_matrix(), np.eye(3)]
        p = rng.normal(size=3)
        X = [np.eye(4), np.eye(4)]
        for i in range(2):
            X[i][:3, :3] = R[i]
        X[0][:3, 3] = p * rng.uniform(0.01, 0.09) / np.linalg.norm(p)
        yield X


def test_distances_of_boxes_are_those_of_scene_graph():
    builder = DiagramBuilder()
    plant, graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    sizes, bodies = ((0.02, 0.027, 0.05), (0.03, 0.02, 0.01)), []
    for name, size in zip("ab", sizes, strict=True):
        bodies.append(plant.AddRigidBody(name, SpatialInertia.SolidSphereWithMass(1.0, 0.1)))
        plant.RegisterCollisionGeometry(bodies[-1], RigidTransform(), Box(*size), name, CoulombFriction(1.0, 1.0))
    a, b = (Hulls.of((Geometry(kind="box", X_OG=np.eye(4), size=size),)) for size in sizes)
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    apart = 0
    for X in poses(300):
        for body, pose in zip(bodies, X, strict=True):
            plant.SetFreeBodyPose(plant.GetMyContextFromRoot(context), body, RigidTransform(pose))
        query = graph.get_query_output_port().Eval(graph.GetMyContextFromRoot(context))
        (found,) = query.ComputeSignedDistancePairwiseClosestPoints()
        said = distance(a, b, X)
        if found.distance <= 1e-6:
            assert said <= 1e-6
            continue
        apart += 1
        assert said == pytest.approx(found.distance, abs=5e-6)
    assert apart > 100


@pytest.mark.parametrize(("kind", "blunt"), [("sphere", 0.0), ("capsule", 0.0), ("cylinder", 6e-5), ("mesh", 0.0)])
def test_distances_from_other_shapes_are_those_of_their_surfaces(kind, blunt):
    """Of a wedge's points; SceneGraph is up to 0.15 mm off here."""
    size = (0.012, 0.04)[: 1 if kind == "sphere" else 2]
    other = wedge() if kind == "mesh" else Geometry(kind=kind, X_OG=np.eye(4), size=size)
    a, b, surface = Hulls.of((wedge(),)), Hulls.of((other,)), Surface((other,))
    mesh = wedge().to_trimesh()
    points, _ = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 5e-4, max_iter=20)
    apart = 0
    for X in poses(60):
        p_O = (points @ X[0][:3, :3].T + X[0][:3, 3] - X[1][:3, 3]) @ X[1][:3, :3]
        nearest, said = surface.closest(p_O)[2].min(), distance(a, b, X)
        if nearest > 0:
            apart += 1
            assert nearest - blunt - 1e-5 <= said <= nearest + 1e-9
    assert apart > 20


@pytest.fixture(scope="module")
def blocky(tmp_path_factory) -> Hand:
    """The quartet with fingers of boxes."""
    folder = tmp_path_factory.mktemp("blocky")
    text = (HANDS / "quartet" / "quartet.urdf").read_text()

    def box(found: re.Match) -> str:
        r, length = float(found[1]), float(found[2])
        return f'<box size="{2 * r} {2 * r} {length}"/>'

    text, count = re.subn(r'<cylinder radius="([\d.]+)" length="([\d.]+)"/>', box, text)
    assert count
    (folder / "quartet.urdf").write_text(text)
    (folder / "blocky.hand.yaml").write_text((HANDS / "quartet" / "quartet.hand.yaml").read_text())
    return Hand.load(folder / "blocky.hand.yaml")


def test_clearances_of_boxes_are_true(blocky):
    """Spheres that covered the boxes once said up to 6 mm less: fingertips beside a flat link had no room."""
    scene = Scene(blocky, Object.load("cube"))
    c, rng = Clearance(Scene(blocky, Object.load("cube"))), np.random.default_rng(0)
    world_, ok, near, verdicts = c.world, np.zeros(1, dtype=bool), 0, set()
    owner = {link: f.index for f in blocky.fingers for link in f.links}
    cube = scene.object_body.name()
    for _ in range(300):
        q = rng.uniform(blocky.q_lower, blocky.q_upper)
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = (
            Rotation.random(random_state=rng).as_matrix(),
            rng.uniform([40, -30, -30], [110, 30, 30]) / 1e3,
        )
        scene.set(q, X)
        true = {}
        for x, y, distance in scene.clearances(0.005):
            pair = frozenset(owner.get(link, "cube" if link == cube else "palm") for link in (x, y))
            true[pair] = min(true.get(pair, 1.0), distance)
        centres = [c.centres(f.index, q[None, f.columns]) for f in blocky.fingers]
        said = {frozenset((f, "cube")): c.to_object(f, x, X, tip=True)[0] for f, x in enumerate(centres)}
        said |= {frozenset((f, "palm")): c.to_palm(f, x)[0] for f, x in enumerate(centres)}
        for i, j in itertools.combinations(range(len(centres)), 2):
            said[frozenset((i, j))] = c.between(i, centres[i], j, centres[j])[0]
        for pair, gap in said.items():
            if 0 < true.get(pair, 1.0) < 0.005:
                near += 1
                assert true[pair] - 4e-4 <= gap <= true[pair] + 1e-5, "knuckles are spheres, and exact; hulls too"
            elif pair not in true:
                assert gap >= 0.004
            else:
                assert gap <= 1e-5
        hands, poses_, alone = by_finger(blocky, q)[None], X[None, :3].copy(), np.zeros((1, 4), dtype=bool)
        clear.clear(world_, poses_, hands, alone, ok)
        palm = clear.object_off_palm(world_, poses_[0], scratch(world_), CLEARANCE_M)
        assert ok[0] == (palm and min(said.values()) >= CLEARANCE_M)
        verdicts.add(bool(ok[0]))
    assert near > 50
    assert verdicts == {True, False}
