"""From how many starts searches and gaits begin, and which gait is taken."""

import itertools
import time
from contextlib import nullcontext
from threading import Barrier
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.planning import attempts as attempts_
from drake_hand.planning import grasp, searches
from drake_hand.planning.grasp import LASTING_SCORE
from drake_hand.planning.planner import find_paths
from drake_hand.planning.problem import Problem
from drake_hand.planning.turns import Attempt, Offer
from drake_hand.planning.world import CORES, at_once
from drake_hand.plans.task import Grasp, Options, Step
from tests.planning.small import move, task, turn

ENDLESS = SimpleNamespace(deadline=np.inf)


def attempts(angle_deg: float, regrasps: list[int | None]) -> list:
    """Attempts from starts whose gaits, if any, take so many regrasps to turn the object by an angle."""
    path = SimpleNamespace(angle=np.radians(angle_deg))
    search = SimpleNamespace(moves=SimpleNamespace(path=path))
    return [SimpleNamespace(search=search, gait=n and SimpleNamespace(regrasps=n)) for n in regrasps]


def problem_of(start: object) -> SimpleNamespace:
    return SimpleNamespace(
        deadline=np.inf,
        stage=lambda name: nullcontext(),
        progress=lambda p: None,
        builder=lambda task: None,
        clearance=None,
        task=SimpleNamespace(start=start, options=SimpleNamespace(seed=0)),
    )


@pytest.mark.parametrize(
    ("regrasps", "taken", "looked_at"),
    [
        ([20, 70, None, None, None, None, 10], 20, 6),  # good enough after six
        ([70, None, None, None, None, None, None, 40, 30], 40, 8),  # 9 deg a regrasp is few
        ([None] * 9 + [70], 70, 10),  # any, before none
        ([None, 70, 60, 50, None, None, 40], 50, 6),  # three are enough
        ([None] * 8, None, 8),
    ],
)
def test_gaits_are_looked_for_until_one_is_good(monkeypatch, regrasps, taken, looked_at):
    looked = []
    monkeypatch.setattr(searches, "gait_of", lambda problem, x, wanted: looked.append(x) or x.gait)
    found = searches._gaits(ENDLESS, attempts(360.0, regrasps), Grasp())
    assert (found[0][1].regrasps if found else None) == taken
    assert len(looked) == looked_at


def lasts(margin: float = -np.inf, ticks: int = 36, fineness: int = 1) -> SimpleNamespace:
    """A search one of whose grasps lasts for the whole motion, with so much margin; or none does."""
    path = SimpleNamespace(ticks=ticks, fineness=fineness)
    moves = SimpleNamespace(path=path)
    return SimpleNamespace(straight=margin > -np.inf, straight_margin=margin, moves=moves)


def test_starts_without_a_grasp_are_made_up_for(monkeypatch):
    """Sixteen starts with a grasp are searched from, however many others are among them; a few are asked at a time."""

    def grasps(problem, task, *_):
        if task % 2:
            raise NoPlanFound("out of reach")
        return SimpleNamespace(task=task, promise=0.0, search=lasts())

    begun = []
    monkeypatch.setattr(attempts_, "from_start", grasps)
    monkeypatch.setattr(searches, "_coming_back", lambda problem, x: None)
    monkeypatch.setattr(searches, "_gaits", lambda problem, some, wanted: [])
    monkeypatch.setattr(searches, "_in_turn", lambda a, b, failures, *_, **__: begun.append(failures) or iter(()))
    assert list(searches.from_grasps(problem_of(None), list(range(40)), Grasp(), [], [])) == []
    assert len(begun[0]) == searches.START_POSES


@pytest.mark.parametrize(
    ("lasting", "begun"),
    [
        ({0: 0.1, 2: 0.1}, [2, 0, 3, 1]),
        ({0: 0.2, 2: 0.1}, [0, 2, 3, 1]),  # what is pressed less lightly
        ({7: 0.0}, [7, 6, 5, 4, 3, 2]),
        ({}, [15, 14, 13, 12, 11, 10]),
    ],
)
def test_a_few_starts_do_where_a_grasp_of_one_lasts_and_these_come_first(monkeypatch, lasting, begun):
    def grasps(problem, task, *_):
        return SimpleNamespace(task=task, promise=task, search=lasts(lasting.get(task, -np.inf)))

    some = []
    monkeypatch.setattr(attempts_, "from_start", grasps)
    monkeypatch.setattr(searches, "_coming_back", lambda problem, x: None)
    monkeypatch.setattr(searches, "_gaits", lambda problem, some, wanted: [])
    monkeypatch.setattr(searches, "_in_turn", lambda problem, these, *_, **__: some.extend(these) or iter(()))
    assert list(searches.from_grasps(problem_of(None), list(range(40)), Grasp(), [], [])) == []
    assert [x.task for x in some] == begun


