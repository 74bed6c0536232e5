"""Free-finger transit: lift along the normal, travel, land along the normal, clear of everything.

Lifting and landing along the normal neither drags the object nor grazes it. A finger that cannot lift off or land like
that leans aside: it does not press any more by then, or not yet. In between, a straight line in joint space mostly
suffices; otherwise the finger stops over at one of the free postures it could also wait in.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from drake_hand.contact.chain import cross
from drake_hand.planning.collision import CLEARANCE_M, Clearance
from drake_hand.planning.kernels import free
from drake_hand.planning.kernels.transit import LIFT_KNOTS
from drake_hand.planning.state import by_finger

MOVING_CLEARANCE_M = CLEARANCE_M / 2
"""Least clearance along a path, m."""
LIFTS_M = (3.0e-3, 8.0e-3, 15.0e-3)
"""Heights over the surface that are tried, m."""
LEAN_RAD = np.pi / 4
"""How far a finger that lifts off or lands may lean from its normal ..."""
LEANS = 8
"""... and to how many sides this is tried."""
TRAVEL_STEP_RAD = np.radians(3.0)
"""Joint step between knots and between collision checks of a travel."""
_MOST_ATTEMPTS = 60
"""Shortest paths looked at before a detour is given up."""


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What a moving finger must keep clear of: palm, object and other fingers, all at rest."""

    clearance: Clearance
    X_WO: np.ndarray
    """(3, 4)."""
    q: np.ndarray
    """(n, m) postures by finger, rad."""
    standing: np.ndarray
    """(n,) bool: the fingers to keep clear of."""

    @classmethod
    def of(cls, clearance: Clearance, q: np.ndarray, X_WO: np.ndarray, moving: int | None = None) -> Surroundings:
        """All fingers but one at rest at q (nq,), the object at X_WO (4, 4); no finger to keep clear of if none is."""
        hand = clearance.hand
        standing = np.array([moving is not None and i != moving for i in range(len(hand.fingers))])
        X = np.ascontiguousarray(X_WO[:3])
        return cls(clearance=clearance, X_WO=X, q=by_finger(hand, q), standing=standing)

    def clear(self, i: int, q: np.ndarray, least: float) -> np.ndarray:
        """(N,) whether finger i, its tip too, is clear of everything by so much, m, at q (N, m)."""
        out = np.zeros(len(q), dtype=bool)
        free.clear_at(*self.around(i), self.padded(q), least, out)
        return out

    def around(self, i: int) -> tuple[Any, ...]:
        """What kernels ask about finger i on its way."""
        return self.clearance.world, i, self.X_WO, self.q, self.standing

    def padded(self, q: np.ndarray) -> np.ndarray:
        """Postures (N, any) of a finger as kernels take them, (N, m)."""
        out = np.zeros((len(q), self.q.shape[1]))
        out[:, : q.shape[1]] = q
        return out


def leaning(n_W: np.ndarray) -> np.ndarray:
    """(..., 1 + LEANS, 3) unit directions off contacts: their normals (..., 3), and those that lean to each side."""
    angle = np.linspace(0, 2 * np.pi, LEANS, endpoint=False)[:, None]
    # rounded, for where two are equal but for the last digit the same normal is to give the same ways each time
    across = cross(n_W, np.eye(3)[np.argmin(np.abs(n_W).round(9), axis=-1)])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    up, one, two = (x[..., None, :] for x in (n_W, across, cross(n_W, across)))
    aside = np.cos(angle) * one + np.sin(angle) * two
    return np.concatenate([up, np.cos(LEAN_RAD) * up + np.sin(LEAN_RAD) * aside], axis=-2)


