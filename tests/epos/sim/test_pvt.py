import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_hand.epos.objects import IP_DEPTH
from drake_hand.epos.sim.motion import Demand
from drake_hand.epos.sim.pvt import (
    ACCELERATION,
    ACCELERATION_WARNING,
    ACTIVE,
    ENABLED,
    OVERFLOW,
    OVERFLOW_WARNING,
    UNDERFLOW,
    UNDERFLOW_WARNING,
    VELOCITY,
    VELOCITY_WARNING,
    Limits,
    PvtQueue,
    PvtRecord,
    cubic,
    end_accelerations,
)

H = 1e-3
coefficients = st.lists(st.floats(-100, 100), min_size=4, max_size=4)


@given(coefficients, st.floats(0.01, 0.255), st.floats(0, 1))
def test_cubic_reproduces_any_cubic(c, T, s):
    p = np.polynomial.Polynomial(c)
    v, a = p.deriv(), p.deriv(2)
    start, end = PvtRecord(p(0), v(0), T), PvtRecord(p(T), v(T), 0.1)
    assert cubic(start, end, s * T) == pytest.approx((p(s * T), v(s * T)), abs=1e-6)
    assert end_accelerations(start, end) == pytest.approx((a(0), a(T)), abs=1e-4)


@pytest.fixture
def queue():
    q = PvtQueue()
    q.clear(enable=True)
    return q


def fill(queue, n, ms=10, last=False):
    for k in range(n):
        queue.push(PvtRecord(k, 100.0, 0.0 if last and k == n - 1 else ms * 1e-3))


def play(queue, demand, seconds):
    for _ in range(round(seconds / H)):
        queue.step(demand, H)


def test_plays_to_the_last_record_and_ends_without_error(queue):
    fill(queue, 10, last=True)
    queue.start()
    demand = Demand()
    play(queue, demand, 0.05)
    assert demand.position == pytest.approx(5.0)
    assert demand.velocity == pytest.approx(100.0)
    assert queue.used == 5
    play(queue, demand, 0.05)
    assert (demand.position, demand.velocity) == (9.0, 0.0)
    assert queue.done
    assert queue.status == ENABLED
    play(queue, demand, 0.05)
    assert not queue.failed


def test_running_dry_is_an_underflow(queue):
    fill(queue, 6)
    queue.start()
    assert queue.status == ENABLED | ACTIVE
    demand = Demand()
    play(queue, demand, 0.031)
    assert queue.status == ENABLED | ACTIVE | UNDERFLOW_WARNING
    play(queue, demand, 0.02)
    assert queue.status & UNDERFLOW
    assert demand.velocity == pytest.approx(100.0)


def test_starting_with_one_record_is_an_underflow(queue):
    fill(queue, 1)
    queue.start()
    assert queue.failed


def test_the_sixty_fifth_record_is_an_overflow(queue):
    fill(queue, 60)
    assert queue.status == ENABLED
    fill(queue, 4)
    assert queue.used == IP_DEPTH
    assert queue.status == ENABLED | OVERFLOW_WARNING
    fill(queue, 1)
    assert queue.used == IP_DEPTH
    assert queue.status & OVERFLOW
    queue.clear(enable=True)
    assert queue.status == ENABLED


def test_speed_and_acceleration_are_watched(queue):
    queue.limits = Limits(4, 60, 50.0, 150.0, 1000.0, 5000.0)
    queue.push(PvtRecord(0, 0, 0.1))
    assert queue.status == ENABLED
    queue.push(PvtRecord(4, 100, 0.1))
    # 0 to 100 counts/s over 4 counts in 0.1 s: 6 d - 4 v0 - 2 v1 over T, by hand
    assert queue.status == ENABLED | VELOCITY_WARNING | ACCELERATION_WARNING
    queue.push(PvtRecord(5, 200, 0.1))
    assert queue.status & VELOCITY
    assert queue.status & ACCELERATION


def test_takes_nothing_while_input_is_off():
    q = PvtQueue()
    fill(q, 3)
    assert q.used == 0
