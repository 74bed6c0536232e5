"""Periodic gaits on symmetric objects: all fingers advance together, then each steps back while the others hold.

On a surface of revolution turned about its own axis every state comes back, so that one period is the whole
plan. A gait is a base contact per finger, a stroke (ticks) and an order of steps; it is rated by the least
margin the holding predicate finds anywhere in it, evaluated in batch over many gaits.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from drake_hand.planning.grasp import spread
from drake_hand.planning.holding import Holding
from drake_hand.planning.reach import CLEARANCE, Hold, ReachTable

STROKES = (36, 28, 20, 14, 10)
"""Ticks a gait may advance before it steps back, the longest first."""
POOL = 40
"""Base contacts per finger."""
SAMPLES = 3000
"""Random gaits rated per stroke."""
KEPT = 12
ROUNDS = 3
"""Rounds of improvement: each finger's contact is exchanged for every other of its pool."""


@dataclass(frozen=True, kw_only=True)
class Gait:
    """One period: base contacts, stroke in ticks, order of the steps (slots) and the least margin in it."""

    holds: tuple[Hold, ...]
    stroke: int
    order: tuple[int, ...]
    margin: float


def find(
    reach: ReachTable, fingers: list[int], holding: Holding, allowed, rng: np.random.Generator, *, enough: float
) -> list[Gait]:
    """Gaits with the given fingers, the best first; the longest stroke whose margin is `enough` comes before all others.

    Args:
        reach: of a symmetric object.
        fingers: indices of the fingers that take part.
        holding: predicate.
        allowed: whether the mode with a set of finger indices in contact may be used.
        rng: for sampling.
        enough: margin with which a longer stroke is preferred over a larger margin.
    """
    everyone = frozenset(fingers)
    steps = [allowed(everyone - {f}) for f in fingers]
    if not allowed(everyone) or not all(steps):
        return []
    found: list[Gait] = []
    for stroke in (s for s in STROKES if s <= reach.path.ticks):
        pools = [spread([h for h in reach.holds(f, 0) if len(h.q) > stroke], POOL) for f in fingers]
        if not all(pools):
            continue
        rated = _Rating(reach, fingers, holding, pools, stroke).best(rng)
        found += rated
        if rated and rated[0].margin >= enough:
            break
    return sorted(found, key=lambda g: -min(g.margin, enough) - 1e-3 * g.stroke * (g.margin >= enough))


