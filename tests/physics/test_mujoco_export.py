"""What is exported replays the plan in plain MuJoCo, without this project."""

import numpy as np
import pytest

from drake_hand.model.hand import Hand
from drake_hand.plans.trajectory import Trajectory
from tests.verify.held import END, RAMP, held_plan

mujoco = pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")

from drake_hand.physics.mujoco_export import export_mujoco, write  # noqa: E402


def test_model_and_controls_replay_the_plan(tmp_path):
    plan = held_plan()
    file = tmp_path / "held.xml"
    controls = np.load(write(export_mujoco(plan), file))
    # From here on what anybody would write who has only the two files.
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    start = data.body("object").xpos.copy()
    fixture = model.equality("fixture").id
    for t, ctrl in zip(controls["t"], controls["ctrl"], strict=True):
        data.eq_active[fixture] = not any(a <= t <= b for a, b in controls["free"])
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data)
        if t < RAMP:
            np.testing.assert_allclose(data.body("object").xpos, start, atol=2e-4)  # a weld of MuJoCo's gives a little
    assert data.time == pytest.approx(END)
    planned = Trajectory(plan).at(END)
    np.testing.assert_allclose(data.body("object").xpos, planned.X_WO[0, :3, 3], atol=0.3e-3)
    np.testing.assert_allclose(data.body("object").xmat.reshape(3, 3), planned.X_WO[0, :3, :3], atol=0.02)
    joints = [data.joint(str(name)).qpos[0] for name in controls["joints"]]
    np.testing.assert_allclose(joints, planned.q[0], atol=np.radians(1.0))


def test_controls_are_the_commands_of_the_plan():
    plan = held_plan()
    made = export_mujoco(plan)
    assert made.joints == plan.joints
    trajectory, hand = Trajectory(plan), Hand.load("kanguera")
    told = trajectory.at(made.t).q_command
    lead = np.gradient(told, made.t, axis=0) * hand.damping / hand.stiffness
    assert np.abs(lead).max() > 1e-5
    smooth = np.abs(made.t[:, None] - trajectory.knots).min(axis=1) > 1.5e-3
    np.testing.assert_allclose(made.ctrl[smooth], (told + lead)[smooth], atol=1e-6)
    np.testing.assert_allclose(made.free, [[RAMP, END]])
