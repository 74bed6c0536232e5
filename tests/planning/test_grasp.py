"""Why there is no grasp: what collides with what."""

import numpy as np

from drake_hand.planning import grasp
from drake_hand.planning.object_path import still
from drake_hand.planning.problem import Problem
from drake_hand.planning.state import by_finger
from drake_hand.plans.task import Grasp, Options, Pose, Step, Task


def test_what_grasps_collide_with_is_named():
    """The sphere around a finger's tip: Drake's overlaps say which finger it is."""
    task = Task(
        hand="kanguera",
        object="sphere",
        start=Pose(xyz_mm=(0.0, 0.0, 0.0)),
        motion=[Step(grasp=Grasp())],
        options=Options(hold="kinematic"),
    )
    problem = Problem.of(task, lambda _: None)
    hand, X_WO = problem.hand, np.eye(4)
    finger = hand.finger("ring")
    problem.scene.set(hand.q_home)
    X_WO[:3, 3] = problem.scene.tip_position(finger)
    problem.scene.set(hand.q_home, X_WO)
    overlapping = {name for pair in problem.scene.penetrations() for name in pair[:2]}
    assert overlapping & set(finger.links)
    moves = problem.moves(task, still(X_WO), frozenset(range(5)))
    q = np.repeat(by_finger(hand, hand.q_home)[None], 2, axis=0)
    touching = np.zeros((2, 5), dtype=bool)
    touching[0] = True
    words, blamed = grasp._collide(moves, np.ascontiguousarray(X_WO[:3]), q, touching)
    assert "links of ring and the object in 100%" in words
    assert words.startswith("of the 2 best, ")
    assert hand.fingers[blamed].name in {f.name for f in hand.fingers if overlapping & set(f.links)}
    assert "palm" not in words