class _Rating:
    """Rates gaits of one stroke over fixed pools of base contacts."""

    def __init__(
        self, reach: ReachTable, fingers: list[int], holding: Holding, pools: list[list[Hold]], stroke: int
    ) -> None:
        self.reach, self.fingers, self.holding, self.pools, self.stroke = reach, fingers, holding, pools, stroke
        clearance = reach.clearance
        self.n = len(clearance.hand.fingers)
        self.m = max(len(f.joints) for f in clearance.hand.fingers)
        self.p_WCom = reach.p_WCom(np.array([0]))
        # Row of a pool's arrays: [contact, 0 at the base or 1 at the end of the stroke].
        ages = np.array([0, stroke])
        self.p = [np.stack([h.p_WP[ages] for h in pool]) for pool in pools]
        self.normal = [np.stack([h.n_W[ages] for h in pool]) for pool in pools]
        self.J = [np.stack([h.J_WP[ages] for h in pool]) for pool in pools]
        centres = [
            clearance.centres(f, np.concatenate([h.q[ages] for h in pool]))
            for f, pool in zip(fingers, pools, strict=True)
        ]
        self.clear: dict[tuple[int, int], np.ndarray] = {}
        for a, b in itertools.combinations(range(len(fingers)), 2):
            x, y = np.meshgrid(np.arange(len(centres[a])), np.arange(len(centres[b])), indexing="ij")
            gap = clearance.between_centres(fingers[a], centres[a][x.ravel()], fingers[b], centres[b][y.ravel()])
            fine = (gap >= CLEARANCE).reshape(len(pools[a]), 2, len(pools[b]), 2)
            self.clear[a, b] = fine.all(axis=(1, 3))
        self.subsets = np.array(list(itertools.product((0, 1), repeat=len(fingers))))

    def best(self, rng: np.random.Generator) -> list[Gait]:
        """The best of a random sample, improved contact by contact."""
        sizes = np.array([len(p) for p in self.pools])
        combos = np.unique((rng.random((SAMPLES, len(sizes))) * sizes).astype(int), axis=0)
        combos = combos[self._clear(combos)]
        combos = combos[self._holds_at_ends(combos)]
        combos, rating = self._top(combos, self.rate(combos))
        for _ in range(ROUNDS):
            if not len(combos):
                break
            swaps = [combos]
            for slot, size in enumerate(sizes):
                changed = np.repeat(combos, size, axis=0)
                changed[:, slot] = np.tile(np.arange(size), len(combos))
                swaps.append(changed)
            fresh = np.unique(np.concatenate(swaps), axis=0)
            fresh = fresh[self._clear(fresh)]
            fresh = fresh[self._holds_at_ends(fresh)]
            before = rating[0]
            combos, rating = self._top(fresh, self.rate(fresh))
            if rating[0] <= before + 1e-6:
                break
        out = []
        for row, margin in zip(combos, rating, strict=True):
            if margin >= 0:
                holds = tuple(pool[j] for pool, j in zip(self.pools, row, strict=True))
                out.append(Gait(holds=holds, stroke=self.stroke, order=self._order(row), margin=float(margin)))
        return out

    def _top(self, combos: np.ndarray, rating: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(-rating, kind="stable")[:KEPT]
        return combos[order], rating[order]

    def _clear(self, combos: np.ndarray) -> np.ndarray:
        fine = np.ones(len(combos), dtype=bool)
        for (a, b), clear in self.clear.items():
            fine &= clear[combos[:, a], combos[:, b]]
        return fine

    def _margins(self, combos: np.ndarray, ends: np.ndarray, without: np.ndarray) -> np.ndarray:
        """Margins of rows of contacts, each finger at base or end (R, slots), without one slot (-1: with all)."""
        R = len(combos)
        p, normal, J = np.zeros((R, self.n, 3)), np.zeros((R, self.n, 3)), np.zeros((R, self.n, 3, self.m))
        normal[..., 2] = 1.0
        mask = np.zeros((R, self.n), dtype=bool)
        for slot, f in enumerate(self.fingers):
            c, e = combos[:, slot], ends[:, slot]
            p[:, f], normal[:, f] = self.p[slot][c, e], self.normal[slot][c, e]
            J[:, f, :, : self.J[slot].shape[3]] = self.J[slot][c, e]
            mask[:, f] = without != slot
        return self.holding.margins(p, normal, J, mask, np.repeat(self.p_WCom, R, axis=0))

    def _holds_at_ends(self, combos: np.ndarray) -> np.ndarray:
        """Cheap first test: all fingers hold at base and end, and some finger can be lifted at the end."""
        if not len(combos):
            return np.zeros(0, dtype=bool)
        slots = len(self.fingers)
        none = np.full(len(combos), -1)
        fine = np.ones(len(combos), dtype=bool)
        for end in (0, 1):
            fine[fine] = self._margins(combos[fine], np.full((fine.sum(), slots), end), none[fine]) >= 0
        some = np.zeros(len(combos), dtype=bool)
        for slot in range(slots):
            todo = fine & ~some
            ends = np.ones((todo.sum(), slots), dtype=int)
            some[todo] = self._margins(combos[todo], ends, np.full(todo.sum(), slot)) >= 0
        return some

    def _lattice(self, combos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Margins over all sets of fingers that have stepped back already.

        Returns:
            whole (R, 2^slots) with all fingers, and lifted (R, 2^slots, slots) without one that is still at its end
            (-inf where it has stepped back already).
        """
        R, U, slots = len(combos), len(self.subsets), len(self.fingers)
        ends = 1 - self.subsets
        rows = np.repeat(combos, U, axis=0)
        whole = self._margins(rows, np.tile(ends, (R, 1)), np.full(R * U, -1)).reshape(R, U)
        lifted = np.full((R, U, slots), -np.inf)
        for slot in range(slots):
            todo = np.flatnonzero(self.subsets[:, slot] == 0)
            rows = np.repeat(combos, len(todo), axis=0)
            values = self._margins(rows, np.tile(ends[todo], (R, 1)), np.full(len(rows), slot))
            lifted[:, todo, slot] = values.reshape(R, len(todo))
        return whole, lifted

    def rate(self, combos: np.ndarray) -> np.ndarray:
        """(R,) least margin on the best order of steps (widest path over the sets that have stepped back)."""
        out = np.full(len(combos), -np.inf)
        for start in range(0, len(combos), 200):
            block = slice(start, start + 200)
            out[block] = self._widest(*self._lattice(combos[block]))[0][:, -1]
        return out

    def _widest(self, whole: np.ndarray, lifted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R, U = whole.shape
        width, last = np.full((R, U), -np.inf), np.full((R, U), -1)
        width[:, 0] = whole[:, 0]
        slots = len(self.fingers)
        for u in sorted(range(1, U), key=lambda u: int(self.subsets[u].sum())):
            for slot in np.flatnonzero(self.subsets[u]):
                before = u - (1 << (slots - 1 - slot))
                value = np.minimum(np.minimum(width[:, before], lifted[:, before, slot]), whole[:, u])
                better = value > width[:, u]
                width[better, u], last[better, u] = value[better], slot
        return width, last

    def _order(self, row: np.ndarray) -> tuple[int, ...]:
        _, last = self._widest(*self._lattice(row[None]))
        u, order = len(self.subsets) - 1, []
        while u:
            slot = int(last[0, u])
            order.append(slot)
            u -= 1 << (len(self.fingers) - 1 - slot)
        return tuple(reversed(order))
