"""A hand or a task before there is a plan: joint sliders, palm frame, reach of the tips, the object and its path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.task import Step, Task
from drake_hand.plans.words import short_name, step_words
from drake_hand.verify.goal import pose_matrix, step_goal
from drake_hand.view.course import tip_centres
from drake_hand.view.hand_picture import sweeps
from drake_hand.view.page import Page, insert
from drake_hand.view.stage import Stage

REACH_POSTURES = 1200
"""Random postures from which the reach of a fingertip is drawn."""
_AXES = (("x", "#c0392b"), ("y", "#1e8449"), ("z", "#2471a3"))
_WAY_COLOR = "#374151"


def render_hand(hand: Hand, *, remarks: Sequence[str] = ()) -> Page:
    """A hand at its home posture: a slider per joint, palm frame, where the palm faces, tip spheres, sweeps and reach.

    Args:
        hand: the hand.
        remarks: what is to be said about it.
    """
    stage = Stage(Scene(hand), np.zeros(1), gravity=np.zeros(3))
    stage.hand(hand.q_home[None], None)
    way, length = hand.closing.palm, 0.5 * stage.size
    start = np.mean([finger.axes[0].X_PJ[:3, 3] for finger in hand.fingers], axis=0)
    stage.still_arrow("ways/palm", _WAY_COLOR, RigidTransform(RotationMatrix.MakeFromOneVector(way, 2), start), length)
    labels = [{"name": "palm faces", "color": _WAY_COLOR, "path": "stage", "p": (start + length * way).tolist()}]
    for finger in hand.fingers:
        stage.ball(finger)
        for joint, points in zip(finger.joints, sweeps(hand, finger), strict=True):
            stage.line(f"ways/sweeps/{joint}", finger.index, points)
    note = (
        f"{len(hand.fingers)} fingers, {hand.nq} joints; palm frame W: x, y, z; balls: the fingertips, numbered as in "
        "mode codes; lines: their paths as one joint moves from limit to limit"
    )
    note = "\n- ".join([note, *remarks])
    return _page(stage, hand, title=hand.name, note=note, labels=labels, numbered=True)


def render_task(task: Task) -> Page:
    """A task's hand at home and its object at the start, each step's axis or displacement as an arrow.

    Raises:
        InputError: hand or object cannot be loaded.
    """
    X_WO, note = _start(task)
    steps = "; ".join(f"{i} {step_words(step)}" for i, step in enumerate(task.motion, start=1))
    return _task_page(task, X_WO, note=f"{note}{steps}")


def render_failure(task: Task, error: NoPlanFound) -> Page:
    """A search that failed: the object where it got stuck, the blocking finger marked."""
    X_WO, note = _start(task)
    where = error.evidence.X_WO
    blocked = error.evidence.finger
    if where is not None:
        X_WO, note = np.array(where), ""
    reason = f"no plan ({error.status}): {error.reason}. {note}The object is where this was found, the hand at home."
    return _task_page(task, X_WO, note=reason, blocked=blocked)


def _start(task: Task) -> tuple[np.ndarray, str]:
    """Where the object starts, and a remark about it."""
    if task.start != "auto":
        return pose_matrix(task.start), ""
    hand = Hand.load(task.hand)
    X_WO = np.eye(4)
    X_WO[:3, 3] = tip_centres(hand, hand.q_home[None])[0].mean(axis=0)
    return X_WO, "start: auto, the planner looks for a pose, so the object is shown between the fingertips; "


def _task_page(task: Task, X_WO: np.ndarray, *, note: str, blocked: str | None = None) -> Page:
    hand, object_ = Hand.load(task.hand), Object.load(task.object)
    gravity = np.zeros(3) if task.physics.gravity == "auto" else np.array(task.physics.gravity)
    stage = Stage(Scene(hand, object_), np.zeros(1), gravity=gravity)
    q = hand.q_home.copy()
    if task.start != "auto":
        for name, angle in task.start.joints_deg.items():
            q[hand.joints.index(name)] = np.radians(angle)
    stage.hand(q[None], X_WO[None])
    stage.object(X_WO[None])
    if task.support:
        assert task.table is not None
        stage.table(task.table, X_WO[:3, 3])
    labels, X = [], X_WO
    for i, step in enumerate(task.motion, start=1):
        label, X = _draw_step(stage, step, X, i)
        labels += label
    title = f"{short_name(task.object)} in {short_name(task.hand)}"
    return _page(stage, hand, q=q, X_WO=X_WO, title=title, note=note, labels=labels, blocked=blocked)


def _draw_step(stage: Stage, step: Step, X_WO: np.ndarray, number: int) -> tuple[list[dict[str, Any]], np.ndarray]:
    """Draws a step's axis or displacement; its label, and the pose after it."""
    if not (step.rotate or step.translate or step.move_to):
        return [], X_WO
    goal, axis, _ = step_goal(step, X_WO)
    if step.rotate and axis is not None:
        about = step.rotate.about_mm
        start = X_WO[:3, 3] if about is None else 1e-3 * np.array(about)
        way = 0.5 * stage.size * np.sign(step.rotate.angle_deg) * axis / np.linalg.norm(axis)
        start = start - way / 2
    else:
        start, way = X_WO[:3, 3], goal[:3, 3] - X_WO[:3, 3]
    length = float(np.linalg.norm(way))
    if length < 1e-6:
        return [], goal
    X = RigidTransform(RotationMatrix.MakeFromOneVector(way, 2), start)
    stage.still_arrow(f"ways/step{number}", _WAY_COLOR, X, length)
    words = f"{number} {step_words(step)}"
    return [{"name": words, "color": _WAY_COLOR, "path": "stage", "p": (start + way).tolist()}], goal


