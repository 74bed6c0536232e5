"""What can be done from a state: strokes of the object, and switches of single fingers, in compiled batches.

Proposals are drawn at random and followed as far as they last; what is kept has been tested for balance, limits and
clearances all the way, transits included.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drake_hand.planning.collision import Clearance
from drake_hand.planning.kernels import clear, hold, stroke, transit
from drake_hand.planning.kernels.world import Load, World
from drake_hand.planning.object_path import TICK_DEG, TICK_M, ObjectPath
from drake_hand.planning.state import State, Stroke, Switch, whole
from drake_hand.planning.transit import LIFTS, STEP, Surroundings, detour, lift
from drake_hand.planning.world import Grid, split

STROKES = 24
"""Strokes drawn for a state."""
SHORTEST, LONGEST = 4, 36
"""Progress they are drawn from, ticks."""
BEST = 10
"""Of those that get on, how many are kept."""
STEPS = 60
"""Poses of a stroke at most."""
SPREAD_RAD, SPREAD_M = np.radians(5.0), 5.0e-3
"""Standard deviation of the offset that a stroke adds."""
TESTED = 3
"""Balance is tested every so many poses."""
LOOK, COARSE = 7, 2.5
"""How far contacts are looked ahead, steps, and the length of a step, ticks."""
POINTS = 200
"""Surface points a switching finger is offered."""
TRIED, KEPT = 14, 4
"""Of those, contacts tried and kept."""
LEAST_ROOM = 0.12
"""A new contact has to roll on at least so far, of 1."""


@dataclass(frozen=True, kw_only=True)
class Corridor:
    """How far the object may be from its nominal way while it moves."""

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
    """The moves along one nominal way, with the fingers that may be used."""

    clearance: Clearance
    world: World
    load: Load
    grid: Grid
    path: ObjectPath
    corridor: Corridor
    fingers: frozenset[int]
    """That may touch."""
    allowed: Callable[[frozenset[int]], bool]
    """Whether the mode with these fingers in contact may be used."""
    rng: np.random.Generator
    rows: int = 0
    """Poses of strokes worked out so far, over all rows."""

    # -- strokes

    def strokes(self, state: State) -> list[State]:
        """The states that strokes from here lead to, each as far as it lasts; those that get on best."""
        found = self._towards(state, *self._targets(state))
        still = [x for x in found if x.s <= state.s]
        return still + sorted((x for x in found if x.s > state.s), key=lambda x: -x.s)[:BEST]

    def carried(self, state: State, s: float, off: np.ndarray) -> State | None:
        """The state with the object at progress s and an offset (6,), if one stroke gets there."""
        if s == state.s and np.array_equal(off, state.off):
            return state
        found = self._towards(state, np.array([s]), off[None])
        return found[0] if found and found[0].s == s and np.array_equal(found[0].off, off) else None

    def _towards(self, state: State, s: np.ndarray, off: np.ndarray) -> list[State]:
        """How far strokes to progress s (N,) and offsets (N, 6) get."""
        K = np.ceil(np.maximum(s - state.s, offset_ticks(off - state.off)) - 1e-9).astype(np.int64)
        some = (K > 0) & (K <= STEPS)
        s, off, K = s[some], off[some], K[some]
        if not len(K):
            return []
        share = np.minimum(np.arange(K.max() + 1) / K[:, None], 1.0)
        X = self.path.beside(
            state.s + share * (s - state.s)[:, None], state.off + share[..., None] * (off - state.off)[:, None]
        )
        q, length = self._roll(X, K, [state] * len(K))
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

    def _targets(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Progress (N,) and offset (N, 6) that strokes aim at; the end of a step is met without an offset."""
        rng, stop = self.rng, self.path.next_stop(state.s)
        s = state.s + rng.uniform(SHORTEST, LONGEST, STROKES)
        noise = np.concatenate([rng.normal(0, SPREAD_RAD, (STROKES, 3)), rng.normal(0, SPREAD_M, (STROKES, 3))], axis=1)
        off = self.corridor.clipped(state.off + noise)
        # Some only improve the pose, some keep it, some go straight for the end.
        s[:4] = state.s
        s[4:6] = state.s + LONGEST
        off[4], off[5:9] = 0.0, state.off
        if stop - state.s < LONGEST:
            s[9:12] = stop
        s = np.minimum(s, stop)
        off[(s >= stop) & (s > state.s)] = 0.0
        if state.s >= stop:
            off[:2] = 0.0
        return s, off

    def onward(self, states: list[State]) -> list[State]:
        """The last states that those on the nominal way, at a tick, get to along it without a switch."""
        states = [x for x in states if not x.off.any() and x.s < self.path.ticks]
        if not states:
            return []
        start = np.array([round(x.s) for x in states])
        K = self.path.ticks - start
        X = self.path.X_WO[np.minimum(start[:, None] + np.arange(K.max() + 1), self.path.ticks), :3]
        q, length = self._roll(np.ascontiguousarray(X), K, states)
        out = []
        for i, state in enumerate(states):
            end = int(start[i] + length[i])
            stops = [stop for stop in self.path.stops if start[i] < stop < end]
            for a, b in itertools.pairwise([int(start[i]), *stops, end] if length[i] else []):
                rows = slice(a - start[i], b - start[i] + 1)
                move = Stroke(X=X[i, rows], q=q[i, rows])
                state = _after(state, s=float(b), off=state.off, move=move)
            if length[i]:
                out.append(state)
        return out

    def _roll(self, X: np.ndarray, K: np.ndarray, states: list[State]) -> tuple[np.ndarray, np.ndarray]:
        """Carries states along ways X (N, most + 1, 3, 4) of K (N,) steps.

        Returns:
            Postures (N, most + 1, n, m), and how many steps of each can be made (N,).
        """
        N = len(K)
        q = np.zeros((*X.shape[:2], *states[0].q.shape))
        length, why, who = np.zeros((3, N), dtype=np.int64)
        q0, touching = np.stack([x.q for x in states]), np.stack([x.touching for x in states])

        def run(r: slice) -> None:
            stroke.strokes(
                self.world, self.load, X[r], K[r], q0[r], touching[r], TESTED, q[r], length[r], why[r], who[r]
            )

        split(run, N, least=12)
        self.rows += int(length.sum())
        return q, length

    # -- switches

    def switches(self, state: State, finger: int) -> list[State]:
        """The states in which a finger has made contact elsewhere, the most promising first."""
        touches = bool(state.touching[finger])
        whole = frozenset(np.flatnonzero(state.touching).tolist())
        if touches and (state.margins[finger] < 0 or not self.allowed(whole - {finger})):
            return []
        if finger not in self.fingers or not self.allowed(whole | {finger}):
            return []
        q, _, n_W = self.contacts(finger, state.X, POINTS)
        room = self.rooms(
            np.full(len(q), finger), q, *self.look(np.full(len(q), state.s), np.tile(state.off, (len(q), 1)))
        )
        order = np.argsort(-(room + self.rng.uniform(0, 0.3, len(room))), kind="stable")[:TRIED]
        order = order[room[order] > LEAST_ROOM]
        posture = np.repeat(state.q[None], len(order), axis=0)
        posture[:, finger] = q[order]
        touching = np.repeat(state.touching[None], len(order), axis=0)
        touching[:, finger] = True
        order, posture = (x[self.clear(state.X, posture, touching)] for x in (order, posture))
        out = [
            State(
                s=state.s,
                off=state.off,
                X=state.X,
                q=row,
                touching=touching[0],
                regrasps=state.regrasps + touches,
                parent=state,
            )
            for row in posture
        ]
        rooms = np.repeat(state.room[None], len(out), axis=0)
        rooms[:, finger] = room[order]
        self.evaluate(out, rooms)
        best = sorted((i for i, x in enumerate(out) if x.margins[-1] >= 0), key=lambda i: -out[i].score)
        kept: list[State] = []
        for some in (best[i : i + KEPT] for i in range(0, len(best), KEPT)):
            found = self._transits(state, finger, q[order[some]], n_W[order[some]])
            for i, (height, landing, stop) in zip(some, found.tolist(), strict=True):
                if height >= 0:
                    out[i].move = Switch(finger=finger, height=height, landing=landing, stop=stop - 1)
                    kept.append(out[i])
            if len(kept) >= KEPT:
                break
        return kept[:KEPT]

    def retreats(self, state: State, finger: int) -> list[State]:
        """The states in which a finger waits elsewhere, off the object."""
        touches = bool(state.touching[finger])
        rest = frozenset(np.flatnonzero(state.touching).tolist()) - {finger}
        if touches and (state.margins[finger] < 0 or not self.allowed(rest)):
            return []
        stops = self.grid.stops[finger]
        found = np.full(len(stops), -1, dtype=np.int64)
        normal = state.n_W[finger]
        transit.retreats(
            self.world, finger, state.X, state.q, state.q[finger], touches, normal, HEIGHTS, stops, STEP, found
        )
        out = []
        for v in np.flatnonzero(found >= 0)[:KEPT]:
            q, touching = state.q.copy(), state.touching.copy()
            q[finger], touching[finger] = stops[v], False
            if np.array_equal(q, state.q):
                continue
            move = Switch(finger=finger, height=int(found[v]), landing=-1, stop=int(v))
            out.append(
                State(
                    s=state.s,
                    off=state.off,
                    X=state.X,
                    q=q,
                    touching=touching,
                    regrasps=state.regrasps,
                    parent=state,
                    move=move,
                )
            )
        self.evaluate(out)
        return [x for x in out if x.margins[-1] >= 0]

    def between(self, before: State, after: State, finger: int) -> Switch | None:
        """The move of a finger to where it is in another state: to a contact, or to where it waits."""
        return self.switch(before, after, finger) if after.touching[finger] else self._retreat(before, after, finger)

    def _retreat(self, before: State, after: State, finger: int) -> Switch | None:
        """The move of a finger to where it waits."""
        found, stop = np.full(1, -1, dtype=np.int64), np.ascontiguousarray(after.q[finger][None])
        touches, normal = bool(before.touching[finger]), before.n_W[finger]
        args = self.world, finger, before.X, before.q, before.q[finger], touches, normal
        transit.retreats(*args, HEIGHTS, stop, STEP, found)
        if found[0] < 0:
            return None
        pieces, start = [], before.q[finger]
        if touches:
            pieces.append(self._lift(before, finger, start, normal, int(found[0])))
            start = pieces[0][-1]
        pieces.append(_straight(start, after.q[finger]))
        m = len(self.clearance.kinematics[finger].lower)
        return Switch(finger=finger, height=-1, landing=-1, stop=-1, ways=tuple(x[:, :m] for x in pieces))

    def _transits(self, state: State, finger: int, q: np.ndarray, n_W: np.ndarray) -> np.ndarray:
        """(N, 3) as `transit.transits` finds them."""
        found = np.zeros((len(q), 3), dtype=np.int64)
        touches = bool(state.touching[finger])
        normal = state.n_W[finger]
        stops = self.grid.stops[finger]
        args = self.world, finger, state.X, state.q, state.q[finger], touches, normal, q, n_W
        transit.transits(*args, HEIGHTS, stops, STEP, found)
        return found

    def switch(self, before: State, after: State, finger: int) -> Switch | None:
        """The move of a finger that touches in both states, by a roadmap where no quicker way is found."""
        old, new = before.q[finger], after.q[finger]
        found = self._transits(before, finger, new[None], after.n_W[finger][None])[0]
        if found[0] >= 0:
            return Switch(finger=finger, height=int(found[0]), landing=int(found[1]), stop=int(found[2]) - 1)
        fingers, X = self.clearance.hand.fingers, np.vstack([before.X, [0.0, 0.0, 0.0, 1.0]])
        m = len(fingers[finger].columns)
        posture = whole(self.clearance.hand, before.q)
        around = Surroundings.of(self.clearance, posture, X, finger)
        normals = np.stack([before.n_W[finger], after.n_W[finger]])
        for height in LIFTS:
            (up, down), able = lift(around, finger, np.stack([old, new])[:, :m], normals, height)
            if able.all():
                pieces = detour(around, finger, up[-1], down[-1])
                ways = None if pieces is None else (up, *pieces, down[::-1])
                return None if ways is None else Switch(finger=finger, height=-1, landing=-1, stop=-1, ways=ways)
        return None

    def ways(self, before: State, after: State) -> tuple[np.ndarray, ...]:
        """The pieces (k, m) of the way of a switch: lift, travel and landing, as many of them as it has."""
        move = after.move
        assert isinstance(move, Switch)
        if move.ways is not None:
            return move.ways
        f, m = move.finger, len(self.clearance.kinematics[move.finger].lower)
        pieces: list[np.ndarray] = []
        points = [before.q[f]]
        if before.touching[f]:
            pieces.append(self._lift(before, f, before.q[f], before.n_W[f], move.height))
            points = [pieces[0][-1]]
        if move.stop >= 0:
            points.append(self.grid.stops[f][move.stop])
        down = None
        if move.landing >= 0:
            down = self._lift(before, f, after.q[f], after.n_W[f], move.landing)[::-1]
            points.append(down[0])
        pieces += [_straight(a, b) for a, b in itertools.pairwise(points)]
        pieces += [down] if down is not None else []
        return tuple(piece[:, :m] for piece in pieces)

    def _lift(self, state: State, finger: int, q: np.ndarray, n_W: np.ndarray, height: int) -> np.ndarray:
        way = np.zeros((transit.KNOTS, len(q)))
        transit.lift_way(self.world, finger, state.X, state.q, q, n_W, LIFTS[height], way)
        return way

    # -- what states are worth

    def evaluate(self, states: list[State], rooms: np.ndarray | None = None) -> None:
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
        for x, room, margin, point, normal in zip(states, rooms, margins, p_OP, n_W, strict=True):
            x.room, x.margins, x.p_OP, x.n_W = room, margin, point, normal
            liftable = (margin[:-1] >= 0) & x.touching
            on = room[x.touching]
            stuck = int(((room < 0.25) & x.touching & ~liftable).sum())
            x.score = float(on.min(initial=1.0) + on.mean() if len(on) else 0.0)
            x.score += 0.3 * int(liftable.sum()) + min(float(margin[-1]), 0.3) - 0.5 * stuck - 0.03 * x.regrasps

    def look(self, s: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is ahead of progress s (N,) with offsets (N, 6): ways (N, LOOK + 1, 3, 4) and their steps (N,).

        Towards the next stop, if it is as near as that, the offset fades, as it has to; after it there is none.
        """
        stops, end = np.array(self.path.marks), self.path.ticks
        stop = stops[np.minimum(np.searchsorted(stops, s + 1e-9, side="right"), len(stops) - 1)]
        left = np.maximum(np.maximum(stop - s, offset_ticks(off)), 0.0)
        to_stop = np.ceil(left / COARSE)
        k = np.arange(LOOK + 1)
        share = np.where(to_stop[:, None] > LOOK, 0.0, np.minimum(k / np.maximum(to_stop[:, None], 1.0), 1.0))
        far = np.minimum(s[:, None] + COARSE * k, stop[:, None])
        near = s[:, None] + share * (stop - s)[:, None] + COARSE * np.maximum(k - to_stop[:, None], 0.0)
        at = np.where(to_stop[:, None] > LOOK, far, np.minimum(near, end))
        steps = np.minimum(LOOK, to_stop + np.ceil((end - stop) / COARSE)).astype(np.int64)
        return self.path.beside(at, (1.0 - share)[..., None] * off[:, None]), steps

    def rooms(self, finger: np.ndarray, q: np.ndarray, X: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """(N,) how far contacts of fingers (N,) at q (N, m) roll along ways ahead, 1 for as far as was looked."""
        length = self.lasting(finger, q, X, steps)
        return np.where(length >= steps, 1.0, length / LOOK)

    def lasting(self, finger: np.ndarray, q: np.ndarray, X: np.ndarray, steps: np.ndarray | int) -> np.ndarray:
        """(N,) for how many steps contacts of fingers (N,) at q (N, m) roll along ways X (N, most + 1, 3, 4)."""
        length = np.zeros(len(q), dtype=np.int64)
        finger = np.ascontiguousarray(finger, dtype=np.int64)
        steps = np.broadcast_to(steps, len(q)).copy()
        split(lambda r: stroke.ahead(self.world, finger[r], q[r], X[r], steps[r], length[r]), len(q), least=128)
        return length

    def contacts(self, finger: int, X: np.ndarray, some: int | None = None) -> tuple[np.ndarray, ...]:
        """Contacts within reach, of all points of the grid or of some at random: q (N, m), p_WP and n_W (N, 3)."""
        points, normals = self.grid.points, self.grid.normals
        if some is not None and some < len(points):
            pick = self.rng.integers(0, len(points), some)
            points, normals = points[pick], normals[pick]
        N, m = len(points), self.world.chains.lower.shape[1]
        q, p_WP, n_W, able = np.zeros((N, m)), np.zeros((N, 3)), np.zeros((N, 3)), np.zeros(N, dtype=bool)
        seeds = self.grid.seeds[finger]
        transit.contacts(self.world, finger, seeds, points, normals, X, q, p_WP, n_W, able)
        return q[able], p_WP[able], n_W[able]

    def clear(self, X: np.ndarray, q: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """(N,) whether hands (N, n, m) that touch (N, n) are clear of everything, the object at X (3, 4)."""
        able, poses = np.zeros(len(q), dtype=bool), np.repeat(X[None], len(q), axis=0)
        split(lambda r: clear.clear(self.world, poses[r], q[r], touching[r], able[r]), len(q))
        return able


def _straight(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The straight way (k, m) in joint space."""
    n = max(3, int(np.ceil(np.abs(b - a).max() / STEP)) + 1)
    return a + np.linspace(0, 1, n)[:, None] * (b - a)


def offset_ticks(off: np.ndarray) -> np.ndarray:
    """(...) how many ticks it takes to bring offsets (..., 6) to zero."""
    turn, shift = np.linalg.norm(off[..., :3], axis=-1), np.linalg.norm(off[..., 3:], axis=-1)
    return np.maximum(turn / np.radians(TICK_DEG), shift / TICK_M)


def _after(state: State, *, s: float, off: np.ndarray, move: Stroke) -> State:
    """The state after a stroke."""
    return State(
        s=s,
        off=off,
        X=move.X[-1],
        q=move.q[-1],
        touching=state.touching,
        regrasps=state.regrasps,
        parent=state,
        move=move,
    )


HEIGHTS = np.array(LIFTS)
"""Of lifts, m."""
