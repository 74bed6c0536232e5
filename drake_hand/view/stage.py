"""`Stage`: a Meshcat page with a hand and an object on it, and the recording of their motion."""

from __future__ import annotations

import logging

import numpy as np
from pydrake.geometry import (
    Cylinder,
    Meshcat,
    MeshcatAnimation,
    MeshcatCone,
    MeshcatParams,
    Rgba,
    Role,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import RigidBody

from drake_hand.model.scene import Scene
from drake_hand.view.colors import CONTACT, finger_color, rgb

FRAMES = 1500
"""Most frames of a recording, however long."""
FRAME_RATE = 30.0
"""Most frames per second."""
FORCE_SCALE = 0.06
"""Length of a force arrow, m/N."""

_ROOT = "/stage"


def frame_times(duration: float) -> np.ndarray:
    """(k,) equally spaced times from 0 to `duration`, as many as a recording needs."""
    frames = int(np.clip(np.ceil(duration * FRAME_RATE), 1, FRAMES))
    return np.linspace(0.0, duration, frames + 1)


class Stage:
    """Draws bodies at many times at once, then gives the whole as one page.

    Arrays have a row per frame; frames are those of :func:`frame_times`. W is turned so that gravity points down.
    """

    def __init__(self, scene: Scene, t: np.ndarray, *, gravity: np.ndarray) -> None:
        self._scene, self._t = scene, t
        self._meshcat = _quiet_meshcat()
        self._animation = MeshcatAnimation((len(t) - 1) / (t[-1] - t[0]) if len(t) > 1 else FRAME_RATE)
        self._animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
        self._R_VW = _upright(gravity)
        self._meshcat.SetTransform(_ROOT, RigidTransform(RotationMatrix(self._R_VW), np.zeros(3)))
        self._meshcat.SetProperty("/Grid", "visible", False)
        self._meshcat.SetProperty("/Axes", "visible", False)
        self._meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.98])
        self._meshcat.SetProperty("/Background/<object>", "bottom_color", [1.0, 1.0, 1.0])

    def hand(self, q: np.ndarray, X_WO: np.ndarray) -> None:
        """Draws the hand.

        Args:
            q: (k, nq) joints, rad.
            X_WO: (k, 4, 4) where the object is then.
        """
        plant = self._scene.plant
        bodies = [plant.get_body(i) for i in plant.GetBodyIndices(self._scene.hand_model)]
        poses = np.empty((len(q), len(bodies), 4, 4))
        for k in range(len(q)):
            self._scene.set(q[k], X_WO[k])
            for b, body in enumerate(bodies):
                poses[k, b] = plant.EvalBodyPoseInWorld(self._scene.plant_context, body).GetAsMatrix4()
        for b, body in enumerate(bodies):
            if self._draw_body(f"hand/{body.name()}", body):
                self._move(f"hand/{body.name()}", poses[:, b])
        self._look(poses[0, :, :3, 3], X_WO[0, :3, 3])

    def object(self, X_WO: np.ndarray, *, ghost: bool = False) -> None:
        """Draws the object at (k, 4, 4) poses; as a `ghost` it is faint, for what was planned beside what happened."""
        plant = self._scene.plant
        path = "ghost" if ghost else "object"
        for i in plant.GetBodyIndices(self._scene.object_model):
            self._draw_body(f"{path}/{plant.get_body(i).name()}", plant.get_body(i), alpha=0.25 if ghost else 1.0)
        self._move(path, X_WO)

    def contact(self, name: str, index: int, p_W: np.ndarray, f_W: np.ndarray) -> None:
        """Draws a contact point and its force.

        Args:
            name: of the finger.
            index: of the finger, for its colour.
            p_W: (k, 3) point in W, m; NaN where there is no contact.
            f_W: (k, 3) force on the object in W, N; zero where there is none.
        """
        color = finger_color(index)
        touching = np.isfinite(p_W).all(axis=1)
        if not touching.any():
            return
        p_W = _hold(p_W, touching)
        X = np.tile(np.eye(4), (len(p_W), 1, 1))
        X[:, :3, 3] = p_W
        self._mark(f"contacts/{name}", Sphere(0.0022), CONTACT)
        self._move(f"contacts/{name}", X)
        self._show(f"contacts/{name}", touching)

        size = np.linalg.norm(f_W, axis=1)
        pushing = touching & (size > 1e-4)
        if not pushing.any():
            return
        f_W = _hold(f_W, pushing)
        X[:, :3, :3] = [RotationMatrix.MakeFromOneVector(f, 2).matrix() for f in f_W]
        self._mark(f"forces/{name}/shaft", Cylinder(0.0009, 0.75), color, RigidTransform([0, 0, 0.375]))
        flip = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, 1])
        self._mark(f"forces/{name}/head", MeshcatCone(0.25, 0.0024, 0.0024), color, flip)
        self._move(f"forces/{name}", X)
        self._scale(f"forces/{name}", np.maximum(size, 1e-4) * FORCE_SCALE)
        self._show(f"forces/{name}", pushing)

    def html(self) -> str:
        """The page, which needs no server and no network."""
        self._meshcat.SetAnimation(self._animation)
        return self._meshcat.StaticHtml()

    def _draw_body(self, path: str, body: RigidBody, alpha: float = 1.0) -> bool:
        """Draws what a body shows (its illustration geometry); whether there was any."""
        inspector = self._scene.scene_graph.model_inspector()
        frame = self._scene.plant.GetBodyFrameIdOrThrow(body.index())
        geometries = inspector.GetGeometries(frame, Role.kIllustration)
        for k, gid in enumerate(geometries):
            color = inspector.GetIllustrationProperties(gid).GetPropertyOrDefault(
                "phong", "diffuse", Rgba(0.85, 0.85, 0.85, 1)
            )
            color = Rgba(color.r(), color.g(), color.b(), color.a() * alpha)
            self._meshcat.SetObject(f"{_ROOT}/{path}/{k}", inspector.GetShape(gid), color)
            self._meshcat.SetTransform(f"{_ROOT}/{path}/{k}", inspector.GetPoseInFrame(gid))
        return bool(geometries)

    def _mark(self, path: str, shape: Shape, color: str, X: RigidTransform | None = None) -> None:
        """Draws a mark: seen through whatever is before it."""
        self._meshcat.SetObject(f"{_ROOT}/{path}", shape, Rgba(*rgb(color), 1.0))
        self._meshcat.SetProperty(f"{_ROOT}/{path}/<object>", "material.depthTest", False)
        self._meshcat.SetProperty(f"{_ROOT}/{path}/<object>", "renderOrder", 1.0)
        if X is not None:
            self._meshcat.SetTransform(f"{_ROOT}/{path}", X)

    def _move(self, path: str, X: np.ndarray) -> None:
        self._meshcat.SetTransform(f"{_ROOT}/{path}", RigidTransform(X[0]))
        if len(X) > 1 and np.ptp(X, axis=0).max() > 1e-9:
            for k in _changes(X.reshape(len(X), -1)):
                self._animation.SetTransform(int(k), f"{_ROOT}/{path}", RigidTransform(X[k]))

    def _scale(self, path: str, length: np.ndarray) -> None:
        self._meshcat.SetProperty(f"{_ROOT}/{path}", "scale", [1.0, 1.0, float(length[0])])
        for k in _changes(length[:, None]):
            self._animation.SetProperty(int(k), f"{_ROOT}/{path}", "scale", [1.0, 1.0, float(length[k])])

    def _show(self, path: str, visible: np.ndarray) -> None:
        self._meshcat.SetProperty(f"{_ROOT}/{path}", "visible", bool(visible[0]))
        if visible.any() and not visible.all():
            for k in _changes(visible[:, None]):
                self._animation.SetProperty(int(k), f"{_ROOT}/{path}", "visible", bool(visible[k]))

    def _look(self, hand: np.ndarray, p_WO: np.ndarray) -> None:
        """Frames the hand: from the object's side, somewhat to the side and from above."""
        centre = (hand.min(axis=0) + hand.max(axis=0)) / 2
        size = np.linalg.norm(np.ptp(hand, axis=0))
        front = self._R_VW @ (p_WO - centre)
        front[2] = 0
        front /= max(np.linalg.norm(front), 1e-9)
        if not front.any():
            front = np.array([1.0, 0, 0])
        side = np.array([-front[1], front[0], 0.0])
        towards = _unit(front + 0.55 * side + np.array([0, 0, 0.6]))
        left = _unit(np.cross(towards, [0, 0, 1.0]))
        target = self._R_VW @ centre + 0.08 * size * left  # the panel's card covers the left
        self._meshcat.SetCameraPose(target + 0.95 * size * towards, target)