def _page(
    stage: Stage,
    hand: Hand,
    *,
    title: str,
    note: str,
    q: np.ndarray | None = None,
    X_WO: np.ndarray | None = None,
    labels: list[dict[str, Any]] | None = None,
    blocked: str | None = None,
    numbered: bool = False,
) -> Page:
    labels = list(labels or [])
    for i, (name, color) in enumerate(_AXES):
        axis = np.eye(3)[i]
        X = RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2), np.zeros(3))
        stage.still_arrow(f"ways/frame/{name}", color, X, 0.3 * stage.size)
        labels.append({"name": name, "color": color, "path": "stage", "p": (0.3 * stage.size * axis).tolist()})
    rng = np.random.default_rng(0)
    p_WC = tip_centres(hand, rng.uniform(hand.q_lower, hand.q_upper, (REACH_POSTURES, hand.nq)))
    for finger in hand.fingers:
        stage.cloud(f"reach/{finger.name}", finger.index, p_WC[:, finger.index])
    q = hand.q_home if q is None else q
    data = {
        "title": title,
        "note": note,
        "joints": [_slider(hand, i, q) for i in range(hand.nq)],
        "links": _links(hand),
        "X_WO": None if X_WO is None else X_WO.T.ravel().tolist(),
        "labels": labels,
        "blocked": blocked,
        "numbered": numbered,
        **stage.scene,
    }
    return insert(stage.html(), "look.html", data)


def _slider(hand: Hand, i: int, q: np.ndarray) -> dict[str, Any]:
    finger = next(f for f in hand.fingers if i in f.columns)
    return {
        "name": hand.joints[i],
        "finger": finger.index,
        "lower": float(hand.q_lower[i]),
        "upper": float(hand.q_upper[i]),
        "home": float(q[i]),
        "mm": hand.urdf.joints[hand.joints[i]].prismatic,
    }


def _links(hand: Hand) -> list[dict[str, Any]]:
    """The URDF's links from the root on, each with its pose in its parent, as matrices column by column."""
    axes = {a.joint: (a, f) for f in hand.fingers for a in f.axes}
    X_RootPalm = np.eye(4)
    for joint in hand.urdf.chain(hand.urdf.root, hand.palm) or []:
        X_RootPalm = X_RootPalm @ joint.X_PC
    order = [hand.urdf.root]
    links = [{"name": hand.urdf.root, "parent": -1, "X": np.linalg.inv(X_RootPalm).T.ravel().tolist()}]
    for link in order:
        for joint in hand.urdf.joints.values():
            if joint.parent != link:
                continue
            entry: dict[str, Any] = {
                "name": joint.child,
                "parent": order.index(link),
                "X": joint.X_PC.T.ravel().tolist(),
            }
            if joint.name in axes:
                axis, finger = axes[joint.name]
                entry |= {"axis": joint.axis.tolist(), "prismatic": joint.prismatic}
                entry |= {"joint": int(finger.columns[axis.source]), "gain": axis.multiplier, "offset": axis.offset}
            order.append(joint.child)
            links.append(entry)
    return links
