"""Search over the hybrid automaton: best-first over states, in bins of progress.

A state is expanded by strokes, which carry the object on, and by switches of the fingers that have the least room left.
States are kept in bins of progress, and the next one is mostly taken from the farthest bins, which count as less far
the longer they lead nowhere, so that no dead end holds up the search. Within a bin the best score goes first; it is
lowered each time a similar state has been tried.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning.ease import at_ease
from drake_hand.planning.grasp import FIRM_FINGERS
from drake_hand.planning.moves import SHORT_ROOM_SHARE, Moves, offset_ticks
from drake_hand.planning.period import Period
from drake_hand.planning.slide import draw_slides
from drake_hand.planning.state import Node, Stroke
from drake_hand.planning.strokes import draw_strokes, onward
from drake_hand.planning.stuck import stuck
from drake_hand.planning.switches import draw_retreats, draw_switches
from drake_hand.plans.progress import Progress

BIN_TICKS = 2.0
"""Ticks of progress that share a bin."""
FARTHEST_CHANCE = 0.35
"""Chance that a state is taken from the farthest bin, then from the next, and so on ..."""
ANYWHERE_CHANCE = 0.1
"""... and that it is taken from any."""
BIN_EXPANSIONS = 10
"""A bin counts as one bin less far each time so many of its states were expanded: it may be a dead end."""
NICHE_PENALTY = 0.15
"""By how much a score is lowered each time a state of its niche was expanded."""
NICHE_M = 0.012
"""States whose contacts are as near as this share a niche, m."""
NOWHERE = 999
"""The cell of a finger that does not touch."""
BIN_CAPACITY, BIN_KEPT = 300, 200
"""A bin that has more states than the first keeps as many as the second."""
FINGERS_SWITCHED = 2
"""Fingers whose switches are worked out in one expansion."""
FINGERS_SLID = 1
"""Fingers whose slides are worked out in one expansion, of those short of room that have no switch."""
SELDOM_LIFTABLE_SHARE = 0.25
"""A finger that can be lifted in a smaller share of the states in which it touches is switched first where it can."""
PERIOD_EXPANSIONS, PERIOD_GRASPS = 6, 4
"""Where a period ends, grasps whose switches are tried for others more at ease, and how many of these are kept."""
RETREAT_CHANCE = 0.2
"""Chance that a finger is asked to wait elsewhere."""
ALONE_SCORE = 2.0
"""What each newton counts that the wanted fingers have to spare, or are short of, without the others."""
UNWANTED_TICKS = 6.0
"""Ticks that a finger costs which has still to make or break contact at the end."""


@dataclass(kw_only=True)
class Search:
    """One search; continues where it stopped when run again."""

    moves: Moves
    wanted: frozenset[int] | None = None
    """Fingers that are to touch in the end, no others; any that hold the object if not given."""
    period: Period | None = None
    """Of the path: once a state has come back, the moves that led there are repeated."""
    able: Callable[[Node], bool] = lambda root: True
    """Whether the hand can get to a root; asked before what follows from it is expanded."""
    slides: bool = True
    """Whether fingers may slide."""
    progress: Callable[[Progress], None] = lambda p: None
    expansions: int = 0
    farthest: Node | None = None
    starts: dict[Node, None] = field(default_factory=dict)
    """What it starts from and has led to no answer yet: roots, or a few moves from one."""
    _bins: dict[int, list[Node]] = field(default_factory=dict)
    _tried: Counter[tuple[int, ...]] = field(default_factory=Counter)
    _expanded: Counter[int] = field(default_factory=Counter)
    _able: dict[int, tuple[Node, bool]] = field(default_factory=dict)
    _touched: np.ndarray | float = 0.0
    _liftable: np.ndarray | float = 0.0
    _started: float = field(default_factory=time.monotonic)

    def begin(self, states: list[Node]) -> None:
        """Adds states to start from."""
        self.starts.update(dict.fromkeys(states))
        self._add(states)

    def restart(self) -> None:
        """Starts over with other random draws, unless it has led to an answer."""
        self._bins.clear()
        self._tried.clear()
        self._expanded.clear()
        self._add(list(self.starts))

    def _add(self, states: list[Node]) -> None:
        if not states:
            return
        self._look_beyond(states)
        for x, progress, cells in zip(states, self._progress(states).tolist(), _cells(states), strict=True):
            x.progress = progress
            if self.farthest is None or x.progress > self.farthest.progress + 1e-9:
                self.farthest = x
            b = int(x.progress // BIN_TICKS)
            x.niche = (b, *cells)
            states_there = self._bins.setdefault(b, [])
            states_there.append(x)
            if len(states_there) > BIN_CAPACITY:
                states_there.sort(key=lambda x: -self._rank(x))
                del states_there[BIN_KEPT:]

    def _look_beyond(self, states: list[Node]) -> None:
        """Scores how well the wanted fingers would hold the object by themselves, once all of them touch."""
        if self.wanted is None:
            return
        wanted = np.isin(np.arange(len(self.moves.clearance.hand.fingers)), sorted(self.wanted))
        some = [x for x in states if x.touching[wanted].all()]
        alone = [replace(x, touching=wanted) for x in some]
        self.moves.evaluate(alone, np.ones((len(alone), len(wanted))))
        for x, y in zip(some, alone, strict=True):
            x.score += ALONE_SCORE * max(float(y.margins[-1]), -1.0)

    def run(self, budget: int, deadline: float) -> Node | None:
        """Expands so many states, or until time is up (monotonic clock) or nothing is left.

        Returns:
            A state at the goal, taken out so that asking again gives another; None where none was found.
        """
        rng, goal = self.moves.rng, self.moves.path.ticks
        last = self.expansions + budget
        if not self.expansions and (answer := self._arrived(self._onward)) is not None:
            self._onward.remove(answer)
            self._add([answer])
            return self._answer(answer)
        while self.expansions < last and self._bins and time.monotonic() < deadline:
            bins = sorted(self._bins, key=lambda b: b - self._expanded[b] / BIN_EXPANSIONS, reverse=True)
            k = min(int(rng.geometric(FARTHEST_CHANCE)) - 1, len(bins) - 1)
            if rng.random() < ANYWHERE_CHANCE:
                k = int(rng.integers(len(bins)))
            state = max(self._bins[bins[k]], key=self._rank)
            at_goal = state.progress >= goal - 1e-9
            # A root is asked when something has come of it: few of them lead on, and asking plans the hand's closing.
            if (at_goal or state.parent is not None) and not self.can_begin(state):
                self._forget(state.chain[0])
                continue
            if at_goal:
                return self._answer(state)
            self._expanded[bins[k]] += 1
            self._tried[state.niche] += 1
            self.expansions += 1
            children = self._children(state)
            if self.expansions == 1:
                self.moves.evaluate(self._onward)
                children += self._onward
            easier, ends = self._repeated(children)
            children += easier + ends
            self._add(children)
            self._tell()
            if (answer := self._arrived(children)) is not None:
                return self._answer(answer)
        return None

    def _arrived(self, states: list[Node]) -> Node | None:
        """The state at the goal with the fewest regrasps, held firmly if one is, of those whose root can be got to.

        Of equals that with the largest margin: what is pressed lightly is lost when the object is a little off.
        """
        if not states:
            return None
        done = list(itertools.compress(states, self._progress(states) >= self.moves.path.ticks - 1e-9))
        self.moves.evaluate([x for x in done if not len(x.n_W)])
        done.sort(key=lambda x: (x.regrasps, not self._firm(x), -self._margin(x)))
        return next(filter(self.can_begin, done), None)

    def _firm(self, x: Node) -> bool:
        """Whether as many fingers touch as hold an object firmly, or as may touch."""
        return self.moves.load.kinematic or x.touching.sum() >= min(FIRM_FINGERS, len(self.moves.fingers))

    def _margin(self, x: Node) -> float:
        """The least margin with which the states on the way to one hold the object, as far as it counts."""
        return min(float(y.margins[-1]) for y in x.chain if len(y.n_W))

    def _answer(self, x: Node) -> Node:
        """Removes a state at the goal; another search begins with another grasp, where there is one."""
        others = {y: None for y in self.starts if y.chain[0] is not x.chain[0]}
        if others or x in self.starts:
            self.starts = others
        return self._take(x)

    def _take(self, x: Node) -> Node:
        """Removes a state."""
        b = int(x.progress // BIN_TICKS)
        self._bins[b].remove(x)
        if not self._bins[b]:
            del self._bins[b]
        return x

    def _forget(self, root: Node) -> None:
        """Removes a root that the hand cannot get to, and all that follows from it."""
        self.starts = {y: None for y in self.starts if y.chain[0] is not root}
        kept = {b: [x for x in states if x.chain[0] is not root] for b, states in self._bins.items()}
        self._bins = {b: states for b, states in kept.items() if states}
        left = itertools.chain.from_iterable(self._bins.values())
        self.farthest = max(left, key=lambda x: x.progress, default=self.farthest)

    def best(self, count: int) -> list[Node]:
        """So many of its states, the best of each part of the path first, then the second best."""
        ranked = [sorted(states, key=self._rank, reverse=True) for states in self._bins.values()]
        turns = itertools.chain.from_iterable(itertools.zip_longest(*ranked))
        return list(itertools.islice((x for x in turns if x is not None), count))

    def can_begin(self, x: Node) -> bool:
        """Whether the hand can get to the root of a state; asked once for each."""
        root = x.chain[0]
        if id(root) not in self._able:
            self._able[id(root)] = root, self.able(root)
        return self._able[id(root)][1]

    @property
    def exhausted(self) -> bool:
        """Whether there is nothing left to expand."""
        return not self._bins

    @property
    def straight(self) -> bool:
        """Whether the object reaches the goal without a switch, held firmly, from a start that the hand can get to."""
        return self.straight_margin > -np.inf

    @property
    def straight_margin(self) -> float:
        """The least margin with which it is held on that way; minus infinity where there is none."""
        answer = self._arrived(self._onward)
        return self._margin(answer) if answer is not None and self._firm(answer) else -np.inf

    @property
    def lasting(self) -> float:
        """Share of the motion that the object gets from a start without a switch."""
        return max((x.s for x in self._onward), default=0.0) / max(self.moves.path.ticks, 1)

    @property
    def fraction(self) -> float:
        """Share of the motion that was reached."""
        return 0.0 if self.farthest is None else self._share(self.farthest)

    @property
    def goal_fraction(self) -> float:
        """Share of the search's goal that was reached: of the motion, or of the period that a gait would repeat."""
        return min(1.0, self.fraction * (self.period.count if self.period else 1))

    @property
    def founded(self) -> bool:
        """Whether the hand can get to the root of the state that got farthest."""
        return self.farthest is not None and self.can_begin(self.farthest)

    def _children(self, state: Node) -> list[Node]:
        rng = self.moves.rng
        children = draw_strokes(self.moves, state)
        self.moves.evaluate(children)
        urge = np.where(state.touching, state.room, 0.5) + rng.uniform(0, 0.5, len(state.touching))
        for x in children:
            self._touched = self._touched + x.touching
            self._liftable = self._liftable + x.liftable
        urge -= state.liftable & (self._liftable < SELDOM_LIFTABLE_SHARE * self._touched)
        urge[[f not in self.moves.fingers for f in range(len(urge))]] = np.inf
        for f in self.wanted or ():
            urge[f] -= 0.0 if state.touching[f] else 1.0
        children += self._contacts_changed(
            state, [int(f) for f in np.argsort(urge, kind="stable") if np.isfinite(urge[f])]
        )
        unwanted = [] if self.wanted is None else [f for f in np.flatnonzero(state.touching) if f not in self.wanted]
        if unwanted:
            children += draw_retreats(self.moves, state, int(rng.choice(unwanted)))
        elif rng.random() < RETREAT_CHANCE:
            children += draw_retreats(self.moves, state, int(rng.integers(len(state.touching))))
        return children

    def _contacts_changed(self, state: Node, fingers: list[int]) -> list[Node]:
        """States in which one of these fingers, the first before the others, has another contact."""
        out: list[Node] = []
        switched, slid = 0, 0
        for f in fingers:
            found: list[Node] = []
            if state.liftable[f] or not state.touching[f]:
                if switched == FINGERS_SWITCHED:
                    continue
                switched, found = switched + 1, draw_switches(self.moves, state, f)
            stays = state.touching[f] and state.room[f] < SHORT_ROOM_SHARE and not found
            if stays and slid < FINGERS_SLID and self.slides:
                slid, found = slid + 1, draw_slides(self.moves, state, f)
            out += found
        return out

    def _repeated(self, children: list[Node]) -> tuple[list[Node], list[Node]]:
        """The states most at ease at which a period ends; and the states at the goal that gaits lead to."""
        if self.period is None:
            return [], []
        ended = [x for x in children if self.period.ended(x)]
        strokes = [x for x in ended if isinstance(x.move, Stroke)]
        best = sorted(strokes, key=lambda x: (x.spared, x.score))[-1:]
        easier = at_ease(self.moves, best, expansions=PERIOD_EXPANSIONS, most=PERIOD_GRASPS)
        easier = [x for x in easier if x not in best]
        some = [x for x in ended if x not in strokes] + best + easier
        ends = [self.period.completed(self.moves, x) for x in some]
        return easier, [x for x in ends if x is not None and self.can_begin(x)]

    @cached_property
    def _onward(self) -> list[Node]:
        """Where the starts get to along the nominal path, for as long as that is not yet an answer."""
        return onward(self.moves, list(self.starts))

    def _progress(self, states: list[Node]) -> np.ndarray:
        s, stop = np.array([x.s for x in states]), np.array([self.moves.path.next_stop(x.s) for x in states])
        progress = stop - np.maximum(stop - s, offset_ticks(np.stack([x.off for x in states])))
        if self.wanted is not None:
            touching = np.stack([x.touching for x in states])
            wanted = np.isin(np.arange(touching.shape[1]), sorted(self.wanted))
            progress -= UNWANTED_TICKS * (touching != wanted).sum(axis=1)
        return progress

    def _share(self, x: Node) -> float:
        ticks = self.moves.path.ticks
        return float(np.clip(x.progress / ticks, 0.0, 1.0)) if ticks else float(x.progress >= 0)

    def _rank(self, x: Node) -> float:
        return x.score - NICHE_PENALTY * self._tried[x.niche]

    def _tell(self) -> None:
        best = self.farthest
        self.progress(
            Progress(
                stage="search",
                fraction=self.fraction,
                expansions=self.expansions,
                best_bound=0.0 if best is None else best.regrasps,
                elapsed_s=time.monotonic() - self._started,
            )
        )

    def failure(self, status: Literal["infeasible", "timeout"]) -> NoPlanFound:
        """Why there is no plan: the state that got farthest, and what each of its fingers lacks."""
        assert self.farthest is not None, "a search has starts"
        return stuck(self.moves, self.farthest, self._share(self.farthest), self.expansions, status)


def _cells(states: list[Node]) -> list[list[int]]:
    """Where the fingers of each touch, coarsely; which of its fingers do is part of that."""
    cells = np.round(np.stack([x.p_OP for x in states]) / NICHE_M).astype(int)
    cells[~np.stack([x.touching for x in states])] = NOWHERE
    return cells.reshape(len(states), -1).tolist()
