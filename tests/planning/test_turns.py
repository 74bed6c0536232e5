"""Which of several searches has the next turn, and when another start is looked for."""

from collections.abc import Iterator
from threading import Barrier

import numpy as np
import pytest

from drake_hand.planning.turns import FARTHER_SHARE, SLICE_EXPANSIONS, Attempt, Offer, in_turn
from drake_hand.planning.world import CORES


class _Search:
    """One that has got to some share of its goal from the start, and from there so much farther in each turn."""

    exhausted = False

    def __init__(self, goal_fraction: float, gain: float = 0.0, period: object = None) -> None:
        self.goal_fraction, self.gain, self.period, self.expansions = goal_fraction, gain, period, 0

    def run(self, budget: int, deadline: float) -> None:
        self.expansions += budget
        self.goal_fraction = min(1.0, self.goal_fraction + self.gain)


def begun(*searches: _Search) -> list[Attempt]:
    return [Attempt(task=None, builder=None, search=x) for x in searches]


def spent(some: list[Attempt], rounds: int) -> list[int]:
    """States that each has expanded after so many rounds."""
    turns = in_turn(some, [], iter(()), lambda: False, np.inf)
    for _ in range(rounds):
        next(turns)
    return [x.search.expansions for x in some]


@pytest.mark.parametrize("period", [None, "one"])
def test_every_search_begins_before_any_goes_on_and_then_the_farther_one_gets_more(period):
    some = begun(*(_Search(share, period=period) for share in (0.9, 0.2, 0.5, 0.2)))
    assert spent(some, 2) == [SLICE_EXPANSIONS] * 4
    far, near, middle, also = spent(some, 30)
    assert far > middle > 1.7 * near
    assert min(near, also) > SLICE_EXPANSIONS, "none is forgotten"


def test_a_search_that_still_gets_farther_goes_on_and_one_that_has_stalled_waits():
    rest = _Search(0.3), _Search(0.3), _Search(0.3)
    grows, *_ = spent(begun(_Search(0.2, gain=0.03), *rest), 22)
    assert grows >= 19 * SLICE_EXPANSIONS
    creeps, *_ = spent(begun(_Search(0.2, gain=FARTHER_SHARE / 40), *rest), 22)
    assert creeps < 15 * SLICE_EXPANSIONS, "by so little none gets anywhere"


def test_a_search_that_is_to_come_back_is_not_taken_to_have_stalled_where_its_period_ends():
    """Only how far it got counts, not when."""
    back, free = spent(begun(_Search(1.0, period="one"), _Search(0.9)), 2)
    assert back == free == 2 * SLICE_EXPANSIONS
    some = begun(_Search(1.0, period="one"), _Search(0.5), _Search(0.5))
    assert spent(some, 30)[0] >= 29 * SLICE_EXPANSIONS, "though it got no farther, and others have their turn as well"


def offering(*attempts: Attempt | None) -> Iterator[Offer]:
    """One a round, which joins where there is one."""
    return (Offer(calls=[lambda x=x: x], joining=lambda found: [x for x in found if x]) for x in attempts)


def test_a_further_start_is_prepared_beside_a_round_after_one_in_which_a_search_got_no_farther_and_has_its_turn():
    """Both begin, neither gets farther, none is there to join, one joins, and has its turn."""
    some, (late,) = begun(_Search(0.9), _Search(0.8)), begun(_Search(0.1))
    rounds = in_turn(some, [], offering(None, late), lambda: False, np.inf)
    for count, spent_late in ((2, 0), (2, 0), (2, 0), (3, 0), (3, SLICE_EXPANSIONS)):
        next(rounds)
        assert (len(some), late.search.expansions) == (count, spent_late)
    some = begun(_Search(0.0, gain=0.1), _Search(0.0, gain=0.1))
    rounds = in_turn(some, [], offering(late), lambda: False, np.inf)
    for _ in range(3):
        next(rounds)
    assert len(some) == 2, "all of them still get farther"


def test_where_all_searches_are_exhausted_what_is_prepared_goes_on():
    some, (late,) = begun(_Search(0.9)), begun(_Search(0.1))
    rounds = in_turn(some, [], offering(late), lambda: False, np.inf)
    next(rounds)
    next(rounds)
    some[0].search.exhausted = True
    next(rounds)
    next(rounds)
    assert late.search.expansions == SLICE_EXPANSIONS


def test_where_further_starts_wait_one_is_prepared_once_no_search_is_left():
    some, (late,) = begun(_Search(0.9), _Search(0.8)), begun(_Search(0.1))
    rounds = in_turn(some, [], offering(late), lambda: False, np.inf, waiting=True)
    for _ in range(5):
        next(rounds)
    some[0].search.exhausted = True
    next(rounds)
    assert len(some) == 2
    some[1].search.exhausted = True
    next(rounds)
    assert some[2:] == [late]


@pytest.mark.skipif(CORES == 1, reason="side by side takes two cores")
def test_further_starts_are_prepared_while_searches_are_at_work():
    both = Barrier(2, timeout=30.0)
    one, (late,) = begun(_Search(0.5)), begun(_Search(0.1))
    rounds = in_turn(one, [], iter([Offer(calls=[lambda: (both.wait() and None) or late], joining=list)]), bool, np.inf)
    next(rounds)
    next(rounds)
    one[0].search.run = lambda budget, deadline: both.wait() and None
    next(rounds)
    assert one[1:] == [late]
