"""Searches from both ends: what is found backwards is a motion forwards, and begins and ends as it has to."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from drake_hand.planning import meeting as meeting_module
from drake_hand.planning.meeting import Meeting, backwards
from drake_hand.planning.object_path import pose, still
from drake_hand.planning.search import Search
from drake_hand.planning.state import FingerSwitch, Stroke
from drake_hand.planning.strokes import rolled
from drake_hand.planning.switches import draw_switches, path_pieces
from drake_hand.planning.turns import Attempt
from tests.planning.small import START, move, moves, path, roots, turn, waiting

ROUND = 10


def meeting(m, *, expanded: bool = True, **values) -> Meeting:
    """Of searches from both ends; the one from the start has had its first turn, if it is not to get any farther."""
    forward = Search(moves=m)
    forward.begin(roots(m))
    forward.expansions = int(expanded)
    return Meeting(forward=forward, moves=backwards(m, 0), grasps=roots, **{"waiting": waiting("quartet")} | values)


def continuous(m, end) -> None:
    """All of a motion, move by move: it begins where the last one ended, rolls, and lands where it says."""
    chain = end.chain
    assert chain[0].s == 0
    assert end.s == m.path.ticks
    np.testing.assert_allclose(end.X, m.path.X_WO[-1, :3], atol=1e-9)
    assert end.regrasps == sum(
        isinstance(x.move, FingerSwitch) and before.touching[x.move.finger] and x.touching[x.move.finger]
        for before, x in itertools.pairwise(chain)
    )
    for before, x in itertools.pairwise(chain):
        if isinstance(x.move, Stroke):
            ends = [(x.move.X[0], before.X), (x.move.X[-1], x.X), (x.move.q[0], before.q), (x.move.q[-1], x.q)]
            for a, b in ends:
                np.testing.assert_allclose(a, b, atol=1e-9)
            K = len(x.move.X) - 1
            kinematic = replace(m, load=m.load._replace(kinematic=True, min_contacts=0))
            q, length = rolled(kinematic, x.move.X[None], np.array([K]), [before])
            assert length[0] >= K - 1  # a joint at its very limit may end it there, by rounding
            np.testing.assert_allclose(q[0, : length[0] + 1], x.move.q[: length[0] + 1], atol=1e-4)
        else:
            f, width = x.move.finger, len(m.clearance.kinematics[x.move.finger].lower)
            pieces = path_pieces(m, before, x)
            np.testing.assert_allclose(pieces[0][0], before.q[f, :width], atol=1e-9)
            np.testing.assert_allclose(pieces[-1][-1], x.q[f, :width], atol=1e-9)
            for a, b in itertools.pairwise(pieces):
                np.testing.assert_allclose(a[-1], b[0], atol=1e-9)
            others = np.arange(len(x.q)) != f
            np.testing.assert_array_equal(before.q[others], x.q[others])


def test_the_way_back_ends_where_the_way_began_and_stops_where_it_stopped():
    m = moves("quartet", "cylinder", path("quartet", turn(20.0), move(0.0, 5.0, 0.0)))
    back = backwards(m, 0)
    np.testing.assert_array_equal(back.path.X_WO, m.path.X_WO[::-1])
    assert back.path.ticks == m.path.ticks
    assert [m.path.ticks - stop for stop in back.path.stops] == [m.path.stops[0], 0]
    np.testing.assert_array_equal(back.load.spin_arm, -m.load.spin_arm)


def test_two_searches_meet_on_the_way():
    m = moves("quartet", "cylinder", path("quartet", turn(40.0)))
    both = meeting(m)
    back = both._begun()
    for search in (both.forward, back):
        search.run(3 * ROUND, np.inf)
    end = next(filter(None, (both._met(back) for _ in range(30))))
    of_forward = {id(x) for states in both.forward._bins.values() for x in states}
    assert any(id(x) in of_forward for x in end.chain)
    assert not all(id(x) in of_forward for x in end.chain)
    continuous(m, end)


def test_the_search_from_the_end_may_get_to_the_start_by_itself(monkeypatch):
    m = moves("quartet", "cylinder", path("quartet", turn(20.0)))
    both = meeting(m)
    monkeypatch.setattr(both.forward, "run", lambda budget, deadline: None)
    monkeypatch.setattr(both, "_met", lambda back: None)
    end = next(filter(None, (both.run(ROUND, np.inf) for _ in range(30))))
    continuous(m, end)
    root = end.chain[0]
    np.testing.assert_array_equal(root.q[~root.touching], waiting("quartet")[~root.touching])


@pytest.mark.parametrize("values", [{"waiting": None}, {"fewest": 5}], ids=["contacts are given", "all have to touch"])
def test_but_not_where_the_first_grasp_has_to_be_another(monkeypatch, values):
    m = moves("quartet", "cylinder", path("quartet", turn(20.0)))
    both = meeting(m, **values)
    monkeypatch.setattr(both.forward, "run", lambda budget, deadline: None)
    monkeypatch.setattr(both, "_met", lambda back: None)
    assert not any(both.run(ROUND, np.inf) for _ in range(10))
    assert both.back.fraction == 1.0


def test_a_start_that_the_hand_cannot_get_to_is_none(monkeypatch):
    m = moves("quartet", "cylinder", path("quartet", turn(20.0)))
    both = meeting(m)
    both.forward.run(3 * ROUND, np.inf)
    both.forward.able, both.forward._able = lambda root: False, {}
    monkeypatch.setattr(both.forward, "run", lambda budget, deadline: None)
    assert not any(both.run(ROUND, np.inf) for _ in range(10))
    assert both.back.fraction == 1.0


def test_the_first_turn_is_that_of_the_search_from_the_start(monkeypatch):
    m = moves("quartet", "cylinder", path("quartet", turn(5.0)))
    both = meeting(m, expanded=False)

    def tires(budget, deadline):
        both.forward.expansions += budget

    monkeypatch.setattr(both.forward, "run", tires)
    assert both.run(ROUND, np.inf) is None
    assert both.back is None
    both.run(ROUND, np.inf)
    assert both.back is not None


def test_the_search_from_the_start_has_more_turns_the_longer_no_order_was_found(monkeypatch):
    m = moves("quartet", "cylinder", path("quartet", turn(40.0)))
    both, turns = meeting(m), list[bool]()
    both.back = both._begun()
    monkeypatch.setattr(meeting_module, "have_order", lambda moves, some, targets: np.zeros(len(some), dtype=bool))
    monkeypatch.setattr(meeting_module.Meeting, "_pairs", lambda self, back: [ends])
    ends = tuple(next(iter(x.starts)) for x in (both.forward, both.back))
    monkeypatch.setattr(both.forward, "run", lambda budget, deadline: turns.append(False))
    monkeypatch.setattr(both.back, "run", lambda budget, deadline: turns.append(turns.pop() or True) and None)
    for _ in range(60):
        both.run(1, np.inf)
    first = turns[: meeting_module.PATIENCE]
    last = turns[-2 * (meeting_module.MOST_RESTED + 1) :]
    assert all(first)
    assert sum(last) == 2


def test_a_switch_is_undone_by_the_way_it_was_made():
    m = moves("quartet", "cylinder", path("quartet", turn(5.0)))
    x = next(x for x in roots(m) if x.liftable.any())
    f = int(np.flatnonzero(x.liftable)[0])
    for y in draw_switches(m, x, f):
        made = path_pieces(m, x, y)
        undone = path_pieces(m, y, replace(x, move=meeting_module._undone(m, y, x)))
        np.testing.assert_array_equal(np.concatenate(undone), np.concatenate(made)[::-1])
        assert [len(way) for way in undone] == [len(way) for way in made][::-1]


def test_a_finger_without_contact_begins_where_it_waits():
    m = moves("quartet", "cylinder", still(pose(START["quartet"])), fingers=frozenset({0, 1, 3}))
    both = meeting(m)
    back = both._begun()
    x = next(x for x in back.starts if not x.touching.all())
    f = int(np.flatnonzero(~x.touching)[0])
    for elsewhere in m.grid.stops[f]:
        move = FingerSwitch(finger=f, rise=-1, landing=-1, stop=-1, ways=(np.linspace(x.q[f], elsewhere, 5),))
        end = both._arrived(x.moved(f, elsewhere, move, touching=False))
        if end is not None and not np.array_equal(elsewhere, x.q[f]):
            break
    np.testing.assert_array_equal(end.chain[0].q[f], waiting("quartet")[f])
    assert any(np.array_equal(y.q[f], elsewhere) for y in end.chain)


def test_pairs_are_near_each_other_can_spare_fingers_and_are_tried_once():
    m = moves("quartet", "cylinder", path("quartet", turn(40.0)))
    both = meeting(m)
    back = both._begun()
    for search in (both.forward, back):
        search.run(ROUND, np.inf)
    first, second = both._pairs(back), both._pairs(back)
    assert first
    for x, y in first:
        assert abs(m.path.ticks - y.s - x.s) <= meeting_module.APART_TICKS
        assert x.spared
        assert y.spared
    names = [[(id(x), id(y)) for x, y in pairs] for pairs in (first, second)]
    assert not set(names[0]) & set(names[1])
    assert len({x for x, _ in names[0]}) == len({y for _, y in names[0]}) == len(first)


def test_states_do_not_meet_across_the_end_of_a_step():
    m = moves("quartet", "cylinder", path("quartet", turn(20.0), turn(20.0)))
    both = meeting(m)
    back, (stop, _) = both._begun(), m.path.stops
    for search in (both.forward, back):
        search.run(2 * ROUND, np.inf)

    def across() -> list[bool]:
        ends = [sorted((x.s, m.path.ticks - y.s)) for x, y in both._pairs(back)]
        return [a < stop < b for a, b in ends]

    some = across()
    assert some
    assert not any(some)
    both.forward.moves = replace(m, path=replace(m.path, stops=(m.path.ticks,)))
    assert any(across()), "there are such pairs, were it one step"


def test_why_nothing_was_found_says_that_there_is_no_grasp_where_it_ends():
    m = moves("quartet", "cylinder", path("quartet", move(0.0, 0.0, 150.0)))
    both = meeting(m)
    assert both.run(ROUND, np.inf) is None
    assert "cannot touch the object anywhere" in both.no_grasp
    attempt = Attempt(task=None, builder=None, search=both.forward, meeting=both)
    assert f"and where the motion ends, {both.no_grasp}" in attempt.failure("timeout").reason
