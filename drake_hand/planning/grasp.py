"""Grasp selection: the sets of first contacts from which the search over the automaton starts."""

from __future__ import annotations

from collections import Counter

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.planning.collision import CLEARANCE, Clearance
from drake_hand.planning.contact_sets import ContactSets
from drake_hand.planning.holding import Holding
from drake_hand.planning.reach import Hold, ReachTable

CANDIDATES = 36
"""First contacts considered per finger."""
COMBINATIONS = 4000
GRASPS = 24
"""Grasps handed to the search."""


def together(hand: Hand, grasps: list[list[Hold]], p_WCom: np.ndarray) -> ContactSets:
    """The contacts of some grasps, each hold of them as it begins, around one mass centre p_WCom (3,)."""
    sets = ContactSets.none(hand, np.repeat(p_WCom[None], len(grasps), axis=0))
    for row, holds in enumerate(grasps):
        for h in holds:
            sets.put(h.finger, h.p_WP[0], h.n_W[0], h.J_WP[0], row)
    return sets


def spread(holds: list[Hold], count: int) -> list[Hold]:
    """The longest-lasting hold and those farthest from the ones already taken (greedy), up to `count`."""
    if len(holds) <= count:
        return holds
    points = np.stack([np.concatenate([h.p_WP[0], 0.02 * h.n_W[0]]) for h in holds])
    bonus = np.array([0.004 * min(len(h.q), 40) / 40 for h in holds])
    taken = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    while len(taken) < count:
        best = int(np.argmax(np.where(distance > 0, distance + bonus, -1)))
        taken.append(best)
        distance = np.minimum(distance, np.linalg.norm(points - points[best], axis=1))
    return [holds[j] for j in taken]


def select(
    reach: ReachTable, fingers: list[int], holding: Holding, rng: np.random.Generator
) -> list[tuple[float, list[Hold]]]:
    """Grasps with the given fingers at tick 0, best first.

    A grasp is good if the object stays held when any one finger is lifted, and if its holds last.

    Returns:
        (score, holds) pairs; empty where some finger reaches nothing or no combination is clear and holds.
    """
    clearance = reach.clearance
    goal = reach.path.ticks
    tables = []
    for i in fingers:
        able = reach.holds(i, 0)
        tables.append(spread([h for h in able if h.end >= goal] or able, CANDIDATES))
    if not all(tables):
        return []
    combos = _combinations(clearance, fingers, tables, rng)
    if not len(combos):
        return []
    grasps = [[tables[x][j] for x, j in enumerate(row)] for row in combos]
    sets = together(clearance.hand, grasps, reach.p_WCom(np.array([0]))[0])
    whole = holding.margins(sets)
    kept = whole >= 0
    if not kept.any():
        return []
    liftable = np.zeros(len(grasps))
    liftable[kept] = np.sum([holding.margins(sets[kept].without(i)) >= 0 for i in fingers], axis=0)
    lasting = np.array([min(len(h.q) for h in holds) for holds in grasps])
    score = np.where(kept, liftable + np.minimum(lasting, 40) / 40 + np.minimum(whole, 1.0), -np.inf)
    best = _different(combos, score)
    return [(float(score[b]), grasps[b]) for b in best]


def _combinations(
    clearance: Clearance, fingers: list[int], tables: list[list[Hold]], rng: np.random.Generator
) -> np.ndarray:
    """Rows of one hold per finger (indices into its table) that are clear of one another: all, or some at random."""
    centres = [clearance.centres(i, np.stack([h.q[0] for h in t])) for i, t in zip(fingers, tables, strict=True)]
    few = np.prod([float(len(t)) for t in tables]) <= COMBINATIONS
    rows = np.zeros((1 if few else COMBINATIONS, 0), dtype=int)
    for y, table in enumerate(tables):
        clear = np.ones((len(rows), len(table)), dtype=bool)
        for x in range(y):
            a, b = np.indices((len(tables[x]), len(table))).reshape(2, -1)
            gap = clearance.between(fingers[x], centres[x][a], fingers[y], centres[y][b])
            clear &= (gap >= CLEARANCE).reshape(len(tables[x]), len(table))[rows[:, x]]
        if few:
            row, column = np.nonzero(clear)
        else:
            # One clear hold each, long ones more often (weighted sampling; Efraimidis & Spirakis 2006).
            weight = np.array([len(h.q) for h in table]) / max(len(h.q) for h in table)
            row = np.flatnonzero(clear.any(axis=1))
            column = np.where(clear, rng.random(clear.shape) ** (1 / weight), -1.0).argmax(axis=1)[row]
        rows = np.column_stack([rows[row], column])
    return np.unique(rows, axis=0)


def _different(combos: np.ndarray, score: np.ndarray) -> list[int]:
    """The best rows; no hold is in too many of them, lest all fail for the same reason."""
    sizes = [len(np.unique(column)) for column in combos.T]
    taken: list[int] = []
    used: Counter[tuple[int, int]] = Counter()
    for b in np.argsort(-score, kind="stable"):
        holds = list(enumerate(combos[b].tolist()))
        if not np.isfinite(score[b]) or len(taken) == GRASPS:
            break
        if all(used[x, j] <= 2 * GRASPS // sizes[x] for x, j in holds):
            taken.append(int(b))
            used.update(holds)
    return taken
