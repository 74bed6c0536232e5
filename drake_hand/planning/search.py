"""Search over the hybrid automaton for the sequence of regrasps that carries the object along its path.

A node is (tick, holds): the mode and its contacts. Edges are the moves of `moves.py`: advance in this mode, then set
one finger down elsewhere while the others hold. Weighted A* on the number of regrasps; nodes, holds and transits are
made lazily. On a symmetric object a state that comes back closes a periodic gait, which is then repeated instead of
searched.
"""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.gait import Gait
from drake_hand.planning.moves import Limits, Moves, Node, chain
from drake_hand.planning.reach import Hold

WEIGHT = 1.5
"""Of the heuristic: above 1 goes for the end sooner at the price of at most that many times the regrasps."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where planning stands."""

    stage: str
    fraction: float = 0.0
    expansions: int = 0
    best_bound: float = 0.0
    """Regrasps the plan will need at least, as far as is known."""
    elapsed_s: float = 0.0


@dataclass
class Search:
    """One search; see the module."""

    moves: Moves
    deadline: float
    """When to give up (monotonic clock) ..."""
    patience: int | None = None
    """... or after how many expansions."""
    progress: Callable[[Progress], None] = lambda p: None
    expansions: int = 0

    def run(self, roots: list[list[Hold]]) -> list[Node]:
        """Finds the nodes from a root to the end of the path.

        Args:
            roots: grasps at tick 0.

        Returns:
            The nodes in order, a regrasp from each to the next.

        Raises:
            NoPlanFound: nothing left to try (``infeasible``) or out of time (``timeout``).
        """
        goal, started, tie = self.moves.goal, time.monotonic(), itertools.count()
        heap: list[tuple[float, int, int, Node]] = []
        for holds in roots:
            node = Node(tick=0, holds=tuple(holds))
            heapq.heappush(heap, (WEIGHT * self._to_go(node.holds), 0, next(tie), node))
        closed: set[tuple] = set()
        first = Node(tick=0, holds=tuple(roots[0]))
        nowhere = np.zeros((len(roots[0]), 0), dtype=bool)
        farthest = (-1, first, Limits(last=-1, liftable=nowhere, why="time limit"))
        while heap:
            f, _, _, node = heapq.heappop(heap)
            key = (node.tick, *((h.table, h.birth) for h in node.holds))
            if key in closed:
                continue
            closed.add(key)
            if time.monotonic() > self.deadline:
                raise self._failure("timeout", "out of time", farthest)
            if self.patience is not None and self.expansions >= self.patience:
                raise self._failure("timeout", f"gave up after {self.patience} nodes", farthest)
            if node.parent is not None and node.points is None:
                ways = self.moves.transit(node)
                if ways is None:
                    continue
                node = replace(node, ways=ways)
            limits = self.moves.limits(node)
            self.expansions += 1
            if limits.last > farthest[0]:
                farthest = (limits.last, node, limits)
            self.progress(
                Progress(
                    stage="search",
                    fraction=max(farthest[0], 0) / max(goal, 1),
                    expansions=self.expansions,
                    best_bound=f / WEIGHT,
                    elapsed_s=time.monotonic() - started,
                )
            )
            if limits.last >= goal:
                return chain(node)
            if self.moves.reach.symmetric:
                repeated = self._repeat(node)
                if repeated is not None:
                    return repeated
            for child, bonus in self.moves.children(node, limits):
                rank = child.g + WEIGHT * self._to_go(child.holds) + bonus
                heapq.heappush(heap, (rank, -child.tick, next(tie), child))
        raise self._failure("infeasible", "nothing left to try", farthest)

    def _to_go(self, holds: tuple[Hold, ...]) -> float:
        """Regrasps still needed: every finger has to be set down again until it lasts to the end."""
        return sum(map(self.moves.regrasps_left, holds))

    def reaches(self, holds: list[Hold]) -> int:
        """Tick up to which a grasp at tick 0 carries the object without a regrasp."""
        return self.moves.limits(Node(tick=0, holds=tuple(holds))).last

    def periodic(self, gait: Gait) -> list[Node] | None:
        """The nodes of a periodic gait up to the goal, if its advance and its transits are clear and hold throughout.

        Args:
            gait: of a symmetric object.
        """
        goal = self.moves.goal
        node = Node(tick=0, holds=gait.holds)
        if self.moves.limits(node).last < min(gait.stroke, goal):
            return None
        if gait.stroke >= goal:
            return [node]
        for slot in gait.order:
            holds = list(node.holds)
            holds[slot] = replace(holds[slot], birth=gait.stroke)
            child = Node(tick=gait.stroke, holds=tuple(holds), g=node.g + 1, parent=node, slot=slot)
            ways = self.moves.transit(child)
            if ways is None or self.moves.limits(child).last < gait.stroke:
                return None
            node = replace(child, ways=ways)
            self.expansions += 1
        return self._repeat(node)

    def _repeat(self, node: Node) -> list[Node] | None:
        """If this configuration occurred before, the periodic gait from there on, up to the goal."""
        walk = node.parent
        while walk is not None and not (walk.tick < node.tick and walk.signature == node.signature):
            walk = walk.parent
        if walk is None:
            return None
        nodes = chain(node)
        period, cycle = node.tick - walk.tick, nodes[nodes.index(walk) + 1 :]
        at, turn = node, 1
        while True:
            for step in cycle:
                tick = step.tick + turn * period
                if min(h.end for h in at.holds) >= self.moves.goal or tick >= self.moves.goal:
                    return nodes
                holds = tuple(replace(h, birth=h.birth + turn * period) for h in step.holds)
                at = Node(
                    tick=tick, holds=holds, g=at.g + 1, parent=at, slot=step.slot, ways=step.ways, points=step.points
                )
                nodes.append(at)
            turn += 1

    def _failure(
        self, status: Literal["infeasible", "timeout"], what: str, farthest: tuple[int, Node, Limits]
    ) -> NoPlanFound:
        last, node, limits = farthest
        hand, path = self.moves.reach.clearance.hand, self.moves.reach.path
        tick = min(max(last, 0), path.ticks)
        finger = self.moves.name(node.holds[limits.slot]) if limits.slot is not None else None
        reason = f"{what} at {100 * tick / max(path.ticks, 1):.0f} % of the motion"
        if limits.liftable.size:
            blocked = [self.moves.name(h) for s, h in enumerate(node.holds) if not limits.liftable[s].any()]
            reason += f": finger {finger} ends at its {limits.why}" if finger else f": {limits.why}"
            reason += f"; {', '.join(blocked)} cannot be lifted while the rest hold" if blocked else ""
        return no_plan(
            reason,
            status=status,
            mode=code(hand, (h.finger for h in node.holds)),
            finger=finger,
            constraint=limits.why,
            X_WO=path.X_WO[tick],
            progress=tick / max(path.ticks, 1),
            expansions=self.expansions,
        )
