"""The search: moves keep to modes and fingers, a goal is met without an offset, failures say where and why."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_hand.planning.failure import code
from drake_hand.planning.object_path import build, pose, still
from drake_hand.planning.period import Period
from drake_hand.planning.search import BIN_EXPANSIONS, BIN_TICKS, Search, _cells
from drake_hand.planning.state import Node, Stroke
from drake_hand.planning.strokes import draw_strokes
from drake_hand.planning.switches import draw_retreats, draw_switches
from tests.planning.small import START, as_sets, equilibrium, margins, move, moves, path, roots, turn

HAND, PENCIL = "quartet", "pencil_r8"
SLIPPERY = equilibrium(HAND, PENCIL, friction=1e-4, gravity=np.array([0.0, 0.0, -9.81]))
"""Its weight along its axis."""


def searched(way, *, wanted=None, begin=None, budget=60, **changes) -> tuple[Search, Node | None]:
    m = moves(HAND, PENCIL, way, **changes)
    search = Search(moves=m, wanted=wanted)
    search.begin(begin or roots(m))
    return search, search.run(budget, time.monotonic() + 60.0)


# -- moves


def test_moves_keep_to_the_fingers_and_modes_that_may_be_used():
    used, may = frozenset({0, 1, 3}), ["1101", "1100"]
    free = moves(HAND, PENCIL, path(HAND, turn(20.0)))
    kept = moves(HAND, PENCIL, path(HAND, turn(20.0)), 2, fingers=used, modes=may)
    made = {f: 0 for f in range(4)}
    for x in roots(free, most=True)[:10]:
        for f in range(4):
            made[f] += len(draw_switches(free, x, f)) + len(draw_retreats(free, x, f))
    assert all(made.values()), "without restrictions every finger is moved"
    lifted = set()
    for x in roots(kept):
        for f in range(4):
            for after in [*draw_switches(kept, x, f), *draw_retreats(kept, x, f)]:
                assert code(kept.clearance.hand, np.flatnonzero(after.touching).tolist()) in may
                lifted.add(f)
                assert after.margins[-1] >= 0
                same = [k for k in range(4) if k != f]
                np.testing.assert_array_equal(after.q[same], x.q[same])
                np.testing.assert_array_equal(after.X, x.X)
    assert 3 in lifted
    assert not {0, 1} & lifted, "they hold on in both modes"


def test_strokes_stay_in_the_corridor_and_meet_a_stop_without_an_offset():
    m = moves(HAND, PENCIL, path(HAND, move(0.0, 0.0, 6.0), move(0.0, 6.0, 0.0)))
    stopped = 0
    for root in roots(m)[:6]:
        for x in draw_strokes(m, root):
            assert np.linalg.norm(x.off[:3]) <= m.corridor.rad + 1e-9
            assert np.linalg.norm(x.off[3:]) <= m.corridor.m + 1e-9
            assert x.s <= m.path.stops[0], "no stroke goes through a stop"
            if x.s == m.path.stops[0]:
                stopped += 1
                np.testing.assert_allclose(x.X, m.path.X_WO[m.path.stops[0], :3], atol=1e-9)
            np.testing.assert_array_equal(x.move.q[0], root.q)
            assert not np.ptp(x.move.q[:, ~x.touching], axis=0).any(), "who does not touch rests"
    assert stopped


def test_as_far_is_looked_ahead_on_a_fine_path_as_on_any():
    coarse = path(HAND, turn(90.0))
    fine = build(coarse.X_WO[0], [turn(90.0)], fineness=2)
    for s, off in ((3.0, np.zeros(6)), (30.0, np.zeros(6))):
        some, others = (
            moves(HAND, PENCIL, way).look(np.array([times * s]), off[None]) for way, times in ((coarse, 1), (fine, 2))
        )
        np.testing.assert_allclose(some[0], others[0], atol=1e-12)
        np.testing.assert_array_equal(some[1], others[1])
        assert np.ptp(some[0][0, :, 0, 0]) > 0.05


def test_strokes_leave_the_path_sideways_only():
    """What lags behind has not got as far as its progress says."""
    m = moves(HAND, PENCIL, path(HAND, turn(60.0), move(0.0, 0.0, 6.0)))
    axis = m.path.X_WO[0, :3, 2]
    ends = [x for root in roots(m)[:6] for s in (0.0, 22.0) for x in draw_strokes(m, replace(root, s=s))]
    offsets = np.stack([x.off for x in ends])
    assert np.abs(offsets[:, :3] @ axis).max() < 1e-9
    assert np.linalg.norm(offsets[:, :3], axis=1).max() > 0.02


# -- search


@pytest.fixture(scope="module")
def turned():
    return searched(path(HAND, turn(60.0)))


def test_a_state_at_the_goal_is_found_and_led_to(turned):
    search, end = turned
    assert end is not None
    assert end.s == search.moves.path.ticks
    assert not end.off.any()
    np.testing.assert_allclose(end.X, search.moves.path.X_WO[-1, :3], atol=1e-9)
    assert end.chain[0].parent is None
    assert all(x.parent is before for before, x in zip(end.chain, end.chain[1:], strict=False))


def test_the_same_seed_finds_the_same(turned):
    search, end = turned
    again, other = searched(path(HAND, turn(60.0)))
    assert again.expansions == search.expansions
    assert [x.q.tobytes() for x in other.chain] == [x.q.tobytes() for x in end.chain]


def test_asked_again_it_finds_another_way(turned):
    search, end = turned
    search.restart()
    other = search.run(60, time.monotonic() + 60.0)
    assert other is not None
    assert [x.q.tobytes() for x in other.chain] != [x.q.tobytes() for x in end.chain]


def test_an_object_that_rests_needs_nothing_but_a_grasp():
    search, end = searched(still(pose(START[HAND])))
    assert end.parent is None
    assert search.expansions == 0
    search.restart()
    assert search.run(60, time.monotonic() + 60.0).q.tobytes() != end.q.tobytes(), "not the same again"


def test_roots_that_the_hand_cannot_get_to_are_left():
    m = moves(HAND, PENCIL, path(HAND, move(0.0, 0.0, 6.0)))
    begin, asked = roots(m), []
    search = Search(moves=m, able=lambda root: asked.append(root) or root in begin[-2:])
    search.begin(begin)
    end = search.run(60, time.monotonic() + 60.0)
    assert end.chain[0] in begin[-2:]
    assert len({id(x) for x in asked}) == len(asked), "no root is asked twice"
    never = Search(moves=m, able=lambda root: False)
    never.begin(roots(m))
    assert never.run(60, time.monotonic() + 60.0) is None
    assert never.exhausted


def test_what_follows_from_a_root_that_cannot_be_got_to_does_not_count(monkeypatch):
    monkeypatch.setattr("drake_hand.planning.search.FARTHEST_CHANCE", 1.0)
    monkeypatch.setattr("drake_hand.planning.search.ANYWHERE_CHANCE", 0.0)
    m = moves(HAND, PENCIL, path(HAND, turn(60.0)))
    good, bad = roots(m)[:2]
    far = replace(bad, s=6.0, parent=bad)
    search = Search(moves=m, able=lambda root: root is good)
    search.begin([good, bad, far])
    assert search.farthest is far
    monkeypatch.setattr(search, "_children", lambda state: [])
    monkeypatch.setattr(Search, "_onward", [])
    search.run(1, time.monotonic() + 60.0)
    assert search.farthest is good
    search.restart()
    assert [x for states in search._bins.values() for x in states] == [good]


def test_the_object_is_handed_over_to_the_fingers_wanted():
    m = moves(HAND, PENCIL, still(pose(START[HAND])), 2, fingers=frozenset({0, 1, 2}))
    begin = roots(m, every=True)[:1]
    _, end = searched(still(pose(START[HAND])), wanted=frozenset({0, 1, 3}), begin=begin, holding=2)
    assert tuple(end.touching) == (True, True, False, True)
    assert all(x.margins[-1] >= 0 for x in end.chain)


def test_a_finger_that_can_seldom_be_lifted_is_switched_where_it_can(monkeypatch):
    m = moves(HAND, PENCIL, path(HAND, turn(60.0)))
    x = replace(roots(m)[0], touching=np.ones(4, dtype=bool), margins=np.ones(5))
    x.room = np.array([0.0, 0.2, 0.4, 1.0])
    never = replace(x, margins=np.array([1.0, 1.0, 1.0, -1.0, 1.0]))
    asked = []
    monkeypatch.setattr("drake_hand.planning.search.draw_switches", lambda m, state, f: asked.append(f) or [])
    monkeypatch.setattr("drake_hand.planning.search.draw_retreats", lambda *_: [])
    monkeypatch.setattr("drake_hand.planning.search.draw_slides", lambda *_: [])
    monkeypatch.setattr(m, "evaluate", lambda states, rooms=None: None)
    for others in ([x] * 4, [never] * 4):
        monkeypatch.setattr("drake_hand.planning.search.draw_strokes", lambda m, state, others=others: others)
        asked.clear()
        for _ in range(20):
            Search(moves=m)._children(x)
        assert asked.count(3) > 15 if others[0] is never else asked.count(3) == 0


def test_where_a_stroke_ends_with_a_period_grasps_at_ease_are_looked_for(monkeypatch):
    """For the best of the strokes that end there, and asked too whether they can go back."""
    way = path(HAND, turn(60.0))
    m = moves(HAND, PENCIL, way)
    period = Period(ticks=way.ticks // 3, count=3, X_OO=np.eye(4))
    x = roots(m)[0]
    stroke = Stroke(X=x.X[None], q=x.q[None])
    arrived = [replace(x, s=float(period.ticks), parent=x, move=stroke, score=score) for score in (1.0, 2.0, 0.0)]
    before = replace(arrived[1], s=period.ticks - 1.0, score=9.0)
    easy, asked, eased = replace(arrived[0], move=None), [], []
    monkeypatch.setattr(Period, "completed", lambda self, m, x: asked.append(x))
    monkeypatch.setattr("drake_hand.planning.search.at_ease", lambda m, some, **_: eased.append(some) or [*some, easy])
    search = Search(moves=m, period=period)
    assert search._repeated([before, *arrived]) == ([easy], [])
    assert eased == [[arrived[1]]]
    assert asked == [arrived[1], easy]


def test_states_much_alike_share_a_niche():
    m = moves(HAND, PENCIL, path(HAND, move(0.0, 0.0, 6.0)))
    search = Search(moves=m)
    x = roots(m)[0]
    twin = Node(s=x.s, off=x.off, X=x.X, q=x.q, touching=x.touching)
    lifted = Node(s=x.s, off=x.off, X=x.X, q=x.q, touching=x.touching & (np.arange(4) > 0))
    later = Node(s=5.0, off=x.off, X=x.X, q=x.q, touching=x.touching)
    m.evaluate([twin, lifted, later])
    search.begin([x, twin, lifted, later])
    assert x.niche == twin.niche
    assert len({x.niche, lifted.niche, later.niche}) == 3 - (not x.touching[0])
    touches, does_not = (SimpleNamespace(p_OP=np.zeros((1, 3)), touching=np.array([on])) for on in (True, False))
    assert np.ptp(_cells([touches, does_not]), axis=0).all(), "also in the middle of the object"


def test_where_nothing_leads_on_the_search_goes_back(monkeypatch):
    monkeypatch.setattr("drake_hand.planning.search.FARTHEST_CHANCE", 1.0)
    monkeypatch.setattr("drake_hand.planning.search.ANYWHERE_CHANCE", 0.0)
    m = moves(HAND, PENCIL, path(HAND, turn(60.0)))
    near = roots(m)[0]
    far = Node(s=5 * BIN_TICKS, off=near.off, X=near.X, q=near.q, touching=near.touching)
    m.evaluate([far])
    search, asked = Search(moves=m, able=lambda root: True), []
    monkeypatch.setattr(search, "_children", lambda state: asked.append(state) or [])
    monkeypatch.setattr(Search, "_onward", [])
    search.begin([near, far])
    search.run(6 * BIN_EXPANSIONS, time.monotonic() + 60.0)
    assert asked.index(near) == 5 * BIN_EXPANSIONS, "five bins back"


def test_a_search_for_a_period_looks_for_one(turned):
    search, _ = turned
    assert search.goal_fraction == search.fraction == 1.0
    gait = Search(moves=search.moves, period=Period(ticks=6, count=4, X_OO=np.eye(4)))
    x = roots(search.moves)[0]
    y = replace(x, s=3.0)
    gait.begin([x, y])
    assert gait.fraction == 3.0 / search.moves.path.ticks
    assert gait.goal_fraction == 4 * gait.fraction


def test_a_failure_says_how_far_it_got_and_who_is_short_of_what():
    m = moves(HAND, PENCIL, path(HAND, turn(360.0)), modes=["1111"])
    search = Search(moves=m)
    search.begin(roots(m))
    assert search.run(10, time.monotonic() + 60.0) is None, "no finger may be lifted"
    error = search.failure("timeout")
    best = search.farthest
    assert 0 < search.fraction < 1
    assert error.status == "timeout"
    assert error.evidence.progress == search.fraction
    assert error.evidence.expansions == 10
    assert error.evidence.mode == "1111"
    assert error.evidence.finger in [f.name for f in m.clearance.hand.fingers]
    assert error.evidence.constraint in ("reach", "balance")
    np.testing.assert_array_equal(error.evidence.X_WO[:3], best.X)
    assert f"{100 * search.fraction:.0f} %" in error.reason


def test_a_search_knows_whether_a_grasp_lasts_all_the_way():
    def straight(step, able=lambda root: True) -> bool:
        m = moves(HAND, PENCIL, path(HAND, step))
        search = Search(moves=m, able=able)
        search.begin(roots(m))
        return search.straight

    assert straight(turn(10.0))
    assert not straight(turn(340.0))
    assert not straight(turn(10.0), able=lambda root: False), "no hand gets there"


def test_a_grasp_of_two_fingers_lasts_only_where_no_more_may_touch():
    """A certified strawberry between two fingers turned 41 deg about the line through both, in either engine."""
    m = moves(HAND, PENCIL, path(HAND, turn(10.0)))
    search = Search(moves=m)
    search.begin(roots(m))
    firm = [x for x in search._onward if x.s == m.path.ticks and x.touching.sum() > 2]
    two = np.cumsum(firm[0].touching) <= 2
    pair = [replace(firm[0], touching=firm[0].touching & two)]
    search.__dict__["_onward"] = pair
    assert search._arrived(pair) in pair
    assert not search.straight
    search.__dict__["_onward"] = pair + firm
    assert search._arrived(pair + firm) in firm
    assert search.straight
    few = Search(moves=replace(m, fingers=frozenset(np.flatnonzero(pair[0].touching).tolist())))
    few.__dict__["_onward"] = pair
    assert few.straight, "no more may touch"


def test_of_grasps_that_last_equally_firm_the_one_with_the_largest_margin_is_the_answer():
    """A TriFinger's banana, its third finger pressed with 0.38 N, was lost in Drake; with 1.4 N it is held."""
    m = moves(HAND, PENCIL, path(HAND, turn(10.0)))
    search = Search(moves=m)
    search.begin(roots(m))
    firm = [x for x in search._onward if x.s == m.path.ticks and x.touching.sum() > 2]
    m.evaluate(firm)
    weakest_first = sorted(firm, key=lambda x: min(y.margins[-1] for y in x.chain))
    margins = [min(y.margins[-1] for y in x.chain) for x in weakest_first]
    assert margins[0] < margins[-1] - 0.01, "they differ"
    assert search._margin(search._arrived(weakest_first)) == margins[-1]


