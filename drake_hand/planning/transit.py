"""Free-finger transit: lift along the normal, travel, land along the normal, clear of everything.

Lifting and landing along the normal neither drags the object nor grazes it. A finger that cannot lift off or land like
that leans aside: it does not press any more by then, or not yet. In between, a straight line in joint space mostly
suffices; otherwise the finger stops over at one of the free postures it could also wait in.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from drake_hand.contact.chain import cross, solve_least_squares
from drake_hand.planning.collision import CLEARANCE_M, Clearance
from drake_hand.planning.kernels.transit import LIFT_JUMP_RAD, LIFT_KNOTS

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
    """(4, 4)."""
    others: tuple[tuple[int, np.ndarray], ...] = ()
    """(finger index, sphere centres (1, any, 3)) of the fingers at rest."""

    @classmethod
    def of(cls, clearance: Clearance, q: np.ndarray, X_WO: np.ndarray, moving: int) -> Surroundings:
        """All fingers but one at rest at q (nq,)."""
        others = tuple(
            (j, clearance.centres(j, q[None, f.columns])) for j, f in enumerate(clearance.hand.fingers) if j != moving
        )
        return cls(clearance=clearance, X_WO=X_WO, others=others)

    def clear(self, i: int, q: np.ndarray, *, tip: bool) -> np.ndarray:
        """(N,) least clearance of finger i at q (N, m) from everything, the tip's from the object only if `tip`."""
        centres = self.clearance.centres(i, q)
        return np.minimum(self.clearance.to_palm(i, centres), self.beside_palm(i, centres, tip=tip))

    def beside_palm(self, i: int, centres: np.ndarray, *, tip: bool) -> np.ndarray:
        """As :meth:`clear`, from sphere centres (N, any, 3), the palm left out."""
        least = self.clearance.to_object(i, centres, self.X_WO, tip=tip)
        for j, other in self.others:
            least = np.minimum(least, self.clearance.between(i, centres, j, other))
        return least


def leaning(n_W: np.ndarray) -> np.ndarray:
    """(1 + LEANS, 3) unit directions off a contact: its normal (3,), and those that lean from it to each side."""
    angle = np.linspace(0, 2 * np.pi, LEANS, endpoint=False)
    across = cross(n_W, np.eye(3)[np.argmin(np.abs(n_W))])
    across /= np.linalg.norm(across)
    aside = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), cross(n_W, across))
    return np.vstack([n_W, np.cos(LEAN_RAD) * n_W + np.sin(LEAN_RAD) * aside])


def lift_off(s: Surroundings, i: int, q: np.ndarray, n_W: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Paths of finger i from contacts at q (N, m) straight up their normals n_W (N, 3).

    Returns:
        (N, LIFT_KNOTS, m) paths, and whether each is clear (N,).
    """
    kin, (N, m) = s.clearance.kinematics[i], q.shape
    p, _, J, _ = kin.jacobian(q)
    heights = np.linspace(0, height, LIFT_KNOTS)[1:, None]
    guess = q[:, None] + heights * solve_least_squares(J, n_W, damping=1e-3)[:, None]
    up, residual = kin.ik((p[:, None] + heights * n_W[:, None]).reshape(-1, 3), guess.reshape(-1, m))
    way = np.concatenate([q[:, None], up.reshape(N, LIFT_KNOTS - 1, m)], axis=1)
    jump = np.abs(np.diff(way, axis=1)).max(axis=(1, 2))
    able = np.logical_and(residual.reshape(N, LIFT_KNOTS - 1).max(axis=1) < 2e-5, jump < LIFT_JUMP_RAD)
    rows = np.flatnonzero(able)
    along = s.clear(i, way[rows].reshape(-1, m), tip=False).reshape(len(rows), LIFT_KNOTS)
    able[rows] = (along >= MOVING_CLEARANCE_M).all(axis=1)
    rows = np.flatnonzero(able)
    able[rows] = s.clear(i, way[rows, -1], tip=True) >= CLEARANCE_M
    return way, able


def straight_path(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """Straight path in joint space from a to b (m,), or None where something is in the way."""
    n = max(3, int(np.ceil(np.abs(b - a).max() / TRAVEL_STEP_RAD)) + 1)
    way = a + np.linspace(0, 1, n)[:, None] * (b - a)
    return way if (s.clear(i, way, tip=True) >= MOVING_CLEARANCE_M).all() else None


def travel(s: Surroundings, i: int, a: np.ndarray, b: np.ndarray) -> list[np.ndarray] | None:
    """Path of a free finger from a to b (m,) as straight pieces (n, m): one if that is clear, or a :func:`detour`."""
    if (s.clear(i, np.stack([a, b]), tip=True) < MOVING_CLEARANCE_M).any():
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
    clear = s.beside_palm(i, grid.centres, tip=True) >= CLEARANCE_M
    nodes = np.vstack([a, b, grid.q[clear]])
    row = np.cumsum(clear) + 1
    pairs = row[grid.neighbours[clear[grid.neighbours].all(axis=1)]]
    ends = cKDTree(nodes / grid.cell).query(nodes[:2] / grid.cell, k=min(12, len(nodes)))[1]
    pairs = np.vstack([pairs, *[np.column_stack([np.full(len(e), x), e]) for x, e in enumerate(ends)]])
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
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
