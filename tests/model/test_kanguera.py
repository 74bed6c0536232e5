"""The bundled hand: what the paper and the model's README promise."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import minimize

from drake_hand.model.geometry import read_collision
from drake_hand.model.inertia import Inertial
from drake_hand.model.meshes import hull
from drake_hand.model.scene import Scene
from drake_hand.model.xml import Source, read_xml


def no_mesh(uri: str):
    raise AssertionError(uri)


def links(hand):
    source = Source(file=hand.urdf.file, key="", find_mesh=no_mesh)
    for link in read_xml(hand.urdf.file, "robot").findall("link"):
        shapes = [g for c in link.findall("collision") for g in read_collision(c, source, hull)]
        yield link.get("name"), Inertial.read(link, source), shapes


def test_five_fingers_of_a_kardan_and_two_revolute_joints(kanguera):
    assert [f.name for f in kanguera.fingers] == ["little", "ring", "middle", "index", "thumb"]
    assert kanguera.nq == 15
    for finger in kanguera.fingers:
        assert len(finger.axes) == 4
        first, second = finger.axes[:2]
        assert np.allclose(second.X_PJ[:3, 3], 0)  # the axes of a Kardan joint meet
        assert abs(first.axis @ (second.X_PJ[:3, :3] @ second.axis)) < 1e-6  # at a right angle


def test_one_coupled_joint_a_finger(kanguera):
    for finger in kanguera.fingers:
        followers = [a for a in finger.axes if a.joint not in finger.joints]
        (follower,) = followers
        assert follower.multiplier == pytest.approx(1.0 if finger.name == "thumb" else 2 / 3, abs=1e-6)
        assert follower.source == 2


def test_every_link_could_be_real(kanguera):
    masses = {name: inertial.mass for name, inertial, _ in links(kanguera)}
    flaws = {name: inertial.flaw for name, inertial, _ in links(kanguera) if inertial.flaw}
    assert not flaws
    assert 0.1 < sum(masses.values()) < 0.5
    assert masses["palm"] == max(masses.values())


def test_drake_reads_it_as_it_is_and_finds_no_contact(kanguera):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    Parser(plant).AddModels(str(kanguera.urdf.file))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("palm"))
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    assert (plant.num_positions(), plant.num_actuators(), plant.num_constraints()) == (20, 15, 5)
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    assert not query.HasCollisions()


def test_loading_finds_nothing_to_put_right(kanguera):
    scene = Scene(kanguera)
    assert scene.report == ()
    assert not scene.penetrations()


def test_home_leaves_the_space_before_the_palm_free(kanguera):
    scene = Scene(kanguera)
    for finger in kanguera.fingers[:-1]:
        assert scene.tip_position(finger)[0] < 0
    assert scene.tip_position("thumb")[1] > 0.08
    assert (kanguera.q_home - kanguera.q_lower > 0.01).all()
    assert (kanguera.q_upper - kanguera.q_home > 0.01).all()


def test_tips_touch_a_flat_surface_first(kanguera):
    """With the finger straight, towards the pad and towards the end, the tip stands out farthest."""
    shapes = {name: [g.to_trimesh() for g in parts] for name, _, parts in links(kanguera)}
    scene = Scene(kanguera)
    scene.set(np.zeros(kanguera.nq))
    for finger in kanguera.fingers:
        R_WL = scene.plant.GetBodyByName(finger.tip_link).EvalPoseInWorld(scene.plant_context).rotation().matrix()
        for angle in np.radians([0, 30, 60, 90]):  # from the pad (x) to the end (z), leaning to either side
            for side in np.radians([-40, 0, 40]):
                u_L = np.array([np.cos(angle) * np.cos(side), np.sin(side), np.sin(angle) * np.cos(side)])
                u = R_WL @ u_L
                tip = scene.tip_position(finger) @ u + finger.radius
                for name in finger.links:
                    X_WL = scene.plant.GetBodyByName(name).EvalPoseInWorld(scene.plant_context).GetAsMatrix4()
                    for mesh in shapes[name] if name != finger.tip_link else []:
                        reach = ((mesh.vertices @ X_WL[:3, :3].T + X_WL[:3, 3]) @ u).max()
                        assert reach < tip - 3e-4, (name, angle, side)


@pytest.mark.parametrize("name", ["little", "ring", "middle", "index"])
def test_thumb_meets_every_finger(kanguera, name):
    scene = Scene(kanguera)
    thumb, finger = kanguera.finger("thumb"), kanguera.finger(name)
    columns = np.concatenate([finger.columns, thumb.columns])
    low, high = kanguera.q_lower[columns], kanguera.q_upper[columns]
    q = kanguera.q_home.copy()

    def gap(x: np.ndarray) -> float:
        q[columns] = x
        scene.set(q)
        away = np.linalg.norm(scene.tip_position(thumb) - scene.tip_position(finger)) - thumb.radius - finger.radius
        depth = sum(d for a, b, d in scene.penetrations() if {a, b} != {thumb.tip_link, finger.tip_link})
        return (away**2 + depth**2) * 1e6

    rng = np.random.default_rng(3)
    starts = (low + rng.uniform(0.3, 0.9, len(low)) * (high - low) for _ in range(20))
    fits = (minimize(gap, x, bounds=list(zip(low, high, strict=True))) for x in starts)
    assert any(fit.fun < 0.01 for fit in fits)  # 0.1 mm
