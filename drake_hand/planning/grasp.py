"""Grasps: the states a search starts from."""

from __future__ import annotations

import numpy as np

from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.planning.contact_sets import ContactSets
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.kernels import hold
from drake_hand.planning.moves import COARSE, Moves
from drake_hand.planning.reach import Hold
from drake_hand.planning.state import State
from drake_hand.planning.world import split

DRAWN = 3000
"""Sets of contacts drawn at random."""
TOUCHES = 0.85
"""Chance that a finger takes part in one, where the task does not say which do."""
LOOKED_AT = 300
"""Of those that hold, how many are looked at more closely."""
AHEAD = 40
"""How far their contacts are followed along the nominal way, coarse steps."""
GRASPS = 60
"""Of those, how many a search starts from."""


def together(hand: Hand, grasps: list[list[Hold]], p_WCom: np.ndarray) -> ContactSets:
    """The contacts of some grasps, each hold of them as it begins, around one mass centre p_WCom (3,)."""
    sets = ContactSets.none(hand, np.repeat(p_WCom[None], len(grasps), axis=0))
    for row, holds in enumerate(grasps):
        for h in holds:
            sets.put(h.finger, h.p_WP[0], h.n_W[0], h.J_WP[0], row)
    return sets


def roots(moves: Moves, q: np.ndarray, *, every: bool, most: bool) -> list[State]:
    """Grasps of the object where its way begins, the most promising first.

    Args:
        moves: whose fingers may touch.
        q: (n, m) where the fingers are that do not, rad.
        every: whether all of these fingers have to.
        most: whether more fingers come before all else.

    Raises:
        NoPlanFound: there is none; counts what failed.
    """
    hand, X = moves.clearance.hand, np.ascontiguousarray(moves.path.X_WO[0, :3])
    n = len(q)
    rng, fingers = moves.rng, sorted(moves.fingers)
    posture, touching = np.repeat(q[None], DRAWN, axis=0), np.zeros((DRAWN, n), dtype=bool)
    reached = {}
    way, steps = _whole_way(moves)
    for f in fingers:
        contacts, _, _ = moves.contacts(f, X)
        reached[f] = len(contacts)
        if not len(contacts):
            continue
        lasting = moves.lasting(np.full(len(contacts), f), contacts, np.repeat(way[None], len(contacts), axis=0), steps)
        weight = lasting / steps + 0.05
        pick = rng.choice(len(contacts), DRAWN, p=weight / weight.sum())
        on = rng.random(DRAWN) < (1.0 if every else TOUCHES)
        posture[on, f], touching[on, f] = contacts[pick[on]], True
    mode = code(hand, fingers)

    def fail(what: str, constraint: str, finger: int | None = None) -> NoPlanFound:
        name = None if finger is None else hand.fingers[finger].name
        return no_plan(what, mode=mode, constraint=constraint, finger=name, X_WO=moves.path.X_WO[0])

    unable = [f for f in fingers if not reached[f]]
    if unable and (every or len(unable) == len(fingers)):
        names = ", ".join(hand.fingers[f].name for f in unable)
        raise fail(f"no point of the object is within reach of {names}", "reach", unable[0])
    modes = {tuple(row) for row in np.unique(touching, axis=0).tolist()}
    able = {row: moves.allowed(frozenset(np.flatnonzero(row).tolist())) for row in modes}
    some = np.array([able[tuple(row)] for row in touching.tolist()])
    if not some.any():
        raise fail("a grasp needs a mode that options.modes leaves out", "modes")
    posture, touching = posture[some], touching[some]
    margins, poses = np.zeros((len(posture), n + 1)), np.repeat(X[None], len(posture), axis=0)
    points, normals = np.zeros((2, len(posture), n, 3))

    def run(r: slice) -> None:
        hold.held_without(moves.world, moves.load, poses[r], posture[r], touching[r], margins[r], points[r], normals[r])

    split(run, len(posture))
    held = np.flatnonzero(margins[:, -1] >= 0)
    if not len(held):
        most_held = float(margins[:, -1].max())
        what = f"none of {len(posture)} sets of contacts balances the object: at best {-most_held:.2g} N are missing"
        raise fail(what, "balance")
    value = (margins[held, :-1] >= 0).sum(axis=1) + np.minimum(margins[held, -1], 1.0)
    value = value + (10.0 * touching[held].sum(axis=1) if most else 0.0)
    held = held[np.argsort(-value, kind="stable")]
    clear = held[moves.clear(X, posture[held], touching[held])][:LOOKED_AT]
    if not len(clear):
        what = f"none of {len(held)} sets of contacts that balance the object is clear of collisions"
        raise fail(what, "collision")
    out = [State(s=0.0, off=np.zeros(6), X=X, q=posture[i], touching=touching[i]) for i in clear]
    moves.evaluate(out)
    best = sorted(out, key=lambda x: (-int(x.touching.sum()) if most else 0, -x.score))
    return best[:GRASPS]


def _whole_way(moves: Moves) -> tuple[np.ndarray, int]:
    """Poses (k + 1, 3, 4) along the nominal way, as far as grasps are looked ahead, and k >= 1."""
    k = int(np.clip(np.ceil(moves.path.ticks / COARSE), 1, AHEAD))
    s = np.minimum(COARSE * np.arange(k + 1), moves.path.ticks)
    return moves.path.beside(s, np.zeros((k + 1, 6))), k
