from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import Sphere

from drake_hand.errors import InputError
from drake_hand.model.hand import Finger, Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene


def tip_by_hand(finger: Finger, q: np.ndarray) -> np.ndarray:
    """Tip centre by the product of the axes' motions, written out independently of Drake."""
    X = np.eye(4)
    for axis in finger.axes:
        angle = axis.multiplier * q[finger.columns[axis.source]] + axis.offset
        x, y, z = axis.axis
        K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        M = np.eye(4)
        M[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
        X = X @ axis.X_PJ @ M
    return (X @ finger.X_JT)[:3, 3]


def pose(x: float, y: float, z: float) -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = x, y, z
    return X


@given(u=st.lists(st.floats(0, 1), min_size=15, max_size=15))
@settings(max_examples=50, deadline=None)
def test_tips_are_where_the_axes_put_them(scene, u):
    hand = scene.hand
    q = hand.q_lower + np.array(u) * (hand.q_upper - hand.q_lower)
    scene.set(q)
    for finger in hand.fingers:
        assert np.allclose(scene.tip_position(finger.name), tip_by_hand(finger, q), atol=1e-9)


def test_coupled_joints_follow(scene):
    hand = scene.hand
    q = hand.q_lower + 0.4 * (hand.q_upper - hand.q_lower)
    scene.set(q)
    for follower, leader, ratio in (("ring_dip", "ring_pip", 2 / 3), ("thumb_ip", "thumb_mcp", 1.0)):
        joint = scene.plant.GetJointByName(follower, scene.hand_model)
        assert joint.get_angle(scene.plant_context) == pytest.approx(ratio * q[hand.joints.index(leader)], abs=1e-6)
    assert scene.expand(np.stack([q, q])).shape == (2, 20)


def test_damping_that_no_servo_overcomes_is_left_to_the_servo(small):
    """The joints of this hand have 0.5 N m and 2 rad/s; a3 follows a2 at half its speed."""
    follows = '<mimic joint="a2" multiplier="0.5" offset="0.1"/>'
    named = {"a1": 0.24, "b1": 0.26}
    changes = {
        f'<joint name="{j}" type="revolute">': f'<joint name="{j}" type="revolute"><dynamics damping="{d}"/>'
        for j, d in named.items()
    }
    scene = Scene(Hand.load(small(changes | {follows: follows + '<dynamics damping="0.6"/>'})))
    damping = {
        j: scene.plant.GetJointByName(j, scene.hand_model).default_damping_vector()[0] for j in ("a1", "b1", "a3")
    }
    assert damping == {"a1": 0.24, "b1": 0.0, "a3": 0.0}
    said = [line for line in scene.report if "damping" in line]
    assert [line.split(":")[0] for line in said] == ["joint a3", "joint b1"]
    assert "0.26 N m s/rad would take 0.52 N m at full speed, more than its effort of 0.5 N m" in said[1]


def test_palm_is_the_world_whatever_the_root(small):
    hand = Hand.load(small())
    scene = Scene(hand)
    palm = scene.plant.GetBodyByName("palm")
    assert palm.EvalPoseInWorld(scene.plant_context).IsNearlyEqualTo(
        type(palm.body_frame().CalcPoseInWorld(scene.plant_context))(), 1e-9
    )
    q = np.array([0.3, 0.2, -0.4, 0.5])
    scene.set(q)
    for finger in hand.fingers:
        assert np.allclose(scene.tip_position(finger), tip_by_hand(finger, q), atol=1e-9)
    assert any("wrist" in line and "fixed" in line for line in scene.report)


def test_plant_has_the_limits_and_actuators_of_the_hand_file(small):
    more = "joints: {a1: {upper_deg: 30, effort_nm: 0.2, speed_deg_s: 50}}\ndefaults:"
    scene = Scene(Hand.load(small(yaml={"defaults:": more})))
    joint = scene.plant.GetJointByName("a1")
    assert joint.position_upper_limits()[0] == pytest.approx(np.radians(30))
    assert joint.velocity_upper_limits()[0] == pytest.approx(np.radians(50))
    efforts = {
        a.joint().name(): a.effort_limit()
        for a in map(scene.plant.get_joint_actuator, scene.plant.GetJointActuatorIndices())
    }
    assert efforts == pytest.approx({"a1": 0.2, "a2": 0.5, "b1": 0.5, "b2": 0.5})


def test_tip_shape_is_the_sphere_of_the_hand_file(small):
    scene = Scene(Hand.load(small()))
    inspector = scene.scene_graph.model_inspector()
    (shape,) = scene.plant.GetCollisionGeometriesForBody(scene.plant.GetBodyByName("a_tip"))
    assert isinstance(inspector.GetShape(shape), Sphere)
    assert inspector.GetShape(shape).radius() == 0.006
    assert np.allclose(inspector.GetPoseInFrame(shape).translation(), [0, 0, 0.005])


def test_neighbours_are_not_checked_also_across_links_without_shape(small):
    def pairs(scene: Scene) -> set[frozenset[str]]:
        return {frozenset((a, b)) for a, b, _ in scene.clearances(1.0)}

    found = pairs(Scene(Hand.load(small())))
    assert frozenset(("palm", "a_bone")) not in found  # they meet in the knuckle, which has no shape
    assert frozenset(("palm", "b_bone")) not in found
    assert frozenset(("a_bone", "a_tip")) not in found
    assert frozenset(("palm", "a_tip")) in found
    assert frozenset(("a_bone", "b_bone")) in found
    ignored = pairs(Scene(Hand.load(small(yaml={"defaults:": "ignore_collisions: [[palm, a_tip]]\ndefaults:"}))))
    # what stands beside the fingertip's sphere is the same link of the URDF
    assert found - ignored == {frozenset(("palm", "a_tip")), frozenset(("palm", "a_tip_shank"))}


def test_clearance_of_tip_and_sphere_is_exact(scene):
    hand = scene.hand
    scene.set(hand.q_home)
    p = scene.tip_position("middle")
    u = np.array([2.0, 0.0, 1.0]) / np.sqrt(5)
    for gap in (0.004, -0.002):
        scene.set(hand.q_home, pose(*(p + (0.027 + 0.007 + gap) * u)))
        near = {(a, b): d for a, b, d in scene.clearances(0.006)}
        distance = near.get(("middle_tip", "sphere"), near.get(("sphere", "middle_tip")))
        assert distance == pytest.approx(gap, abs=1e-7)
        touching = {frozenset(pair[:2]) for pair in scene.penetrations()}
        assert (frozenset(("middle_tip", "sphere")) in touching) == (gap < 0)


def test_excluded_fingers_may_touch_the_object_with_the_tip_only(scene):
    hand = scene.hand
    scene.set(hand.q_home)
    scene.set(hand.q_home, pose(*(scene.tip_position("middle") + np.array([0.02, 0, -0.02]))))
    touching = {name for pair in scene.penetrations() for name in pair[:2]}
    assert {"middle_tip", "middle_distal"} <= touching
    left = {name for pair in scene.penetrations(["middle"]) for name in pair[:2]}
    assert "middle_tip" not in left
    assert "middle_distal" in left
    assert not any("middle_tip" in pair for pair in scene.clearances(0.001, exclude=["middle"]))
    with pytest.raises(InputError, match="no finger"):
        scene.penetrations(["midle"])


@given(u=st.lists(st.floats(0, 1), min_size=15, max_size=15), z=st.floats(0.05, 0.2))
@settings(max_examples=30, deadline=None)
def test_penetrations_are_the_negative_clearances(scene, u, z):
    hand = scene.hand
    scene.set(hand.q_lower + np.array(u) * (hand.q_upper - hand.q_lower), pose(0.06, 0.0, z))
    deep = {frozenset(p[:2]) for p in scene.penetrations() if p[2] > 1e-4}
    negative = {frozenset(p[:2]) for p in scene.clearances(0.001) if p[2] < 0}
    deeply_negative = {frozenset(p[:2]) for p in scene.clearances(0.001) if p[2] < -1e-4}
    assert deep <= negative
    assert deeply_negative <= {frozenset(p[:2]) for p in scene.penetrations()}


@pytest.mark.parametrize(
    ("q", "X_WO"),
    [
        (np.full(15, np.nan), None),
        (np.zeros(14), None),
        (np.zeros(15), np.full((4, 4), np.inf)),
        (np.zeros(15), np.eye(3)),
        (np.zeros(15), np.diag([2.0, 1, 1, 1])),
        (np.zeros(15), np.diag([-1.0, 1, 1, 1])),
    ],
)
def test_what_would_abort_drake_is_refused(scene, q, X_WO):
    before = scene.plant.GetPositions(scene.plant_context)
    with pytest.raises(InputError):
        scene.set(q, X_WO)
    assert np.array_equal(scene.plant.GetPositions(scene.plant_context), before)


def test_object_mass(kanguera):
    scene = Scene(kanguera, Object.load("pencil"), object_mass=0.02)
    inertia = scene.object_body.CalcSpatialInertiaInBodyFrame(scene.plant_context)
    assert inertia.get_mass() == pytest.approx(0.02)
    expected = Object.load("pencil").I_OCom * 2.5
    assert np.allclose(inertia.CalcRotationalInertia().CopyToFullMatrix3(), expected)
    with pytest.raises(InputError, match="mass"):
        Scene(kanguera, Object.load("pencil"), object_mass=-1)


def test_object_keeps_its_pose_when_none_is_given(scene):
    scene.set(scene.hand.q_home, pose(0.1, 0.2, 0.3))
    scene.set(scene.hand.q_lower)
    assert np.allclose(scene.object_body.EvalPoseInWorld(scene.plant_context).translation(), [0.1, 0.2, 0.3])


def test_a_scene_without_object_says_so(kanguera):
    with pytest.raises(InputError, match="no object"):
        Scene(kanguera).set(kanguera.q_home, np.eye(4))


def test_pieces_of_a_mesh_collide_where_they_are(kanguera, tmp_path):
    import trimesh

    a, b = (trimesh.creation.box((0.01, 0.01, 0.01)) for _ in range(2))
    b.apply_translation([0.06, 0, 0])
    trimesh.util.concatenate([a, b]).export(tmp_path / "two.stl")
    scene = Scene(kanguera, Object.load(tmp_path / "two.stl"))
    p = scene.tip_position("middle")
    scene.set(kanguera.q_home, pose(*(p - [0.03, 0, 0])))  # the tip is in the gap, inside the hull of both
    assert not [pair for pair in scene.penetrations() if "middle_tip" in pair[:2]]
    scene.set(kanguera.q_home, pose(*(p - [0.06, 0, 0])))
    assert [pair for pair in scene.penetrations() if "middle_tip" in pair[:2]]


def test_shapes_are_where_the_object_s_file_puts_them(kanguera, tmp_path):
    shape = '<origin xyz="0.05 0 0" rpy="0 1.5707963 0"/><geometry><cylinder radius="0.004" length="0.04"/></geometry>'
    text = f'<robot name="rod"><link name="rod"><collision>{shape}</collision></link></robot>'
    (tmp_path / "rod.urdf").write_text(text)
    scene = Scene(kanguera, Object.load(tmp_path / "rod.urdf"))
    scene.set(kanguera.q_home, pose(*(scene.tip_position("middle") + np.array([-0.1, 0, 0.0]))))
    distances = [d for a, b, d in scene.clearances(0.05) if {a, b} == {"middle_tip", "rod"}]
    assert distances == pytest.approx([0.05 - 0.02 - 0.007], abs=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<sphere radius="0.01"/>', '<sphere radius="-0.01"/>', "wrong numbers"),
        ('<sphere radius="0.01"/>', '<sphere radius="nan"/>', "wrong numbers"),
        ('<sphere radius="0.01"/>', '<mesh filename="none.stl"/>', "mesh file is missing"),
        ('<sphere radius="0.01"/>', '<mesh filename="small.urdf"/>', "cannot read mesh"),
        ('<sphere radius="0.01"/>', "<sphere/>", "Drake cannot read"),
        ('<mass value="0.01"/>', '<mass value="-0.01"/>', "negative"),
        ('<mass value="0.01"/>', '<mass value="nan"/>', "wrong numbers"),
        ('ixx="1e-6"', 'ixx="inf"', "wrong numbers"),
    ],
)
def test_wrong_shapes_and_masses_are_one_clear_error(small, old, new, message):
    file = small({old: new})
    with pytest.raises(InputError, match=message) as error:
        Scene(Hand.load(file))
    assert error.value.file.name == "small.urdf" or message == "cannot read mesh"
