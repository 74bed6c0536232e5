"""Slides: where a step asks for one, and where the search finds that nothing else is left."""

import msgspec
import numpy as np
import pytest

from drake_hand import api
from drake_hand.physics.replay import replay
from drake_hand.planning.force_plan import LIGHT
from drake_hand.planning.slide import directions
from drake_hand.plans.task import Grasp, Options, Rotate, Slide, Step, Task
from drake_hand.plans.trajectory import Trajectory

LONG = 6.0
"""mm."""


@pytest.fixture(scope="module")
def slid():
    task = msgspec.structs.replace(
        Task.load("spin"), motion=[Step(grasp=Grasp()), Step(slide=Slide(finger="index", by_mm=(0.0, LONG)))]
    )
    return api.plan(task)


def test_a_finger_slides_while_the_others_hold_in_equilibrium(slid):
    assert slid.modes == ["00000", "11111", "11121", "11111"]
    part = slid.parts[2]
    f_W, t = np.array(part.contacts["index"].f_W), np.array(part.t)
    way = np.array(part.contacts["index"].p_OP)
    moving = np.linalg.norm(np.gradient(way, t, axis=0), axis=1) > 1e-3
    states = Trajectory(slid).at(t[moving])
    along = np.gradient(way, t, axis=0)[moving] @ states.X_WO[0, :3, :3].T
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    friction = np.sum(f_W[moving] * along, axis=1)
    press = np.linalg.norm(f_W[moving] - friction[:, None] * along, axis=1)
    np.testing.assert_allclose(friction / press, slid.task.physics.friction, rtol=0.02)
    assert press.max() < 2 * LIGHT


def test_physics_lets_it_slide_that_far(slid):
    run, record = replay(slid, contact="point")
    assert run.success
    assert run.position_error_mm < 0.3
    index, X = slid.fingers.index("index"), record.X_WO[-1]
    touched = record.p_W[:, index] @ X[:3, :3] - X[:3, 3] @ X[:3, :3]
    t0, t1 = slid.parts[2].t[0], slid.parts[2].t[-1]
    way = touched[np.searchsorted(record.t, t1)] - touched[np.searchsorted(record.t, t0)]
    assert np.linalg.norm(way) * 1e3 == pytest.approx(LONG, abs=1.0)


def test_where_no_finger_may_be_lifted_the_search_slides_them():
    paper = Task.load("paper")
    task = msgspec.structs.replace(
        paper,
        motion=[paper.motion[0], Step(rotate=Rotate(axis=(0.0, 1.0, 0.0), angle_deg=240.0))],
        options=Options(hold="kinematic", model="pivot", modes=["00000", "00111", "00112", "00121", "00211"]),
    )
    result = api.solve(task)
    assert result.plan.certified
    assert result.regrasps == 0
    assert any("2" in mode for mode in result.plan.modes)


def test_directions_are_those_of_the_material():
    """A tip that only rolls, and one that only slides, on a plane."""
    q = np.linspace(0.0, 1.0, 5)[:, None]
    n_W = np.tile([0.0, 0.0, 1.0], (5, 1))
    rolls, slides = np.zeros((5, 3, 1)), np.tile([[1.0], [0.0], [0.3]], (5, 1, 1))
    np.testing.assert_allclose(directions(q, rolls, n_W), 0.0)
    np.testing.assert_allclose(directions(q, slides, n_W), np.tile([1.0, 0.0, 0.0], (5, 1)), atol=1e-12)
