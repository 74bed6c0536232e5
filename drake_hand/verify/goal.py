"""Where the motion of a task leads, computed from the task alone, and whether a plan gets there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.plans.task import MoveTo, Pose, Step, Task
from drake_hand.plans.tolerances import TOLERANCES
from drake_hand.plans.trajectory import States, quaternions, rotations
from drake_hand.verify.findings import Findings

MOVES = ("rotate", "translate", "move_to", "push")
"""Kinds of steps after which the object is elsewhere."""


@dataclass(frozen=True, kw_only=True)
class ObjectSamples:
    """The object at k samples of a plan."""

    t: np.ndarray
    """(k,) s."""
    part: np.ndarray
    """(k,) index of the part."""
    q_WO: np.ndarray
    """(k, 4) orientation as unit quaternion w x y z."""
    p_WO: np.ndarray
    """(k, 3) position, m."""
    w_WO: np.ndarray
    """(k, 3) angular velocity, rad/s."""

    @classmethod
    def of(cls, states: States) -> ObjectSamples:
        """That of samples."""
        X_WO, w_WO = states.X_WO, states.V_WO[:, :3]
        return cls(t=states.t, part=states.part, q_WO=quaternions(X_WO[:, :3, :3]), p_WO=X_WO[:, :3, 3], w_WO=w_WO)

    @property
    def first_pose(self) -> np.ndarray:
        """(4, 4) X_WO of the first sample."""
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = rotations(self.q_WO[:1])[0], self.p_WO[0]
        return X


@dataclass(frozen=True, kw_only=True)
class StepSpan:
    """The samples in which one step of the motion is carried out, `first` to `last`."""

    step: Step
    name: str
    first: int
    last: int
    X_from: np.ndarray
    """(4, 4) goal of the step before."""
    goal: np.ndarray
    """(4, 4)."""
    turn: np.ndarray
    """(3,) axis times angle of its rotation in W, winding counted, rad."""
    about: np.ndarray
    """(3,) point about which it turns: O's origin, wherever that is, unless it is a rotation about another."""


def pose_matrix(p: Pose | MoveTo) -> np.ndarray:
    """(4, 4) pose as a person writes it: roll, pitch, yaw about fixed x, y, z; mm and degrees."""
    roll, pitch, yaw = np.radians(p.rpy_deg)
    X = np.eye(4)
    X[:3, :3] = (
        Rotation.from_rotvec([0, 0, yaw]) * Rotation.from_rotvec([0, pitch, 0]) * Rotation.from_rotvec([roll, 0, 0])
    ).as_matrix()
    X[:3, 3] = np.array(p.xyz_mm) / 1000
    return X


def check_goal(task: Task, motion: ObjectSamples, findings: Findings) -> list[StepSpan]:
    """Follows the motion through the plan: start pose, then every step's goal in turn, the last at the end.

    A rotation has to turn by its whole angle: the turn about its axis since the end of the step before says how often
    it has come round.
    Each goal is met at its closest approach, the first time it is met at all. The first that is not met is the last
    that is reported: what comes after it starts elsewhere.

    Returns:
        The stages, for all steps.
    """
    count = len(motion.t)
    if isinstance(task.start, Pose):
        errors = _errors(motion, slice(0, 1), pose_matrix(task.start))
        _report(findings, motion, 0, errors[:, 0], ["start", "start"])
    # turned vector: time integral of the angular velocity
    w, dt = motion.w_WO, np.diff(motion.t)[:, None]
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum((w[1:] + w[:-1]) / 2 * dt, axis=0)])
    X, first, stages, met = motion.first_pose, 0, [], True
    moving = [i for i, s in enumerate(task.motion) if s.kind in MOVES]
    for i, step in enumerate(task.motion):
        name = f"step {i + 1}, {step.kind}"
        if i not in moving:
            still = {"X_from": X, "goal": X, "turn": np.zeros(3), "about": X[:3, 3]}
            stages.append(StepSpan(step=step, name=name, first=first, last=first, **still))
            continue
        goal, axis, angle = step_goal(step, X)
        looked = count - 1 if i == moving[-1] else first
        position_mm, rotation_deg = _errors(motion, slice(looked, count), goal)
        if axis is None:
            way = 1000 * (goal[:3, 3] - X[:3, 3])
            whole = float(np.linalg.norm(way))
            along = 1000 * (motion.p_WO[looked:] - X[:3, 3]) @ way / max(whole, 1e-9)
        else:
            whole = float(np.degrees(angle))
            along = np.degrees((turned[looked:] - turned[first]) @ axis)
            # Beside its nominal path the object does not turn about the axis alone: whole turns are what winding tells.
            rotation_deg = np.where(np.abs(along - whole) < 180, rotation_deg, np.abs(along - whole))
        error = np.maximum(position_mm / TOLERANCES["goal_position_mm"], rotation_deg / TOLERANCES["goal_rotation_deg"])
        at = _first_closest(error)
        if met:
            met = bool(error[at] <= 1)
            names = [name, name]
            if not met and abs(whole) > TOLERANCES["goal_position_mm"]:
                verb, unit = ("moved", "mm") if axis is None else ("turned", "deg")
                names[axis is not None] += f": {verb} {along[at]:.3g} of {whole:.4g} {unit}"
            _report(findings, motion, looked + at, np.array([position_mm[at], rotation_deg[at]]), names)
        turn = Rotation.from_matrix(goal[:3, :3] @ X[:3, :3].T).as_rotvec() if axis is None else angle * axis
        about = X[:3, 3]
        if step.rotate and step.rotate.about_mm:
            about = np.array(step.rotate.about_mm) / 1000
        stages.append(
            StepSpan(step=step, name=name, first=first, last=looked + at, X_from=X, goal=goal, turn=turn, about=about)
        )
        X, first = goal, looked + at
    return stages


