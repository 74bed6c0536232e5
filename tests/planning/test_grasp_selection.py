"""First grasps: clear of one another, holding, different, best first."""

import numpy as np
import pytest

from drake_hand.planning import grasp
from drake_hand.planning.collision import CLEARANCE
from tests.planning.small import equilibrium, table, turn

FINGERS = [0, 1, 2]


@pytest.fixture(scope="module")
def reach():
    return table("trio", "sphere", turn(15.0))


@pytest.fixture(scope="module")
def selected(reach):
    return grasp.select(reach, FINGERS, equilibrium("trio", "sphere"), np.random.default_rng(0))


def test_grasps_hold_with_every_finger_once(reach, selected):
    assert selected
    grasps = [holds for _, holds in selected]
    sets = grasp.together(reach.clearance.hand, grasps, reach.p_WCom(np.array([0]))[0])
    assert (equilibrium("trio", "sphere").margins(sets) >= 0).all()
    assert sets.mask.all()
    assert all([h.finger for h in holds] == FINGERS for holds in grasps)


def test_fingers_of_a_grasp_are_clear_of_one_another(reach, selected):
    for _, holds in selected:
        for a, b in ((0, 1), (0, 2), (1, 2)):
            x, y = (reach.centres(holds[k])[:1] for k in (a, b))
            assert reach.clearance.between(a, x, b, y)[0] >= CLEARANCE


def test_they_are_different_and_the_best_come_first(selected):
    scores = [score for score, _ in selected]
    assert scores == sorted(scores, reverse=True)
    assert len({tuple(h.table for h in holds) for _, holds in selected}) == len(selected)


def test_there_is_none_without_a_contact_or_without_friction(reach):
    slippery = equilibrium("trio", "sphere", friction=1e-4, gravity=np.array([0.0, 9.81, 0.0]))
    assert grasp.select(reach, FINGERS[:2], slippery, np.random.default_rng(0)) == []


def test_a_few_of_many_are_spread_out(reach):
    holds = reach.holds(0, 0)
    few = grasp.spread(holds, 5)
    assert few[0] is holds[0], "the longest is among them"
    assert len({h.table for h in few}) == 5
    apart = [np.linalg.norm(a.p_WP[0] - b.p_WP[0]) for a in few for b in few if a is not b]
    assert min(apart) > 5e-3
    assert grasp.spread(holds, len(holds)) == holds
