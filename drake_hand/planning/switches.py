"""Switches from a state: one finger breaks contact, makes it elsewhere, or both; and the paths it takes.

Balance and clearances are tested before a switch is kept, those of lift, travel and landing too: gaits found without
their transits turned out to collide in them.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from drake_hand.planning.kernels import transit
from drake_hand.planning.moves import Moves
from drake_hand.planning.state import FingerSwitch, Node, whole
from drake_hand.planning.transit import LIFTS_M, TRAVEL_STEP_RAD, Surroundings, detour, leaning, lift_off

POINTS_OFFERED = 200
"""Surface points a switching finger is offered."""
CONTACTS_TRIED, CONTACTS_KEPT = 14, 4
"""Of those, contacts tried and kept."""
LEAST_ROOM_SHARE = 0.12
"""A new contact has to roll on at least so far, of 1."""


def draw_switches(moves: Moves, state: Node, finger: int) -> list[Node]:
    """The states in which a finger has made contact elsewhere, the most promising first."""
    touches = bool(state.touching[finger])
    whole = frozenset(np.flatnonzero(state.touching).tolist())
    if touches and (state.margins[finger] < 0 or not moves.allowed(whole - {finger})):
        return []
    if finger not in moves.fingers or not moves.allowed(whole | {finger}):
        return []
    q = moves.contacts(finger, state.X, POINTS_OFFERED)[0]
    room = moves.rooms(
        np.full(len(q), finger), q, *moves.look(np.full(len(q), state.s), np.tile(state.off, (len(q), 1)))
    )
    order = np.argsort(-(room + moves.rng.uniform(0, 0.3, len(room))), kind="stable")[:CONTACTS_TRIED]
    order = order[room[order] > LEAST_ROOM_SHARE]
    posture = np.repeat(state.q[None], len(order), axis=0)
    posture[:, finger] = q[order]
    touching = np.repeat(state.touching[None], len(order), axis=0)
    touching[:, finger] = True
    order, posture = (x[moves.clear(state.X, posture, touching)] for x in (order, posture))
    out = [state.moved(finger, row[finger]) for row in posture]
    rooms = np.repeat(state.room[None], len(out), axis=0)
    rooms[:, finger] = room[order]
    moves.evaluate(out, rooms)
    best = sorted((i for i, x in enumerate(out) if x.margins[-1] >= 0), key=lambda i: -out[i].score)
    kept: list[Node] = []
    for some in (best[i : i + CONTACTS_KEPT] for i in range(0, len(best), CONTACTS_KEPT)):
        n_W = np.stack([out[i].n_W[finger] for i in some])  # those that the paths will be made with
        found = _transits(moves, state, finger, q[order[some]], n_W)
        for i, (rise, landing, stop) in zip(some, found.tolist(), strict=True):
            if rise >= 0:
                out[i].move = FingerSwitch(finger=finger, rise=rise, landing=landing, stop=stop - 1)
                kept.append(out[i])
        if len(kept) >= CONTACTS_KEPT:
            break
    return kept[:CONTACTS_KEPT]


def draw_retreats(moves: Moves, state: Node, finger: int) -> list[Node]:
    """The states in which a finger waits elsewhere, off the object."""
    touches = bool(state.touching[finger])
    rest = frozenset(np.flatnonzero(state.touching).tolist()) - {finger}
    if touches and (state.margins[finger] < 0 or not moves.allowed(rest)):
        return []
    stops, found = moves.grid.stops[finger], _ways_off(moves, state, finger)
    out = []
    for v in np.flatnonzero(found >= 0)[:CONTACTS_KEPT]:
        if not np.array_equal(stops[v], state.q[finger]):
            move = FingerSwitch(finger=finger, rise=int(found[v]), landing=-1, stop=int(v))
            out.append(state.moved(finger, stops[v], move, touching=False))
    moves.evaluate(out)
    return [x for x in out if x.margins[-1] >= 0]


def leaves(moves: Moves, state: Node, finger: int) -> bool:
    """Whether a finger gets away from its contact: lifted off it, and on to where it can wait."""
    return bool((_ways_off(moves, state, finger) >= 0).any())


def _ways_off(moves: Moves, state: Node, finger: int) -> np.ndarray:
    """(V,) the lift with which a finger gets to each of its stops, -1 where none does."""
    stops = moves.grid.stops[finger]
    found = np.full(len(stops), -1, dtype=np.int64)
    transit.retreats(*_departure(moves, state, finger), stops, TRAVEL_STEP_RAD, found)
    return found


def switch_between(moves: Moves, before: Node, after: Node, finger: int) -> FingerSwitch | None:
    """The move of a finger to where it is in another state: to a contact, or to where it waits."""
    return switch_to(moves, before, after, finger) if after.touching[finger] else _retreat(moves, before, after, finger)


def _retreat(moves: Moves, before: Node, after: Node, finger: int) -> FingerSwitch | None:
    """The move of a finger to where it waits."""
    found, stop = np.full(1, -1, dtype=np.int64), np.ascontiguousarray(after.q[finger][None])
    transit.retreats(*_departure(moves, before, finger), stop, TRAVEL_STEP_RAD, found)
    if found[0] < 0:
        return None
    pieces, start = [], before.q[finger]
    if before.touching[finger]:
        pieces.append(_lift(moves, before, finger, start, _rises(before.n_W[finger])[found[0]]))
        start = pieces[0][-1]
    pieces.append(_straight(start, after.q[finger]))
    m = len(moves.clearance.kinematics[finger].lower)
    return FingerSwitch(finger=finger, rise=-1, landing=-1, stop=-1, ways=tuple(x[:, :m] for x in pieces))


def _transits(moves: Moves, state: Node, finger: int, q: np.ndarray, n_W: np.ndarray) -> np.ndarray:
    """(N, 3) as `transit.transits` finds them."""
    found = np.zeros((len(q), 3), dtype=np.int64)
    stops = moves.grid.stops[finger]
    transit.transits(*_departure(moves, state, finger), q, _rises(n_W), stops, TRAVEL_STEP_RAD, found)
    return found


def _departure(moves: Moves, state: Node, finger: int) -> tuple[Any, ...]:
    """What the kernels ask about a finger that goes away: where it is, what is around it, and how it may lift off."""
    touches = bool(state.touching[finger])
    rises = _rises(state.n_W[finger]) if touches else np.zeros((1, 3))
    return moves.world, finger, state.X, state.q, state.q[finger], touches, rises, len(LIFTS_M)


def _rises(n_W: np.ndarray) -> np.ndarray:
    """(..., D, 3) ways off contacts of outward normals (..., 3), m: along them, then leaning by the least height."""
    upright = np.array(LIFTS_M)[:, None] * n_W[..., None, :]
    return np.concatenate([upright, LIFTS_M[0] * leaning(n_W)[..., 1:, :]], axis=-2)


def direct_switch(moves: Moves, before: Node, after: Node, finger: int) -> FingerSwitch | None:
    """As `switch_between`, without a roadmap."""
    if not after.touching[finger]:
        return _retreat(moves, before, after, finger)
    rise, landing, stop = _transits(moves, before, finger, after.q[finger][None], after.n_W[finger][None])[0].tolist()
    return None if rise < 0 else FingerSwitch(finger=finger, rise=rise, landing=landing, stop=stop - 1)


def switch_to(moves: Moves, before: Node, after: Node, finger: int) -> FingerSwitch | None:
    """The move of a finger that touches in both states, by a roadmap where no quicker path is found."""
    quick = direct_switch(moves, before, after, finger)
    if quick is not None:
        return quick
    old, new = before.q[finger], after.q[finger]
    fingers, X = moves.clearance.hand.fingers, np.vstack([before.X, [0.0, 0.0, 0.0, 1.0]])
    m = len(fingers[finger].columns)
    posture = whole(moves.clearance.hand, before.q)
    around = Surroundings.of(moves.clearance, posture, X, finger)
    normals = np.stack([before.n_W[finger], after.n_W[finger]])
    for height in LIFTS_M:
        (up, down), able = lift_off(around, finger, np.stack([old, new])[:, :m], normals, height)
        if able.all():
            pieces = detour(around, finger, up[-1], down[-1])
            ways = None if pieces is None else (up, *pieces, down[::-1])
            return None if ways is None else FingerSwitch(finger=finger, rise=-1, landing=-1, stop=-1, ways=ways)
    return None


def path_pieces(moves: Moves, before: Node, after: Node) -> tuple[np.ndarray, ...]:
    """The pieces (k, m) of the path of a switch: lift, travel and landing, as many of them as it has."""
    move = after.move
    assert isinstance(move, FingerSwitch)
    if move.ways is not None:
        return move.ways
    f, m = move.finger, len(moves.clearance.kinematics[move.finger].lower)
    pieces: list[np.ndarray] = []
    points = [before.q[f]]
    if before.touching[f]:
        pieces.append(_lift(moves, before, f, before.q[f], _rises(before.n_W[f])[move.rise]))
        points = [pieces[0][-1]]
    if move.stop >= 0:
        points.append(moves.grid.stops[f][move.stop])
    down = None
    if move.landing >= 0:
        down = _lift(moves, before, f, after.q[f], _rises(after.n_W[f])[move.landing])[::-1]
        points.append(down[0])
    pieces += [_straight(a, b) for a, b in itertools.pairwise(points)]
    pieces += [down] if down is not None else []
    return tuple(piece[:, :m] for piece in pieces)


def _lift(moves: Moves, state: Node, finger: int, q: np.ndarray, rise: np.ndarray) -> np.ndarray:
    way = np.zeros((transit.LIFT_KNOTS, len(q)))
    transit.lift_path(moves.world, finger, state.X, state.q, q, rise, way)
    return way


def _straight(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The straight path (k, m) in joint space."""
    n = max(3, int(np.ceil(np.abs(b - a).max() / TRAVEL_STEP_RAD)) + 1)
    return a + np.linspace(0, 1, n)[:, None] * (b - a)
