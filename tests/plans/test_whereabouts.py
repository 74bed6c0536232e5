"""Where in a plan a hand is, by its posture alone, though gaits come by the same posture again and again."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "epos"))
from swing import swing

from drake_hand.plans.trajectory import Trajectory
from drake_hand.plans.whereabouts import Whereabouts

JOINTS = ["a", "b", "c"]
PLAN = swing(JOINTS, 6.0, swings=3)


def test_it_follows_a_plan_that_repeats_itself_pauses_and_all():
    where, trajectory = Whereabouts(PLAN, ["c", "a"]), Trajectory(PLAN)
    assert (where.time_s, where.words) == (None, "not on the plan")
    for t in [*np.arange(0.3, 3.0, 0.05), *[3.0] * 20, *np.arange(3.0, 5.9, 0.05)]:
        where.look(trajectory.at(t).q_command[0][[2, 0]])
    assert where.time_s == pytest.approx(5.85, abs=0.06)
    assert where.words == "5.8 of 6.0 s, part 0 (0)" or where.words.startswith("5.9 of 6.0 s")
    assert pytest.approx(np.eye(4)) == where.X_WO


def test_what_is_not_of_the_plan_changes_nothing():
    where = Whereabouts(PLAN, JOINTS)
    for q in (np.full(3, 2.0), np.array([np.nan, 0.0, 0.0])):
        where.look(q)
        assert where.time_s is None
