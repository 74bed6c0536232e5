"""Several searches from several starts: a slice each at first, then more for those that get farther.

Which of them works does not depend on the number of cores or on how fast they are, so that plans are repeatable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from drake_hand.errors import NoPlanFound
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.meeting import Meeting
from drake_hand.planning.search import Search
from drake_hand.planning.state import Node
from drake_hand.planning.world import at_once
from drake_hand.plans.task import Task

SLICE_EXPANSIONS = 20
"""States expanded before it is another search's turn."""
FARTHER_SHARE = 0.02
"""Of the motion: a search that has not got so much farther has stalled since."""
SEARCHES_AT_ONCE = 2
"""Searches at work side by side, however many cores there are: so that plans do not depend on the machine."""


@dataclass(kw_only=True, eq=False)
class Attempt:
    """A search, and what it starts from."""

    task: Task
    """With its start and gravity."""
    builder: LegBuilder
    search: Search
    ease: int = 0
    """Fingers that can leave the grasp that it is to come back to."""
    staying: float = 0.0
    """Share of the motion for which the fingers that its first grasp cannot spare keep their contacts."""
    promise: float = 0.0
    """How promising it was before anything was expanded."""
    gait: Node | None = None
    """The end of a gait of equal strokes."""
    meeting: Meeting | None = None
    """Of the search with one from the end of its path."""
    _farther: tuple[float, int] = (0.0, 0)
    """How far it had got when it last got farther, and its expansions then."""

    def run(self, budget: int, deadline: float) -> Node | None:
        """Expands so many states, of both searches where there are two."""
        end = (self.meeting or self.search).run(budget, deadline)
        if self.reached > self._farther[0] + FARTHER_SHARE:
            self._farther = self.reached, self.expansions
        return end

    @property
    def expansions(self) -> int:
        """States expanded so far."""
        back = self.meeting.back if self.meeting else None
        return self.search.expansions + (back.expansions if back else 0)

    def failure(self, status: Literal["infeasible", "timeout"]) -> NoPlanFound:
        """Why there is none: what blocks the state that got farthest, and whether there is no grasp where it ends."""
        why = self.search.failure(status)
        if self.meeting is None or not self.meeting.no_grasp:
            return why
        reason = f"{why.reason}; and where the motion ends, {self.meeting.no_grasp}"
        return NoPlanFound(reason, status=status, evidence=why.evidence)

    @property
    def reached(self) -> float:
        """Share of the motion, or of the period that a gait would repeat; of two searches the mean of theirs."""
        far = self.search.goal_fraction
        return (far + self.meeting.back.fraction) / 2 if self.meeting and self.meeting.back else far

    @property
    def stalled(self) -> int:
        """States expanded since it last got farther."""
        return self.expansions - self._farther[1]

    @property
    def effort(self) -> float:
        """Its cost so far, relative to how far it got; zero while that is unknown.

        Mostly what it cost since it last got farther; not so where it is to come back, which is not seen in that.
        """
        cost = self.expansions if self.search.period else 2 * self.stalled + self.expansions / 4
        return cost / (0.3 + self.reached) ** 3


Joining = Callable[[list[Attempt | None]], list[Attempt]]
"""Those of what was prepared that take turns from then on."""


@dataclass(frozen=True, kw_only=True)
class Offer:
    """Attempts that are prepared while others are at work."""

    calls: Sequence[Callable[[], Attempt | None]]
    """Prepare one each, side by side; None where there is none."""
    joining: Joining


def in_turn(
    attempts: list[Attempt],
    failures: list[NoPlanFound],
    further: Iterator[Offer],
    out_of_time: Callable[[], bool],
    deadline: float,
    waiting: bool = False,
) -> Iterator[list[tuple[Attempt, Node]]]:
    """Rounds of searching; what each found.

    Args:
        attempts: any number.
        failures: of attempts that were not even begun.
        further: attempts to add, some beside each round that follows one in which one got no farther.
        out_of_time: asked before each round.
        deadline: on the monotonic clock.
        waiting: whether further attempts wait until none is at work.

    Raises:
        NoPlanFound: time is up, or nothing was found and nothing is left to try.
    """
    found = behind = False
    while not out_of_time():
        live = sorted((x for x in attempts if not x.search.exhausted), key=lambda x: x.effort)
        offer = next(further, None) if behind and not (waiting and live) else None
        if not live and offer is None:
            break
        now = live[:SEARCHES_AT_ONCE]
        runs: list[Callable[[], Any]] = [partial(x.run, SLICE_EXPANSIONS, deadline) for x in now]
        ends = at_once([*runs, *(offer.calls if offer else ())])
        if offer is not None:
            attempts += offer.joining(ends[len(runs) :])
        done = [(x, end) for x, end in zip(now, ends[: len(runs)], strict=True) if end is not None]
        yield done
        found |= bool(done)
        for x, _ in done:
            x.search.restart()  # what was found did not do, nor would what is much like it
        behind = not done and any(x.stalled for x in now)
    late = out_of_time()
    if not found or late:
        failures = failures + [x.failure("timeout" if late else "infeasible") for x in attempts]
        raise max(failures, key=lambda e: e.progress)
