import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_hand.epos.sim.motion import CyclicMotion, Demand, Profile, Ramp
from drake_hand.epos.sim.motor import COAST_S, LAG_S, MAX_ACCELERATION_RAD_S2, Motor

H = 1e-3


def run(generator, demand, steps):
    rows = []
    for _ in range(steps):
        generator.step(demand, H)
        rows.append((demand.position, demand.velocity))
        if isinstance(generator, Profile) and generator.done:
            break
    return np.array(rows)


@settings(deadline=None, max_examples=50)
@given(st.floats(-3000, 3000), st.floats(100, 5000), st.floats(1000, 50000), st.floats(1000, 50000))
def test_profile_arrives_at_rest_within_its_limits(target, speed, acceleration, deceleration):
    demand = Demand(0.0)
    profile = Profile(target, speed=speed, acceleration=acceleration, deceleration=deceleration)
    rows = run(profile, demand, 40_000)
    assert profile.done
    assert demand.position == target
    assert demand.velocity == 0.0
    assert np.abs(rows[:, 1]).max() <= speed + 1e-9
    # the last two steps land on the target
    steps = np.abs(np.diff(rows[:, 1], prepend=0.0))
    assert steps.max() <= 3 * max(acceleration, deceleration) * H
    assert np.abs(rows[:, 0]).max() <= abs(target) + 1


def test_ramp_takes_the_distance_of_the_text_book():
    demand = Demand(10.0, 2000.0)
    ramp = Ramp(10_000.0)
    rows = run(ramp, demand, 199)
    assert not ramp.done
    run(ramp, demand, 2)
    assert ramp.done
    assert demand.position == pytest.approx(10 + 2000**2 / (2 * 10_000), rel=1e-3)
    assert np.all(np.diff(rows[:, 1]) < 0)


def test_cyclic_targets_make_a_straight_line_when_the_period_fits():
    demand, cyclic = Demand(), CyclicMotion()
    rows = []
    for k in range(1, 20):
        cyclic.aim(10.0 * k, demand, 0.01)
        rows.append(run(cyclic, demand, 10))
    assert np.concatenate(rows)[:, 1] == pytest.approx(1000.0)
    run(cyclic, demand, 2)
    assert (demand.position, demand.velocity, cyclic.done) == (190.0, 0.0, True)


def test_a_target_is_reached_exactly_whatever_the_step():
    demand, cyclic = Demand(), CyclicMotion()
    cyclic.aim(10.0, demand, 0.01)
    for _ in range(5):
        cyclic.step(demand, 0.003)
    assert demand.position == pytest.approx(10.0)


def test_a_wrong_interpolation_time_shakes_the_axis():
    demand, cyclic = Demand(), CyclicMotion()
    cyclic.aim(10.0, demand, 0.001)
    rows = run(cyclic, demand, 10)
    assert rows[0, 1] == pytest.approx(10_000.0)
    assert (rows[1:, 1] == 0).all()


def test_motor_trails_a_steady_demand_by_its_lag():
    motor, demand, v = Motor(64), Demand(0.0, 500.0), 500.0
    for _ in range(500):
        demand.position += v * H
        motor.step(demand, H, True)
    assert demand.position - motor.position == pytest.approx(v * LAG_S, rel=0.01)


def test_motor_keeps_its_torque_limit_and_coasts_without_power():
    motor = Motor(64)
    motor.step(Demand(1e6), H, True)
    assert motor.velocity == pytest.approx(MAX_ACCELERATION_RAD_S2 * 64 / (2 * np.pi) * H)
    assert 0 < motor.current_ma < 1000
    before = motor.velocity
    for _ in range(round(COAST_S / H)):
        motor.step(Demand(), H, False)
    assert motor.velocity == pytest.approx(before / np.e, rel=0.05)


def test_stuck_and_slipping_motors():
    motor = Motor(64)
    motor.stuck = True
    motor.step(Demand(100.0), H, True)
    assert motor.position == 0.0
    assert motor.current_ma > 0
    motor.stuck, motor.slip = False, 200.0
    for _ in range(100):
        motor.step(Demand(0.0), H, True)
    assert motor.position == pytest.approx(20.0)
