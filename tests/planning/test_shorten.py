"""Regrasps that a way does without are left out; those that it needs are not."""

import numpy as np

from drake_hand.planning import grasp, searches, shorten
from drake_hand.planning.planner import find_paths
from drake_hand.planning.shorten import shortened
from drake_hand.planning.slide import draw_slides, slid_again
from drake_hand.planning.state import FingerSlide, Node, Stroke
from drake_hand.planning.strokes import carried
from drake_hand.planning.switches import draw_switches
from drake_hand.plans.task import Grasp, Options, Rotate, Step, Task
from tests.planning.small import moves, path, turn, waiting

NOWHERE = np.zeros(6)
FAR = turn(35.0)


def regrasped(step: Step, *, lasts: bool):
    """Moves of a pencil, and ways that begin with one regrasp: the end, and that of the way without it or None.

    From all grasps that last without a regrasp, or from those that do not.
    """
    m = moves("quartet", "pencil_r8", path("quartet", step))
    goal, out = float(m.path.ticks), []
    for root in grasp.roots(m, waiting("quartet"), every=False, most=True):
        without = carried(m, root, goal, NOWHERE)
        if (without is None) == lasts:
            continue
        for f in range(4):
            ends = [carried(m, x, goal, NOWHERE) for x in draw_switches(m, root, f) if root.touching[f]]
            out += [(end, without) for end in ends if end is not None]
    return m, out


def test_a_regrasp_that_nothing_needs_is_left_out():
    m, ways = regrasped(turn(5.0), lasts=True)
    assert len(ways) > 3
    for end, without in ways:
        assert end.regrasps == 1
        found = shortened(m, end)
        assert (found.regrasps, found.s) == (0, end.s)
        np.testing.assert_array_equal(found.q, without.q)
        assert [type(x.move) for x in found.chain] == [type(None), Stroke]


def test_a_slide_that_nothing_needs_is_left_out_and_another_finger_s_is_kept():
    """Fingers slide to where the motion can be made; a regrasp of another finger before it is not needed."""
    m = moves("quartet", "cylinder", path("quartet", turn(90.0)))
    needless, kept = 0, 0
    for root in grasp.roots(m, waiting("quartet"), every=False, most=True):
        for f in np.flatnonzero(root.touching).tolist():
            for y in draw_slides(m, root, f)[:1]:
                found = shortened(m, y)
                assert found is root
                needless += 1
                kept += needed(m, root, f, y)
    assert needless > 3
    assert kept


def needed(m, root: Node, f: int, y: Node) -> bool:
    """Whether a motion was found that the slide of f from root to y is needed for; it stays if so, and only it."""
    s = next((s for s in range(36, 2, -2) if (end := carried(m, y, float(s), NOWHERE)) is not None), 0)
    if not s or carried(m, root, float(s), NOWHERE) is not None:
        return False
    for g in np.flatnonzero(root.touching).tolist():
        for z in draw_switches(m, root, g) if g != f else []:
            slid = slid_again(m, z, y)
            if slid is None:
                continue
            m.evaluate([slid])
            end = carried(m, slid, float(s), NOWHERE)
            if end is not None:
                found = shortened(m, end)
                assert [type(x.move) for x in found.chain] == [type(None), FingerSlide, Stroke]
                assert found.regrasps == 1
                np.testing.assert_allclose(found.q[f], carried(m, y, float(s), NOWHERE).q[f], atol=1e-9)
                return True
    return False


def test_a_regrasp_without_which_the_object_does_not_get_there_stays():
    m, ways = regrasped(FAR, lasts=False)
    assert len(ways) > 3
    for end, _ in ways:
        assert shortened(m, end) is end


def test_what_the_finger_does_next_is_done_from_where_it_was_left():
    """Two regrasps of one finger: the first is left out, the second begins at the contact before it, or not at all."""
    m = moves("quartet", "pencil_r8", path("quartet", turn(5.0)))
    left = []
    for root in grasp.roots(m, waiting("quartet"), every=False, most=True)[:8]:
        for f in np.flatnonzero(root.touching).tolist():
            for one in draw_switches(m, root, f)[:1]:
                for two in draw_switches(m, one, f)[:1]:
                    found = shortened(m, two)
                    assert found.regrasps < 2
                    left.append(found.regrasps)
                    for x in found.chain[1:]:
                        assert x.parent is not None
                        assert x.parent.margins[f] >= 0
                        assert x.regrasps == x.parent.regrasps + 1
    assert len(left) > 3


def test_what_is_kept_joins_to_the_last_digit():
    """States that were repeated are not quite what rolling anew would make of them."""
    m, ways = regrasped(turn(5.0), lasts=True)
    end, _ = ways[0]
    f, stroke = end.parent.move.finger, end.move
    others = [i for i in range(4) if i != f]
    stroke.q[:, others] += 1e-6
    end.q = stroke.q[-1]
    found = shortened(m, end)
    assert found.regrasps == 0
    np.testing.assert_array_equal(found.q[others], end.q[others])


def test_what_recurs_is_left_out_each_time(monkeypatch):
    """Not tried again is only what could not be left out: a gait loses the same regrasp in every period."""
    task = Task(
        hand="trio",
        object="pencil_r8",
        start="auto",
        motion=[Step(grasp=Grasp()), Step(rotate=Rotate(axis=(0, 0, 1), frame="object", angle_deg=1440.0))],
        options=Options(hold="kinematic"),
    )
    found = []

    def remembered(m, end):
        short = shortened(m, end)
        with monkeypatch.context() as patch:
            patch.setattr(shorten, "_postures", lambda chain, i: object())
            found.append((end.regrasps, short.regrasps, shortened(m, end).regrasps))
        return short

    monkeypatch.setattr(searches, "shortened", remembered)
    next(find_paths(task))
    assert found
    for before, after, without_memory in found:
        assert after == without_memory < before - 5
