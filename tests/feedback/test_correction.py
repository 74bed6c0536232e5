"""The correction in a world that obeys it: the object goes where contacts that roll take it, and nowhere else."""

from time import process_time

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.errors import InputError
from drake_hand.feedback import correction as module
from drake_hand.feedback.correction import TWIST_LIMIT, Correction
from drake_hand.feedback.pose import PoseSeen
from drake_hand.feedback.sensor import PoseSensor, SimulatedSensor
from drake_hand.feedback.tube import Tube
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.plans.plan import Certificate, Worst
from drake_hand.plans.trajectory import Trajectory
from tests.verify.held import RAMP, held_plan

HAND, PENCIL = Hand.load("kanguera"), Object.load("pencil_r8")
TICK = 0.01
EXACT = PoseSensor(noise_mm=0.0, noise_deg=0.0, dropout=0.0)
ASIDE = np.array([0.0, 0.0, 0.0, 0.6e-3, -0.4e-3, 0.5e-3])


def certified(plan, apart_mm=4.0):
    apart = [apart_mm] * len(plan.parts)
    stamp = Certificate(certified=True, samples=0, worst={}, failures=[], plan_hash=plan.hash, apart_mm=apart).sealed()
    return msgspec.structs.replace(plan, certificate=stamp)


@pytest.fixture(scope="module")
def plan():
    return certified(held_plan(end=4.0))


def carried(plan, by_m, start=1.0):
    """The same plan with the object, not the fingers, moved along x, from `start` s on."""
    (part,) = plan.parts
    t = [*part.t[:-1], start, part.t[-1]]
    X = [list(part.X_WO[0]) for _ in t]
    X[-1][4] += by_m
    V = [[0.0] * 7 for _ in t]
    rate = by_m / (t[-1] - start)
    V[-1][4] = V[-2][4] = rate
    rows = {k: [*getattr(part, k)[:-1], getattr(part, k)[-1], getattr(part, k)[-1]] for k in ("q", "v", "q_offset")}
    contacts = {
        n: msgspec.structs.replace(c, p_OP=[*c.p_OP, c.p_OP[-1]], f_W=[*c.f_W, c.f_W[-1]])
        for n, c in part.contacts.items()
    }
    moved = msgspec.structs.replace(part, t=t, X_WO=X, V_WO=V, contacts=contacts, **rows)
    return certified(msgspec.structs.replace(plan, parts=[moved], certificate=None))


def play(
    plan,
    error,
    *,
    sensor=EXACT,
    drift=None,
    stamp=lambda seen, t: seen,
    until=4.0,
    watch=None,
    object_=PENCIL,
    told=None,
):
    """Plays a plan in a world where the object is off by a twist that only the fingers can change.

    Returns:
        The correction, and the error (k, 6) at every tick.
    """
    correction = Correction(plan, HAND, object_, told)
    trajectory, eyes = Trajectory(plan), SimulatedSensor(sensor, 1)
    follow, dq, errors = correction._follow, np.zeros(HAND.nq), []
    error = np.array(error, dtype=float)
    times = np.arange(0.0, until, TICK)
    for t, X_WO in zip(times, trajectory.at(times).X_WO, strict=True):
        X = X_WO.copy()
        row = correction._row(t)
        X[:3, :3] = Rotation.from_rotvec(error[:3]).as_matrix() @ X[:3, :3]
        X[:3, 3] = follow.p_WM[row] + error[3:] - X[:3, :3] @ correction._p_OM
        eyes.observe(t, X)
        seen = eyes.poll(t)
        now = correction.step(t, None if seen is None else stamp(seen, t))
        if t > RAMP:
            error = error + np.linalg.lstsq(follow.roll[row], now - dq, rcond=None)[0]
            error += 0.0 if drift is None else np.asarray(drift) * TICK
        if watch:
            watch(t, now - dq)
        dq = now
        errors.append(error)
    return correction, np.array(errors)


@pytest.fixture
def sure(monkeypatch):
    """Every error is taken for real, as these sensors without noise deserve."""
    monkeypatch.setattr(module, "UNSURE_RAD", 0.0)
    monkeypatch.setattr(module, "UNSURE_M", 0.0)


