"""Grasp selection: the sets of first contacts from which the search over the automaton starts."""

from __future__ import annotations

from collections import Counter

import numpy as np

from drake_hand.planning.collision import CLEARANCE, Clearance
from drake_hand.planning.holding import Holding
from drake_hand.planning.reach import Hold, ReachTable

CANDIDATES = 36
"""First contacts considered per finger."""
COMBINATIONS = 4000
GRASPS = 24
"""Grasps handed to the search."""


def stack(holds: list[list[Hold]], ticks: np.ndarray, n: int, m: int) -> tuple[np.ndarray, ...]:
    """Contact arrays of N sets of holds, each at its tick, as :class:`Holding` takes them.

    Args:
        holds: N sets of holds of distinct fingers.
        ticks: (N,).
        n: number of fingers of the hand.
        m: largest number of joints of a finger.

    Returns:
        p_WP (N, n, 3), n_W (N, n, 3), J_WP (N, n, 3, m), mask (N, n).
    """
    N = len(holds)
    p, normal, J = np.zeros((N, n, 3)), np.zeros((N, n, 3)), np.zeros((N, n, 3, m))
    normal[..., 2] = 1.0
    mask = np.zeros((N, n), dtype=bool)
    for row, (held, tick) in enumerate(zip(holds, ticks, strict=True)):
        for h in held:
            a = tick - h.birth
            p[row, h.finger], normal[row, h.finger], mask[row, h.finger] = h.p_WP[a], h.n_W[a], True
            J[row, h.finger, :, : h.J_WP.shape[2]] = h.J_WP[a]
    return p, normal, J, mask


def lifts(mask: np.ndarray) -> np.ndarray:
    """(N, n) masks -> (N, n, n): row i is the set without finger i (all False where i is not in it)."""
    out = np.repeat(mask[:, None, :], mask.shape[1], axis=1)
    i = np.arange(mask.shape[1])
    out[:, i, i] = False
    out[~mask] = False
    return out


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
    n, m = len(clearance.hand.fingers), max(len(f.joints) for f in clearance.hand.fingers)
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
    sets = [[tables[x][j] for x, j in enumerate(row)] for row in combos]
    p, normal, J, mask = stack(sets, np.zeros(len(sets), dtype=int), n, m)
    p_WCom = np.repeat(reach.p_WCom(np.array([0])), len(sets), axis=0)
    whole = holding.margins(p, normal, J, mask, p_WCom)
    kept = whole >= 0
    if not kept.any():
        return []
    without = np.stack(
        [holding.margins(p[kept], normal[kept], J[kept], lifts(mask[kept])[:, i], p_WCom[kept]) >= 0 for i in fingers]
    )
    liftable = np.zeros(len(sets))
    liftable[kept] = without.sum(axis=0)
    lasting = np.array([min(len(h.q) for h in held) for held in sets])
    score = np.where(kept, liftable + np.minimum(lasting, 40) / 40 + np.minimum(whole, 1.0), -np.inf)
    best = _different(combos, score)
    return [(float(score[b]), sets[b]) for b in best]


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
