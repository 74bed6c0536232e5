"""The second engine says what the first does where both must agree, and holds and drops as physics does."""

import numpy as np
import pytest

from drake_hand.physics.engine import Perturbation
from drake_hand.physics.replay import replay
from drake_hand.plans.trajectory import Trajectory
from tests.physics.test_replay import twice
from tests.verify.held import END, RAMP, held_plan

pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
WEIGHT = np.array([0, 0, -0.015 * 9.81])


@pytest.fixture(scope="module")
def plan():
    return held_plan()


def test_planned_forces_hold_the_pencil(plan):
    run, record = replay(plan, engine="mujoco")
    assert run.success
    assert run.position_error_mm < 0.2
    assert run.tilt_error_deg < 0.5
    assert run.rotation_error_deg < 0.5
    planned = Trajectory(plan).at(END).f_W[0]
    np.testing.assert_allclose(record.f_W[-1], planned, atol=0.1)
    assert run.strays == {}
    assert run.free_s == pytest.approx(RAMP)
    np.testing.assert_allclose(record.f_W[-1].sum(axis=0), -WEIGHT, atol=0.02)
    touching = record.X_WO[-1, :3, 3] - record.p_W[-1, 1:]
    assert np.all(np.linalg.norm(touching, axis=1) < 0.08)


def test_contacts_inside_their_cones_stay_where_they_are():
    _, record = replay(held_plan(end=5.0), engine="mujoco")
    late = record.X_WO[record.t > 1.0]
    assert np.linalg.norm(late[:, :3, 3] - late[0, :3, 3], axis=1).max() < 0.05e-3
    assert np.abs(late[:, :3, :3] - late[0, :3, :3]).max() < np.radians(0.1)


def test_without_forces_the_pencil_falls():
    run, _ = replay(held_plan(hold="kinematic"), engine="mujoco")
    assert run.dropped
    assert run.position_error_mm > 30


def test_it_falls_on_slippery_fingers(plan):
    assert replay(plan, Perturbation(friction=0.05), engine="mujoco")[0].dropped


def test_the_fixture_stands_still_and_takes_the_object_back():
    both = twice(held_plan())
    again = both.parts[-1].t[0]
    run, record = replay(both, Perturbation(shift_mm=(0.0, 0.0, 0.3)), engine="mujoco")
    held = record.t <= RAMP
    np.testing.assert_allclose(record.X_WO[held] - record.X_WO[0], 0, atol=1e-6)
    assert not run.dropped
    between = (record.t > END + 0.01) & (record.t < again)
    np.testing.assert_allclose(record.X_WO[between] - record.X_WO[between][0], 0, atol=1e-6)


def test_stiffer_servos_press_harder(plan):
    soft, hard = (replay(plan, Perturbation(stiffness=s), engine="mujoco")[1].f_W[-1] for s in (0.8, 1.2))
    assert np.linalg.norm(hard, axis=1).sum() > 1.1 * np.linalg.norm(soft, axis=1).sum()
