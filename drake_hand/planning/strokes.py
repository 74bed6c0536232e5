"""Strokes from a state: the object moves on along paths drawn at random, every touching finger with it.

A path is followed as far as it is feasible: balance, limits and clearances are tested all along, and the last feasible
pose is the new state. Paths that leave the nominal one make room: often a finger can be lifted from a pose that is
a little off it.
"""

from __future__ import annotations

import itertools

import numpy as np

from drake_hand.planning.kernels import stroke
from drake_hand.planning.moves import Moves, offset_ticks
from drake_hand.planning.state import Node, Stroke
from drake_hand.planning.world import split

STROKES_DRAWN = 24
"""Strokes drawn for a state."""
SHORTEST_TICKS, LONGEST_TICKS = 4, 36
"""Progress they are drawn from, ticks."""
STROKES_KEPT = 10
"""Of those that get on, how many are kept."""
MOST_POSES = 60
"""Poses of a stroke at most."""
SPREAD_RAD, SPREAD_M = np.radians(5.0), 5.0e-3
"""Standard deviation of the offset that a stroke adds."""
BALANCE_INTERVAL_POSES = 3
"""Balance is tested every so many poses."""


def draw_strokes(moves: Moves, state: Node) -> list[Node]:
    """The states that strokes from here lead to, each as far as it lasts; the best of them."""
    found = _towards(moves, state, *_targets(moves, state))
    still = [x for x in found if x.s <= state.s]
    return still + sorted((x for x in found if x.s > state.s), key=lambda x: -x.s)[:STROKES_KEPT]


def carried(moves: Moves, state: Node, s: float, off: np.ndarray) -> Node | None:
    """The state with the object at progress s and an offset (6,), if one stroke gets there."""
    if s == state.s and np.array_equal(off, state.off):
        return state
    found = _towards(moves, state, np.array([s]), off[None])
    return found[0] if found and found[0].s == s and np.array_equal(found[0].off, off) else None


def carried_to(moves: Moves, states: list[Node], s: np.ndarray, off: np.ndarray) -> list[Node | None]:
    """Each state with the object at progress s (N,) and an offset (N, 6) of its own, if one stroke gets there."""
    s0, off0 = (np.array([getattr(x, k) for x in states]) for k in ("s", "off"))
    K = _steps(s - s0, off - off0)
    X = _straight(moves, K, s0, off0, s, off)
    q, length = rolled(moves, X, K, states)
    out: list[Node | None] = []
    for i, (x, k) in enumerate(zip(states, K.tolist(), strict=True)):
        stroke = Stroke(X=X[i, : k + 1], q=q[i, : k + 1])
        out.append(None if length[i] < k else _after(x, s=float(s[i]), off=off[i], move=stroke) if k else x)
    return out


def _steps(ds: np.ndarray, doff: np.ndarray) -> np.ndarray:
    """(N,) how many steps it takes to progress by ds (N,) and change the offset by doff (N, 6)."""
    return np.ceil(np.maximum(np.abs(ds), offset_ticks(doff)) - 1e-9).astype(np.int64)


def _straight(
    moves: Moves, K: np.ndarray, s0: np.ndarray, off0: np.ndarray, s: np.ndarray, off: np.ndarray
) -> np.ndarray:
    """Poses (N, most + 1, 3, 4) in K (N,) even steps of progress, s0 to s (N,), and offset, off0 to off (N, 6)."""
    share = np.minimum(np.arange(K.max() + 1) / np.maximum(K, 1)[:, None], 1.0)
    return moves.path.beside(
        s0[:, None] + share * (s - s0)[:, None], off0[:, None] + share[..., None] * (off - off0)[:, None]
    )


