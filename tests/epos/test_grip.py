"""What the fingers press, judged by currents: as planned, lost, too hard, all gone, and not judged where little is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fault_trials import drives_of
from swing import swing

from drake_hand.epos.grip import GONE_S, LOST_S, Grip
from drake_hand.epos.schedule import Schedule

DRIVES = drives_of("epos2")
SCHEDULE = Schedule.build(swing(DRIVES.joints, 2.0), DRIVES)
FINGERS = {
    name: [j for j in DRIVES.joints if j.startswith(name)] for name in ("little", "ring", "middle", "index", "thumb")
}
BEGIN, STEPS = 60, len(SCHEDULE.counts)
T = SCHEDULE.period


def planned() -> np.ndarray:
    """(k, n) from a step on every finger presses, the thumb hardly."""
    torque = np.zeros((STEPS, 15))
    torque[BEGIN:] = 0.02 * np.sin(np.arange(1, 16))
    torque[:, 12:] *= 0.05
    return torque


WEIGHT = np.full((STEPS, 15), 0.006)


def grip(drives=DRIVES) -> Grip:
    schedule = replace(SCHEDULE, drives=drives)
    return Grip(schedule, FINGERS, contact=planned(), weight=WEIGHT, part=np.full(STEPS, 7))


def play(found: Grip, factor, drives=DRIVES, *, first=0) -> list[tuple[int, str]]:
    """Steps and what was said at them; currents show the factor (fingers,) of what is planned, from a step on."""
    said = []
    for j in range(STEPS):
        share = np.repeat(np.ones(5) if j < first else np.asarray(factor, float), 3)
        current = np.linalg.solve(drives.torque_per_ma, planned()[j] * share + WEIGHT[j])
        said += [(j, text) for text in found.look(j, [SimpleNamespace(current_ma=x) for x in current])]
    return said


@pytest.mark.parametrize("coupled", [False, True])
def test_as_planned_nothing_is_said(coupled):
    C = np.eye(15)
    C[2, 1], C[5, 4] = 0.5, -0.3
    drives = replace(DRIVES, coupling=C) if coupled else DRIVES
    found = grip(drives)
    assert play(found, np.ones(5), drives) == []
    assert found.shares == {n: pytest.approx(1.0) for n in ("little", "ring", "middle", "index")}


def test_a_finger_that_loses_its_contact_is_named_with_the_part():
    said = play(grip(), [1, 0, 1, 1, 1], first=100)
    assert said[0] == (100 + round(LOST_S / T) - 1, "ring lost contact in part 7")


def test_one_that_never_makes_it_too():
    said = play(grip(), [1, 1, 1, 0, 1])
    assert said[0][1] == "index lost contact in part 7"
    assert BEGIN < said[0][0] <= BEGIN + round((LOST_S + 0.15) / T)


def test_one_that_presses_much_too_hard():
    assert play(grip(), [4, 1, 1, 1, 1], first=100)[0][1] == "little presses 4.0 times as hard as planned in part 7"
    assert play(grip(), [2, 1, 1, 1, 1], first=100) == []


def test_when_all_let_go_the_object_is_gone():
    said = play(grip(), np.zeros(5), first=100)
    assert said[0] == (100 + round(GONE_S / T) - 1, "the object is gone: no finger presses in part 7")


def test_where_little_is_planned_nothing_is_judged():
    """The thumb's fifth of a millinewton metre is less than its links weigh."""
    found = grip()
    assert play(found, [1, 1, 1, 1, 0]) == []
    assert "thumb" not in found.shares


def test_a_moment_is_not_enough():
    found = grip()
    for j in range(STEPS):
        gone = 100 <= j < 100 + round(GONE_S / T) - 1
        current = np.linalg.solve(DRIVES.torque_per_ma, planned()[j] * (0 if gone else 1) + WEIGHT[j])
        assert list(found.look(j, [SimpleNamespace(current_ma=x) for x in current])) == []


def test_how_near_a_run_came_to_a_fault_is_kept():
    """Ten steps of a ring finger at a twentieth, then five of a little finger at four times its press."""
    found, nobody = grip(), np.ones(5)
    for j in range(STEPS):
        ring, hard = 100 <= j < 110, 120 <= j < 125
        factor = [1, 0.05, 1, 1, 1] if ring else [4, 1, 1, 1, 1] if hard else nobody
        current = np.linalg.solve(DRIVES.torque_per_ma, planned()[j] * np.repeat(factor, 3) + WEIGHT[j])
        assert list(found.look(j, [SimpleNamespace(current_ma=x) for x in current])) == []
    sizes = [np.linalg.norm(planned()[-1, 3 * f : 3 * f + 3]) for f in range(4)]
    assert found.worst.lost_s == pytest.approx(10 * T)
    assert found.worst.hard_s == pytest.approx(5 * T)
    assert found.worst.together == pytest.approx(1 - 0.95 * sizes[1] / sum(sizes))
    assert grip().worst.together == 1.0
