"""When the fingers hold the object by themselves. Needs no Drake."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from drake_hand.errors import InputError
from drake_hand.plans.plan import Plan
from drake_hand.plans.tolerances import STANDARD_GRAVITY, UNBALANCED_SHARE
from drake_hand.plans.trajectory import Trajectory

_SHORTEST_S = 0.01
_LOOK_S, _NEAR_RAD = 0.02, np.radians(3.0)


def hold_windows(plan: Plan) -> list[tuple[float, float]]:
    """Intervals in which the fingers are to hold the object without a fixture, one per grasp, s.

    A grasp is complete at the first knot at which the planned forces balance the weight and have stopped rising
    (for kinematic plans: at which enough fingers touch). Its hold ends at the last such knot.

    Raises:
        InputError: the fingers never hold the object for a while.
    """
    options, weight_W = plan.task.options, plan.object_mass_kg * np.array(plan.task.physics.gravity)
    tolerance = UNBALANCED_SHARE * STANDARD_GRAVITY * plan.object_mass_kg
    windows = []
    for _, parts in itertools.groupby(plan.parts, key=lambda part: bool(part.contacts)):
        held = []
        for part in parts:
            forces = [np.array(c.f_W) for c in part.contacts.values() if c.f_W is not None]
            if forces:
                residual = np.linalg.norm(np.sum(forces, axis=0) + weight_W, axis=1)
                pressed = np.sum([np.linalg.norm(f, axis=1) for f in forces], axis=0)
                rising = np.diff(pressed, append=pressed[-1]) > 0.05 * pressed
                good = (residual <= tolerance) & (pressed > 0) & ~rising
            else:
                enough = len(part.contacts) >= max(1, options.min_contacts)
                good = np.full(len(part.t), enough and options.hold == "kinematic")
            held += [t for t, yes in zip(part.t, good, strict=True) if yes]
        if held and held[-1] - held[0] >= _SHORTEST_S:
            windows.append((held[0], held[-1]))
    if not windows:
        raise InputError("in this plan the fingers never hold the object", key="parts", expected="a part that holds it")
    return windows


def free_windows(plan: Plan) -> list[tuple[float, float]]:
    """Intervals without a fixture, s: while the fingers hold the object, or all the time if it lies on a table."""
    return [(0.0, plan.duration)] if plan.task.support else hold_windows(plan)


def may_hold(plan: Plan, joints: Sequence[str], q: np.ndarray) -> float | None:
    """Plan time [s] at which a posture is one in which the plan's fingers touch the object; None if there is none.

    Args:
        plan: what was played.
        joints: names of those known.
        q: (n,) where they are, rad.
    """
    trajectory, columns = Trajectory(plan), [plan.joints.index(j) for j in joints]
    touching = [np.arange(p.t[0], p.t[-1] + _LOOK_S, _LOOK_S) for p in plan.parts if p.contacts]
    if not touching:
        return None
    t = np.concatenate(touching)
    states = trajectory.at(t)
    # pressing, a joint stands anywhere between where it should be and where it was commanded
    low, high = np.minimum(states.q, states.q_command), np.maximum(states.q, states.q_command)
    off = np.maximum(low[:, columns] - q, q - high[:, columns]).max(axis=1)
    nearest = int(off.argmin())
    return float(t[nearest]) if off[nearest] <= _NEAR_RAD else None
