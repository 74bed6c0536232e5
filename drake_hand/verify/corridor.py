"""Whether the object stays in its corridor around the nominal path of each step."""

from __future__ import annotations

import numpy as np

from drake_hand.plans.task import Corridor, Task
from drake_hand.plans.trajectory import quaternions, right_product
from drake_hand.verify.findings import TOLERANCES, Findings
from drake_hand.verify.goal import MOVES, ObjectSamples, StepSpan, angles


def check_corridor(task: Task, motion: ObjectSamples, stages: list[StepSpan], findings: Findings) -> None:
    """Judges how far the object is off its path, all the time.

    A step's nominal path leads from the goal of the step before to its own: straight on, turning evenly. What is judged
    is the Frechet distance to it: samples are compared with points of the path that never go back, as near to them as
    that allows. On a turn that is near in angle; where a path both turns and leads on, or leads round a point
    elsewhere, both count by the measure of the corridor.
    """
    asked = task.options.corridor
    wide = asked if isinstance(asked, Corridor) else None
    mm = wide.mm if wide else TOLERANCES["goal_position_mm"]
    deg = wide.deg if wide else TOLERANCES["goal_rotation_deg"]
    ways = [s for s in stages if s.step.kind in MOVES] or stages[:1]
    for i, way in enumerate(ways):
        rows = slice(way.first, way.last + 1 if i + 1 < len(ways) else len(motion.t))
        shift, turn = beside(motion.q_WO[rows], motion.p_WO[rows], way, mm / 1000, np.radians(deg))
        t, part = motion.t[rows], motion.part[rows]
        findings.add("corridor_mm", shift * 1000, t, part, [way.name], limit=mm)
        findings.add("corridor_deg", np.degrees(turn), t, part, [way.name], limit=deg)


def beside(
    q_WO: np.ndarray, p_WO: np.ndarray, way: StepSpan, length: float, angle: float
) -> tuple[np.ndarray, np.ndarray]:
    """How far poses are off a path.

    Args:
        q_WO: (k, 4) orientations in the order of time, the first at the beginning of the path.
        p_WO: (k, 3) positions, m.
        way: the samples of the step it belongs to.
        length: in m, and ...
        angle: ... in rad, what counts as equally far.

    Returns:
        (k,) distance of O's origin, m, and (k,) angle of rotation, rad.
    """
    total = float(np.linalg.norm(way.turn))
    round_a_point = way.step.rotate is not None
    along = np.zeros(3) if round_a_point else way.goal[:3, 3] - way.X_from[:3, 3]
    weight, progress = np.zeros(2), np.zeros((2, len(p_WO)))
    if total > 0:
        turned = q_WO @ right_product(_from(way) * [1, -1, -1, -1])
        turned *= np.copysign(1.0, turned[0, 0])  # the way begins with no turn, whatever the sign of the quaternion
        twist = 2 * np.arctan2(turned[:, 1:] @ way.turn / total, turned[:, 0])
        weight[0], progress[0] = (total / angle) ** 2, np.unwrap(twist) / total
    if along.any():
        weight[1] = along @ along / length**2
        progress[1] = (p_WO - way.X_from[:3, 3]) @ along / (along @ along)
    u = weight @ progress / max(weight.sum(), 1e-300)
    if round_a_point and total > 0 and np.linalg.norm(np.cross(way.turn, way.X_from[:3, 3] - way.about)) > 1e-3 * total:
        u = _nearest(u, q_WO, p_WO, way, length, angle)
    return _off(q_WO, p_WO, way, _onward(np.clip(u, 0.0, 1.0)))


def _from(way: StepSpan) -> np.ndarray:
    """(4,) orientation with which a way begins."""
    return quaternions(way.X_from[None, :3, :3])[0]


def _off(q_WO: np.ndarray, p_WO: np.ndarray, way: StepSpan, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance, m, and angle, rad, of poses from those of a way that have come a share u (k,) of it."""
    total = float(np.linalg.norm(way.turn))
    axis = way.turn / max(total, 1e-300)
    half = u * total / 2
    turn = np.column_stack([np.cos(half), np.outer(np.sin(half), axis)])
    shift = p_WO - way.X_from[:3, 3]
    if way.step.rotate is None:
        shift = shift - np.outer(u, way.goal[:3, 3] - way.X_from[:3, 3])
    else:
        arm = way.X_from[:3, 3] - way.about
        out = arm - axis * (axis @ arm)  # turns about the axis; Rodrigues
        shift = shift + np.outer(1 - np.cos(2 * half), out) - np.outer(np.sin(2 * half), np.cross(axis, arm))
    return np.linalg.norm(shift, axis=1), angles(q_WO, turn @ right_product(_from(way)))


def _onward(u: np.ndarray) -> np.ndarray:
    """(k,) values that never decrease, with the least largest distance from u (isotonic regression in that norm)."""
    return (np.maximum.accumulate(u) + np.minimum.accumulate(u[::-1])[::-1]) / 2


def _nearest(
    u: np.ndarray, q_WO: np.ndarray, p_WO: np.ndarray, way: StepSpan, length: float, angle: float
) -> np.ndarray:
    """(k,) progress around a point beside the object, where position and rotation both count, near that in angle u."""
    best, least = u, np.full(len(u), np.inf)
    for step in np.linspace(-angle, angle, 121) / float(np.linalg.norm(way.turn)):
        tried = np.clip(u + step, 0.0, 1.0)
        shift, turned = _off(q_WO, p_WO, way, tried)
        far = np.maximum(shift / length, turned / angle)
        best, least = np.where(far < least, tried, best), np.minimum(far, least)
    return best