def _quiet_meshcat() -> Meshcat:
    """A Meshcat that does not tell of its port: only its page is wanted."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    finally:
        logger.setLevel(level)


def _upright(gravity: np.ndarray) -> np.ndarray:
    """(3, 3) the rotation R_VW that turns gravity onto -z of the view frame V; none if there is no gravity."""
    size = np.linalg.norm(gravity)
    if size < 1e-9:
        return np.eye(3)
    up = -gravity / size
    # x of W comes nearest to x of V that way, or, when it points up or down, z does.
    forward = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0, 0, -np.sign(up[0])])
    x = _unit(forward - up * (forward @ up))
    return np.stack([x, np.cross(up, x), up])


def _unit(a: np.ndarray) -> np.ndarray:
    return a / np.linalg.norm(a)


def _hold(rows: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Rows with the bad ones replaced by the last good one before (or the first good one)."""
    last = np.maximum.accumulate(np.where(good, np.arange(len(rows)), -1))
    return rows[np.where(last < 0, np.argmax(good), last)]


def _changes(rows: np.ndarray) -> np.ndarray:
    """Indices of the rows an animation needs: first, last, and those unlike a neighbour."""
    differs = np.any(rows[1:] != rows[:-1], axis=1)
    return np.flatnonzero(np.r_[True, differs] | np.r_[differs, True])