def test_a_grasp_that_lasts_is_an_answer_at_once_and_the_next_one_after_it():
    m = moves(HAND, PENCIL, path(HAND, turn(10.0)))
    asked: list[Node] = []
    search = Search(moves=m, able=lambda root: asked.append(root) or len(asked) > 1)
    search.begin(roots(m))
    first, second = (search.run(1, time.monotonic() + 60.0) for _ in range(2))
    assert search.expansions == 0
    assert len(asked) == 3, "of those that last, no more are closed on than it takes"
    assert [first.chain[0], second.chain[0]] == asked[1:]
    assert first.s == second.s == m.path.ticks
    assert search.fraction == 1.0


def test_a_failure_says_whether_more_friction_would_let_a_finger_be_lifted():
    m = moves(HAND, PENCIL, path(HAND, turn(100.0)), equilibrium(HAND, PENCIL, friction=0.1))
    twice, told = equilibrium(HAND, PENCIL, friction=0.2), set()
    for root in roots(m):
        kept = [f for f in np.flatnonzero(root.touching) if root.margins[f] < 0]
        if not kept:
            continue
        search = Search(moves=m)
        search.begin([root])
        reason = search.failure("timeout").reason
        less = np.repeat(root.touching[None], len(kept), axis=0)
        less[range(len(kept)), kept] = False
        X, q = (np.repeat(a[None], len(kept), axis=0) for a in (root.X, root.q))
        could = bool((margins(twice, as_sets(m.clearance, X, q, less)) >= 0).any())
        assert ("twice the friction" in reason) == could
        told.add(could)
    assert told


def test_a_failure_says_friction_where_twice_as_much_would_not_do():
    m = moves(HAND, PENCIL, path(HAND, turn(100.0)), equilibrium(HAND, PENCIL, friction=0.05))
    search = Search(moves=m)
    found = roots(moves(HAND, PENCIL, path(HAND, turn(100.0))))
    for x in found:
        m.evaluate([x], x.room[None])
    search.begin(found)
    assert "twenty times the friction" in search.failure("infeasible").reason