@pytest.mark.parametrize(
    ("ticks", "fineness", "gaits", "enough"),
    [
        (searches.LONG_TICKS - 1, 1, False, np.inf),
        (searches.LONG_TICKS, 1, False, 1),
        (searches.LONG_TICKS, 2, False, np.inf),
        (4 * searches.LONG_TICKS, 1, True, np.inf),
    ],
)
def test_on_long_ways_without_a_gait_further_starts_wait_until_no_search_is_left(
    monkeypatch, ticks, fineness, gaits, enough
):
    begun = []
    attempt = SimpleNamespace(task=0, promise=0.0, ease=0, search=lasts(ticks=ticks, fineness=fineness))
    monkeypatch.setattr(attempts_, "from_start", lambda *_: attempt)
    monkeypatch.setattr(searches, "_coming_back", lambda problem, x: x if gaits else None)
    monkeypatch.setattr(searches, "_gaits", lambda problem, some, wanted: [])
    monkeypatch.setattr(searches, "_in_turn", lambda *_, enough: begun.append(enough) or iter(()))
    assert list(searches.from_grasps(problem_of(None), [0], Grasp(), [], [])) == []
    assert begun == [enough]


@pytest.mark.parametrize(
    ("lasting", "tried"),
    [
        ({0: 0.6, 1: 0.7, 2: 0.65, 3: 1.0, 4: 1.0}, [1, 2, 3]),  # until one lasts all the way
        ({0: 0.6} | dict.fromkeys(range(1, 40), 0.5), [*range(1, 1 + attempts_.STARTS_BESIDE)]),  # none is better
        ({0: 0.6, 5: 0.61} | dict.fromkeys([1, 2, 3, 4, *range(6, 40)], 0.1), [*range(1, 6 + attempts_.STARTS_BESIDE)]),
        ({0: attempts_.NEARLY_LASTING_SHARE - 0.01, 1: 1.0}, []),
        ({0: 1.0, 1: 1.0}, []),
        ({}, []),
    ],
)
def test_starts_beside_the_best_are_tried_as_long_as_they_get_better(monkeypatch, lasting, tried):
    def attempt(k: int) -> SimpleNamespace:
        search = SimpleNamespace(lasting=lasting[k], straight=lasting[k] == 1.0)
        return SimpleNamespace(task=k, search=search)

    asked, beside = [], []
    monkeypatch.setattr(attempts_, "BESIDE_AT_ONCE", 1)
    monkeypatch.setattr(attempts_, "from_start", lambda problem, task, *_: asked.append(task) or attempt(task))
    monkeypatch.setattr(attempts_.start, "close_by", lambda task, clearance, rng: beside.append(task) or len(beside))
    free = [attempt(0)] if lasting else []
    found = attempts_.starts_beside(problem_of("auto"), free, Grasp(), [], [])
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
    spent, reached = attempts_.STALLED_EXPANSIONS, reached or {}

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
    monkeypatch.setattr(attempts_, "PROMISING_STARTS", promising)
    monkeypatch.setattr(attempts_, "OFFERED_A_ROUND", a_round)
    monkeypatch.setattr(attempts_, "from_start", attempt)
    monkeypatch.setattr(attempts_, "_turned", lambda *_: turned or None)
    monkeypatch.setattr(attempts_, "gait_of", lambda problem, x, wanted: f"gait {x.task}" if x.task in gaits else None)
    monkeypatch.setattr(attempts_.start, "close_by", lambda task, *_: beside.append(task) or 9 + len(beside))
    tasks, free = iter(range(1, 1 + offered)), [attempt(None, 0)]
    more = attempts_.further_starts(problem_of("auto"), tasks, free, Grasp(), [], [], gaits=coming_back)
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
    little = attempts_.NEARLY_LASTING_SHARE - 0.01
    more, beside, _ = further(monkeypatch, {0: little}, {}, {0: little})
    assert numbers(more, 9) == [[]] * 3, "of all that are offered"
    assert beside == []


