"""A real hand nobody here wrote turns a stick by 90 deg: planned, certified, held in physics."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.replays import ALLEGRO, PALMS, own, turn
from drake_hand import api
from drake_hand.model.hand import Hand
from drake_hand.physics.replay import replay
from drake_hand.plans.task import Pose
from drake_hand.plans.trajectory import Trajectory

MODELS = Path(__file__).parents[2] / "../shared/models"
pytestmark = pytest.mark.skipif(not MODELS.is_dir(), reason="the folder of real hands is not there")
START = Pose(xyz_mm=(78.0, 8.0, -14.0), rpy_deg=(147.0, -13.0, -78.0))
"""One that `start: auto` finds."""


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    file = tmp_path_factory.mktemp("allegro") / "allegro.hand.yaml"
    file.write_text(ALLEGRO.format(models=MODELS.resolve()))
    return api.plan(turn(str(file), "pencil_r12", own(90.0), PALMS["up"], start=START))


def test_commands_stay_within_the_joints_limits_however_strong_the_servos(plan):
    hand = Hand.load(plan.task.hand)
    states = Trajectory(plan).at(np.concatenate([part.t for part in plan.parts]))
    assert np.degrees(np.abs(states.q_offset).max()) > 3.0, "the hand presses harder than the margin for servos allows"
    assert (states.q_command <= hand.q_upper + 1e-9).all()
    assert (states.q_command >= hand.q_lower - 1e-9).all()


def test_physics_holds_it(plan):
    run = replay(plan, contact="point")[0]
    assert run.success
    assert run.planned_deg == pytest.approx(90.0, abs=0.1)
    assert run.position_error_mm < 1.0
    assert run.tilt_error_deg < 2.0
    assert abs(run.rotation_error_deg) < 5.0
