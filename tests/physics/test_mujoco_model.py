"""The MuJoCo model is the Drake plant: masses, kinematics, limits, filters, servos."""

import numpy as np
import pytest

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene

mujoco = pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")

from drake_hand.physics.mujoco_model import CONTACT_IMPEDANCE, OBJECT_NAME, build_model, tip_shapes  # noqa: E402

PADS = np.array([3000.0, 3500.0, 4000.0, 2500.0, 4500.0])


@pytest.fixture(scope="module")
def hand():
    return Hand.load("kanguera")


@pytest.fixture(scope="module", params=["pencil_r8", "cube"])
def made(hand, request):
    """Drake's scene and MuJoCo's model of the same."""
    object_ = Object.load(request.param).with_mass(0.037)
    gravity = np.array([1.0, 2.0, -9.0])
    spec = build_model(hand, object_, gravity=gravity, friction=0.7, pad_stiffness=PADS, relaxation=0.02)
    model = spec.compile()
    return Scene(hand, object_), model, mujoco.MjData(model)


def pose(scene, data, model, q, X_WO):
    """Puts both where they are asked about."""
    scene.set(q, X_WO)
    for finger in scene.hand.fingers:
        for axis in finger.axes:
            value = axis.multiplier * q[finger.columns[axis.source]] + axis.offset
            data.qpos[model.joint(axis.joint).qposadr[0]] = value
    start = model.joint(OBJECT_NAME).qposadr[0]
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, X_WO[:3, :3].ravel())
    data.qpos[start : start + 7] = [*X_WO[:3, 3], *quat]
    mujoco.mj_forward(model, data)


def somewhere(rng):
    X = np.eye(4)
    X[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    X[:3, :3] *= np.sign(np.linalg.det(X[:3, :3]))
    X[:3, 3] = rng.uniform(-0.1, 0.1, 3)
    return X


def test_tips_links_and_mass_matrix_are_drakes(made):
    scene, model, data = made
    hand, rng = scene.hand, np.random.default_rng(0)
    joints = [scene.plant.get_joint(i) for i in scene.plant.GetJointIndices(scene.hand_model)]
    moving = [j for j in joints if j.num_positions() == 1]
    drake = np.array([j.velocity_start() for j in moving])
    own = np.array([model.joint(j.name()).dofadr[0] for j in moving])
    for _ in range(20):
        pose(scene, data, model, rng.uniform(hand.q_lower, hand.q_upper), somewhere(rng))
        for finger, name in zip(hand.fingers, tip_shapes(hand), strict=True):
            np.testing.assert_allclose(data.geom(name).xpos, scene.tip_position(finger), atol=1e-6)
        for i in scene.plant.GetBodyIndices(scene.hand_model):
            body = scene.plant.get_body(i)
            X = body.EvalPoseInWorld(scene.plant_context)
            np.testing.assert_allclose(data.body(body.name()).xpos, X.translation(), atol=1e-6)
            np.testing.assert_allclose(data.body(body.name()).xmat.reshape(3, 3), X.rotation().matrix(), atol=1e-6)
        M = scene.plant.CalcMassMatrix(scene.plant_context)[np.ix_(drake, drake)]
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        np.testing.assert_allclose(full[np.ix_(own, own)], M, atol=1e-6 * np.abs(M).max())


def test_masses_and_inertias_are_drakes(made):
    scene, model, _ = made
    bodies = [scene.plant.get_body(i) for i in scene.plant.GetBodyIndices(scene.hand_model)]
    for body, name in [*((b, b.name()) for b in bodies), (scene.object_body, OBJECT_NAME)]:
        M = body.default_spatial_inertia()
        ours = model.body(name)
        assert ours.mass[0] == pytest.approx(M.get_mass(), rel=1e-6)
        if M.get_mass() > 0:
            np.testing.assert_allclose(ours.ipos, M.get_com(), atol=1e-6)
            moments = np.linalg.eigvalsh(M.Shift(M.get_com()).CalcRotationalInertia().CopyToFullMatrix3())
            np.testing.assert_allclose(np.sort(ours.inertia), moments, rtol=1e-6)


def test_limits_couplings_and_servos_are_those_of_the_hand_file(made):
    scene, model, _ = made
    hand = scene.hand
    for j, name in enumerate(hand.joints):
        np.testing.assert_allclose(model.joint(name).range, [hand.q_lower[j], hand.q_upper[j]], atol=1e-6)
        assert model.joint(name).limited
        servo = model.actuator(name)
        assert servo.gainprm[0] == hand.stiffness[j]
        assert list(servo.biasprm[1:3]) == [-hand.stiffness[j], -hand.damping[j]]
        np.testing.assert_allclose(servo.forcerange, [-hand.effort[j], hand.effort[j]])
    assert [model.actuator(i).name for i in range(model.nu)] == list(hand.joints)
    follow = {a.joint: a for f in hand.fingers for a in f.axes if a.joint not in hand.joints}
    assert model.neq == len(follow) == 5
    for k in range(model.neq):
        axis = follow[model.joint(model.eq_obj1id[k]).name]
        np.testing.assert_allclose(model.eq_data[k, :2], [axis.offset, axis.multiplier])


def test_the_same_links_are_kept_from_colliding(made):
    scene, model, _ = made
    inspector = scene.scene_graph.model_inspector()
    # MuJoCo's number of a pair: the smaller body first, in the upper half.
    apart = {frozenset((int(s) >> 16, int(s) & 0xFFFF)) for s in model.exclude_signature}
    name = {g: scene.plant.GetBodyFromFrameId(inspector.GetFrameId(g)).name() for g in inspector.GetAllGeometryIds()}
    checked = 0
    for a, b in inspector.GetCollisionCandidates():
        bodies = [OBJECT_NAME if name[g] == scene.object.link else name[g] for g in (a, b)]
        assert frozenset(model.body(n).id for n in bodies) not in apart
        checked += 1
    assert checked > 100
    assert len(apart) >= 15
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT


def test_a_pad_is_as_stiff_as_asked(hand):
    """The object rests by its weight on a tip: as deep as a spring would be."""
    object_ = Object.load("sphere").with_mass(0.3)
    spec = build_model(
        hand, object_, gravity=np.array([0, 0, -9.81]), friction=0.7, pad_stiffness=PADS, relaxation=0.02
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    tip, radius = data.geom(tip_shapes(hand)[2]).xpos.copy(), hand.fingers[2].radius + object_.geometries[0].size[0]
    # Fingers that cannot move, so that the pad alone yields.
    model.dof_armature[: model.nv - 6] = 1e6
    data.qpos[-7:] = [*(tip + np.array([0, 0, radius])), 1, 0, 0, 0]
    # Nothing pushes it off the top of the tip meanwhile.
    for _ in range(300):
        data.qvel[-6:-4], data.qvel[-3:] = 0, 0
        mujoco.mj_step(model, data)
    depth = tip[2] + radius - data.qpos[-5]
    assert depth == pytest.approx(0.3 * 9.81 / PADS[2], rel=0.02)
    assert 0 < CONTACT_IMPEDANCE < 1
