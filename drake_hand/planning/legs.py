"""Legs from search nodes: joint and object knots, modes, events and contact points of a whole path."""

from __future__ import annotations

from copy import copy

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.planning.failure import code
from drake_hand.planning.moves import Node
from drake_hand.planning.object_path import ObjectPath
from drake_hand.planning.reach import Hold
from drake_hand.plans.path import Leg


class LegBuilder:
    """Strings legs together; knows the hand's posture, the object's pose and who touches."""

    def __init__(self, hand: Hand, q: np.ndarray, X_WO: np.ndarray) -> None:
        self.hand, self.q, self.X_WO = hand, q, X_WO
        self.touching: dict[int, np.ndarray] = {}
        """Contact points in O (3,) by finger index."""
        self.sliding: set[int] = set()
        """Those of them that slide."""
        self.legs: list[Leg] = []
        self.regrasps = 0
        self._events: list[str] = []

    def copy(self) -> LegBuilder:
        """One that goes on from here without changing this one."""
        other = copy(self)
        other.touching, other.sliding = dict(self.touching), set(self.sliding)
        other.legs, other._events = list(self.legs), list(self._events)
        return other

    @property
    def mode(self) -> str:
        """The mode code of who touches now."""
        return code(self.hand, self.touching, self.sliding)

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
        """Everything at rest in this mode: where forces are handed over."""
        self._add(np.repeat(self.q[None], 2, axis=0), np.repeat(self.X_WO[None], 2, axis=0), {})

    def move(self, ways: dict[int, np.ndarray], points: dict[int, np.ndarray] | None = None) -> None:
        """Fingers move at once, the object at rest, each along (n, m) knots of its own; all with the same n.

        Args:
            ways: joints by finger index.
            points: contact points in O (n, 3) of those that slide.
        """
        n = len(next(iter(ways.values())))
        q = np.repeat(self.q[None], n, axis=0)
        for finger, way in ways.items():
            q[:, self.hand.fingers[finger].columns] = way
        self._add(q, np.repeat(self.X_WO[None], n, axis=0), points or {})

    def carry(self, holds: tuple[Hold, ...], X_WO: np.ndarray, first: int, last: int) -> None:
        """The object moves from tick `first` to `last` of a path X_WO (K, 4, 4), held by `holds`."""
        ticks = np.arange(first, last + 1)
        X = X_WO[ticks]
        q = np.repeat(self.q[None], len(ticks), axis=0)
        points = {}
        for h in holds:
            a = ticks - h.birth
            q[:, self.hand.fingers[h.finger].columns] = h.q[a]
            points[h.finger] = np.einsum("kji,kj->ki", X[:, :3, :3], h.p_WP[a] - X[:, :3, 3])
        self._add(q, X, points)

    def _event(self, kind: str, finger: int) -> None:
        self._events.append(f"{kind} {self.hand.fingers[finger].name}")

    def _add(self, q: np.ndarray, X_WO: np.ndarray, points: dict[int, np.ndarray]) -> None:
        p_OP = {}
        for i in sorted(self.touching):
            rows = points.get(i, np.repeat(self.touching[i][None], len(q), axis=0))
            p_OP[self.hand.fingers[i].name] = rows
            self.touching[i] = rows[-1]
        self.legs.append(Leg(mode=self.mode, events=tuple(self._events), q=q, X_WO=X_WO, p_OP=p_OP))
        self._events = []
        self.q, self.X_WO = q[-1], X_WO[-1]


def gait(builder: LegBuilder, path: ObjectPath, nodes: list[Node]) -> None:
    """Appends what the search found: advance, lift one finger and set it down or slide it on, advance..."""
    for i, node in enumerate(nodes):
        if i:
            _regrasp(builder, node, path.X_WO[node.tick])
        until = nodes[i + 1].tick if i + 1 < len(nodes) else path.ticks
        stops = [s for s in path.stops if node.tick < s < until]
        for first, last in zip([node.tick, *stops], [*stops, until], strict=True):
            if last > first:
                builder.carry(node.holds, path.X_WO, first, last)


def _regrasp(builder: LegBuilder, node: Node, X_WO: np.ndarray) -> None:
    finger = node.holds[node.slot].finger
    if node.points is not None:
        builder.slide(finger, node.ways[0], node.points)
        return
    builder.regrasps += 1
    builder.dwell()
    builder.break_(finger)
    for way in node.ways:
        builder.move({finger: way})
    contact = node.holds[node.slot].at(node.tick)[1]
    builder.make(finger, X_WO[:3, :3].T @ (contact - X_WO[:3, 3]))
    builder.dwell()