def test_fingers_follow_the_noise_of_a_sensor_less_if_it_is_told():
    noisy, plan = PoseSensor(noise_mm=2.0, noise_deg=4.0), certified(held_plan())
    moved = [play(plan, np.zeros(6), sensor=noisy, told=told)[0].report.largest_mm for told in (None, noisy)]
    assert moved[1] < 0.75 * moved[0]
    X_WO = Trajectory(plan).at(0.0).X_WO[0].copy()
    X_WO[0, 3] += 2e-3
    believed = []
    for told in (None, noisy):
        correction = Correction(plan, HAND, PENCIL, told)
        for t in (0.0, TICK):
            correction.step(t, PoseSeen(t=t, X_WO=X_WO))
        believed.append(np.linalg.norm(correction.error[3:]))
    assert believed[1] < 0.6 * believed[0]


def test_the_object_is_brought_back_where_it_should_be(plan, sure):
    correction, errors = play(plan, ASIDE + np.array([0.01, 0.02, -0.015, 0, 0, 0]))
    assert np.linalg.norm(errors[-1, 3:]) < 0.02e-3
    assert np.degrees(np.linalg.norm(errors[-1, :3])) < 0.05
    assert correction.report.saturated_s == 0
    assert correction.report.looks > 100


def test_with_the_wrong_sign_it_is_not(plan, monkeypatch):
    monkeypatch.setattr(module, "CORRECTION_RATE_PER_S", -module.CORRECTION_RATE_PER_S)
    _, errors = play(plan, ASIDE, until=3.0)
    assert np.linalg.norm(errors[-1, 3:]) > 1.3 * np.linalg.norm(ASIDE)


def test_an_error_is_brought_back_to_what_may_be_noise(plan):
    _, errors = play(plan, ASIDE + np.array([0.01, 0.02, -0.015, 0, 0, 0]))
    assert np.linalg.norm(errors[-1, 3:]) == pytest.approx(module.UNSURE_M, abs=0.02e-3)
    assert np.linalg.norm(errors[-1, :3]) == pytest.approx(module.UNSURE_RAD, abs=np.radians(0.05))


def test_what_is_left_at_the_end_is_brought_back_after_it(plan, sure):
    """The object slips just before the end: the fingers hold it there, and have a second."""
    correction = Correction(plan, HAND, PENCIL)
    late = play(plan, ASIDE, until=4.0, stamp=lambda seen, t: seen if t > 3.9 else None)[1]
    after = play(plan, ASIDE, until=4.0 + correction.linger_s, stamp=lambda seen, t: seen if t > 3.9 else None)[1]
    assert np.linalg.norm(late[-1, 3:]) > 0.6e-3
    assert np.linalg.norm(after[-1, 3:]) < 0.2e-3


def test_a_hand_that_has_let_go_has_nothing_to_bring_back(plan):
    (part,) = plan.parts
    rest = {k: [getattr(part, k)[-1]] * 2 for k in ("q", "v", "X_WO", "V_WO", "q_offset")}
    open_ = msgspec.structs.replace(part, mode="00000", events=[], t=[4.0, 4.5], contacts={}, **rest)
    let_go = certified(msgspec.structs.replace(plan, parts=[part, open_], certificate=None))
    assert Correction(let_go, HAND, PENCIL).linger_s == 0
    assert Correction(plan, HAND, PENCIL).linger_s > 0


