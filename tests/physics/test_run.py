"""What is said about a run: in place, upright and turned as planned, or not, and by how much."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.model.object import Object
from drake_hand.physics.run import Record, SimulatedRun, judge
from drake_hand.physics.simulation import Perturbation
from drake_hand.plans.trajectory import Trajectory
from tests.verify.held import AXIS_W, END, RAMP, held_plan

PENCIL = Object.load("pencil_r8")
AXIS = AXIS_W / np.linalg.norm(AXIS_W)
ACROSS = np.cross(AXIS, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(AXIS, [0.0, 0.0, 1.0]))


@pytest.fixture(scope="module")
def plan():
    return held_plan(hold="kinematic")


@pytest.fixture(scope="module")
def as_planned(plan) -> Record:
    t = np.linspace(0.0, END, 81)
    states = Trajectory(plan).at(t)
    n = len(plan.fingers)
    return Record(
        t=t,
        q=states.q,
        X_WO=states.X_WO,
        p_W=np.zeros((len(t), n, 3)),
        f_W=np.ones((len(t), n, 3)),
        slip_W=np.zeros((len(t), n, 3)),
        strays=((),) * len(t),
        wall_s=2.0,
    )


def ended(plan, record: Record, *, turn=(0.0, 0.0, 0.0), shift_mm=(0.0, 0.0, 0.0), dropped=False) -> SimulatedRun:
    """The run whose object drifts away from its plan, at the end by so much (turn: rotation vector in deg)."""
    X = record.X_WO.copy()
    share = np.clip((record.t - RAMP) / (END - RAMP), 0.0, 1.0)
    lean = Rotation.from_rotvec(share[:, None] * np.asarray(turn), degrees=True).as_matrix()
    X[:, :3, :3] = lean @ X[:, :3, :3]
    X[:, :3, 3] += share[:, None] * np.asarray(shift_mm) * 1e-3
    happened = dataclasses.replace(record, X_WO=X)
    return judge(happened, plan, PENCIL, Perturbation(), free=RAMP, dropped=dropped)


def test_as_planned_is_a_success_without_errors(plan, as_planned):
    run = ended(plan, as_planned)
    assert run.success
    assert (run.free_s, run.end_s) == (pytest.approx(RAMP), pytest.approx(END))
    for error in (run.position_error_mm, run.tilt_error_deg, run.rotation_error_deg, run.slip_mm):
        assert error == pytest.approx(0.0, abs=1e-4)
    assert run.realtime_factor == pytest.approx(END / 2.0)


@pytest.mark.parametrize(("tilt", "success"), [(7.0, True), (9.0, False), (-9.0, False)])
def test_a_tilted_object_is_reported_and_beyond_8_deg_no_success(plan, as_planned, tilt, success):
    run = ended(plan, as_planned, turn=tilt * ACROSS)
    assert run.tilt_error_deg == pytest.approx(abs(tilt), abs=1e-3)
    assert run.worst_tilt_deg == pytest.approx(abs(tilt), abs=1e-3)
    assert run.errors.tilt_deg[-1] == pytest.approx(abs(tilt), abs=1e-3)
    assert run.errors.tilt_deg[0] == pytest.approx(0.0, abs=1e-3)
    assert run.rotation_error_deg == pytest.approx(0.0, abs=1e-3)
    assert run.success == success


@pytest.mark.parametrize(("turn", "success"), [(7.0, True), (9.0, False), (-9.0, False)])
def test_a_turn_that_is_off_by_more_than_8_deg_is_no_success(plan, as_planned, turn, success):
    run = ended(plan, as_planned, turn=turn * AXIS)
    assert run.rotation_error_deg == pytest.approx(abs(turn), abs=1e-3)
    assert run.rotated_deg == pytest.approx(run.planned_deg + turn, abs=1e-3)
    assert run.tilt_error_deg == pytest.approx(0.0, abs=1e-3)
    assert run.success == success


@pytest.mark.parametrize(("shift", "success"), [(2.5, True), (3.5, False)])
def test_an_object_farther_than_3_mm_away_is_no_success(plan, as_planned, shift, success):
    run = ended(plan, as_planned, shift_mm=(0.0, shift, 0.0))
    assert run.position_error_mm == pytest.approx(shift, abs=1e-4)
    assert run.success == success


def test_what_was_dropped_is_no_success_wherever_it_is(plan, as_planned):
    assert not ended(plan, as_planned, dropped=True).success
    untouched = dataclasses.replace(as_planned, f_W=np.zeros_like(as_planned.f_W))
    run = ended(plan, untouched)
    assert run.dropped
    assert not run.success
