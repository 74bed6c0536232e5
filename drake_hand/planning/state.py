"""States of the search and the moves between them, as data.

A state of the hybrid automaton is a mode (who touches), the contacts (postures of the touching fingers) and the
object's pose. The pose is free within the task's corridor: it is a progress along the nominal path and an offset from
it. ::

    Node --Stroke--> Node      the object moves on, every touching finger rolls (or pivots) with it
    Node --FingerSwitch--> Node      one finger breaks contact, makes one elsewhere, or both; all else rests
    Node --FingerSlide--> Node      one finger slides over the surface; all else rests
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from drake_hand.model.hand import Hand


@dataclass(frozen=True, kw_only=True, eq=False)
class Stroke:
    """The object moves, held by all fingers that touch."""

    X: np.ndarray
    """(k + 1, 3, 4) object poses."""
    q: np.ndarray
    """(k + 1, n, m) postures at them, rad."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FingerSwitch:
    """One finger breaks and makes contact elsewhere, makes one, or breaks it and waits; the object rests."""

    finger: int
    rise: int
    """Index of the way off its contact that it begins with; of no meaning where the finger does not touch before."""
    landing: int
    """Index of the way off its new contact, by which it lands; -1 where it does not land."""
    stop: int
    """Index of the stop-over on its path, or of where it waits; -1 for none."""
    ways: tuple[np.ndarray, ...] | None = None
    """The pieces of its path (k, m), where they are not to be made from the indices."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FingerSlide:
    """One finger moves over the surface in contact; the object rests, held by the others and by it."""

    finger: int
    q: np.ndarray
    """(k + 1, m) its postures, rad."""
    p_OP: np.ndarray
    """(k + 1, 3) its contact points, m."""


@dataclass(kw_only=True, eq=False, slots=True)
class Node:
    """Where a hand holds the object."""

    s: float
    """Progress along the nominal path, ticks."""
    off: np.ndarray
    """(6,) rotation vector (rad) and translation (m) from the nominal pose, in W."""
    X: np.ndarray
    """(3, 4) object pose."""
    q: np.ndarray
    """(n, m) posture by finger, rad; columns a finger lacks are zero."""
    touching: np.ndarray
    """(n,) bool."""
    regrasps: int = 0
    """And slides."""
    parent: Node | None = None
    move: Stroke | FingerSwitch | FingerSlide | None = None
    """What led here from the parent."""
    room: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n,) how far each contact would roll on along the nominal path, 1 for far enough."""
    margins: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n + 1,) with which the object is held without each finger and, last, with all of them, N."""
    p_OP: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) contact points, m, of the fingers that touch."""
    n_W: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) outward normals there."""
    score: float = 0.0
    """How promising the state is."""
    progress: float = 0.0
    """Ticks behind it, less what the offset and unwanted contacts cost at the end of the step."""
    niche: tuple[int, ...] = ()
    """Equal for states that are much alike."""

    @property
    def liftable(self) -> np.ndarray:
        """(n,) which of the fingers that touch can be lifted: the others hold the object."""
        return (self.margins[:-1] >= 0) & self.touching

    @property
    def spared(self) -> int:
        """How many of its fingers it can spare, one at a time."""
        return int(self.liftable.sum())

    def moved(
        self, finger: int, q: np.ndarray, move: FingerSwitch | FingerSlide | None = None, *, touching: bool = True
    ) -> Node:
        """The state after one finger has gone to q (m,), the object and all else at rest; not evaluated."""
        posture, on = self.q.copy(), self.touching.copy()
        posture[finger], on[finger] = q, touching
        regrasps = self.regrasps + bool(self.touching[finger] and touching)
        return Node(s=self.s, off=self.off, X=self.X, q=posture, touching=on, regrasps=regrasps, parent=self, move=move)

    @property
    def chain(self) -> list[Node]:
        """The states from the root to this one."""
        out, walk = [], self
        while walk is not None:
            out.append(walk)
            walk = walk.parent  # type: ignore[assignment]
        return out[::-1]


def by_finger(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(n, m) a posture q (nq,) finger by finger."""
    out = np.zeros((len(hand.fingers), max(len(f.columns) for f in hand.fingers)))
    for row, finger in zip(out, hand.fingers, strict=True):
        row[: len(finger.columns)] = q[finger.columns]
    return out


def whole(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(nq,) a posture (n, m) that is given finger by finger."""
    out = np.zeros(hand.nq)
    for row, finger in zip(q, hand.fingers, strict=True):
        out[finger.columns] = row[: len(finger.columns)]
    return out
