"""Grasps from which every finger can be lifted are found a few switches away from others."""

from functools import cache

import numpy as np

from drake_hand.planning import grasp
from drake_hand.planning.ease import at_ease
from drake_hand.planning.moves import Moves
from drake_hand.planning.state import FingerSwitch, Node
from tests.planning.small import equilibrium, moves, path, turn, waiting

HAND, PENCIL = "quartet", "pencil_r8"


@cache
def grasps() -> tuple[Moves, list[Node]]:
    """Held in equilibrium, those that can spare fewest fingers first."""
    m = moves(HAND, PENCIL, path(HAND, turn(20.0)), equilibrium(HAND, PENCIL))
    return m, sorted(grasp.roots(m, waiting(HAND), every=False, most=False), key=lambda x: x.spared)


def anyone(root: Node) -> bool:
    return True


def test_grasps_that_can_spare_more_fingers_are_a_few_switches_away():
    m, roots = grasps()
    poor = [x for x in roots if x.spared == roots[0].spared]
    found = at_ease(m, poor, anyone)
    assert found[0].spared > poor[0].spared
    assert {x.spared for x in found} == {found[0].spared}
    assert [x.score for x in found] == sorted((x.score for x in found), reverse=True)
    for x in found:
        assert x.chain[0] in poor
        for before, after in zip(x.chain, x.chain[1:], strict=False):
            assert isinstance(after.move, FingerSwitch)
            assert after.margins[-1] >= 0
            finger = after.move.finger
            assert before.liftable[finger] or not before.touching[finger]
            np.testing.assert_array_equal(after.X, poor[0].X)


def test_only_grasps_that_the_hand_can_close_on_lead_on():
    m, roots = grasps()
    able = roots[::3]
    assert {id(x.chain[0]) for x in at_ease(m, roots, lambda root: root in able)} <= {id(x) for x in able}
    assert at_ease(m, roots, lambda root: False) == roots


def test_what_can_be_spared_is_what_the_others_hold_without():
    m, roots = grasps()
    for x in roots:
        held = 0
        for f in np.flatnonzero(x.touching):
            rest = Node(s=x.s, off=x.off, X=x.X, q=x.q, touching=x.touching & (np.arange(4) != f))
            m.evaluate([rest])
            held += rest.margins[-1] >= 0
        assert x.spared == held
