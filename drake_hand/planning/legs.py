"""Legs from states: joint and object knots, modes, events and contact points of a whole path.

A chain of states says what happens; a leg is a smooth stretch in one mode, as timing wants it. The joints of a stroke
are those that rolling gives, so contacts are exact without solving for them again.
"""

from __future__ import annotations

import itertools
from copy import copy
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from drake_hand.model.hand import Hand
from drake_hand.modes.switch import Event, EventKind
from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code
from drake_hand.planning.moves import Moves
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.state import FingerSlide, Node, Stroke, by_finger
from drake_hand.planning.strokes import rolled
from drake_hand.planning.switches import path_pieces
from drake_hand.plans.path import Leg

FEWEST_STEPS = 4
"""Of a stroke in a leg."""
INTERPOLATED_M, MOST_TIMES = 1e-5, 8
"""How far from rolling interpolation between its poses may take a tip, m, and how many times as many there are at most:
a tenth of the certificate's tolerance. Near postures stretched out, joints bend within a few steps."""


class LegBuilder:
    """Strings legs together, and keeps track of the hand's posture, the object's pose and who touches."""

    def __init__(self, hand: Hand, q: np.ndarray, X_WO: np.ndarray) -> None:
        self.hand, self.q, self.X_WO = hand, q.copy(), X_WO
        self.touching: dict[int, np.ndarray] = {}
        """Contact points in O (3,) by finger index."""
        self.sliding: set[int] = set()
        """Those of them that slide."""
        self.legs: list[Leg] = []
        self.regrasps = 0
        self._events: list[str] = []

    def copy(self) -> LegBuilder:
        """An independent copy, to continue from here."""
        other = copy(self)
        other.touching, other.sliding = dict(self.touching), set(self.sliding)
        other.legs, other._events = list(self.legs), list(self._events)
        return other

    @property
    def mode(self) -> str:
        """The mode code of who touches now."""
        return code(self.hand, self.touching, self.sliding)

    @property
    def state(self) -> Node:
        """The state that a search begins with from here, not evaluated."""
        touching = np.zeros(len(self.hand.fingers), dtype=bool)
        touching[list(self.touching)] = True
        X, q = np.ascontiguousarray(self.X_WO[:3]), by_finger(self.hand, self.q)
        return Node(s=0.0, off=np.zeros(6), X=X, q=q, touching=touching)

    def make(self, finger: int, p_OP: np.ndarray) -> None:
        """A finger makes contact; takes no time."""
        self.touching[finger] = p_OP
        self._event("make", finger)

    def break_(self, finger: int) -> None:
        """A finger breaks contact; takes no time."""
        del self.touching[finger]
        self._event("break", finger)

    def slip(self, finger: int) -> None:
        """A finger begins to slide; takes no time."""
        self.sliding.add(finger)
        self._event("slip", finger)

    def stick(self, finger: int) -> None:
        """A finger stops sliding; takes no time."""
        self.sliding.remove(finger)
        self._event("stick", finger)

    def slide(self, finger: int, way: np.ndarray, points: np.ndarray) -> None:
        """A finger slides along joints (n, m) and contact points in O (n, 3); the object rests.

        It lightens its touch before and takes it up again after, already sliding by name: its friction is not what it
        was while it rolled.
        """
        self.dwell()
        self.slip(finger)
        self.dwell()
        self.move({finger: way}, {finger: points})
        self.dwell()
        self.stick(finger)
        self.dwell()

    def dwell(self) -> None:
        """Everything at rest in this mode, while forces are handed over."""
        self._add(np.repeat(self.q[None], 2, axis=0), np.repeat(self.X_WO[None], 2, axis=0), {})

    def move(self, ways: dict[int, np.ndarray], points: dict[int, np.ndarray] | None = None) -> None:
        """Fingers move at the same time, the object at rest, each along (n, m) knots of its own; all with the same n.

        Args:
            ways: joints by finger index.
            points: contact points in O (n, 3) of those that slide.
        """
        n = len(next(iter(ways.values())))
        q = np.repeat(self.q[None], n, axis=0)
        for finger, way in ways.items():
            q[:, self.hand.fingers[finger].columns] = way
        self._add(q, np.repeat(self.X_WO[None], n, axis=0), points or {})

    def carry(self, clearance: Clearance, ways: dict[int, np.ndarray], X_WO: np.ndarray) -> None:
        """The object moves along X_WO (k, 4, 4), held by fingers that go along joints (k, m), by index."""
        q = np.repeat(self.q[None], len(X_WO), axis=0)
        points = {}
        for i, way in ways.items():
            q[:, self.hand.fingers[i].columns] = way
            p_WC = clearance.kinematics[i].fk(way)[0]
            points[i] = clearance.surface.closest(np.einsum("kji,kj->ki", X_WO[:, :3, :3], p_WC - X_WO[:, :3, 3]))[0]
        self._add(q, X_WO, points)

    def _event(self, kind: EventKind, finger: int) -> None:
        self._events.append(str(Event(kind, self.hand.fingers[finger].name)))

    def _add(self, q: np.ndarray, X_WO: np.ndarray, points: dict[int, np.ndarray]) -> None:
        p_OP = {}
        for i in sorted(self.touching):
            rows = points.get(i, np.repeat(self.touching[i][None], len(q), axis=0))
            p_OP[self.hand.fingers[i].name] = rows
            self.touching[i] = rows[-1]
        self.legs.append(Leg(mode=self.mode, events=tuple(self._events), q=q, X_WO=X_WO, p_OP=p_OP))
        self._events = []
        self.q, self.X_WO = q[-1], X_WO[-1]


