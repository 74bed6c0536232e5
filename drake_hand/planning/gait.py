"""Periodic gaits on symmetric objects: all fingers advance together, then each steps back while the others hold.

On a surface of revolution turned about its own axis every state comes back, so that one period is the whole
plan. A gait is a base contact per finger, a stroke (ticks) and an order of steps; it is rated by the least
margin the holding predicate finds anywhere in it, evaluated in batch over many gaits.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drake_hand.contact.contact_sets import ContactSets
from drake_hand.planning.collision import CLEARANCE
from drake_hand.planning.holding import Holding
from drake_hand.planning.moves import Moves
from drake_hand.planning.reach import Hold, ReachTable
from drake_hand.planning.state import State, Stroke, Switch
from drake_hand.planning.strokes import carried
from drake_hand.planning.switches import switch_to

STROKES = (36, 28, 20, 14, 10)
"""Ticks a gait may advance before it steps back, the longest first."""
POOL = 120
"""Base contacts per finger."""
SAMPLES = 6000
"""Random gaits rated per stroke."""
STARTS = 12
"""The most promising of them are improved."""

ENOUGH = 0.3
"""Margin over the preload with which a gait's longer stroke counts for more, N."""


@dataclass(frozen=True, kw_only=True)
class Gait:
    """One period: base contacts, stroke in ticks, order of the steps (slots) and the least margin in it."""

    holds: tuple[Hold, ...]
    stroke: int
    order: tuple[int, ...]
    margin: float


def find(
    reach: ReachTable,
    fingers: list[int],
    holding: Holding,
    allowed: Callable[[frozenset[int]], bool],
    rng: np.random.Generator,
    *,
    enough: float,
    strokes: tuple[int, ...] = STROKES,
    starts: int = STARTS,
) -> list[Gait]:
    """Gaits with the given fingers, the best first; the longest stroke whose margin is `enough` comes first.

    Args:
        reach: of a symmetric object.
        fingers: indices of the fingers that take part.
        holding: predicate.
        allowed: whether the mode with a set of finger indices in contact may be used.
        rng: for sampling.
        enough: margin with which a longer stroke is preferred over a larger margin.
        strokes: ticks to advance, tried in this order.
        starts: local searches per stroke.
    """
    everyone = frozenset(fingers)
    steps = [allowed(everyone - {f}) for f in fingers]
    if not allowed(everyone) or not all(steps):
        return []
    found: list[Gait] = []
    for stroke in (s for s in strokes if s <= reach.path.ticks):
        pools = [_sample([h for h in reach.holds(f, 0) if len(h.q) > stroke], rng) for f in fingers]
        if not all(pools):
            continue
        rated = _Rating(reach, fingers, holding, pools, stroke).best(rng, starts)
        found += rated
        if rated and rated[0].margin >= enough:
            break
    return sorted(found, key=lambda g: -min(g.margin, enough) - 1e-3 * g.stroke * (g.margin >= enough))


def _sample(holds: list[Hold], rng: np.random.Generator) -> list[Hold]:
    return [holds[j] for j in rng.permutation(len(holds))[:POOL]]


def propose(
    table: ReachTable,
    fingers: list[int],
    moves: Moves,
    holding: Holding,
    q: np.ndarray,
    able: Callable[[State], bool],
) -> State | None:
    """The end of the best periodic gait whose advance and transits are clear and hold throughout.

    Args:
        table: of a symmetric object.
        fingers: indices of the fingers that take part.
        moves: of the same path.
        holding: predicate.
        q: (n, m) where the others wait, rad.
        able: whether the hand can get to a grasp.
    """
    for gait in find(table, fingers, holding, moves.allowed, moves.rng, enough=ENOUGH):
        end = _unrolled(gait, table, moves, q) if able(_root(gait, moves, q)) else None
        if end is not None:
            return end
    return None


def _root(gait: Gait, moves: Moves, q: np.ndarray) -> State:
    q, touching = q.copy(), np.zeros(len(q), dtype=bool)
    for h in gait.holds:
        q[h.finger, : h.q.shape[1]], touching[h.finger] = h.q[0], True
    X = np.ascontiguousarray(moves.path.X_WO[0, :3])
    root = State(s=0.0, off=np.zeros(6), X=X, q=q, touching=touching)
    moves.evaluate([root])
    return root


