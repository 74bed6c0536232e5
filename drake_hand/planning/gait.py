"""Periodic gaits on symmetric objects: all fingers advance together, then each steps back while the others hold.

On a surface of revolution turned about its own axis every state comes back, so that one period is the whole
plan. A gait is a base contact per finger, a stroke (ticks) and an order of steps; it is rated by the least
margin with which the contacts hold the object anywhere in it, evaluated in compiled batches over many gaits.
Often one finger's reach keeps all strokes short: where enough others hold, a gait without it may spare many regrasps.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from drake_hand.contact.kernels.stiffness import SPRING_ROWS
from drake_hand.planning.grasp import FIRM_FINGERS
from drake_hand.planning.kernels import gait as kernels
from drake_hand.planning.kernels.steady import springs
from drake_hand.planning.kernels.world import Load
from drake_hand.planning.moves import Moves
from drake_hand.planning.reach import ContactSpan, ReachTable
from drake_hand.planning.state import FingerSwitch, Node, Stroke
from drake_hand.planning.strokes import carried
from drake_hand.planning.switches import switch_to
from drake_hand.planning.world import split

STROKE_TICKS = (48, 36, 29, 24, 18, 12)
"""Ticks a gait may advance before it steps back; a little less where the path divides evenly so."""
BASE_CONTACTS = 120
"""Base contacts per finger."""
FEWER_SHARE = 0.8
"""A gait without one of the fingers is taken if it has no more than this share of the regrasps."""
GAITS_RATED = 6000
"""Random gaits rated per stroke."""
GAITS_IMPROVED = 6
"""The most promising of them are improved."""
GAITS_IN_VAIN = 3
"""Improved gaits, none of which holds the object, after which the others are not improved."""
IMPROVEMENT_N = 1e-3
"""By at least so much for each contact exchanged, N."""
AMPLE_MARGIN_N = 0.3
"""Margin over the preload with which a gait's longer stroke counts for more, N."""


@dataclass(frozen=True, kw_only=True)
class Gait:
    """One period: base contacts, stroke in ticks, order of the steps (slots) and the least margin in it."""

    spans: tuple[ContactSpan, ...]
    stroke: int
    order: tuple[int, ...]
    margin: float


