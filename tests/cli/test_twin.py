"""The twin, told what the bus shows: the same where the drives press as it does, and who differs where they do not."""

import numpy as np
import pytest

from drake_hand import api
from drake_hand.cli.drives_twin import Twin
from drake_hand.contact.press import press
from drake_hand.epos.drives import Drives
from drake_hand.epos.mirror import HandPose
from drake_hand.model.object import Object
from drake_hand.model.table import feet
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.trajectory import Trajectory

DRIVES = Drives.load()
DT = 0.02


def said(plan, until_s: float, shares: dict[str, float]) -> tuple[Twin, list[str]]:
    """Plays into a twin what drives would show that press so much of what is planned, finger by finger."""
    twin, lines = Twin(plan, DRIVES), []
    columns = DRIVES.columns(plan.joints)
    t = np.arange(0.0, until_s, DT)
    q, torque = Trajectory(plan).at(t).q_command[:, columns], press(plan, twin.hand, t)
    for i, row in enumerate(q):
        share = np.array([shares.get(f.name, 1.0) for j in DRIVES.joints for f in twin.hand.fingers if j in f.joints])
        turns = torque.contact[i, columns] * share + torque.weight[i, columns]
        current = np.linalg.solve(DRIVES.torque_per_ma, turns)
        lines += twin.follow(HandPose(t=t[i], commanded=row, measured=row, current_ma=current))
    return twin, lines


def test_a_twin_that_hears_nothing_does_not_say_that_all_is_the_same(carry):
    twin = Twin(carry, DRIVES)
    assert list(twin.follow(HandPose(t=0.0, commanded=np.full(15, np.nan), measured=np.full(15, np.nan)))) == []
    assert twin.words == "listening: not all drives are heard yet"


def test_a_twin_of_a_hand_that_does_as_planned_has_nothing_to_say_to_the_end(carry):
    """Contacts that creep would let the fingers press half as much by then."""
    end = carry.duration - DT
    twin, lines = said(carry, end, {})
    assert lines == []
    assert "twin: the same" in twin.words
    assert np.linalg.norm(twin.X_WO[:3, 3] - Trajectory(carry).at(end).X_WO[0, :3, 3]) < 1e-3


def test_a_finger_that_does_not_press_is_named(carry):
    contacts = carry.parts[1].contacts
    finger = max(contacts, key=lambda f: np.linalg.norm(contacts[f].f_W, axis=1).max())
    _, lines = said(carry, 5.5, {finger: 0.0})
    assert len(lines) == 1
    assert lines[0].startswith(f"{finger}: the drives turn with ")
    assert "part 1" in lines[0]


@pytest.mark.slow
def test_a_twin_picks_the_object_up_from_its_table_and_puts_it_down():
    plan = api.plan("table_cube")
    twin, lines = said(plan, plan.duration, {})
    assert lines == []
    end = Trajectory(plan).at(plan.duration).X_WO[0]
    assert np.linalg.norm(twin.X_WO[:3, 3] - end[:3, 3]) < 2e-3
    assert plan.task.table.gap(feet(Object.load(plan.task.object).geometries), twin.X_WO) == pytest.approx(0, abs=2e-4)


def test_fingers_that_do_not_press_what_lies_on_a_table_are_told():
    """The drives show that nothing is pressed, while the twin's fingers lift."""
    plan = api.plan("table_cube")
    middle = np.mean(hold_windows(plan))
    _, lines = said(plan, middle, {f: 0.0 for f in plan.fingers})
    assert sum("the drives turn with" in line for line in lines) >= 2