def _unrolled(gait: Gait, table: ReachTable, moves: Moves, q: np.ndarray) -> State | None:
    """The gait as states from tick 0 to the end of the path; None where a transit or an advance is blocked."""
    goal, state = moves.path.ticks, _root(gait, moves, q)
    births = [0] * len(gait.holds)
    steps: dict[int, Switch] = {}
    while True:
        start = round(state.s)
        end = min(start + gait.stroke, goal)
        if all(b + len(h.q) - 1 >= goal for b, h in zip(births, gait.holds, strict=True)):
            end = goal
        ticks = np.arange(start, end + 1)
        posture = np.repeat(state.q[None], len(ticks), axis=0)
        for b, h in zip(births, gait.holds, strict=True):
            posture[:, h.finger, : h.q.shape[1]] = h.q[ticks - b]
        X = np.ascontiguousarray(moves.path.X_WO[ticks, :3])
        if not steps and carried(moves, state, float(end), state.off) is None:
            return None
        move = Stroke(X=X, q=posture)
        state = State(
            s=float(end), off=state.off, X=X[-1], q=posture[-1], touching=state.touching, regrasps=state.regrasps,
            parent=state, move=move,
        )  # fmt: skip
        if end == goal:
            return state
        for slot in gait.order:
            h, q_next = gait.holds[slot], state.q.copy()
            q_next[h.finger, : h.q.shape[1]] = h.q[0]
            after = State(
                s=state.s, off=state.off, X=state.X, q=q_next, touching=state.touching, regrasps=state.regrasps + 1,
                parent=state, move=steps.get(slot),
            )  # fmt: skip
            if after.move is None:
                moves.evaluate([state, after])
                switch = switch_to(moves, state, after, h.finger)
                if switch is None:
                    return None
                after.move = steps[slot] = switch
            births[slot], state = end, after


