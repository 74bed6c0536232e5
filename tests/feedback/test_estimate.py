"""What moves an object, told apart from looks alone: errors, drift per planned turn, lag, noise."""

import numpy as np
import pytest

from drake_hand.feedback.estimate import Estimate

TICK, LOOK_TICKS, LATE_TICKS = 0.01, 3, 3
AXIS = np.array([0.0, 0.6, 0.8])
NOISE = np.repeat([np.radians(1.0), 0.5e-3], 3)


def turn(*, drift=0.0, lag_s=0.0, off_rad=0.0, speed=8.0, noise=1.0, seconds=6.0, told_speed=1.0, told_noise=1.0):
    """Strokes of 0.2 s with rests of 0.3 s between them, seen with noise of 1 deg, late.

    Returns:
        The estimate; its errors beside the true ones (k, 2, 6), rad and m.
    """
    rng, estimate = np.random.default_rng(3), Estimate(told_noise * NOISE)
    error, seen, both, thoughts, rates = np.append(off_rad * AXIS, np.zeros(3)), [], [], [], []
    for k in range(round(seconds / TICK)):
        w = AXIS * speed * (k % 50 < 20)
        error = error + np.append(drift * w * TICK, np.zeros(3))
        estimate.move(np.zeros(6), w * TICK * told_speed, TICK)
        thoughts.append(estimate.error.copy())
        rates.append(w)
        there = error - np.append(lag_s * w, np.zeros(3))
        seen.append(there + noise * rng.normal(size=6) * NOISE)
        if k % LOOK_TICKS == 0 and k >= LATE_TICKS:
            at = k - LATE_TICKS
            change = estimate.look(seen[at], thoughts[at], rates[at] * told_speed)
            thoughts = [thought + change for thought in thoughts]
        both.append([estimate.error.copy(), error.copy()])
    return estimate, np.array(both)


def off_deg(both):
    return np.degrees(np.linalg.norm(both[:, 0, :3] - both[:, 1, :3], axis=1))


def test_drift_and_lag_are_told_apart():
    estimate, both = turn(drift=0.04, lag_s=0.008)
    assert estimate.drift == pytest.approx(0.04, abs=0.01)
    assert off_deg(both)[-200:].mean() < 0.7
    assert np.degrees(np.linalg.norm(both[-1, 1])) > 20


def test_an_object_that_only_lags_does_not_drift():
    estimate, both = turn(lag_s=0.012)
    assert abs(estimate.drift) < 0.01
    assert off_deg(both)[-200:].mean() < 0.7


def test_without_the_planned_turn_it_knows_neither():
    """What fails if the estimate ignores how the object turns."""
    _, both = turn(drift=0.04, lag_s=0.008, told_speed=0.0)
    assert off_deg(both)[-200:].mean() > 1.0


def test_the_first_look_is_believed_most_and_noise_is_averaged():
    estimate = Estimate(NOISE)
    change = estimate.look(np.array([0.1, 0, 0, 1e-3, 0, 0]), np.zeros(6), np.zeros(3))
    assert 0.08 < change[0] < 0.1
    assert 0.8e-3 < change[3] < 1e-3
    _, both = turn(off_rad=0.05, speed=0.0)
    late = off_deg(both)[-300:]
    assert np.sqrt(np.mean(late**2)) < 0.5, "of 1 deg about each axis"


def test_what_is_forgotten_is_the_error_and_not_why_there_was_one():
    estimate, _ = turn(drift=0.04)
    learnt = estimate.drift
    estimate.forget()
    assert not estimate.error.any()
    assert estimate.drift == learnt
    change = estimate.look(np.array([0.1, 0, 0, 0, 0, 0]), np.zeros(6), np.zeros(3))
    assert change[0] > 0.08


def test_a_noisy_sensor_is_believed_less_if_that_is_told():
    rms = {
        told: np.sqrt(np.mean(off_deg(turn(noise=5.0, seconds=12.0, told_noise=told)[1])[-600:] ** 2))
        for told in (1, 5)
    }
    assert rms[5] < 0.75 * rms[1]
