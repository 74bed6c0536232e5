"""Small hands and short paths: what is planned on them is planned in a second."""

from functools import cache

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.planning import approach
from drake_hand.planning.collision import Clearance
from drake_hand.planning.holding import Equilibrium
from drake_hand.planning.object_path import ObjectPath, build, pose
from drake_hand.planning.reach import Hold, ReachTable
from drake_hand.plans.task import Grasp, Options, Physics, Pose, Rotate, Step, Task, Translate

UP = {"quartet": (-9.81, 0.0, 0.0), "trio": (0.0, 0.0, -9.81)}
"""Gravity in W with the palm up, m/s^2."""
START = {"quartet": Pose(xyz_mm=(75.0, 0.0, 0.0)), "trio": Pose(xyz_mm=(0.0, 0.0, 80.0))}
"""Of an object between the fingers."""


def turn(angle_deg: float) -> Step:
    """About the object's own z."""
    return Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=angle_deg))


def move(*by_mm: float) -> Step:
    return Step(translate=Translate(by_mm=by_mm))


def task(hand: str, object_: str, *steps: Step, start: Pose | None = None, **options) -> Task:
    """Grasp with any fingers, then the steps; palm up."""
    return Task(
        hand=hand,
        object=object_,
        start=start or START[hand],
        motion=[Step(grasp=Grasp()), *steps],
        physics=Physics(gravity=UP[hand]),
        options=Options(**options),
    )


@cache
def clearance(hand: str, object_: str) -> Clearance:
    return Clearance(scene(hand, object_))


@cache
def scene(hand: str, object_: str) -> Scene:
    return Scene(Hand.load(hand), Object.load(object_))


def path(hand: str, *steps: Step) -> ObjectPath:
    return build(pose(START[hand]), list(steps))


@cache
def table(hand: str, object_: str, *steps: Step) -> ReachTable:
    return ReachTable(clearance(hand, object_), path(hand, *steps), "rolling")


def equilibrium(hand: str, object_: str, **changes) -> Equilibrium:
    """As a run states it, with the palm up."""
    values = {
        "gravity": np.array(UP[hand]),
        "mass": Object.load(object_).mass,
        "friction": 0.8,
        "preload": 0.1,
    } | changes
    return Equilibrium(Hand.load(hand), **values)


def contact(reach: ReachTable, i: int, p_OP: tuple[float, float, float]) -> Hold:
    """The hold of finger i that begins with its tip at the surface point nearest to p_OP, m.

    Raises:
        AssertionError: the finger does not reach it.
    """
    kin, X = reach.clearance.kinematics[i], reach.path.X_WO[0]
    foot, n_O, _ = reach.clearance.surface.closest(np.array([p_OP]))
    q, residual = kin.ik((foot + kin.finger.radius * n_O) @ X[:3, :3].T + X[:3, 3])
    assert residual[0] < 1e-6, "out of reach"
    hold = reach.from_contact(i, 0, q[0])
    assert hold is not None, "does not last"
    return hold


def touch(reach: ReachTable, hold: Hold) -> approach.Contact:
    """Where a hold begins, as closing the hand asks for it."""
    X = reach.path.X_WO[hold.birth]
    return approach.Contact(q=hold.q[0], n_W=hold.n_W[0], p_OP=X[:3, :3].T @ (hold.p_WP[0] - X[:3, 3]))
