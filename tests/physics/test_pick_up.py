"""Objects on a table, from task to physics: picked up, put down, and never held by a fixture."""

import numpy as np
import pytest

from drake_hand import api
from drake_hand.errors import InputError
from drake_hand.model.object import Object
from drake_hand.model.table import feet
from drake_hand.physics.engine import Perturbation
from drake_hand.physics.replay import replay
from drake_hand.plans.holds import free_windows, hold_windows
from drake_hand.plans.plan import Plan


@pytest.fixture(scope="module")
def cube() -> Plan:
    return api.plan("table_cube")


@pytest.fixture(scope="module")
def pencil() -> Plan:
    return api.plan("table_pencil")


def judge(plan: Plan, engine: str, turned_deg: float) -> None:
    """Plays it, and sees that it is lifted, held and put down, free at all times."""
    run, record = replay(plan, engine=engine)
    assert run.success
    assert run.free_s == 0.0
    assert run.planned_deg == pytest.approx(turned_deg, abs=0.1)
    assert run.strays == {}
    at, table = feet(Object.load(plan.task.object).geometries), plan.task.table
    assert table is not None
    gaps = np.array([table.gap(at, X_WO) for X_WO in record.X_WO])
    assert gaps.max() > 0.028
    assert abs(gaps[0]) < 1e-4
    assert abs(gaps[-1]) < 2e-4
    assert not record.f_W[-1].any()


def test_the_fingers_hold_from_before_the_lift_until_after_the_landing(cube):
    assert cube.certified
    ((start, end),) = hold_windows(cube)
    assert free_windows(cube) == [(0.0, cube.duration)]
    t = np.arange(0.0, cube.duration, 0.01)
    off = np.abs(cube.at(t).X_WO[:, 0, 3] - 0.082) > 1e-6
    assert start < t[off][0]
    assert t[off][-1] < end


@pytest.mark.parametrize("engine", [pytest.param("drake", marks=pytest.mark.slow), "mujoco"])
def test_a_cube_is_picked_up_and_put_down(cube, engine):
    judge(cube, engine, 0.0)


def test_a_cube_that_slips_out_of_the_fingers_is_dropped(cube):
    slippery = Perturbation(friction=0.1)
    run, _ = replay(cube, slippery, engine="mujoco")
    assert run.dropped


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["drake", "mujoco"])
def test_a_pencil_is_picked_up_turned_and_put_down(pencil, engine):
    assert pencil.certified
    judge(pencil, engine, -90.0)


def test_point_contact_is_refused(cube):
    with pytest.raises(InputError, match="point contact"):
        replay(cube, contact="point")