def follow(builder: LegBuilder, moves: Moves, states: list[Node]) -> None:
    """Appends what a search found: strokes, and between them fingers that break and make contact."""
    known: dict[bytes, np.ndarray] = {}
    for before, after in itertools.pairwise(states):
        move = after.move
        if isinstance(move, Stroke):
            move = _with_more_poses(moves, before, move, known)
            X = _square(move.X)
            held = np.flatnonzero(after.touching)
            widths = {int(i): len(builder.hand.fingers[i].columns) for i in held}
            builder.carry(moves.clearance, {i: move.q[:, i, :m] for i, m in widths.items()}, X)
        elif isinstance(move, FingerSlide):
            builder.slide(move.finger, move.q[:, : len(builder.hand.fingers[move.finger].columns)], move.p_OP)
        else:
            assert move is not None
            _switch(builder, moves, before, after, move.finger)


def _with_more_poses(moves: Moves, before: Node, stroke: Stroke, known: dict[bytes, np.ndarray]) -> Stroke:
    """The stroke with so many poses that joints interpolated between them roll, too.

    Joints of strokes that are repeated are kept by those they had, so that they stay the same to the last digit.
    """
    K = len(stroke.X) - 1
    path = ObjectPath(X_WO=_square(stroke.X), stops=(K,))
    weightless = replace(moves, load=moves.load._replace(kinematic=True, min_contacts=0))  # forces are found later

    def finer(times: int) -> Stroke | None:
        share = np.linspace(0.0, 1.0, times * K + 1)
        X = path.beside(K * share, np.zeros((len(share), 6)))
        if (key := stroke.q.tobytes() + bytes([times])) not in known:
            q, length = rolled(weightless, X[None], np.array([times * K]), [before])
            if length[0] < times * K:
                return None
            # what follows begins where the stroke ended
            known[key] = q[0] + share[:, None, None] * (stroke.q[-1] - q[0, -1])
        return Stroke(X=X, q=known[key])

    times = -(-FEWEST_STEPS // K)
    out = stroke if times == 1 else finer(times)
    while out is not None and times <= MOST_TIMES // 2:
        next_ = finer(2 * times)
        if next_ is None or _off(moves, out, next_) < INTERPOLATED_M:
            return out
        out, times = next_, 2 * times
    return out or stroke


def _off(moves: Moves, stroke: Stroke, finer: Stroke) -> float:
    """How far tips are from where they roll, on splines through joints of a stroke, seen from one twice as fine, m."""
    K = len(stroke.q) - 1
    halfway = make_interp_spline(np.arange(K + 1.0), stroke.q, k=min(3, K))(np.arange(K) + 0.5)
    ways = []
    for i, finger in enumerate(moves.clearance.hand.fingers):
        fk, m = moves.clearance.kinematics[i].fk, len(finger.columns)
        ways.append(fk(halfway[:, i, :m])[0] - fk(finer.q[1::2, i, :m])[0])
    return float(np.linalg.norm(ways, axis=-1).max())


def _square(X: np.ndarray) -> np.ndarray:
    """Poses (n, 4, 4) from their upper rows (n, 3, 4)."""
    out = np.tile(np.eye(4), (len(X), 1, 1))
    out[:, :3] = X
    return out


def _switch(builder: LegBuilder, moves: Moves, before: Node, after: Node, finger: int) -> None:
    ways = path_pieces(moves, before, after)
    if before.touching[finger]:
        builder.regrasps += bool(after.touching[finger])
        builder.dwell()
        builder.break_(finger)
    for way in ways:
        builder.move({finger: way})
    if after.touching[finger]:
        builder.make(finger, after.p_OP[finger])
        builder.dwell()