class _Rating:
    """Rates gaits of one stroke over fixed pools of base contacts."""

    def __init__(
        self, reach: ReachTable, fingers: list[int], holding: Holding, pools: list[list[Hold]], stroke: int
    ) -> None:
        self.reach, self.fingers, self.holding, self.pools, self.stroke = reach, fingers, holding, pools, stroke
        clearance = reach.clearance
        self.p_WCom = reach.p_WCom(np.array([0]))
        # Row of a pool's arrays: [contact, 0 at the base or 1 at the end of the stroke].
        ages = np.array([0, stroke])
        self.p = [np.stack([h.p_WP[ages] for h in pool]) for pool in pools]
        self.normal = [np.stack([h.n_W[ages] for h in pool]) for pool in pools]
        self.J = [np.stack([h.J_WP[ages] for h in pool]) for pool in pools]
        self.centres = [
            clearance.centres(f, np.concatenate([h.q[ages] for h in pool])).reshape(len(pool), 2, -1, 3)
            for f, pool in zip(fingers, pools, strict=True)
        ]
        self.subsets = np.array(list(itertools.product((0, 1), repeat=len(fingers))))

    def best(self, rng: np.random.Generator, starts: int) -> list[Gait]:
        """Local optima: from the most promising of a random sample, one contact exchanged at a time."""
        sizes = np.array([len(p) for p in self.pools])
        sample = np.unique((rng.random((SAMPLES, len(sizes))) * sizes).astype(int), axis=0)
        for end in (0, 1):
            ends, none = np.full((len(sample), len(sizes)), end), np.full(len(sample), -1)
            whole = self._margins(sample, ends, none)
            sample = sample[np.argsort(-whole, kind="stable")[: max(len(sample) // 8, 1)]]
        sample = self._clear(sample)
        if not len(sample):
            return []
        rating = self._rate(sample)
        climbed = [self._climb(sample[x], rating[x], sizes) for x in np.argsort(-rating, kind="stable")[:starts]]
        best = {tuple(row): margin for row, margin in climbed if margin >= 0}
        return [
            Gait(
                holds=tuple(pool[j] for pool, j in zip(self.pools, row, strict=True)),
                stroke=self.stroke,
                order=self._order(np.array(row)),
                margin=float(margin),
            )
            for row, margin in sorted(best.items(), key=lambda item: (-item[1], item[0]))
        ]

    def _climb(self, row: np.ndarray, margin: float, sizes: np.ndarray) -> tuple[np.ndarray, float]:
        """Exchanges the contact that helps most, until none does."""
        while True:
            swaps = []
            for slot, size in enumerate(sizes):
                changed = np.repeat(row[None], size, axis=0)
                changed[:, slot] = np.arange(size)
                swaps.append(changed)
            fresh = self._promising(np.concatenate(swaps), margin + 1e-3)
            if not len(fresh):
                return row, margin
            rating = self._rate(fresh, margin)
            top = int(rating.argmax())
            if rating[top] < margin + 1e-3:
                return row, margin
            row, margin = fresh[top], float(rating[top])

    def _rate(self, combos: np.ndarray, least: float = -np.inf) -> np.ndarray:
        """(R,) least margin on the best order of steps; -inf where that is below `least`."""
        return self._widest(combos, least)[0][:, -1]

    def _clear(self, combos: np.ndarray) -> np.ndarray:
        """Combinations whose fingers are clear of one another, each at its base or its end."""
        between = self.reach.clearance.between
        for a, b in itertools.combinations(range(len(self.fingers)), 2):
            for x, y in ((0, 0), (1, 1), (0, 1), (1, 0)):
                if len(combos):
                    gap = between(
                        self.fingers[a],
                        self.centres[a][combos[:, a], x],
                        self.fingers[b],
                        self.centres[b][combos[:, b], y],
                    )
                    combos = combos[gap >= CLEARANCE]
        return combos

    def _margins(self, combos: np.ndarray, ends: np.ndarray, without: np.ndarray) -> np.ndarray:
        """Margins of rows of contacts, each finger at base or end (R, slots), without one slot (-1: with all)."""
        sets = ContactSets.none(self.reach.clearance.hand, np.repeat(self.p_WCom, len(combos), axis=0))
        for slot, f in enumerate(self.fingers):
            c, e = combos[:, slot], ends[:, slot]
            sets.put(f, self.p[slot][c, e], self.normal[slot][c, e], self.J[slot][c, e])
            sets.mask[:, f] = without != slot
        return self.holding.margins(sets)

    def _promising(self, combos: np.ndarray, least: float) -> np.ndarray:
        """Combinations that may reach a margin: all fingers at base and at end, and some finger lifted in either."""
        slots = len(self.fingers)
        for end in (0, 1):
            ends = np.full((len(combos), slots), end)
            combos = combos[self._margins(combos, ends, np.full(len(combos), -1)) >= least]
        combos = self._clear(combos)
        for end in (1, 0):
            some = np.zeros(len(combos), dtype=bool)
            for slot in range(slots):
                todo = np.flatnonzero(~some)
                ends = np.full((len(todo), slots), end)
                some[todo] = self._margins(combos[todo], ends, np.full(len(todo), slot)) >= least
            combos = combos[some]
        return combos

    def _widest(self, combos: np.ndarray, least: float = -np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Widest paths over the sets of fingers that have stepped back.

        Returns:
            Least margin on the best order of steps to each set (R, 2^slots), and the last step of that order. What
            cannot reach `least` is not followed further.
        """
        R, U, slots = len(combos), len(self.subsets), len(self.fingers)
        ends = 1 - self.subsets
        whole = np.full((R, U), np.nan)
        width, last = np.full((R, U), -np.inf), np.full((R, U), -1)
        everyone = np.full(R, -1)
        width[:, 0] = self._margins(combos, np.tile(ends[0], (R, 1)), everyone)
        for u in np.argsort(self.subsets.sum(axis=1), kind="stable"):
            rows = np.flatnonzero(width[:, u] >= least)
            for slot in np.flatnonzero(self.subsets[u] == 0):
                if not len(rows):
                    break
                lifted = self._margins(combos[rows], np.tile(ends[u], (len(rows), 1)), np.full(len(rows), slot))
                value, after = np.minimum(width[rows, u], lifted), u + (1 << (slots - 1 - slot))
                gain = value > np.maximum(width[rows, after], least)
                some, value = rows[gain], value[gain]
                ask = some[np.isnan(whole[some, after])]
                whole[ask, after] = self._margins(
                    combos[ask], np.tile(ends[after], (len(ask), 1)), everyone[: len(ask)]
                )
                value = np.minimum(value, whole[some, after])
                better = value > width[some, after]
                width[some[better], after], last[some[better], after] = value[better], slot
        return width, last

    def _order(self, row: np.ndarray) -> tuple[int, ...]:
        _, last = self._widest(row[None])
        u, order = len(self.subsets) - 1, []
        while u:
            slot = int(last[0, u])
            order.append(slot)
            u -= 1 << (len(self.fingers) - 1 - slot)
        return tuple(reversed(order))
