"""Free-finger transit: lift along the normal, travel, land along the normal, clear of everything."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from drake_hand.planning.collision import Clearance
from drake_hand.planning.reach import CLEARANCE

LIFTS = (3.0e-3, 8.0e-3, 15.0e-3)
"""Heights over the surface that are tried, m."""
KNOTS = 9
"""Knots of a lift or a landing."""
STEP = np.radians(3.0)
"""Joint step between knots and between collision checks of a travel."""


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What a moving finger must keep clear of: object and all other fingers, all at rest."""

    clearance: Clearance
    X_WO: np.ndarray
    """(4, 4)."""
    others: tuple[tuple[int, np.ndarray], ...]
    """(finger index, sphere centres (1, S, 3)) of the fingers at rest."""

    @classmethod
    def of(cls, clearance: Clearance, q: np.ndarray, X_WO: np.ndarray, moving: int) -> Surroundings:
        """All fingers but one at rest at q (nq,)."""
        others = tuple(
            (j, clearance.centres(j, q[None, f.columns])) for j, f in enumerate(clearance.hand.fingers) if j != moving
        )
        return cls(clearance=clearance, X_WO=X_WO, others=others)

    def clear(self, i: int, q: np.ndarray, *, tip: bool) -> np.ndarray:
        """(N,) least clearance of finger i at q (N, m) from everything, the tip's from the object only if `tip`."""
        return np.minimum(self.clear_centres(i, self.clearance.centres(i, q), tip=tip), self.clearance.to_palm(i, q))

    def clear_centres(self, i: int, centres: np.ndarray, *, tip: bool) -> np.ndarray:
        """As :meth:`clear`, from sphere centres (N, S, 3), the palm left out."""
        least = self.clearance.centres_to_object(i, centres, self.X_WO, tip=tip)
        for j, other in self.others:
            least = np.minimum(least, self.clearance.between_centres(i, centres, j, other))
        return least


def lift(s: Surroundings, i: int, q: np.ndarray, n_W: np.ndarray, height: float) -> np.ndarray | None:
    """Way of finger i from its contact at q (m,) straight up the normal: (KNOTS, m), or None where it is blocked."""
    kin = s.clearance.kinematics[i]
    p, _ = kin.fk(q[None])
    heights = np.linspace(0, height, KNOTS)[1:, None]
    rest, residual = kin.ik(p + heights * n_W, np.repeat(q[None], KNOTS - 1, axis=0))
    if (residual > 2e-5).any():
        return None
    way = np.vstack([q, rest])
    if (s.clear(i, way, tip=False) < CLEARANCE / 2).any() or (s.clear(i, way[-1:], tip=True) < CLEARANCE).any():
        return None
    return way


def straight(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Straight way in joint space from a to b (m,), or None where something is in the way."""
    n = max(3, int(np.ceil(np.abs(b - a).max() / STEP)) + 1)
    u = np.linspace(0, 1, n)[:, None]
    way = a + u * (b - a)
    return way if (s.clear(i, way, tip=True) >= CLEARANCE / 2).all() else None


def travel(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> list[np.ndarray] | None:
    """Way of a free finger from a to b (m,): straight where that is clear, else by :func:`detour`."""
    direct = straight(s, i, a, b)
    return [direct] if direct is not None else detour(s, i, a, b)


def detour(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> list[np.ndarray] | None:
    """Way of a free finger from a to b (m,) over a roadmap.

    The roadmap is a grid of clear postures; its edges are checked only when a shortest path uses them
    (lazy PRM; Bohlin & Kavraki 2000).

    Returns:
        Straight pieces, each (n, m); None where no way was found.
    """
    nodes, graph = _roadmap(s, i, a, b)
    pieces: dict[tuple[int, int], np.ndarray] = {}
    for _ in range(_ATTEMPTS):
        length, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
        if not np.isfinite(length[1]):
            return None
        way = [1]
        while way[-1] != 0:
            way.append(int(before[way[-1]]))
        way.reverse()
        blocked = False
        for u, v in zip(way[:-1], way[1:], strict=True):
            if (u, v) not in pieces:
                piece = straight(s, i, nodes[u], nodes[v])
                if piece is None:
                    graph[u, v] = graph[v, u] = 0.0
                    blocked = True
                    break
                pieces[u, v] = piece
        if not blocked:
            graph.eliminate_zeros()
            return _shorten(s, i, [nodes[x] for x in way])
        graph.eliminate_zeros()
    return None


_ATTEMPTS = 60


def _roadmap(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, csr_matrix]:
    """Nodes (row 0 is a, row 1 is b) and their distances: grid neighbours, and both ends to what is near."""
    q, centres = s.clearance.grid(i)
    nodes = np.vstack([a, b, q[s.clear_centres(i, centres, tip=True) >= CLEARANCE]])
    cell = s.clearance.cell(i)
    tree = cKDTree(nodes / cell)
    pairs = tree.query_pairs(1.8, output_type="ndarray")
    ends = tree.query(nodes[:2] / cell, k=min(12, len(nodes)))[1]
    pairs = np.vstack([pairs, *[np.column_stack([np.full(len(e), x), e]) for x, e in enumerate(ends)]])
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    distance = np.abs(nodes[pairs[:, 0]] - nodes[pairs[:, 1]]).max(axis=1)
    graph = csr_matrix((distance, pairs.T), shape=(len(nodes), len(nodes)))
    return nodes, (graph + graph.T).tocsr()


def _shorten(s: Surroundings, i: int, way: list[np.ndarray]) -> list[np.ndarray]:
    """Skips stop-overs that a straight way avoids."""
    pieces, at = [], 0
    while at < len(way) - 1:
        for to in range(len(way) - 1, at, -1):
            piece = straight(s, i, way[at], way[to])
            if piece is not None:
                break
        assert piece is not None, "neighbours were found connected"
        pieces.append(piece)
        at = to
    return pieces