def lift_off(s: Surroundings, i: int, q: np.ndarray, n_W: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Paths of finger i from contacts at q (N, m) straight up their normals n_W (N, 3).

    Returns:
        (N, LIFT_KNOTS, m) paths, and whether each is clear (N,).
    """
    able, ways = np.zeros(len(q), dtype=bool), np.zeros((len(q), LIFT_KNOTS, s.q.shape[1]))
    free.lifts(*s.around(i), s.padded(q), np.ascontiguousarray(height * n_W), ways, able)
    return ways[..., : q.shape[1]], able


def straight_path(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Straight path in joint space from a to b (m,), or None where something is in the way."""
    n = max(3, int(np.ceil(np.abs(b - a).max() / TRAVEL_STEP_RAD)) + 1)
    able = np.zeros(1, dtype=bool)
    free.goes_straight(*s.around(i), *s.padded(np.stack([a, b])), TRAVEL_STEP_RAD, able)
    return a + np.linspace(0, 1, n)[:, None] * (b - a) if able[0] else None


def travel(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> list[np.ndarray] | None:
    """Path of a free finger from a to b (m,) as straight pieces (n, m): one if that is clear, or a :func:`detour`."""
    if not s.clear(i, np.stack([a, b]), MOVING_CLEARANCE_M).all():
        return None
    direct = straight_path(s, i, a, b)
    return [direct] if direct is not None else detour(s, i, a, b)


def detour(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> list[np.ndarray] | None:
    """Path of a free finger from a to b (m,) over a roadmap.

    The roadmap is a grid of clear postures; its edges are checked only when a shortest path uses them
    (lazy PRM; Bohlin & Kavraki 2000).

    Returns:
        Straight pieces, each (n, m); None where no path was found.
    """
    nodes, graph = _roadmap(s, i, a, b)
    pieces: dict[tuple[int, int], np.ndarray] = {}
    for _ in range(_MOST_ATTEMPTS):
        length, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
        if not np.isfinite(length[1]):
            return None
        way = [1]
        while way[-1] != 0:
            way.append(int(before[way[-1]]))
        way.reverse()
        blocked = False
        for u, v in itertools.pairwise(way):
            if (u, v) not in pieces:
                piece = straight_path(s, i, nodes[u], nodes[v])
                if piece is None:
                    graph[u, v] = graph[v, u] = 0.0
                    blocked = True
                    break
                pieces[u, v] = piece
        graph.eliminate_zeros()
        if not blocked:
            return _shorten(s, i, [nodes[x] for x in way])
    return None


def _roadmap(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, csr_matrix]:
    """Nodes (row 0 is a, row 1 is b) and their distances: grid neighbours, and both ends to what is near."""
    grid = s.clearance.postures(i)
    clear = s.clear(i, grid.q, CLEARANCE_M)
    nodes = np.vstack([a, b, grid.q[clear]])
    row = np.cumsum(clear) + 1
    pairs = row[grid.neighbours[clear[grid.neighbours].all(axis=1)]]
    ends = cKDTree(nodes / grid.cell).query(nodes[:2] / grid.cell, k=min(12, len(nodes)))[1]
    pairs = np.vstack([pairs, *[np.column_stack([np.full(len(e), x), e]) for x, e in enumerate(ends)]])
    low, high = np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1).T
    pairs = np.stack(np.divmod(np.unique(low * len(nodes) + high), len(nodes)), axis=1)
    distance = np.abs(nodes[pairs[:, 0]] - nodes[pairs[:, 1]]).max(axis=1)
    graph = csr_matrix((distance, pairs.T), shape=(len(nodes), len(nodes)))
    return nodes, (graph + graph.T).tocsr()


def _shorten(s: Surroundings, i: int, way: list[np.ndarray]) -> list[np.ndarray]:
    """Skips stop-overs that a straight path makes unnecessary."""
    pieces, at = [], 0
    while at < len(way) - 1:
        for to in range(len(way) - 1, at, -1):
            piece = straight_path(s, i, way[at], way[to])
            if piece is not None:
                break
        assert piece is not None, "neighbours were found connected"
        pieces.append(piece)
        at = to
    return pieces
