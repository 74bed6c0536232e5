"""Turning the world upright, and keeping only the frames an animation needs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_hand import api
from drake_hand.view import stage
from drake_hand.view.keyframes import last_good, needed, row_changes
from drake_hand.view.stage import MOST_FRAMES, MOST_FRAMES_PER_S, frame_times, tubes, upright

directions = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda g: np.linalg.norm(g) > 1e-3)


@settings(deadline=None)  # the machine may be busy
@given(directions)
def test_gravity_points_down_whatever_its_direction(g):
    R = upright(g)
    assert R @ g / np.linalg.norm(g) == pytest.approx([0, 0, -1])
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)


def test_without_gravity_the_world_stays():
    assert (upright(np.zeros(3)) == np.eye(3)).all()
    assert upright(np.array([0, 0, -9.81])) == pytest.approx(np.eye(3))


@pytest.mark.parametrize("duration", [0.01, 1.0, 65.0, 1000.0])
def test_frames_cover_the_plan_and_are_not_too_many(duration):
    t = frame_times(duration)
    assert t[0] == 0
    assert t[-1] == duration
    assert len(t) <= min(MOST_FRAMES, np.ceil(duration * MOST_FRAMES_PER_S)) + 1


@settings(deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=1, max_size=60), st.floats(1e-3, 0.5))
def test_dropped_frames_are_those_interpolation_gives_back(values, tolerance):
    rows = np.array(values)[:, None]
    kept = needed(rows, tolerance)
    assert {0, len(rows) - 1} <= set(kept.tolist())
    assert np.interp(np.arange(len(rows)), kept, rows[kept, 0]) == pytest.approx(rows[:, 0], abs=tolerance * 1.001)


def test_a_straight_way_needs_its_ends_only():
    assert needed(np.linspace(0, 1, 500)[:, None], 1e-6).tolist() == [0, 499]


def test_switches_are_first_row_and_changes():
    assert row_changes(np.array([True, True, False, False, True])).tolist() == [0, 2, 4]


def test_a_way_is_a_closed_tube_around_each_stretch():
    starts, ends = np.array([[0, 0, 0], [1.0, 0, 0]]), np.array([[1.0, 0, 0], [1, 2, 0]])
    vertices, faces = tubes(starts, ends, 0.1)
    assert len(faces) == 16
    first, second = vertices[np.unique(faces[:8])], vertices[np.unique(faces[8:])]
    assert np.hypot(first[:, 1], first[:, 2]) == pytest.approx(0.1)
    assert sorted({round(x, 9) for x in second[:, 1]}) == [0, 2]
    corner = vertices[faces]
    outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    middle = np.repeat((starts + ends) / 2, 8, axis=0)
    assert (np.sum(outward * (corner.mean(axis=1) - middle), axis=1) > 0).all()


def test_gaps_are_bridged_by_the_last_good_row():
    rows = np.array([[9.0], [1.0], [9.0], [9.0], [2.0]])
    good = np.array([False, True, False, False, True])
    assert last_good(rows, good)[:, 0].tolist() == [1, 1, 1, 1, 2]


def test_a_long_recording_is_coarser_and_so_has_room(sample_plan, monkeypatch):
    fine = len(api.show(sample_plan))
    monkeypatch.setattr(stage, "_MOST_POSES", 60)
    assert len(api.show(sample_plan)) < fine - 5000
