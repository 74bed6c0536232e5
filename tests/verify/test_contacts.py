"""Rules about free tips, and slip against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.plans.trajectory import States
from drake_hand.verify.contacts import free_tips_mm, pivot_slip, rolling_slip, runs, sliding_velocity
from drake_hand.verify.observe import Observed


def judged(gap, digits):
    return free_tips_mm(np.array(gap, dtype=float)[:, None], np.array(digits)[:, None], 0.1)[:, 0]


def test_runs():
    assert list(runs(np.array([True, True, False, True]))) == [(0, 2), (3, 4)]
    assert list(runs(np.zeros(3, dtype=bool))) == []


def test_landing_and_lifting_may_touch_and_overlap_by_the_tolerance():
    ok = judged([0, -0.05, 0.0, 0.4, 3, np.nan, 1, 0.3, 0.05, -0.02, 0], [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1])
    assert np.nanmax(np.nan_to_num(ok, nan=-9)) < 0
    deep = judged([0, -0.2, 0.5, 3], [1, 0, 0, 0])
    assert np.nanmax(deep) == pytest.approx(0.1)


def test_a_free_tip_away_from_its_contacts_keeps_the_tolerance():
    grazing = judged([0, 0.5, 2, 0.05, 2, 0.5, 0], [1, 0, 0, 0, 0, 0, 1])
    assert np.nanmax(grazing) == pytest.approx(0.05)
    passing = judged([0, 0.5, 2, 0.6, 2, 0.5, 0], [1, 0, 0, 0, 0, 0, 1])
    assert np.nanmax(passing) == pytest.approx(-0.6)


def test_a_free_tip_that_never_gets_clear_is_in_contact():
    assert np.nanmax(judged([0, 0, 0.05, 0.05, 0, 0], [1, 0, 0, 0, 0, 1])) > 0
    assert np.nanmax(judged([0, 0.02, 0.03], [1, 0, 0])) > 0
    assert np.nanmax(judged([0.0, 0.0], [0, 0])) > 0


def ball_on_plane(distance, turn, n=200, r=0.01, digit=1):
    """A tip of radius r whose centre moves along x over the object's plane z = 0 and turns about y; W is O."""
    s = np.linspace(0, 1, n)
    X = np.tile(np.eye(4), (n, 1, 1, 1))
    X[:, 0, :3, :3] = Rotation.from_rotvec(turn * s[:, None] * [0, 1, 0]).as_matrix()
    X[:, 0, 0, 3], X[:, 0, 2, 3] = distance * s, r
    up = np.tile([0.0, 0, 1], (n, 1, 1))
    zero = np.zeros((n, 1))
    states = States(
        t=s,
        part=np.zeros(n, dtype=int),
        q=zero,
        v=zero,
        a=zero,
        q_offset=zero,
        X_WO=np.tile(np.eye(4), (n, 1, 1)),
        V_WO=np.zeros((n, 6)),
        A_WO=np.zeros((n, 6)),
        p_OP=np.zeros((n, 1, 3)),
        f_W=np.zeros((n, 1, 3)),
    )
    return Observed(
        states=states,
        digits=np.full((n, 1), digit),
        X_WC=X,
        p_OC=X[:, :, :3, 3].copy(),
        gap=np.zeros((n, 1)),
        n_O=up,
        p_OS=X[:, :, :3, 3] - r * up,
        bend=zero,
        nearest=[(1.0, 0, "")],
        apart=[1.0],
        between=(0.0, 0, ""),
        travel=np.zeros((n, 2)),
        J_WS=np.zeros((n, 1, 3, 1)),
        torque=zero,
        weight=zero,
    )


@pytest.mark.parametrize(("distance", "turn"), [(0.012, 1.2), (0.012, 0.0), (0.0, 1.2), (0.012, -1.2)])
def test_slip_is_the_way_not_accounted_for_by_rolling(distance, turn):
    slip = rolling_slip(ball_on_plane(distance, turn))
    assert slip[-1, 0] == pytest.approx(abs(distance - 0.01 * turn), abs=1e-7)


def test_slip_counts_back_and_forth_and_starts_anew_with_every_contact():
    seen = ball_on_plane(0.01, 0.0)
    there = np.concatenate([np.linspace(0, 0.005, 100), np.linspace(0.005, 0, 100)])
    seen.p_OC[:, 0, 0] = seen.p_OS[:, 0, 0] = there
    assert rolling_slip(seen)[-1, 0] == pytest.approx(0.01, rel=1e-2)
    assert pivot_slip(seen)[:, 0].max() == pytest.approx(0.005)
    seen.digits[100] = 0
    slip = rolling_slip(seen)[:, 0]
    assert np.isnan(slip[100])
    assert slip[101] == 0
    assert np.nanmax(slip) == pytest.approx(0.005, rel=2e-2)


def test_sliding_velocity_is_that_of_the_tips_surface():
    v = sliding_velocity(ball_on_plane(0.012, 0.5, digit=2))
    assert np.allclose(v[:-1, 0], [0.012 - 0.005, 0, 0], atol=1e-6)
    assert not np.any(sliding_velocity(ball_on_plane(0.012, 0.5)))
