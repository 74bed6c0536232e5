"""Starts beside the best and further ones: which are tried, and which join the searches that take turns."""

import itertools
from threading import Barrier
from types import SimpleNamespace

import pytest

from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.planning import attempts, grasp
from drake_hand.planning.grasp import LASTING_SCORE
from drake_hand.planning.problem import Problem
from drake_hand.planning.turns import Attempt
from drake_hand.planning.world import CORES
from drake_hand.plans.task import Grasp
from tests.planning.small import problem_of, task, turn


@pytest.mark.parametrize(
    ("lasting", "tried"),
    [
        ({0: 0.6, 1: 0.7, 2: 0.65, 3: 1.0, 4: 1.0}, [1, 2, 3]),  # until one lasts all the way
        ({0: 0.6} | dict.fromkeys(range(1, 40), 0.5), [*range(1, 1 + attempts.STARTS_BESIDE)]),  # none is better
        ({0: 0.6, 5: 0.61} | dict.fromkeys([1, 2, 3, 4, *range(6, 40)], 0.1), [*range(1, 6 + attempts.STARTS_BESIDE)]),
        ({0: attempts.NEARLY_LASTING_SHARE - 0.01, 1: 1.0}, []),
        ({0: 1.0, 1: 1.0}, []),
        ({}, []),
    ],
)
def test_starts_beside_the_best_are_tried_as_long_as_they_get_better(monkeypatch, lasting, tried):
    def attempt(k: int) -> SimpleNamespace:
        search = SimpleNamespace(lasting=lasting[k], straight=lasting[k] == 1.0)
        return SimpleNamespace(task=k, search=search)

    asked, beside = [], []
    monkeypatch.setattr(attempts, "BESIDE_AT_ONCE", 1)
    monkeypatch.setattr(attempts, "from_start", lambda problem, task, *_: asked.append(task) or attempt(task))
    monkeypatch.setattr(attempts.start, "close_by", lambda task, clearance, rng: beside.append(task) or len(beside))
    free = [attempt(0)] if lasting else []
    found = attempts.starts_beside(problem_of("auto"), free, Grasp(), [], [])
    assert [x.task for x in found] == asked == tried
    best = [max(range(k), key=lambda x: (lasting[x], -x)) for k in tried]
    assert beside == best, "each step is taken from the best so far"


def further(
    monkeypatch,
    lasting,
    promise,
    staying,
    *,
    gaits=(),
    turned=False,
    promising=1,
    a_round=1,
    offered=3,
    reached=None,
    coming_back=False,
):
    """Further starts by number (those beside others from 10, the third none), and what they were begun beside.

    Searches from some have expanded states and reached so much of the motion.
    """
    spent, reached = attempts.STALLED_EXPANSIONS, reached or {}

    def attempt(problem, k: int, *_) -> Attempt:
        if k == 3:
            raise NoPlanFound("out of reach")
        search = SimpleNamespace(
            lasting=lasting.get(k, 0.0),
            straight=lasting.get(k) == 1.0,
            moves=SimpleNamespace(evaluate=begun.append),
            begin=begun.append,
            exhausted=False,
            expansions=spent if k in reached else 0,
            fraction=reached.get(k, 0.0),
        )
        stays = staying.get(k, 0.0)
        promises = promise.get(k, 0.0) + LASTING_SCORE * stays
        return Attempt(task=k, builder=None, search=search, staying=stays, promise=promises)

    beside, begun = [], []
    monkeypatch.setattr(attempts, "PROMISING_STARTS", promising)
    monkeypatch.setattr(attempts, "OFFERED_A_ROUND", a_round)
    monkeypatch.setattr(attempts, "from_start", attempt)
    monkeypatch.setattr(attempts, "_turned", lambda *_: turned or None)
    monkeypatch.setattr(attempts, "gait_of", lambda problem, x, wanted: f"gait {x.task}" if x.task in gaits else None)
    monkeypatch.setattr(attempts.start, "close_by", lambda task, *_: beside.append(task) or 9 + len(beside))
    tasks, free = iter(range(1, 1 + offered)), [attempt(None, 0)]
    more = attempts.further_starts(problem_of("auto"), tasks, free, Grasp(), [], [], gaits=coming_back)
    return more, beside, begun


def numbers(more, rounds: int) -> list[list[int]]:
    """Those that join in each round."""
    return [[x.task for x in y.joining([call() for call in y.calls])] for y in itertools.islice(more, rounds)]


def test_each_round_some_that_are_offered_and_one_beside_the_best_are_looked_at_and_only_lasting_ones_join(monkeypatch):
    lasting = {0: 0.6, 1: 0.5, 2: 0.8, 10: 0.7, 11: 0.75, 12: 1.0, 13: 0.9}
    more, beside, _ = further(monkeypatch, lasting, {}, {})
    assert numbers(more, 5) == [[], [], [12], [], []]
    assert beside == [0, 10, 2, 12, 12], "the best before the round"


def test_none_are_begun_beside_others_where_nothing_nearly_lasts(monkeypatch):
    little = attempts.NEARLY_LASTING_SHARE - 0.01
    more, beside, _ = further(monkeypatch, {0: little}, {}, {0: little})
    assert numbers(more, 9) == [[]] * 3, "of all that are offered"
    assert beside == []


