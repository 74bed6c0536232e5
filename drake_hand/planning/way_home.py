"""`find_way`: a path of the empty hand through free space, from its present posture to another.

A hand that was stopped in mid-plan may have fingers in front of one another. Where moving all of them straight back
would make them collide, they move one after the other, each around the rest, in an order that is found by trying.

If they may hold an object, they leave it first, one after the other, around where it was: on the straight way back they
go on pressing, take it along, and push it onto another finger. Where it falls before all are gone nobody knows; but
what lies on fingers of one side is squeezed by none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.approach import joint_paths, lift_together
from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.transit import LIFTS_M, MOVING_CLEARANCE_M, Surroundings, leaning, lift_off, travel
from drake_hand.plans.path import Path
from drake_hand.plans.task import Task

_FAR_AWAY_M = 10.0
"""Where an object stands that is not to be kept clear of, m."""


@dataclass(frozen=True, kw_only=True)
class HeldObject:
    """What the fingers may hold where they are."""

    q: np.ndarray
    """(nq,) where they should be, rad."""
    X_WO: np.ndarray
    """(4, 4)."""
    p_OP: np.ndarray
    """(fingers, 3) contact points, m; NaN where a finger does not touch."""


def find_way(
    scene: Scene,
    task: Task,
    q: np.ndarray,
    goal: np.ndarray,
    X_WO: np.ndarray | None,
    held: HeldObject | None = None,
) -> Path:
    """Plans a path from q to a goal.

    Args:
        scene: hand and object.
        task: what the path is for.
        q: (nq,) where the hand is, rad.
        goal: (nq,) where it should be.
        X_WO: (4, 4) where the object stands, which is kept clear of; None if it is not there.
        held: what the fingers let go of first; it falls.

    Raises:
        NoPlanFound: a finger touches something where it is, or finds no path.
    """
    hand, object_ = scene.hand, scene.object
    assert isinstance(object_, Object)
    if X_WO is None:
        X_WO = np.eye(4)
        X_WO[0, 3] = _FAR_AWAY_M
    clearance = Clearance(scene, task.table)
    _check_clear(clearance, q, X_WO)
    builder = LegBuilder(hand, q, X_WO)
    if held is not None:
        _let_go(builder, clearance, held, goal)
    legs = joint_paths(clearance, builder.q, {i: goal[f.columns] for i, f in enumerate(hand.fingers)}, X_WO)
    if legs is None:
        raise no_plan("no order of the fingers gives a path", mode=code(hand, ()), constraint="collision", X_WO=X_WO)
    for pieces in legs:
        builder.move(pieces)
    if not builder.legs:
        builder.dwell()
    return Path(legs=tuple(builder.legs), hand=hand, object=object_, task=task, stats={})


def _let_go(builder: LegBuilder, clearance: Clearance, held: HeldObject, goal: np.ndarray) -> None:
    """Fingers leave the object one after the other, those first that get to their goal (nq,) straight.

    Those that do not get there while the object is where it was rise off it, if they can, all at once.
    """
    columns, rises = [f.columns for f in clearance.hand.fingers], {}
    for i in np.flatnonzero(np.isfinite(held.p_OP).all(axis=1)).tolist():
        n_O = clearance.surface.closest(held.p_OP[i][None])[1][0]
        rises[i] = leaning(held.X_WO[:3, :3] @ n_O)
    now, standing = held.q.copy(), list(rises)
    while standing:
        around = {i: Surroundings.of(clearance, now, held.X_WO, i) for i in standing}
        ways = {i: x for i in standing if (x := _leave(around[i], i, now[columns[i]], rises[i], goal[columns[i]]))}
        if not ways:
            break
        first = min(ways, key=lambda i: len(ways[i]))
        for k, way in enumerate(ways[first]):
            builder.move({first: _from(builder.q[columns[first]], way) if k == 0 else way})
        now[columns[first]] = goal[columns[first]]
        standing.remove(first)
    rest = {i: (now[columns[i]], rises[i]) for i in standing}
    if rest and (together := next(lift_together(clearance, now, rest, held.X_WO), None)):
        builder.move({i: _from(builder.q[columns[i]], way) for i, way in together.items()})


def _leave(s: Surroundings, i: int, q: np.ndarray, rises: np.ndarray, goal: np.ndarray) -> list[np.ndarray] | None:
    """Pieces (n, m) of a path of finger i from its contact at q (m,) off it, along one of (D, 3), and to its goal."""
    for height in LIFTS_M:
        ways, able = lift_off(s, i, np.tile(q, (len(rises), 1)), rises, height)
        for way in ways[able]:
            if (pieces := travel(s, i, way[-1], goal)) is not None:
                return [way, *pieces]
    return None


def _from(q: np.ndarray, way: np.ndarray) -> np.ndarray:
    """A path (n, m) that begins at q (m,) instead: pressing, a finger is commanded to somewhere inside the object."""
    return way + np.linspace(1.0, 0.0, len(way))[:, None] * (q - way[0])


def _check_clear(clearance: Clearance, q: np.ndarray, X_WO: np.ndarray) -> None:
    """Says which finger touches what, where the hand is."""
    hand = clearance.hand
    centres = [clearance.centres(i, q[None, f.columns]) for i, f in enumerate(hand.fingers)]
    for i, finger in enumerate(hand.fingers):
        gaps = {"the object": float(clearance.to_object(i, centres[i], X_WO, tip=True)[0])}
        still = "the palm" if clearance.table is None else "the palm or the table"
        gaps[still] = float(clearance.to_palm(i, centres[i])[0])
        for j, other in enumerate(hand.fingers[:i]):
            gaps[other.name] = float(clearance.between(i, centres[i], j, centres[j])[0])
        for what, gap in gaps.items():
            if gap < MOVING_CLEARANCE_M:
                raise no_plan(
                    f"finger {finger.name} is {gap * 1e3:.1f} mm from {what}: move it clear by hand, drives off",
                    mode=code(hand, ()),
                    finger=finger.name,
                    constraint="collision",
                    X_WO=X_WO,
                )
