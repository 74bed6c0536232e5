"""Grasps from which every finger can be lifted are found a few switches away from others."""

from dataclasses import replace
from functools import cache

import numpy as np

from drake_hand.planning import grasp
from drake_hand.planning.ease import at_ease, ease
from drake_hand.planning.moves import Moves
from drake_hand.planning.state import FingerSwitch, Node
from drake_hand.planning.switches import draw_retreats, leaves
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


def test_a_finger_that_cannot_get_away_does_not_count(monkeypatch):
    """However well the others hold the object: what cannot leave a contact cannot come back to it."""
    m, roots = grasps()
    x = max(roots, key=lambda x: x.spared)
    away = [f for f in np.flatnonzero(x.liftable).tolist() if leaves(m, x, f)]
    assert ease(m, x) == len(away) > 0
    for f in away:
        assert draw_retreats(m, x, f)
    walled_in = replace(x, n_W=-x.n_W)
    assert ease(m, walled_in) == 0, "lifted into the object"


def test_the_grasps_that_most_fingers_can_leave_come_first():
    m, roots = grasps()
    found = [ease(m, x) for x in at_ease(m, roots, anyone)]
    assert found == sorted(found, reverse=True)
    assert found[0] >= max(ease(m, x) for x in roots[-5:])
