"""`find_way`: a path of the empty hand through free space, from its present posture to another.

A hand that was stopped in mid-plan may have fingers in front of one another. Where moving all of them straight back
would make them collide, they move one after the other, each around the rest, in an order that is found by trying.
"""

from __future__ import annotations

import numpy as np

from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning.approach import joint_paths
from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.transit import MOVING_CLEARANCE_M
from drake_hand.plans.path import Path
from drake_hand.plans.task import Task

_FAR_AWAY_M = 10.0
"""Where an object stands that is not to be kept clear of, m."""


def find_way(scene: Scene, task: Task, q: np.ndarray, goal: np.ndarray, X_WO: np.ndarray | None) -> Path:
    """Plans a path from q to a goal.

    Args:
        scene: hand and object.
        task: what the path is for.
        q: (nq,) where the hand is, rad.
        goal: (nq,) where it should be.
        X_WO: (4, 4) where the object stands, which is kept clear of; None if it is not there.

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
    legs = joint_paths(clearance, q, {i: goal[f.columns] for i, f in enumerate(hand.fingers)}, X_WO)
    if legs is None:
        raise no_plan("no order of the fingers gives a path", mode=code(hand, ()), constraint="collision", X_WO=X_WO)
    for pieces in legs:
        builder.move(pieces)
    if not legs:
        builder.dwell()
    return Path(legs=tuple(builder.legs), hand=hand, object=object_, task=task, stats={})


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
