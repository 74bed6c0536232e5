"""Slides, where a step asks for one."""

import msgspec
import numpy as np
import pytest

from drake_hand import api
from drake_hand.contact.surface import Surface
from drake_hand.model.object import Object
from drake_hand.physics.replay import replay
from drake_hand.planning.force_plan import SLIDING_FORCE_N
from drake_hand.planning.slide import directions
from drake_hand.plans.task import Grasp, Slide, Step, Task
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
    n_W = Surface.of(Object.load("pencil_r8")).closest(way[moving])[1] @ states.X_WO[0, :3, :3].T
    press = -np.sum(f_W[moving] * n_W, axis=1)
    friction_W = f_W[moving] + press[:, None] * n_W
    friction = np.linalg.norm(friction_W, axis=1)
    np.testing.assert_allclose(friction / press, slid.task.physics.friction, rtol=0.02)
    # The tip turns as it goes, so that its material slides in another direction than its contact moves in.
    assert (np.sum(friction_W * along, axis=1) > 0.8 * friction).all()
    assert press.max() < 2 * SLIDING_FORCE_N


def test_physics_lets_it_slide_that_far(slid):
    run, record = replay(slid, contact="point")
    assert run.success
    assert run.position_error_mm < 0.3
    index, X = slid.fingers.index("index"), record.X_WO[-1]
    touched = record.p_W[:, index] @ X[:3, :3] - X[:3, 3] @ X[:3, :3]
    t0, t1 = slid.parts[2].t[0], slid.parts[2].t[-1]
    way = touched[np.searchsorted(record.t, t1)] - touched[np.searchsorted(record.t, t0)]
    assert np.linalg.norm(way) * 1e3 == pytest.approx(LONG, abs=1.0)


def test_directions_are_those_of_the_material():
    """A tip that only rolls, and one that only slides, on a plane."""
    q = np.linspace(0.0, 1.0, 5)[:, None]
    n_W = np.tile([0.0, 0.0, 1.0], (5, 1))
    rolls, slides = np.zeros((5, 3, 1)), np.tile([[1.0], [0.0], [0.3]], (5, 1, 1))
    np.testing.assert_allclose(directions(q, rolls, n_W), 0.0)
    np.testing.assert_allclose(directions(q, slides, n_W), np.tile([1.0, 0.0, 0.0], (5, 1)), atol=1e-12)
