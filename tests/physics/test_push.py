"""A push in a run: as hard and as long as asked, in both engines, and felt by what is held."""

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from drake_hand import cli
from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.engine import Perturbation, PushForce
from drake_hand.physics.replay import replay
from drake_hand.physics.runs import simulate
from drake_hand.physics.simulation import DrakeSimulation
from drake_hand.plans.holds import hold_windows
from tests.feedback.test_correction import certified
from tests.verify.held import held_plan

HAND, CUBE = Hand.load("kanguera"), Object.load("cube").with_mass(0.1)
FORCE = np.array([0.3, -0.2, 0.1])


def drake(**setting):
    return DrakeSimulation(HAND, CUBE, **setting)


def in_mujoco(**setting):
    pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    from drake_hand.physics.mujoco_simulation import MujocoSimulation

    return MujocoSimulation(HAND, CUBE, pad_stiffness=np.full(5, 3000.0), **setting)


@pytest.mark.parametrize("engine", [drake, in_mujoco])
def test_a_free_object_is_accelerated_while_it_is_pushed_and_then_flies_on(engine):
    X = np.eye(4)
    X[:3, 3] = [0.5, 0, 0]
    still = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], np.column_stack([HAND.q_home] * 2))
    physics = engine(commands=still, X_WO=X, gravity=np.zeros(3), friction=0.8)
    physics.let_go()
    physics.push(FORCE)
    physics.advance(0.1)
    physics.push(np.zeros(3))
    physics.advance(0.2)
    flown = FORCE / 0.1 * (0.1**2 / 2 + 0.1 * 0.1)
    np.testing.assert_allclose(physics.X_WO[:3, 3] - X[:3, 3], flown, rtol=0.02)
    np.testing.assert_allclose(physics.X_WO[:3, :3], np.eye(3), atol=1e-9)


def test_its_impulse_is_that_asked_for_however_it_falls_between_samples():
    seen = set()
    for seed in range(20):
        change = Perturbation().pushed(PushForce(push_n=2.0, push_ms=7.0), (1.0, 4.0), np.random.default_rng(seed))
        assert np.linalg.norm(change.push_n) == pytest.approx(2.0)
        assert 2.0 <= change.push_s[0] <= 3.0
        times = np.arange(0.0, 5.0, 5e-3)
        impulse = sum(change.push_during(t, t + 5e-3) * 5e-3 for t in times)
        np.testing.assert_allclose(impulse, np.array(change.push_n) * 7e-3, rtol=1e-9)
        seen.add(change.push_n)
    assert len(seen) == 20


def test_what_is_held_gives_way_and_comes_back():
    pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    plan = certified(held_plan(end=3.0))
    (run,) = simulate(plan, engine="mujoco", push=PushForce(push_n=1.0, push_ms=50.0)).runs
    begin, end = run.perturbation.push_s
    ((free, until),) = hold_windows(plan)
    assert free < begin < end < until
    again, record = replay(plan, run.perturbation, engine="mujoco")
    assert again.position_error_mm == run.position_error_mm
    off = np.linalg.norm(record.X_WO[:, :3, 3] - record.X_WO[0, :3, 3], axis=1) * 1e3
    during = off[(record.t > begin) & (record.t < end + 0.05)].max()
    assert during > 0.1 + off[record.t < begin].max()
    assert not run.dropped
    assert off[-1] < during / 2


def test_a_push_of_no_size_is_refused(capsys):
    with pytest.raises(InputError, match="push_ms"):
        PushForce(push_ms=0.0)
    assert cli.run(["simulate", "spin.plan.json", "--push-n", "-1"]) == 2
    assert "push_n" in capsys.readouterr().err