def test_what_is_beside_the_search_that_got_farthest_joins_where_that_has_stalled(monkeypatch):
    """However little it promises; what has just begun, or still gets farther, is left to itself."""
    more, beside, _ = further(monkeypatch, {}, {}, {}, offered=0, reached={0: 0.4, 11: 0.6, 12: 0.5})
    assert numbers(more, 4) == [[10], [11], [12], [13]]
    assert beside == [0, 0, 11, 11]
    monkeypatch.setattr(attempts_, "STALLED_EXPANSIONS", attempts_.STALLED_EXPANSIONS + 1)
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
    monkeypatch.setattr(attempts_.start, "close_by", lambda task, clearance, rng, share: shares.append(share) or 99)
    numbers(more, 30)
    assert shares[2::3] == [1.0] * 10, "beside that whose grasp nearly lasts"
    near = [share for k, share in enumerate(shares) if k % 3 != 2]
    assert 0.5**attempts_.MOST_HALVINGS <= min(near) < 0.25
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


def test_starts_after_the_first_few_come_in_the_order_of_how_long_contacts_last_there(monkeypatch):
    asked = []
    monkeypatch.setattr(attempts_, "from_start", lambda problem, task, *_: asked.append(task) or grasp_of(task))
    monkeypatch.setattr(searches, "may_touch", lambda problem, wanted: frozenset())
    monkeypatch.setattr(searches, "most_enduring_first", lambda problem, tasks, *_: tasks[::-1])
    monkeypatch.setattr(searches, "_coming_back", lambda problem, x: None)
    monkeypatch.setattr(searches, "_gaits", lambda problem, some, wanted: [])
    monkeypatch.setattr(searches, "_in_turn", lambda *_, **__: iter(()))
    assert list(searches.from_grasps(problem_of(None), list(range(7)), Grasp(), ["a step"], [])) == []
    assert asked == [0, 1, 2, 3, 6, 5, 4]


def grasp_of(task: int) -> SimpleNamespace:
    return SimpleNamespace(task=task, promise=task, search=lasts(), gait=None)


def test_of_a_further_start_a_period_is_looked_for_too(monkeypatch):
    """Beside the next round, if it joined; unless there is a gait already, or no period."""
    some = [grasp_of(k) for k in range(4)]
    some[1].gait = "gait"
    monkeypatch.setattr(searches, "_coming_back", lambda problem, x: None if x.task == 2 else f"back {x.task}")

    def offer(k: int) -> Offer:
        return Offer(calls=[lambda: some[k]], joining=lambda found: [x for x in found if x is not some[3]])

    offers = searches._also_coming_back(ENDLESS, iter([offer(k) for k in (3, 1, 2, 3, 0)]))
    found = [y.joining([call() for call in y.calls]) for y in offers]
    assert found == [[], [some[1]], [some[2]], [], [some[0]], ["back 0"]], "also of the last"


def test_a_start_promises_what_its_first_grasp_does_whatever_becomes_of_it():
    t = task("trio", "cube", turn(90.0))
    problem = Problem.of(t, Hand.load(t.hand), lambda _: None)
    x = attempts_.from_start(problem, t, problem.builder(t), Grasp(), t.motion[1:], [])
    first = next(iter(x.search.starts))
    x.search.starts.clear()
    assert x.staying == grasp.staying(x.search.moves, [first])[0]
    assert x.promise == pytest.approx(first.score + LASTING_SCORE * x.staying)


@pytest.mark.skipif(CORES == 1, reason="side by side takes two cores")
def test_starts_are_prepared_side_by_side(monkeypatch):
    both = Barrier(2, timeout=30.0)
    monkeypatch.setattr(attempts_, "from_start", lambda problem, task, *_: (both.wait() and task) or task)
    assert attempts_.from_starts(problem_of("auto"), [1, 2, 3, 4], Grasp(), [], []) == [1, 2, 3, 4]


def test_the_scene_is_asked_by_one_at_a_time(monkeypatch):
    """It has one state: where another has put hand and object would be answered for."""
    t = task("trio", "cube", turn(90.0))
    problem, asked = Problem.of(t, Hand.load(t.hand), lambda _: None), []
    monkeypatch.setattr(grasp, "check_palm", lambda *_: asked.append(problem.scene_free.locked()))
    attempts_.from_starts(problem, [t, t], Grasp(), t.motion[1:], [])
    assert asked == [True, True]
    assert not problem.scene_free.locked()


def test_no_period_is_looked_for_where_the_hand_can_get_to_no_grasp(monkeypatch):
    """As further searches find out while others take turns."""
    monkeypatch.setattr(searches.Period, "of", lambda *_: SimpleNamespace(ticks=9))
    problem = SimpleNamespace(clearance=SimpleNamespace(surface=None, p_OCom=None))
    search = SimpleNamespace(starts={}, moves=SimpleNamespace(path=None))
    assert searches._coming_back(problem, SimpleNamespace(search=search)) is None