def test_what_is_beside_the_search_that_got_farthest_joins_where_that_has_stalled(monkeypatch):
    """However little it promises; what has just begun, or still gets farther, is left to itself."""
    more, beside, _ = further(monkeypatch, {}, {}, {}, offered=0, reached={0: 0.4, 11: 0.6, 12: 0.5})
    assert numbers(more, 4) == [[10], [11], [12], [13]]
    assert beside == [0, 0, 11, 11]
    monkeypatch.setattr(attempts, "STALLED_EXPANSIONS", attempts.STALLED_EXPANSIONS + 1)
    assert numbers(more, 1) == []
    gait, beside, _ = further(monkeypatch, {}, {}, {}, offered=0, reached={0: 0.4}, coming_back=True)
    assert (numbers(gait, 3), beside) == ([], []), "how far it gets without coming back does not count"


def test_of_three_starts_one_is_beside_that_whose_grasp_nearly_lasts_the_others_beside_the_farthest(monkeypatch):
    more, beside, _ = further(monkeypatch, {0: 0.5}, {}, {}, offered=0, reached={0: 0.2, 10: 0.3})
    assert numbers(more, 4) == [[10], [11], [], [13]]
    assert beside == [0, 10, 0, 10]


def test_beside_the_farthest_starts_are_nearer_than_beside_others(monkeypatch):
    more, _, _ = further(monkeypatch, {0: 0.5}, {}, {}, offered=0, reached={0: 0.2, 99: 0.3})
    shares: list[float] = []
    monkeypatch.setattr(attempts.start, "close_by", lambda task, clearance, rng, share: shares.append(share) or 99)
    numbers(more, 30)
    assert shares[2::3] == [1.0] * 10, "beside that whose grasp nearly lasts"
    near = [share for k, share in enumerate(shares) if k % 3 != 2]
    assert 0.5**attempts.MOST_HALVINGS <= min(near) < 0.25
    assert 0.5 < max(near) < 1.0


def test_starts_join_that_are_among_the_most_promising_so_far(monkeypatch):
    """Two are; several are tried beside a round."""
    promise = {0: 1.0, 1: 0.5, 2: 0.4, 4: 0.9, 5: 0.8, 6: 1.1, 7: 1.0, 8: 0.95}
    more, _, _ = further(monkeypatch, {}, promise, {}, promising=2, a_round=3, offered=8)
    # 1 joins, 2 does not, and 3 is none; 4 joins, 5 does not, 6 joins; 7 and 8 are not as good as two before
    assert numbers(more, 3) == [[1], [4, 6], []]


def test_starts_whose_fingers_stay_longer_join_and_are_begun_beside_in_turn(monkeypatch):
    """A grasp that lasts longest is not the one that promises most; each is bettered by starts beside it."""
    more, beside, _ = further(
        monkeypatch,
        {0: 0.5, 2: 0.6, 11: 0.7},
        promise={0: 1.0, 1: 1.0, 2: 0.5, 11: 0.2, 12: 1.1, 14: 0.9},
        staying={0: 0.6, 1: 0.7, 12: 0.7, 14: 0.9},
    )
    assert numbers(more, 6) == [[1], [], [12], [], [14], []]
    assert beside == [0, 0, 1, 11, 12, 11]


def test_starts_with_a_gait_join_with_its_end_to_start_from(monkeypatch):
    more, beside, begun = further(monkeypatch, {}, {}, {}, gaits=(2,), turned=True)
    first, second, third = (y.joining([call() for call in y.calls]) for y in itertools.islice(more, 3))
    assert first == third == []
    assert [(x.task, x.gait) for x in second] == [(2, "gait 2")]
    assert begun == [["gait 2"]] * 2, "evaluated, then begun from"
    assert beside == []


def test_a_start_promises_what_its_first_grasp_does_whatever_becomes_of_it():
    t = task("trio", "cube", turn(90.0))
    problem = Problem.of(t, Hand.load(t.hand), lambda _: None)
    x = attempts.from_start(problem, t, problem.builder(t), Grasp(), t.motion[1:], [])
    first = next(iter(x.search.starts))
    x.search.starts.clear()
    assert x.staying == grasp.staying(x.search.moves, [first])[0]
    assert x.promise == pytest.approx(first.score + LASTING_SCORE * x.staying)


@pytest.mark.skipif(CORES == 1, reason="side by side takes two cores")
def test_starts_are_prepared_side_by_side(monkeypatch):
    both = Barrier(2, timeout=30.0)
    monkeypatch.setattr(attempts, "from_start", lambda problem, task, *_: (both.wait() and task) or task)
    assert attempts.from_starts(problem_of("auto"), [1, 2, 3, 4], Grasp(), [], []) == [1, 2, 3, 4]


def test_the_scene_is_asked_by_one_at_a_time(monkeypatch):
    """It has one state: where another has put hand and object would be answered for."""
    t = task("trio", "cube", turn(90.0))
    problem, asked = Problem.of(t, Hand.load(t.hand), lambda _: None), []
    monkeypatch.setattr(grasp, "check_palm", lambda *_: asked.append(problem.scene_free.locked()))
    attempts.from_starts(problem, [t, t], Grasp(), t.motion[1:], [])
    assert asked == [True, True]
    assert not problem.scene_free.locked()


def test_a_start_beside_without_a_grasp_is_passed_over(monkeypatch):
    first = SimpleNamespace(task=0, search=SimpleNamespace(lasting=0.5, straight=False))

    def none(*_):
        raise NoPlanFound("out of reach")

    monkeypatch.setattr(attempts, "from_start", none)
    monkeypatch.setattr(attempts.start, "close_by", lambda task, *_: task)
    assert attempts.starts_beside(problem_of("auto"), [first], Grasp(), [], []) == []
