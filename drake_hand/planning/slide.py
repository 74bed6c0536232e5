"""Slides: a finger moves over the surface in light contact while the object rests, held by the others.

The friction of a sliding contact may be anything up to the coefficient, so the others have to hold for all and none.
"""

from __future__ import annotations

import numpy as np

from drake_hand.planning.kernels import slide as kernels
from drake_hand.planning.moves import SHORT_ROOM_SHARE, Moves
from drake_hand.planning.state import FingerSlide, Node

SLIDE_STEP_M = 1e-3
"""Between knots of a slide, m."""
LONGEST_SLIDE_STEPS, SLIDE_LOOK = 15, 3
"""Of slides in search of room; and after how many steps each it is asked how much there is."""
SLIDES_TRIED, SLIDES_RATED, SLIDES_KEPT = 8, 8, 2
"""Ways on which a finger slides, all round; and ends of slides kept, where there is most room."""


def directions(q: np.ndarray, J_WP: np.ndarray, n_W: np.ndarray) -> np.ndarray:
    """Unit vectors along which a tip's material slides over an object at rest.

    Args:
        q: (n, m) joints along the path, evenly spaced in its parameter.
        J_WP: (n, 3, m) Jacobians of the tip's material point at the contact.
        n_W: (n, 3) normals.

    Returns:
        (n, 3).
    """
    velocity = np.einsum("nij,nj->ni", J_WP, np.gradient(q, axis=0, edge_order=2))
    velocity -= n_W * np.sum(velocity * n_W, axis=1, keepdims=True)
    return velocity / np.maximum(np.linalg.norm(velocity, axis=1, keepdims=True), 1e-12)


def draw_slides(moves: Moves, state: Node, finger: int) -> list[Node]:
    """The states in which a finger has slid to where its contact lasts longer, the most promising of them."""
    touching = np.flatnonzero(state.touching).tolist()
    if not moves.allowed(touching, [finger]):
        return []
    p_OP, n_O = _lines(moves, state, finger)
    q, length, _ = slid(moves, state, finger, p_OP, n_O)
    ends = np.arange(SLIDE_LOOK, p_OP.shape[1], SLIDE_LOOK)
    line, end = np.nonzero(ends <= length[:, None])
    end = ends[end]
    if not len(line):
        return []
    ways, steps = moves.look(np.full(len(line), state.s), np.tile(state.off, (len(line), 1)))
    room = moves.rooms(np.full(len(line), finger), np.ascontiguousarray(q[line, end]), ways, steps)
    best = np.argsort(-room, kind="stable")
    best = best[room[best] >= SHORT_ROOM_SHARE][:SLIDES_RATED]
    out = []
    for i in best:
        k = int(end[i])
        move = FingerSlide(finger=finger, q=q[line[i], : k + 1], p_OP=p_OP[line[i], : k + 1])
        out.append(state.moved(finger, move.q[k], move))
    rooms = np.repeat(state.room[None], len(out), axis=0)
    rooms[:, finger] = room[best]
    moves.evaluate(out, rooms)
    better = [x for x in out if x.margins[-1] >= 0 and x.score > state.score]
    return sorted(better, key=lambda x: -x.score)[:SLIDES_KEPT]


def slid(
    moves: Moves, state: Node, finger: int, p_OP: np.ndarray, n_O: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slides a finger along points (N, K + 1, 3) of the surface with normals n_O.

    Returns:
        Postures (N, K + 1, m), how many steps of each can be made (N,), and what ends them (N,), see `END_WORDS`.
    """
    N, p_OP, n_O = len(p_OP), np.ascontiguousarray(p_OP), np.ascontiguousarray(n_O)
    q, length, why = np.zeros((*p_OP.shape[:2], state.q.shape[1])), np.zeros(N, np.int64), np.zeros(N, np.int64)
    kernels.slides(moves.world, moves.load, finger, state.X, state.q, state.touching, p_OP, n_O, q, length, why)
    return q, length, why


def slid_again(moves: Moves, before: Node, x: Node) -> Node | None:
    """The state in which a finger has slid as it did to x, another finger elsewhere; if that holds, and is clear."""
    move = x.move
    assert isinstance(move, FingerSlide)
    n_O = moves.clearance.surface.closest(move.p_OP)[1]
    _, length, _ = slid(moves, before, move.finger, move.p_OP[None], n_O[None])
    return before.moved(move.finger, x.q[move.finger], move) if length[0] == len(move.p_OP) - 1 else None


def _lines(moves: Moves, state: Node, finger: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, K + 1, 3) and normals of ways over the surface from a contact, straight as seen from above."""
    n_O = state.n_W[finger] @ state.X[:, :3]
    e = np.eye(3)[np.argmin(np.abs(n_O))]
    t1 = np.cross(e, n_O)
    t1 /= np.linalg.norm(t1)
    angle = 2 * np.pi * np.arange(SLIDES_TRIED) / SLIDES_TRIED
    ways = np.cos(angle)[:, None] * t1 + np.sin(angle)[:, None] * np.cross(n_O, t1)
    far = SLIDE_STEP_M * np.arange(LONGEST_SLIDE_STEPS + 1)
    above = state.p_OP[finger] + far[:, None] * ways[:, None]
    p, n, _ = moves.clearance.surface.closest(above.reshape(-1, 3))
    return p.reshape(above.shape), n.reshape(above.shape)
