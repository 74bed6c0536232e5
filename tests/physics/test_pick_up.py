"""The bundled pencil on a table, from task to physics: picked up, turned, put down, and never held by a fixture."""

import numpy as np
import pytest

from drake_hand import api
from drake_hand.errors import InputError
from drake_hand.model.object import Object
from drake_hand.model.table import feet
from drake_hand.physics.replay import replay
from drake_hand.plans.holds import free_windows, hold_windows


@pytest.fixture(scope="module")
def plan():
    return api.plan("table_pencil")


@pytest.mark.slow
def test_is_certified_and_the_fingers_hold_from_before_the_lift_until_after_the_landing(plan):
    assert plan.certified
    ((start, end),) = hold_windows(plan)
    assert free_windows(plan) == [(0.0, plan.duration)]
    t = np.arange(0.0, plan.duration, 0.01)
    off = np.abs(plan.at(t).X_WO[:, 0, 3] - 0.074) > 1e-6
    assert off.any()
    assert start < t[off][0]
    assert t[off][-1] < end


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["drake", "mujoco"])
def test_is_held_and_lies_on_the_table_again(plan, engine):
    run, record = replay(plan, engine=engine)
    assert run.success
    assert run.free_s == 0.0
    assert run.planned_deg == pytest.approx(-90.0, abs=0.1)
    assert run.strays == {}
    gaps = np.array([plan.task.table.gap(feet(Object.load("pencil_r12").geometries), X) for X in record.X_WO])
    assert gaps.max() > 0.029
    assert abs(gaps[0]) < 1e-4
    assert abs(gaps[-1]) < 2e-4
    assert not record.f_W[-1].any()


@pytest.mark.slow
def test_point_contact_is_refused(plan):
    with pytest.raises(InputError, match="point contact"):
        replay(plan, contact="point")