def step_goal(step: Step, X: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, float]:
    """Pose after a step that starts at pose X; axis in W and angle in rad if it is a rotation."""
    goal = X.copy()
    if step.kind not in MOVES:
        return goal, None, 0.0
    if step.move_to:
        return pose_matrix(step.move_to), None, 0.0
    if step.translate or step.push:
        by_mm = step.translate.by_mm if step.translate else step.push.by_mm if step.push else (0.0, 0.0, 0.0)
        goal[:3, 3] += np.array(by_mm) / 1000
        return goal, None, 0.0
    rotate = step.rotate
    assert rotate is not None
    axis = np.array(rotate.axis, dtype=float) / np.linalg.norm(rotate.axis)
    axis = X[:3, :3] @ axis if rotate.frame == "object" else axis
    about = X[:3, 3] if rotate.about_mm is None else np.array(rotate.about_mm) / 1000
    angle = np.radians(rotate.angle_deg)
    R = Rotation.from_rotvec(axis * angle).as_matrix()
    goal[:3, :3] = R @ X[:3, :3]
    goal[:3, 3] = about + R @ (X[:3, 3] - about)
    return goal, axis, float(angle)


def _errors(motion: ObjectSamples, rows: slice, goal: np.ndarray) -> np.ndarray:
    """(2, k) distance in mm and angle in degrees between some samples' poses and a goal (4, 4)."""
    angle = angles(motion.q_WO[rows], quaternions(goal[None, :3, :3]))
    return np.stack([np.linalg.norm(motion.p_WO[rows] - goal[:3, 3], axis=1) * 1000, np.degrees(angle)])


def angles(q: np.ndarray, q_from: np.ndarray) -> np.ndarray:
    """(k,) angles between orientations, unit quaternions (k, 4), and others, rad; exact where they hardly differ."""
    squares = [np.einsum("ki,ki->k", off, off) for off in (q - q_from, q + q_from)]
    return 4 * np.arcsin(np.sqrt(np.minimum(*squares)) / 2)


def _first_closest(error: np.ndarray) -> int:
    """Where the error is least in the first stretch in which it is within tolerance (1), or at all if it never is."""
    within = np.flatnonzero(error <= 1)
    if not len(within):
        return int(np.argmin(error))
    beyond = np.flatnonzero(error[within[0] :] > 1)
    stretch = error[within[0] : within[0] + beyond[0]] if len(beyond) else error[within[0] :]
    return int(within[0] + np.argmin(stretch))


def _report(findings: Findings, motion: ObjectSamples, at: int, errors: np.ndarray, names: Sequence[str]) -> None:
    t, part = motion.t[at : at + 1], motion.part[at : at + 1]
    findings.add("goal_position_mm", errors[:1], t, part, names[:1])
    findings.add("goal_rotation_deg", errors[1:], t, part, names[1:])
