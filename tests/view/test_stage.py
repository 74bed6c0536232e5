"""Turning the world upright, and keeping only the frames an animation needs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_hand.view.stage import FRAME_RATE, FRAMES, _changes, _hold, _upright, frame_times

directions = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda g: np.linalg.norm(g) > 1e-3)


@given(directions)
def test_gravity_points_down_whatever_its_direction(g):
    R = _upright(g)
    assert R @ g / np.linalg.norm(g) == pytest.approx([0, 0, -1])
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)


def test_without_gravity_the_world_stays():
    assert (_upright(np.zeros(3)) == np.eye(3)).all()
    assert _upright(np.array([0, 0, -9.81])) == pytest.approx(np.eye(3))


@pytest.mark.parametrize("duration", [0.01, 1.0, 65.0, 1000.0])
def test_frames_cover_the_plan_and_are_not_too_many(duration):
    t = frame_times(duration)
    assert t[0] == 0
    assert t[-1] == duration
    assert len(t) <= min(FRAMES, np.ceil(duration * FRAME_RATE)) + 1


@given(st.lists(st.integers(0, 2), min_size=1, max_size=30))
def test_dropped_frames_are_those_interpolation_gives_back(values):
    rows = np.array(values, dtype=float)[:, None]
    kept = _changes(rows)
    assert kept[0] == 0
    assert kept[-1] == len(rows) - 1
    assert np.interp(np.arange(len(rows)), kept, rows[kept, 0]) == pytest.approx(rows[:, 0])


def test_gaps_are_bridged_by_the_last_good_row():
    rows = np.array([[9.0], [1.0], [9.0], [9.0], [2.0]])
    good = np.array([False, True, False, False, True])
    assert _hold(rows, good)[:, 0].tolist() == [1, 1, 1, 1, 2]
