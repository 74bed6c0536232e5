"""A real hand nobody here wrote turns a stick by 90 deg: planned, certified, held in physics."""

import numpy as np
import pytest

from drake_hand import api
from drake_hand.model.hand import Hand
from drake_hand.physics.replay import replay
from drake_hand.planning.collision import LIMIT_MARGIN_RAD
from drake_hand.plans.task import Grasp, Options, Physics, Pose, Rotate, Step, Task
from drake_hand.plans.trajectory import Trajectory

ALLEGRO = """
name: allegro
urdf: {models}/hands/allegro/allegro_hand_right.urdf
palm: base_link
fingers:
- {{name: ring, tip: {{link: link_11.0_tip, radius_mm: 11.94, xyz_mm: [0.0, -0.05, -11.94]}}}}
- {{name: middle, tip: {{link: link_7.0_tip, radius_mm: 11.94, xyz_mm: [0.0, -0.05, -11.94]}}}}
- {{name: index, tip: {{link: link_3.0_tip, radius_mm: 11.94, xyz_mm: [0.0, -0.05, -11.94]}}}}
- {{name: thumb, tip: {{link: link_15.0_tip, radius_mm: 11.94, xyz_mm: [0.0, -0.05, -11.94]}}}}
defaults: {{speed_deg_s: 120, acceleration_deg_s2: 1500, effort_nm: 0.35, stiffness_nm_rad: 2, damping_nm_s_rad: 0.1}}
"""
START = Pose(xyz_mm=(86.0, 10.0, 6.0), rpy_deg=(83.0, -84.0, -161.0))
"""One that `start: auto` finds."""


@pytest.fixture(scope="module")
def plan(tmp_path_factory, models):
    file = tmp_path_factory.mktemp("allegro") / "allegro.hand.yaml"
    file.write_text(ALLEGRO.format(models=models))
    turn = Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=90.0))
    task = Task(
        hand=str(file),
        object="pencil_r12",
        start=START,
        motion=[Step(grasp=Grasp()), turn],
        physics=Physics(gravity=(-9.81, 0.0, 0.0)),
        options=Options(time_limit_s=180.0),
    )
    return api.plan(task)


def test_commands_stay_within_the_joints_limits_however_strong_the_servos(plan):
    hand = Hand.load(plan.task.hand)
    states = Trajectory(plan).at(np.concatenate([part.t for part in plan.parts]))
    assert np.abs(states.q_offset).max() > LIMIT_MARGIN_RAD, "the hand presses harder than the margin for servos allows"
    assert (states.q_command <= hand.q_upper + 1e-9).all()
    assert (states.q_command >= hand.q_lower - 1e-9).all()


def test_physics_holds_it(plan):
    run = replay(plan, contact="point")[0]
    assert run.success
    assert run.planned_deg == pytest.approx(90.0, abs=0.1)
    assert run.position_error_mm < 1.0
    assert run.tilt_error_deg < 2.0
    assert abs(run.rotation_error_deg) < 5.0
