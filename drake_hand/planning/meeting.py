"""Searches from both ends of a path that meet: what gets stuck from one end is often easily come by from the other.

All moves can be made backwards: strokes roll back the way they came, and a finger lands where it lifted off. So a
second search begins at grasps where the path ends. The two meet halfway between a pose that one has reached and one
that the other has, where the fingers can go, one by one, from where the one has them to where the other does. ::

    start ──moves──▶ state ──Stroke──▶ ──Switch──▶ ... ──Switch──▶ ◀──Stroke── state ◀──moves── goal
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning.moves import Moves, offset_ticks
from drake_hand.planning.orders import have_order, switched_to
from drake_hand.planning.search import Search
from drake_hand.planning.state import FingerSwitch, Node, Stroke
from drake_hand.planning.strokes import carried_to
from drake_hand.planning.switches import path_pieces

APART_TICKS = 30.0
"""States as near as this are brought together, each of them halfway."""
STATES_LOOKED_AT = 300
"""Of each search, the most promising of all parts of the path."""
STROKES_TRIED = 100
"""Of states of either search towards each other, after each round."""
PATIENCE, MOST_RESTED = 4, 7
"""Rounds without an order in which fingers could switch; after that, for each of them, the search from the start has a
turn more to itself, up to so many. Where a finger can never be lifted there will be none."""
SPARED_COUNTED = 3
"""Of the fingers that a state can spare; more do not make it easier to meet."""


@dataclass(kw_only=True)
class Meeting:
    """A search from the start of a path, and one from its end that begins when the first has not got there at once."""

    forward: Search
    moves: Moves
    """Along the path from its end to its start."""
    grasps: Callable[[Moves], list[Node]]
    """That a search along given moves can start from."""
    waiting: np.ndarray | None = None
    """(n, m) where fingers wait that the first grasp does without; None where contacts are given to begin with."""
    fewest: int = 0
    """Fingers that the first grasp needs, where the search backwards finds it."""
    back: Search | None = None
    no_grasp: str = ""
    """Why there is no grasp where the path ends, if there is none."""
    _fruitless: int = 0
    """Rounds since there was such an order."""
    _resting: int = 0
    _tried: dict[tuple[int, int], tuple[Node, Node]] = field(default_factory=dict)

    def run(self, budget: int, deadline: float) -> Node | None:
        """As the search from the start by itself; after its first turn, both."""
        first = not self.forward.expansions
        end = self.forward.run(budget, deadline)
        if end is not None or first or self.forward.exhausted:
            return end
        if self._resting:
            self._resting -= 1
            return None
        if self.back is None:
            self.back = self._begun()
        arrived = self.back.run(budget, deadline)
        end = None if arrived is None else self._arrived(arrived)
        return self._met(self.back) if end is None else end

    def _begun(self) -> Search:
        search = Search(moves=self.moves, slides=False)
        try:
            search.begin(self.grasps(self.moves))
        except NoPlanFound as e:
            self.no_grasp = e.reason
        return search

    def _met(self, back: Search) -> Node | None:
        """A state at the goal, by way of one of each search."""
        moves, pairs = self.forward.moves, self._pairs(back)
        if not pairs:
            return None
        s = np.array([(x.s + moves.path.ticks - y.s) / 2 for x, y in pairs])
        off = np.stack([(x.off + y.off) / 2 for x, y in pairs])
        here = carried_to(moves, [x for x, _ in pairs], s, off)
        there = carried_to(back.moves, [y for _, y in pairs], moves.path.ticks - s, off)
        some = [(x, y, self._mirrored(y)) for x, y in zip(here, there, strict=True) if x and y]
        able = have_order(moves, [x for x, *_ in some], [z for *_, z in some])
        self._fruitless = 0 if able.any() else self._fruitless + 1
        self._resting = int(np.clip(self._fruitless - PATIENCE, 0, MOST_RESTED))
        for x, y, z in itertools.compress(some, able):
            if not len(x.n_W):
                moves.evaluate([x])
            if (end := switched_to(moves, x, z)) is not None and self.forward.can_begin(end):
                return self._on(end, y)
        return None

    def _arrived(self, y: Node) -> Node | None:
        """A state at the goal, by way of one at the start that the search backwards has got to."""
        if self.waiting is None or y.touching.sum() < self.fewest:
            return None
        there, moves = self._mirrored(y), self.forward.moves
        q = np.where(there.touching[:, None], there.q, self.waiting)
        root = replace(there, q=q)
        moves.evaluate([root])
        if root.margins[-1] < 0 or not self.forward.can_begin(root):
            return None
        end = switched_to(moves, root, there)
        return None if end is None else self._on(end, y)

    def _on(self, x: Node, y: Node) -> Node:
        """The state at the goal that follows from one that is like one of the search backwards."""
        for before, after in itertools.pairwise(y.chain[::-1]):
            move = _undone(self.forward.moves, before, after)
            again = isinstance(move, FingerSwitch) and before.touching[move.finger] and after.touching[move.finger]
            x = replace(self._mirrored(after), move=move, parent=x, regrasps=x.regrasps + int(again))
        return x

    def _mirrored(self, y: Node) -> Node:
        """A state of the search backwards as one of the other."""
        return replace(y, s=self.forward.moves.path.ticks - y.s, parent=None, move=None, regrasps=0)

    def _pairs(self, back: Search) -> list[tuple[Node, Node]]:
        """States of either search that are near each other, those first that can spare fingers; no state twice.

        Between them is no end of a step, where the object has to be on its nominal path.
        """
        xs, ys = self.forward.best(STATES_LOOKED_AT), back.best(STATES_LOOKED_AT)
        if not xs or not ys:
            return []
        path = self.forward.moves.path
        s_x, s_y = np.array([x.s for x in xs])[:, None], path.ticks - np.array([y.s for y in ys])
        first, last = np.minimum(s_x, s_y), np.maximum(s_x, s_y)
        passes = np.searchsorted(path.stops, first, side="right") < np.searchsorted(path.stops, last, side="left")
        off = np.stack([y.off for y in ys]) - np.stack([x.off for x in xs])[:, None]
        apart = np.maximum(last - first, offset_ticks(off))
        spared = [np.array([min(x.spared, SPARED_COUNTED) for x in some]) for some in (xs, ys)]
        value = spared[0][:, None] + spared[1] - apart / APART_TICKS
        value[passes | (apart > APART_TICKS) | (spared[0][:, None] == 0) | (spared[1] == 0)] = -np.inf
        out: list[tuple[Node, Node]] = []
        taken = set[int]()
        for k in np.argsort(-value, axis=None, kind="stable")[: int(np.isfinite(value).sum())]:
            x, y = (some[i] for some, i in zip((xs, ys), np.unravel_index(k, value.shape), strict=True))
            if len(out) == STROKES_TRIED:
                break
            if (id(x), id(y)) not in self._tried and not {id(x), id(y)} & taken:
                taken |= {id(x), id(y)}
                out.append((x, y))
        self._tried.update({(id(x), id(y)): (x, y) for x, y in out})
        return out


def backwards(moves: Moves, seed: int) -> Moves:
    """Along the same path from its end to its start. Pads that twist push back the other way."""
    path, load = moves.path, moves.load
    stops = (*sorted(path.ticks - stop for stop in path.stops if stop != path.ticks), path.ticks)
    there = replace(path, X_WO=np.ascontiguousarray(path.X_WO[::-1]), stops=stops, axis_W=None, point_W=None)
    load = load._replace(spin_arm=-load.spin_arm)
    return replace(moves, path=there, load=load, rng=np.random.default_rng(seed))


def _undone(moves: Moves, before: Node, after: Node) -> Stroke | FingerSwitch:
    """The move from a state of a search backwards to the one that it came from."""
    if isinstance(before.move, Stroke):
        return Stroke(X=np.ascontiguousarray(before.move.X[::-1]), q=np.ascontiguousarray(before.move.q[::-1]))
    assert isinstance(before.move, FingerSwitch), "searches backwards do not slide"
    ways = tuple(way[::-1] for way in path_pieces(moves, after, before)[::-1])
    return FingerSwitch(finger=before.move.finger, rise=-1, landing=-1, stop=-1, ways=ways)
