"""From how many starts searches and gaits begin, and which gait is taken."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from drake_hand.errors import NoPlanFound
from drake_hand.planning import attempts as attempts_
from drake_hand.planning import searches
from drake_hand.planning.planner import find_paths
from drake_hand.planning.turns import Offer
from drake_hand.plans.task import Grasp, Step
from tests.planning.small import move, problem_of, task

ENDLESS = SimpleNamespace(deadline=np.inf)


def attempts(angle_deg: float, regrasps: list[int | None]) -> list:
    """Attempts from starts whose gaits, if any, take so many regrasps to turn the object by an angle."""
    path = SimpleNamespace(angle=np.radians(angle_deg))
    search = SimpleNamespace(moves=SimpleNamespace(path=path))
    return [SimpleNamespace(search=search, gait=n and SimpleNamespace(regrasps=n)) for n in regrasps]


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
    ("ticks", "fineness", "gaits", "waiting"),
    [
        (searches.LONG_TICKS - 1, 1, False, False),
        (searches.LONG_TICKS, 1, False, True),
        (searches.LONG_TICKS, 2, False, False),
        (4 * searches.LONG_TICKS, 1, True, False),
    ],
)
def test_on_long_ways_without_a_gait_further_starts_wait_until_no_search_is_left(
    monkeypatch, ticks, fineness, gaits, waiting
):
    begun = []
    attempt = SimpleNamespace(task=0, promise=0.0, ease=0, search=lasts(ticks=ticks, fineness=fineness))
    monkeypatch.setattr(attempts_, "from_start", lambda *_: attempt)
    monkeypatch.setattr(searches, "_coming_back", lambda problem, x: x if gaits else None)
    monkeypatch.setattr(searches, "_gaits", lambda problem, some, wanted: [])
    monkeypatch.setattr(searches, "_in_turn", lambda *_, waiting: begun.append(waiting) or iter(()))
    assert list(searches.from_grasps(problem_of(None), [0], Grasp(), [], [])) == []
    assert begun == [waiting]


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