def test_noise_is_not_passed_on(plan):
    _, errors = play(plan, np.zeros(6), sensor=PoseSensor())
    late = errors[len(errors) // 2 :]
    assert np.std(late[:, 3:], axis=0).max() < 0.03e-3
    assert np.degrees(np.std(late[:, :3], axis=0).max()) < 0.1


def test_a_look_is_compared_with_the_plan_when_it_was_taken(plan, sure):
    """An object carried at 5 mm/s, seen 100 ms late: taken for new, a look is wrong by half a millimetre."""
    late = PoseSensor(noise_mm=0.0, noise_deg=0.0, dropout=0.0, latency_ms=100.0)
    moving = carried(plan, 0.015)
    _, right = play(moving, np.zeros(6), sensor=late)
    _, wrong = play(moving, np.zeros(6), sensor=late, stamp=lambda seen, t: PoseSeen(t=t, X_WO=seen.X_WO))
    assert np.linalg.norm(right[-1, 3:]) < 0.02e-3
    assert np.linalg.norm(wrong[-1, 3:]) > 0.3e-3


def test_dropouts_are_borne_and_a_lost_sensor_leads_back_to_the_plan_smoothly(plan, sure):
    _, few = play(plan, ASIDE, sensor=PoseSensor(noise_mm=0.0, noise_deg=0.0, dropout=0.8))
    assert np.linalg.norm(few[-1, 3:]) < 0.1e-3
    steps = []
    correction, blind = play(
        plan, ASIDE, stamp=lambda seen, t: seen if t < 0.6 else None, watch=lambda t, dq: steps.append(np.abs(dq).max())
    )
    assert correction.report.lost_s > 2
    assert np.linalg.norm(blind[-1, 3:]) > 0.1e-3, "it cannot know"
    assert np.abs(blind[-1] - blind[-200]).max() < 1e-6, "and does nothing then"
    assert np.abs(np.diff(steps)).max() < np.radians(0.05)


def test_without_a_sensor_nothing_is_added(plan):
    correction = Correction(plan, HAND, PENCIL)
    assert not any(correction.step(t, None).any() for t in np.arange(0, 2, 0.01))


def test_it_stays_within_the_tube_and_says_so(plan):
    tight = certified(held_plan(end=4.0), apart_mm=0.2)
    reached = []
    correction, errors = play(tight, 3 * ASIDE)
    assert correction.report.largest_mm <= 0.2 + 1e-6
    assert correction.report.saturated_s > 1
    assert np.linalg.norm(errors[-1, 3:]) > 1e-3
    follow = correction._follow
    play(plan, ASIDE * 20, watch=lambda t, dq: reached.append((t, dq)))
    for t, dq in reached:
        assert np.all(np.abs(dq) <= HAND.speed * TICK + 1e-9)
        if t > RAMP:
            moved = np.linalg.lstsq(follow.roll[correction._row(t)], dq, rcond=None)[0] / TICK
            assert np.all(np.abs(moved) <= TWIST_LIMIT * 1.05)


def test_the_tube_is_as_wide_as_bodies_are_apart_until_a_finger_has_let_go(plan):
    (part,) = plan.parts
    after = [t + part.t[-1] for t in part.t]
    held = {name: contact for name, contact in part.contacts.items() if name != "ring"}
    later = msgspec.structs.replace(part, t=after, mode="00111", contacts=held)
    both = msgspec.structs.replace(plan, parts=[part, later])

    def stamped(**found):
        proof = Certificate(certified=True, samples=0, failures=[], plan_hash=both.hash, **found)
        return msgspec.structs.replace(both, certificate=proof.sealed())

    assert (part.mode, plan.fingers[1]) == ("01111", "ring"), "the finger that lets go between the parts"
    narrows = Tube.of(stamped(worst={}, apart_mm=[4.0, 1.0]), HAND).reach
    assert narrows == pytest.approx(0.45e-3 * np.ones((2, 5))), "what is moved now stays so"
    widens = Tube.of(stamped(worst={}, apart_mm=[1.0, 4.0]), HAND).reach
    assert widens[1] == pytest.approx(0.45e-3 * np.array([1.0, 4.0, 1.0, 1.0, 1.0]))
    older = stamped(worst={"penetration_mm": Worst(value=-2.0, limit=0.0, ok=True)})
    assert older.certified
    assert "apart_mm" not in msgspec.json.encode(older).decode()
    assert Tube.of(older, HAND).reach == pytest.approx(0.9e-3 * np.ones((2, 5)))


def test_what_cannot_be_seen_is_left_alone(plan, tmp_path):
    """A pencil without stripes: the sensor makes up a turn about its axis, which nobody could have seen."""
    bare = tmp_path / "bare.urdf"
    text = PENCIL.file.read_text()
    bare.write_text(text[: text.index("<visual>")] + "</link></robot>")
    plain = Object.load(bare)
    axis = Trajectory(plan).at(0.0).X_WO[0, :3, 2]
    about = np.append(0.1 * axis, np.zeros(3))
    _, left = play(plan, about, object_=plain)
    np.testing.assert_allclose(left[-1] @ about / 0.01, 1.0, atol=0.02)
    _, seen = play(plan, about)
    assert abs(seen[-1] @ about / 0.01) < 0.1


def test_the_same_looks_give_the_same_correction(plan):
    (_, first), (_, again) = (play(plan, ASIDE, sensor=PoseSensor(), until=1.0) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_only_certified_plans_are_corrected():
    with pytest.raises(InputError, match="certified"):
        Correction(held_plan(), HAND, PENCIL)


def test_a_tick_costs_less_than_a_third_of_a_millisecond(plan):
    correction = Correction(plan, HAND, PENCIL)
    X = Trajectory(plan).at(0.0).X_WO[0]
    costs = []
    for block in range(10):
        began = process_time()
        for k in range(100):
            t = (100 * block + k) * TICK
            correction.step(t, None if k % 3 else PoseSeen(t=t - 0.03, X_WO=X))
        costs.append((process_time() - began) / 100)
    assert min(costs) < 0.3e-3