@pytest.mark.parametrize(("straight", "asked"), [(False, ["gaits", "beside"]), (True, [])])
def test_starts_beside_are_tried_after_gaits_and_only_where_no_grasp_lasts(monkeypatch, straight, asked):
    def grasps(problem, task, *_):
        return SimpleNamespace(task=task, promise=task, search=lasts(0.1) if straight else lasts())

    told = []
    monkeypatch.setattr(attempts_, "from_start", grasps)
    monkeypatch.setattr(searches, "_coming_back", lambda problem, x: None)
    monkeypatch.setattr(searches, "_gaits", lambda problem, some, wanted: told.append("gaits") or [])
    monkeypatch.setattr(searches, "starts_beside", lambda problem, *_: told.append("beside") or [])
    monkeypatch.setattr(searches, "_in_turn", lambda *_, **__: iter(()))
    assert list(searches.from_grasps(problem_of("auto"), list(range(40)), Grasp(), [], [])) == []
    assert told == asked


def test_a_start_beside_without_a_grasp_is_passed_over(monkeypatch):
    first = SimpleNamespace(task=0, search=SimpleNamespace(lasting=0.5, **vars(lasts())))

    def none(*_):
        raise NoPlanFound("out of reach")

    monkeypatch.setattr(attempts_, "from_start", none)
    monkeypatch.setattr(attempts_.start, "close_by", lambda task, *_: task)
    assert attempts_.starts_beside(problem_of("auto"), [first], Grasp(), [], []) == []


def test_gaits_are_looked_for_first_where_the_grasp_can_spare_most_fingers(monkeypatch):
    def attempt(task: int, **search) -> SimpleNamespace:
        """Of a start with a grasp that so many fingers can leave."""
        search = SimpleNamespace(**vars(lasts()), **search)
        return SimpleNamespace(task=task, promise=0.0, search=search, ease=task)

    begun = []
    monkeypatch.setattr(attempts_, "from_start", lambda problem, task, *_: attempt(task, period=None))
    monkeypatch.setattr(searches, "_coming_back", lambda problem, x: attempt(x.task, period="one"))
    monkeypatch.setattr(searches, "_gaits", lambda problem, some, wanted: [])
    monkeypatch.setattr(searches, "_in_turn", lambda problem, some, *_, **__: begun.extend(some) or iter(()))
    assert list(searches.from_grasps(problem_of(None), [2, 5, 4], Grasp(), [], [])) == []
    assert [x.task for x in begun if x.search.period] == [5, 4, 2]
    assert [x.task for x in begun if not x.search.period] == [2, 5, 4]


def test_what_follows_a_hand_over_is_looked_for_from_both_ends_too(monkeypatch):
    asked = []
    monkeypatch.setattr(
        searches, "meeting_of", lambda *args: asked.append(args[2].wanted) or attempts_.meeting_of(*args)
    )
    first, then = ["left_1", "left_2", "right_2"], ["left_1", "right_1", "right_2"]
    steps = [Step(grasp=Grasp(fingers=first)), Step(grasp=Grasp(fingers=then)), move(0.0, 0.0, 3.0)]
    found = next(find_paths(msgspec.structs.replace(task("quartet", "cylinder"), motion=steps)))
    assert asked == [None], "of the motion, not of the hand-over"
    assert set(found.legs[-1].p_OP) == set(then)


@pytest.mark.parametrize(("limit", "ends"), [(10.0, 9.0), (60.0, 54.0), (600.0, 594.0)])
def test_searching_ends_early_enough_for_the_reason_to_be_within_the_time_limit(limit, ends):
    some = object.__new__(Problem)
    some.started, some.task = 100.0, SimpleNamespace(options=Options(time_limit_s=limit))
    assert some.deadline == 100.0 + ends
    assert some.late == 100.0 + (ends + limit) / 2


def test_what_goes_on_beside_a_stage_on_another_core_is_not_counted_again():
    """A plan's times said once that all but the gait, the search and so on had taken -19 s."""
    some, told = object.__new__(Problem), []
    some.started, some.stages, some.progress, some._within_stage = 0.0, {}, told.append, False

    def gait() -> None:
        with some.stage("gait"):
            time.sleep(0.02)

    with some.stage("search"):
        at_once([gait, gait])
    gait()
    assert some.stages["search"] >= 0.02
    assert list(some.stages) == ["search", "gait"]
    assert [x.stage for x in told] == ["search", "gait"], "that there is no other beside it"