def _towards(moves: Moves, state: Node, s: np.ndarray, off: np.ndarray) -> list[Node]:
    """How far strokes to progress s (N,) and offsets (N, 6) get."""
    K = _steps(s - state.s, off - state.off)
    some = (K > 0) & (K <= MOST_POSES)
    s, off, K = s[some], off[some], K[some]
    if not len(K):
        return []
    X = _straight(moves, K, np.full(len(K), state.s), np.tile(state.off, (len(K), 1)), s, off)
    q, length = rolled(moves, X, K, [state] * len(K))
    out = []
    for i, done in enumerate(length):
        if not done:
            continue
        part, whole = done / K[i], done == K[i]
        out.append(
            _after(
                state,
                s=float(s[i]) if whole else float(state.s + part * (s[i] - state.s)),
                off=off[i] if whole else state.off + part * (off[i] - state.off),
                move=Stroke(X=X[i, : done + 1], q=q[i, : done + 1]),
            )
        )
    return out


def _targets(moves: Moves, state: Node) -> tuple[np.ndarray, np.ndarray]:
    """Progress (N,) and offset (N, 6) that strokes aim at; the end of a step is met without an offset."""
    rng, stop = moves.rng, moves.path.next_stop(state.s)
    s = state.s + rng.uniform(SHORTEST_TICKS, LONGEST_TICKS, STROKES_DRAWN)
    noise = np.concatenate(
        [rng.normal(0, SPREAD_RAD, (STROKES_DRAWN, 3)), rng.normal(0, SPREAD_M, (STROKES_DRAWN, 3))], axis=1
    )
    off = moves.corridor.clipped(moves.path.sideways(state.s, state.off + noise))
    # Some only improve the pose, some keep it, some go straight for the end.
    s[:4] = state.s
    s[4:6] = state.s + LONGEST_TICKS
    off[4], off[5:9] = 0.0, state.off
    if stop - state.s < LONGEST_TICKS:
        s[9:12] = stop
    s = np.minimum(s, stop)
    off[(s >= stop) & (s > state.s)] = 0.0
    if state.s >= stop:
        off[:2] = 0.0
    return s, off


def onward(moves: Moves, states: list[Node]) -> list[Node]:
    """The last states that states on the nominal path, at a tick, reach along it without a switch."""
    states = [x for x in states if not x.off.any() and x.s < moves.path.ticks]
    if not states:
        return []
    start = np.array([round(x.s) for x in states])
    K = moves.path.ticks - start
    X = moves.path.X_WO[np.minimum(start[:, None] + np.arange(K.max() + 1), moves.path.ticks), :3]
    q, length = rolled(moves, np.ascontiguousarray(X), K, states)
    out = []
    for i, state in enumerate(states):
        end = int(start[i] + length[i])
        stops = [stop for stop in moves.path.stops if start[i] < stop < end]
        for a, b in itertools.pairwise([int(start[i]), *stops, end] if length[i] else []):
            rows = slice(a - start[i], b - start[i] + 1)
            move = Stroke(X=X[i, rows], q=q[i, rows])
            state = _after(state, s=float(b), off=state.off, move=move)
        if length[i]:
            out.append(state)
    return out


def rolled(moves: Moves, X: np.ndarray, K: np.ndarray, states: list[Node]) -> tuple[np.ndarray, np.ndarray]:
    """Carries states along paths X (N, most + 1, 3, 4) of K (N,) steps.

    Returns:
        Postures (N, most + 1, n, m), and how many steps of each can be made (N,).
    """
    N = len(K)
    q = np.zeros((*X.shape[:2], *states[0].q.shape))
    length, why, who = np.zeros((3, N), dtype=np.int64)
    q0, touching = np.stack([x.q for x in states]), np.stack([x.touching for x in states])

    def run(r: slice) -> None:
        stroke.strokes(
            moves.world,
            moves.load,
            X[r],
            K[r],
            q0[r],
            touching[r],
            BALANCE_INTERVAL_POSES,
            q[r],
            length[r],
            why[r],
            who[r],
        )

    split(run, N, least=12)
    return q, length


def _after(state: Node, *, s: float, off: np.ndarray, move: Stroke) -> Node:
    """The state after a stroke."""
    return Node(
        s=s,
        off=off,
        X=move.X[-1],
        q=move.q[-1],
        touching=state.touching,
        regrasps=state.regrasps,
        parent=state,
        move=move,
    )
