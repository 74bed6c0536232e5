"""Deviations from the plan: pose errors and slip of contacts. Numpy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.model.object import Object
from drake_hand.modes.code import Mode
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Task
from drake_hand.verify.goal import step_goal


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Deviation of the object from the plan, (k,) each."""

    position_mm: np.ndarray
    tilt_deg: np.ndarray
    """Of the axis."""
    rotation_deg: np.ndarray
    """About the axis, signed, continuous over time so that whole turns count."""


@dataclass(frozen=True, kw_only=True)
class Slip:
    """How far a fingertip's surface slid over the object's during one contact."""

    finger: str
    start_s: float
    end_s: float
    slip_mm: float
    """Largest distance, at any time of the contact, of the two points that met when it began."""


def deviation(X_WO: np.ndarray, planned: np.ndarray, axis_W: np.ndarray) -> Deviation:
    """Compares (k, 4, 4) poses; the rotation between them is split into turn about an axis (3,) and tilt of it."""
    R = X_WO[:, :3, :3] @ planned[:, :3, :3].transpose(0, 2, 1)
    quaternion = Rotation.from_matrix(R).as_quat()
    twist = 2 * np.arctan2(quaternion[:, :3] @ axis_W, quaternion[:, 3])
    tilt = np.arccos(np.clip(np.einsum("i,kij,j->k", axis_W, R, axis_W), -1.0, 1.0))
    twist[0] = (twist[0] + np.pi) % (2 * np.pi) - np.pi
    return Deviation(
        position_mm=np.linalg.norm(X_WO[:, :3, 3] - planned[:, :3, 3], axis=1) * 1e3,
        tilt_deg=np.degrees(tilt),
        rotation_deg=np.degrees(np.unwrap(twist)),
    )


def main_axis(task: Task, X_WO: np.ndarray, object_: Object) -> np.ndarray:
    """(3,) unit axis in W of the task's largest rotation, or the object's long axis at the (4, 4) start pose."""
    axis_W, largest = X_WO[:3, :3] @ Surface.of(object_).long_axis, 0.0
    for step in task.motion:
        X_WO, turned, angle = step_goal(step, X_WO)
        if turned is not None and abs(angle) > largest:
            axis_W, largest = turned, abs(angle)
    return axis_W


def slips(t: np.ndarray, X_WO: np.ndarray, slip_W: np.ndarray, part: np.ndarray, plan: Plan) -> list[Slip]:
    """Integrates slip over each of the plan's rolling contacts, in the object's frame.

    Args:
        t: (k,) equally spaced times, s.
        X_WO: (k, 4, 4) object poses then.
        slip_W: (k, fingers, 3) velocity of the tip's surface over the object's, m/s.
        part: (k,) the plan's part then.
        plan: says which contacts roll.
    """
    out = []
    modes = [Mode.parse(code, plan.fingers) for code in plan.modes]
    rolling = np.array([[s is Submodel.ROLL for s in mode.submodels] for mode in modes])[part]
    slip_O = np.einsum("kji,kfj->kfi", X_WO[:, :3, :3], slip_W)
    for f, finger in enumerate(plan.fingers):
        edges = np.flatnonzero(np.diff(np.r_[False, rolling[:, f], False].astype(int)))
        for a, b in edges.reshape(-1, 2):
            way = np.cumsum(slip_O[a:b, f] * np.gradient(t)[a:b, None], axis=0) if b - a > 1 else np.zeros((1, 3))
            largest = float(np.linalg.norm(way - way[0], axis=1).max() * 1e3)
            out.append(Slip(finger=finger, start_s=float(t[a]), end_s=float(t[b - 1]), slip_mm=largest))
    return out