def find(
    reach: ReachTable,
    sets: list[tuple[int, ...]],
    load: Load,
    allowed: Callable[[frozenset[int]], bool],
    rng: np.random.Generator,
    *,
    enough: float,
    strokes: tuple[int, ...] = STROKE_TICKS,
    regrasps: float = np.inf,
    starts: int = GAITS_IMPROVED,
) -> Iterator[Gait]:
    """Gaits whose margin is `enough`, the fewest regrasps first; then the others, the largest margin first.

    Args:
        reach: of a symmetric object.
        sets: indices of the fingers that may take part together.
        load: what it takes to hold the object.
        allowed: whether the mode with a set of finger indices in contact may be used.
        rng: for sampling.
        enough: margin with which fewer regrasps are preferred over a larger margin.
        strokes: ticks to advance, at most.
        regrasps: at most, along the whole path.
        starts: local searches per stroke.
    """
    some = [x for x in sets if allowed(frozenset(x)) and all(allowed(frozenset(x) - {f}) for f in x)]
    counts = {-(-reach.path.ticks // stroke) - 1 for stroke in strokes if stroke <= reach.path.ticks}
    lesser: list[Gait] = []
    for total, count, fingers in sorted((k * len(x), k, x) for k, x in itertools.product(counts, some)):
        if total > regrasps:
            break
        stroke = -(-reach.path.ticks // (count + 1))
        pools = [_sample([h for h in reach.spans(f, 0) if len(h.q) > stroke], rng) for f in fingers]
        if not all(pools):
            continue
        for one in _Rating(reach, fingers, load, pools, stroke).best(rng, starts):
            if one.margin >= enough:
                yield one
            else:
                lesser.append(one)
    yield from sorted(lesser, key=lambda g: -g.margin)


def _sample(spans: list[ContactSpan], rng: np.random.Generator) -> list[ContactSpan]:
    return [spans[j] for j in rng.permutation(len(spans))[:BASE_CONTACTS]]


def propose(
    table: ReachTable,
    fingers: list[int],
    every: bool,
    moves: Moves,
    q: np.ndarray,
    able: Callable[[Node], bool],
) -> Node | None:
    """The end of the best periodic gait whose advance and transits are clear and hold throughout.

    Args:
        table: of a symmetric object.
        fingers: indices of the fingers that may take part.
        every: whether all of them have to.
        moves: of the same path.
        q: (n, m) where the others wait, rad.
        able: whether the hand can get to a grasp.
    """
    end, most = None, np.inf
    fewer = not every and len(fingers) > FIRM_FINGERS + 1  # with another one lifted, enough still hold
    for n in (len(fingers), len(fingers) - 1)[: 1 + fewer]:
        sets = list(itertools.combinations(fingers, n))
        for gait in find(table, sets, moves.load, moves.allowed, moves.rng, enough=AMPLE_MARGIN_N, regrasps=most):
            found = _unrolled(gait, table, moves, q) if able(_root(gait, moves, q)) else None
            if found is not None:
                end = found
                break
        most = FEWER_SHARE * (end.regrasps if end else n * moves.path.ticks / min(STROKE_TICKS))
    return end


def _root(gait: Gait, moves: Moves, q: np.ndarray) -> Node:
    q, touching = q.copy(), np.zeros(len(q), dtype=bool)
    for h in gait.spans:
        q[h.finger, : h.q.shape[1]], touching[h.finger] = h.q[0], True
    X = np.ascontiguousarray(moves.path.X_WO[0, :3])
    root = Node(s=0.0, off=np.zeros(6), X=X, q=q, touching=touching)
    moves.evaluate([root])
    return root


def _unrolled(gait: Gait, table: ReachTable, moves: Moves, q: np.ndarray) -> Node | None:
    """The gait as states from tick 0 to the end of the path; None where a transit or an advance is blocked."""
    goal, state = moves.path.ticks, _root(gait, moves, q)
    births = [0] * len(gait.spans)
    steps: dict[int, FingerSwitch] = {}
    while True:
        start = round(state.s)
        end = min(start + gait.stroke, goal)
        lasting = all(b + len(h.q) - 1 >= goal for b, h in zip(births, gait.spans, strict=True))
        if lasting and carried(moves, state, float(goal), state.off) is not None:
            end = goal
        elif not steps and carried(moves, state, float(end), state.off) is None:
            return None
        ticks = np.arange(start, end + 1)
        posture = np.repeat(state.q[None], len(ticks), axis=0)
        for b, h in zip(births, gait.spans, strict=True):
            posture[:, h.finger, : h.q.shape[1]] = h.q[ticks - b]
        X = np.ascontiguousarray(moves.path.X_WO[ticks, :3])
        move = Stroke(X=X, q=posture)
        state = Node(
            s=float(end), off=state.off, X=X[-1], q=posture[-1], touching=state.touching, regrasps=state.regrasps,
            parent=state, move=move,
        )  # fmt: skip
        if end == goal:
            return state
        for slot in gait.order:
            h, q_next = gait.spans[slot], state.q[gait.spans[slot].finger].copy()
            q_next[: h.q.shape[1]] = h.q[0]
            after = state.moved(h.finger, q_next, steps.get(slot))
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
        self, reach: ReachTable, fingers: tuple[int, ...], load: Load, pools: list[list[ContactSpan]], stroke: int
    ) -> None:
        self.reach, self.load, self.pools, self.stroke = reach, load, pools, stroke
        self.fingers = np.array(fingers)
        S, most, m = len(pools), max(len(pool) for pool in pools), reach.world.chains.lower.shape[1]
        ages = np.array([0, stroke])
        # Row of a pool's arrays: [contact, 0 at the base or 1 at the end of the stroke].
        self.p, self.normal, self.q = np.zeros((S, most, 2, 3)), np.zeros((S, most, 2, 3)), np.zeros((S, most, 2, m))
        self.J = np.zeros((S, most, 2, 3, m))
        for slot, pool in enumerate(pools):
            for j, h in enumerate(pool):
                own = h.q.shape[1]
                self.p[slot, j], self.normal[slot, j] = h.p_WP[ages], h.n_W[ages]
                self.q[slot, j, :, :own], self.J[slot, j, :, :, :own] = h.q[ages], h.J_WP[ages]
        self.spring, self.press = np.zeros((S, most, 2, SPRING_ROWS, 3)), np.zeros((S, most, 2))
        X = np.ascontiguousarray(reach.path.X_WO[ages, :3])
        if not load.kinematic:
            for slot, finger in enumerate(fingers):
                springs(reach.world, load, finger, X, self.q[slot], self.spring[slot], self.press[slot])
        self._args = (
            reach.world, load, X[0].copy(), self.fingers, self.p, self.normal, self.J, self.spring, self.press
        )  # fmt: skip

    def best(self, rng: np.random.Generator, starts: int) -> list[Gait]:
        """Local optima: from the most promising of a random sample, one contact exchanged at a time."""
        sizes = np.array([len(pool) for pool in self.pools])
        drawn = (rng.random((GAITS_RATED, len(sizes))) * sizes).astype(int)
        sample = np.stack(np.unravel_index(np.unique(np.ravel_multi_index(tuple(drawn.T), sizes)), sizes), axis=1)
        for stepped in (False, True):
            sample = sample[np.argsort(-self._together(sample, stepped), kind="stable")[: max(len(sample) // 8, 1)]]
        rating, _ = self._widest(sample)
        first = [x for x in np.argsort(-rating, kind="stable")[:starts] if np.isfinite(rating[x])]
        best: dict[tuple[int, ...], float] = {}
        for k, x in enumerate(first):
            if k == GAITS_IN_VAIN and max(best.values()) < 0:
                break
            best |= [self._climb(sample[x], rating[x], sizes)]
        return [
            Gait(
                spans=tuple(pool[j] for pool, j in zip(self.pools, row, strict=True)),
                stroke=self.stroke,
                order=self._order(np.array(row)),
                margin=margin,
            )
            for row, margin in sorted(best.items(), key=lambda item: (-item[1], item[0]))
            if margin >= 0
        ]

    def _climb(self, row: np.ndarray, margin: float, sizes: np.ndarray) -> tuple[tuple[int, ...], float]:
        """Exchanges the contact that helps most, until none does."""
        while True:
            swaps = []
            for slot, size in enumerate(sizes):
                changed = np.repeat(row[None], size, axis=0)
                changed[:, slot] = np.arange(size)
                swaps.append(changed)
            fresh = np.concatenate(swaps)
            rating, _ = self._widest(fresh, margin + IMPROVEMENT_N)
            top = int(rating.argmax())
            if not np.isfinite(rating[top]):
                return tuple(row.tolist()), float(margin)
            row, margin = fresh[top], float(rating[top])

    def _together(self, rows: np.ndarray, stepped: bool) -> np.ndarray:
        """(R,) margins with all fingers at the base, or all at the end."""
        margin = np.zeros(len(rows))
        split(lambda r: kernels.margins_together(*self._args, rows[r], stepped, margin[r]), len(rows), least=64)
        return margin

    def _widest(self, rows: np.ndarray, least: float = -np.inf) -> tuple[np.ndarray, np.ndarray]:
        """(R,) least margins on the best orders of steps, -inf below `least`, and these orders' last steps."""
        margin, last = np.zeros(len(rows)), np.zeros((len(rows), 1 << len(self.fingers)), dtype=np.int64)
        split(lambda r: kernels.widest(*self._args, self.q, rows[r], least, margin[r], last[r]), len(rows), least=16)
        return margin, last

    def _order(self, row: np.ndarray) -> tuple[int, ...]:
        _, last = self._widest(row[None])
        u, order = (1 << len(self.fingers)) - 1, []
        while u:
            order.append(int(last[0, u]))
            u -= 1 << order[-1]
        return tuple(reversed(order))
