"""Back from a stop in mid-plan: by a way from where the hand is, or with a refusal that says what would fall."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from drake_hand.cli import run
from drake_hand.cli.drives_way import way
from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.process import spawn_simulated_drives
from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.collision import Clearance
from drake_hand.planning.way_home import HeldObject, find_way
from drake_hand.plans.holds import may_hold
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Physics, Support, Task
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.way import certify_way

KANGUERA, HAND = Drives.load(), Hand.load()


@pytest.fixture(scope="module")
def plan(tmp_path_factory, carry) -> Path:
    file = tmp_path_factory.mktemp("plans") / "carry.plan.json"
    carry.save(file)
    return file


@pytest.fixture(scope="module")
def trajectory(carry) -> Trajectory:
    return Trajectory(carry)


@pytest.fixture(scope="module")
def start(trajectory) -> np.ndarray:
    """(nq,) in mid-plan, rad."""
    return trajectory.at(trajectory.plan.duration / 2).q[0]


@pytest.fixture(scope="module")
def found(start) -> Plan:
    """The way home from there."""
    return way("kanguera", HAND.joints, start)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(HAND, Object.load("sphere"))


def test_the_posture_tells_whether_the_fingers_may_hold_the_object(trajectory):
    plan, noise = trajectory.plan, np.radians(1.0) * np.random.default_rng(0).uniform(-1, 1, 15)
    middle = trajectory.at(plan.duration / 2)
    for q in (middle.q[0], middle.q_command[0]):
        assert may_hold(plan, plan.joints, q + noise) is not None
    assert may_hold(plan, plan.joints, trajectory.at(0.0).q[0]) is None
    assert may_hold(plan, plan.joints, HAND.q_home) is None


def test_a_way_is_proved_by_code_of_its_own(found, scene, start):
    """Other ends than asked for, a finger through its neighbour, a joint out of bounds or too fast: each is found."""
    assert certify_way(found, scene, start, HAND.q_home).certified

    beyond = HAND.q_home.copy()
    beyond[1] = HAND.q_lower[1] - 0.003  # two counts, on the way back
    assert certify_way(way("kanguera", HAND.joints, beyond), scene, beyond, HAND.q_home).certified

    def failures(plan, q=start, goal=HAND.q_home):
        return " ".join(certify_way(plan, scene, q, goal).failures)

    assert "start_deg" in failures(found, q=start + 0.01)
    assert "goal_deg" in failures(found, goal=HAND.q_home + 0.01)
    part = found.parts[0]
    stretched = np.array(part.t) / 4
    fast = msgspec.structs.replace(part, t=stretched.tolist(), v=(4 * np.array(part.v)).tolist())
    assert "speed_ratio" in failures(msgspec.structs.replace(found, parts=[fast]))
    crossed = np.array(part.q)
    middle = len(crossed) // 2
    crossed[middle, HAND.joints.index("index_abduction")] = HAND.q_lower[HAND.joints.index("index_abduction")]
    crossed[middle, HAND.joints.index("middle_abduction")] = HAND.q_upper[HAND.joints.index("middle_abduction")]
    assert "penetration_mm" in failures(
        msgspec.structs.replace(found, parts=[msgspec.structs.replace(part, q=crossed.tolist())])
    )
    crossed[middle] = HAND.q_upper + 0.1
    assert "limit_margin_rad" in failures(
        msgspec.structs.replace(found, parts=[msgspec.structs.replace(part, q=crossed.tolist())])
    )


def test_a_way_keeps_off_the_table(found, scene, start):
    def beside(plane_mm: float) -> Task:
        down = Physics(gravity=(9.81, 0.0, 0.0))
        return msgspec.structs.replace(found.task, physics=down, support=Support(plane_mm=plane_mm))

    def over(plane_mm: float) -> Plan:
        return msgspec.structs.replace(found, task=beside(plane_mm))

    assert certify_way(over(-150.0), scene, start, HAND.q_home).certified
    (failure,) = certify_way(over(-20.0), scene, start, HAND.q_home).failures
    assert "and table" in failure
    assert find_way(scene, beside(-150.0), start, HAND.q_home, None).legs
    with pytest.raises(NoPlanFound, match="from the palm or the table"):
        find_way(scene, beside(-20.0), start, HAND.q_home, None)


@pytest.fixture(scope="module")
def pencil(trajectory) -> tuple[Scene, Clearance]:
    both = Scene(HAND, Object.load(trajectory.plan.task.object))
    return both, Clearance(both)


def held_in(trajectory) -> tuple[HeldObject, np.ndarray]:
    """What the fingers hold in mid-plan, and where they are commanded to: inside it."""
    then = trajectory.at(trajectory.plan.duration / 2)
    return HeldObject(q=then.q[0], X_WO=then.X_WO[0], p_OP=then.p_OP[0]), then.q_command[0]


def gaps(c: Clearance, held: HeldObject, path) -> np.ndarray:
    """(fingers, n) of each finger, its tip too, from the object where it was held, along a path."""
    q = np.concatenate([leg.q for leg in path.legs])
    return np.array(
        [c.to_object(i, c.centres(i, q[:, f.columns]), held.X_WO, tip=True) for i, f in enumerate(HAND.fingers)]
    )


def test_fingers_that_hold_something_leave_it_and_go_around_it(trajectory, pencil):
    """Straight back, all at once, they would take it along: its fingers of both sides go on pressing."""
    (both, c), (held, q) = pencil, held_in(trajectory)
    goal, task = trajectory.at(0.0).q_command[0], trajectory.plan.task
    away = [gaps(c, held, find_way(both, task, q, goal, None, some)) for some in (None, held)]
    holding = np.flatnonzero(np.isfinite(held.p_OP).all(axis=1))
    assert len(holding) == 3
    pressed = away[0][:, 0].min()
    assert away[0].min() < pressed - 2e-3, "through where it is"
    assert away[1].min() > pressed - 1e-6
    off = [np.flatnonzero(away[1][i] < 0)[-1] for i in holding]  # the last knot at which it presses
    assert np.diff(sorted(off)).min() > 5, "one after the other"
    found = find_way(both, task, q, goal, None, held)
    np.testing.assert_array_equal(found.legs[0].q[0], q)
    np.testing.assert_allclose(found.legs[-1].q[-1], goal, atol=1e-12)


def test_opened_for_a_person_the_hand_goes_home_from_its_hold(trajectory, plan):
    q = held_in(trajectory)[1]
    found = way("kanguera", HAND.joints, q, plan=plan, held_s=trajectory.plan.duration / 2)
    np.testing.assert_allclose(found.parts[-1].q[-1], HAND.q_home, atol=1e-9)
    moved = np.abs(np.array(found.parts[0].q)[5] - q) > np.radians(0.1)
    assert [f.name for f in HAND.fingers if moved[f.columns].any()] == ["middle"]


def test_fingers_that_cannot_get_around_it_rise_off_it_all_at_once(trajectory, pencil):
    """To where they are closed a little farther than now, which is where the object is."""
    (both, c), (held, q) = pencil, held_in(trajectory)
    flexions = [HAND.joints.index(f"{f.name}_flexion") for f in HAND.fingers if f.name != "thumb"]
    goal = q.copy()
    goal[flexions] += np.radians(4.0)
    found = find_way(both, trajectory.plan.task, q, goal, None, held)
    first = gaps(c, held, found)[:, len(found.legs[0].q) - 1]
    assert (first[np.isfinite(held.p_OP).all(axis=1)] > 2e-3).all()
    np.testing.assert_allclose(found.legs[-1].q[-1], goal, atol=1e-12)


def test_where_the_object_stands_in_the_way_there_is_none(plan, start):
    with pytest.raises(NoPlanFound, match="from the object"):
        way("kanguera", HAND.joints, start, plan=plan, to_start=True, object_there=True)


@pytest.mark.clocked
def test_from_mid_plan_home_and_back_to_its_start(plan, trajectory, capsys):
    stopped = trajectory.at(trajectory.plan.duration / 2).q_command[0][KANGUERA.columns(HAND.joints)]

    def answer(*tokens):
        status = run([*tokens, "--drives", "kanguera", "--yes", "--json", *bus])
        return status, json.loads(capsys.readouterr().out)

    def where():
        assert run(["drives", "status", "--drives", "kanguera", "--json", *bus]) == 0
        return np.array([d["position_deg"] for d in json.loads(capsys.readouterr().out)["drives"]])

    with spawn_simulated_drives(KANGUERA, q=stopped) as spawned:
        bus = ["--interface", spawned.interface, "--channel", spawned.channel]
        status, found = answer("execute", str(plan), "--from-here", "--trust")  # proved again elsewhere
        assert (status, found["ok"], found["disabled"]) == (1, False, True)
        assert "--open lets it fall" in found["problems"][0]
        status, found = answer("drives", "home")
        assert (status, found["ok"], found["drives"], found["disabled"]) == (0, True, 15, True)
        assert where() == pytest.approx(np.degrees(HAND.q_home), abs=0.5)
        status, found = answer("drives", "goto", str(plan))
        assert (status, found["ok"], found["disabled"]) == (0, True, True)
        assert where() == pytest.approx(np.degrees(trajectory.at(0.0).q_command[0]), abs=0.5)
