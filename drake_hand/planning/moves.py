"""`Moves`: samples moves along one nominal path and scores states, in compiled batches.

The moves themselves are strokes (`strokes.py`) and switches (`switches.py`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code
from drake_hand.planning.kernels import clear, hold, stroke, transit
from drake_hand.planning.kernels.world import END, END_WORDS, REACH, Load, World
from drake_hand.planning.object_path import TICK_DEG, TICK_M, ObjectPath
from drake_hand.planning.state import Node
from drake_hand.planning.world import Grid, split

SHORT_ROOM_SHARE = 0.25
"""A contact is short of room that rolls on by less than this, of 1."""
ROOM_STEPS, ROOM_STEP_TICKS = 7, 2.5
"""How far contacts are looked ahead, steps, and the length of a step, in ticks as there usually are."""
LOOKAHEAD_STEPS = 40
"""The same where it is asked whether they last for the whole path."""


@dataclass(frozen=True, kw_only=True)
class OffsetBounds:
    """How far the object may be from its nominal path while it moves."""

    rad: float
    m: float

    def clipped(self, off: np.ndarray) -> np.ndarray:
        """Offsets (..., 6) brought inside."""
        out = off.copy()
        for part, most in ((slice(0, 3), self.rad), (slice(3, 6), self.m)):
            length = np.linalg.norm(off[..., part], axis=-1, keepdims=True)
            out[..., part] *= np.minimum(1.0, most / np.maximum(length, 1e-12))
        return out


@dataclass(kw_only=True)
class Moves:
    """One nominal path, the fingers that may be used along it, and the scores of states and contacts on it."""

    clearance: Clearance
    world: World
    load: Load
    grid: Grid
    path: ObjectPath
    corridor: OffsetBounds
    fingers: frozenset[int]
    """That may touch."""
    modes: Collection[str] | None
    """Codes of those that may be used; all if not given."""
    rng: np.random.Generator

    def allowed(self, touching: Iterable[int], sliding: Iterable[int] = ()) -> bool:
        """Whether the mode may be used in which some fingers touch, and of these some slide."""
        return self.modes is None or code(self.clearance.hand, touching, sliding) in self.modes

    def evaluate(self, states: list[Node], rooms: np.ndarray | None = None) -> None:
        """Works out room, margins and score of states; `rooms` (N, n) where they are known."""
        if not states:
            return
        X, q, touching = (np.stack([getattr(x, k) for x in states]) for k in ("X", "q", "touching"))
        n = touching.shape[1]
        margins, p_OP, n_W = (
            np.zeros((len(states), n + 1)),
            np.zeros((len(states), n, 3)),
            np.zeros((len(states), n, 3)),
        )

        def run(r: slice) -> None:
            hold.held_without(self.world, self.load, X[r], q[r], touching[r], margins[r], p_OP[r], n_W[r])

        split(run, len(states), least=24)
        if rooms is None:
            rooms = np.ones((len(states), n))
            ways, steps = self.look(np.array([x.s for x in states]), np.stack([x.off for x in states]))
            row, finger = np.nonzero(touching)
            rooms[row, finger] = self.rooms(finger, q[row, finger], ways[row], steps[row])
        liftable = (margins[:, :-1] >= 0) & touching
        stuck = ((rooms < SHORT_ROOM_SHARE) & touching & ~liftable).sum(axis=1)
        score = np.where(touching, rooms, 1.0).min(axis=1)
        score += np.where(touching, rooms, 0.0).sum(axis=1) / np.maximum(touching.sum(axis=1), 1)
        score[~touching.any(axis=1)] = 0.0
        regrasps = np.array([x.regrasps for x in states])
        counted = np.minimum(margins[:, -1], hold.COUNTED_MARGIN_N)
        score += 0.3 * liftable.sum(axis=1) + counted - 0.5 * stuck - 0.03 * regrasps
        for x, *found, worth in zip(states, rooms, margins, p_OP, n_W, score.tolist(), strict=True):
            x.room, x.margins, x.p_OP, x.n_W = found
            x.score = worth

    def look(self, s: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is ahead of progress s (N,) with offsets (N, 6): paths (N, ROOM_STEPS + 1, 3, 4) and their steps (N,).

        Towards the next stop, if it is as near as that, the offset fades, as it has to; after it there is none.
        """
        stops, end, step = np.array(self.path.marks), self.path.ticks, self._room_step
        stop = stops[np.minimum(np.searchsorted(stops, s + 1e-9, side="right"), len(stops) - 1)]
        left = np.maximum(np.maximum(stop - s, offset_ticks(off)), 0.0)
        to_stop = np.ceil(left / step)
        k = np.arange(ROOM_STEPS + 1)
        share = np.where(to_stop[:, None] > ROOM_STEPS, 0.0, np.minimum(k / np.maximum(to_stop[:, None], 1.0), 1.0))
        far = np.minimum(s[:, None] + step * k, stop[:, None])
        near = s[:, None] + share * (stop - s)[:, None] + step * np.maximum(k - to_stop[:, None], 0.0)
        at = np.where(to_stop[:, None] > ROOM_STEPS, far, np.minimum(near, end))
        steps = np.minimum(ROOM_STEPS, to_stop + np.ceil((end - stop) / step)).astype(np.int64)
        return self.path.beside(at, (1.0 - share)[..., None] * off[:, None]), steps

    @property
    def _room_step(self) -> float:
        """Of its path's ticks: as far on a fine path as on any."""
        return ROOM_STEP_TICKS * self.path.fineness

    def rooms(self, finger: np.ndarray, q: np.ndarray, X: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """(N,) how far contacts of fingers (N,) at q (N, m) roll along the paths ahead, over `ROOM_STEPS`."""
        length = self.lasting(finger, q, X, steps)
        return np.where(length >= steps, 1.0, length / ROOM_STEPS)

    def lasting(self, finger: np.ndarray, q: np.ndarray, X: np.ndarray, steps: np.ndarray | int) -> np.ndarray:
        """(N,) for how many steps contacts of fingers (N,) at q (N, m) roll along paths X (N, most + 1, 3, 4)."""
        length = np.zeros(len(q), dtype=np.int64)
        finger = np.ascontiguousarray(finger, dtype=np.int64)
        steps = np.broadcast_to(steps, len(q)).copy()
        split(lambda r: stroke.ahead(self.world, finger[r], q[r], X[r], steps[r], length[r]), len(q), least=128)
        return length

    def enduring(self, finger: np.ndarray, q: np.ndarray) -> np.ndarray:
        """(N,) share of the nominal path for which contacts of fingers (N,) at q (N, m) last, as far as is looked."""
        k = int(np.clip(np.ceil(self.path.ticks / self._room_step), 1, LOOKAHEAD_STEPS))
        way = self.path.beside(np.minimum(self._room_step * np.arange(k + 1), self.path.ticks), np.zeros((k + 1, 6)))
        return self.lasting(finger, q, np.repeat(way[None], len(q), axis=0), k) / k

    def contacts(self, finger: int, X: np.ndarray, some: int | slice | None = None) -> tuple[np.ndarray, ...]:
        """Contacts a finger can make: q (N, m), p_WP and n_W (N, 3).

        Of all points of the grid, of a slice of them, or of so many at random.

        They are within reach, and the finger is clear of the object and of what stands still.
        """
        *found, why = self._tried(finger, X, some)
        q, p_WP, n_W = (x[why == END] for x in found)
        return q, p_WP, n_W

    def out_of_reach(self, finger: int, X: np.ndarray) -> str:
        """What keeps a finger from most of the grid's points within its reach; that none is, where none is."""
        why = self._tried(finger, X, None)[-1]
        counts = np.bincount(why, minlength=len(END_WORDS))[:REACH]
        return END_WORDS[int(counts.argmax()) if counts.any() else REACH]

    def _tried(self, finger: int, X: np.ndarray, some: int | slice | None) -> tuple[np.ndarray, ...]:
        """Postures (N, m), points and normals (N, 3) in W, and what `transit.contacts` says of them (N,)."""
        points, normals = self.grid.points, self.grid.normals
        if isinstance(some, slice):
            points, normals = np.ascontiguousarray(points[some]), np.ascontiguousarray(normals[some])
        elif some is not None and some < len(points):
            pick = self.rng.integers(0, len(points), some)
            points, normals = points[pick], normals[pick]
        N, m = len(points), self.world.chains.lower.shape[1]
        q, p_WP, n_W, why = np.zeros((N, m)), np.zeros((N, 3)), np.zeros((N, 3)), np.zeros(N, dtype=np.int64)
        seeds = self.grid.seeds[finger]
        transit.contacts(self.world, finger, seeds, points, normals, X, q, p_WP, n_W, why)
        return q, p_WP, n_W, why

    def clear(self, X: np.ndarray, q: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """(N,) whether hands (N, n, m) that touch (N, n) are clear of everything, the object at X (3, 4)."""
        able, poses = np.zeros(len(q), dtype=bool), np.repeat(X[None], len(q), axis=0)
        split(lambda r: clear.clear(self.world, poses[r], q[r], touching[r], able[r]), len(q))
        return able


def offset_ticks(off: np.ndarray) -> np.ndarray:
    """(...) how many ticks it takes to bring offsets (..., 6) to zero."""
    length = np.sqrt(np.square(off).reshape(*off.shape[:-1], 2, 3).sum(axis=-1))
    return np.maximum(length[..., 0] / np.radians(TICK_DEG), length[..., 1] / TICK_M)
