"""`Stage`: a Meshcat page with a hand and an object on it, and the recording of their motion."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import (
    Box,
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
from pydrake.perception import PointCloud

from drake_hand.model.hand import Finger
from drake_hand.model.scene import Scene
from drake_hand.model.table import Table
from drake_hand.plans.trajectory import quaternions
from drake_hand.view.colors import finger_color, rgb
from drake_hand.view.keyframes import last_good, needed, row_changes

MOST_FRAMES = 12000
"""Most frames of a recording, however long."""
MOST_FRAMES_PER_S = 30.0
"""Most frames per second."""

_ROOT = "/stage"
_ARROW_SHARE = 0.32
"""Length of the arrow of a strong force, over the hand's size."""
_STRONG_PER_CENT = 97
"""Per cent of forces that are no stronger than a strong one."""
_LONGEST_ARROW_RATIO = 1.5
"""Length at which arrows are cut, over that of a strong force."""
_RECORDING_ERROR_SHARE = 5e-4
"""How far off the recording may be, over the hand's size; in rotation, rad over 2."""
_TABLE_THICKNESS_M = 4e-3
"""Thickness of a table, m."""
_WOOD, _CLAY, _GREY = "#d9c3a0", "#c98f6b", "#d9d9d9"
"""Colours of tables, and of objects and hands whose files name none."""
_MOST_POSES = 30000
"""Most poses of a recording: what a page of 6 MB has room for. Long recordings are coarser."""


@dataclass(frozen=True, kw_only=True)
class _Track:
    """A motion to be recorded."""

    path: str
    X: np.ndarray
    """(k, 4, 4) poses."""
    rows: np.ndarray
    """(k, 7) the same as numbers between which one interpolates."""
    tolerance: np.ndarray
    """(7,) how far off each may be."""


def frame_times(duration: float) -> np.ndarray:
    """(k,) equally spaced times from 0 to `duration`, as many as a recording needs."""
    frames = int(np.clip(np.ceil(duration * MOST_FRAMES_PER_S), 1, MOST_FRAMES))
    return np.linspace(0.0, duration, frames + 1)


class Stage:
    """Draws bodies at many times at once, then gives the whole as one page.

    Arrays have a row per frame; frames are those of :func:`frame_times`. W is turned so that gravity points down.

    Attributes:
        size: of the hand, from the palm's origin to the farthest fingertip at home, m.
    """

    def __init__(self, scene: Scene, t: np.ndarray, *, gravity: np.ndarray) -> None:
        self._scene, self._t = scene, t
        self._meshcat = _quiet_meshcat()
        self._animation = MeshcatAnimation((len(t) - 1) / (t[-1] - t[0]) if len(t) > 1 else MOST_FRAMES_PER_S)
        self._animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
        self._R_VW = upright(gravity)
        self._ways: list[dict[str, Any]] = []
        self._tracks: list[_Track] = []
        self._ghost = False
        self._look = {"front": [1.0, 0, 0], "side": [0, 1.0, 0], "palm": [1.0, 0, 0]}
        self._force_scale, self._most_force = 1.0, 0.0
        p_WT = np.array([scene.tip_position(f) for f in scene.hand.fingers])
        self.size = float(np.linalg.norm(p_WT, axis=1).max()) + 1e-3
        self._meshcat.SetTransform(_ROOT, RigidTransform(RotationMatrix(self._R_VW), np.zeros(3)))
        for path in ("/Grid", "/Axes"):
            self._meshcat.SetProperty(path, "visible", False)
        self._meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.98])
        self._meshcat.SetProperty("/Background/<object>", "bottom_color", [1.0, 1.0, 1.0])
        self._meshcat.SetObject("/floor", Cylinder(1.0, 1e-4), Rgba(0.98, 0.99, 1.0, 1.0))

    def hand(self, q: np.ndarray, X_WO: np.ndarray | None) -> None:
        """Draws the hand.

        Args:
            q: (k, nq) joints, rad.
            X_WO: (k, 4, 4) where the object is then, if there is one.
        """
        plant = self._scene.plant
        bodies = [plant.get_body(i) for i in plant.GetBodyIndices(self._scene.hand_model)]
        poses = np.empty((len(q), len(bodies), 4, 4))
        for k in range(len(q)):
            self._scene.set(q[k], None if X_WO is None else X_WO[k])
            for b, body in enumerate(bodies):
                poses[k, b] = plant.EvalBodyPoseInWorld(self._scene.plant_context, body).GetAsMatrix4()
        for b, body in enumerate(bodies):
            self._draw_body(f"hand/{body.name()}", body, color=_GREY)
            self._move(f"hand/{body.name()}", poses[:, b])
        origins = poses[0, :, :3, 3]
        middle = (origins.min(axis=0) + origins.max(axis=0)) / 2
        self._face(self._R_VW @ (self._scene.hand.palm_direction if X_WO is None else X_WO[0, :3, 3] - middle))

    def object(self, X_WO: np.ndarray, *, ghost: bool = False) -> None:
        """Draws the object at (k, 4, 4) poses; as a `ghost` it is faint, to compare the plan with what happened."""
        plant = self._scene.plant
        path = "ghost" if ghost else "object"
        for i in plant.GetBodyIndices(self._scene.object_model):
            body = plant.get_body(i)
            self._draw_body(f"{path}/{body.name()}", body, color=_CLAY, alpha=0.25 if ghost else 1.0)
        self._move(path, X_WO)
        self._ghost |= ghost

    def table(self, table: Table, p_W: np.ndarray) -> None:
        """Draws a piece of a table, below a point (3,) of W."""
        X_WT, side = RigidTransform(table.X_WT), 2.5 * self.size
        at = X_WT.inverse().multiply(p_W) * [1.0, 1.0, 0.0] - [0.0, 0.0, _TABLE_THICKNESS_M / 2]
        self._meshcat.SetObject(f"{_ROOT}/table", Box(side, side, _TABLE_THICKNESS_M), Rgba(*rgb(_WOOD), 1.0))
        self._meshcat.SetTransform(f"{_ROOT}/table", X_WT @ RigidTransform(at))

    def contacts(self, p_W: np.ndarray, f_W: np.ndarray, X_WO: np.ndarray) -> None:
        """Draws contact points and forces; a strong force is an arrow of a third of the hand's size.

        They are drawn on the object, where they hardly move.

        Args:
            p_W: (k, F, 3) points in W, m; NaN where there is no contact.
            f_W: (k, F, 3) forces on the object in W, N; zero where there is none.
            X_WO: (k, 4, 4) where the object is.
        """
        R_OW = np.swapaxes(X_WO[:, :3, :3], 1, 2)
        p_O = np.einsum("kij,kfj->kfi", R_OW, p_W - X_WO[:, None, :3, 3])
        f_O = np.einsum("kij,kfj->kfi", R_OW, f_W)
        size = np.linalg.norm(f_W, axis=2)
        pushing = size > 1e-4
        if pushing.any():
            self._most_force = float(np.percentile(size[pushing], _STRONG_PER_CENT))
            self._force_scale = _ARROW_SHARE * self.size / self._most_force
        for finger in self._scene.hand.fingers:
            self._contact(finger.name, finger.index, p_O[:, finger.index], f_O[:, finger.index])

    def way(self, index: int, p_P: np.ndarray, *, on_object: bool) -> None:
        """Draws the path of a point, which grows as the recording plays.

        Args:
            index: of the finger whose colour it has.
            p_P: (k, 3) in O or in W, m; NaN where there is none.
            on_object: whether in O.
        """
        path = f"{'object/' if on_object else ''}ways/{index}"
        known = np.isfinite(p_P).all(axis=1)
        starts, ends, times = [], [], []
        edges = np.flatnonzero(np.diff(np.r_[False, known, False]))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            kept = a + needed(p_P[a:b], _RECORDING_ERROR_SHARE * self.size)
            starts += list(p_P[kept[:-1]])
            ends += list(p_P[kept[1:]])
            times += list(self._t[kept[1:]])
        if not times:
            return
        vertices, faces = tubes(np.array(starts), np.array(ends), 0.005 * self.size)
        color = Rgba(*rgb(finger_color(index)), 1.0)
        self._meshcat.SetTriangleMesh(f"{_ROOT}/{path}", vertices.T, faces.T, color)
        each = 3 * len(faces) // len(times)
        self._ways.append({"path": f"stage/{path}", "ends": np.round(times, 3).tolist(), "each": each})

    def line(self, path: str, index: int, p_W: np.ndarray) -> None:
        """Draws a line through points (k, 3) of W in a finger's colour."""
        vertices, faces = tubes(p_W[:-1], p_W[1:], 0.003 * self.size)
        self._meshcat.SetTriangleMesh(f"{_ROOT}/{path}", vertices.T, faces.T, Rgba(*rgb(finger_color(index)), 1.0))

    def ball(self, finger: Finger) -> None:
        """Draws the sphere that stands for a fingertip; it goes with its link."""
        path = f"{_ROOT}/hand/{finger.tip_link}/sphere"
        self._meshcat.SetObject(path, Sphere(finger.radius), Rgba(*rgb(finger_color(finger.index)), 0.6))
        self._meshcat.SetTransform(path, RigidTransform(finger.p_LC))

    def mark(self, path: str, shape: Shape, color: str, X: RigidTransform | None = None) -> None:
        """Draws a mark: seen through whatever is before it."""
        self._meshcat.SetObject(f"{_ROOT}/{path}", shape, Rgba(*rgb(color), 1.0))
        self._meshcat.SetProperty(f"{_ROOT}/{path}/<object>", "material.depthTest", False)
        self._meshcat.SetProperty(f"{_ROOT}/{path}/<object>", "renderOrder", 1.0)
        if X is not None:
            self._meshcat.SetTransform(f"{_ROOT}/{path}", X)

    def arrow(self, path: str, color: str) -> None:
        """Draws an arrow of length 1 along z, as thick as its length asks."""
        self.mark(f"{path}/shaft", Cylinder(0.022, 0.8), color, RigidTransform([0, 0, 0.4]))
        flip = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, 1])
        self.mark(f"{path}/head", MeshcatCone(0.24, 0.06, 0.06), color, flip)

    def still_arrow(self, path: str, color: str, X: RigidTransform, length: float) -> None:
        """Draws an arrow along z of the frame X, which stays."""
        self.arrow(path, color)
        self._meshcat.SetTransform(f"{_ROOT}/{path}", X)
        thick = min(length, 0.3 * self.size)
        self._meshcat.SetProperty(f"{_ROOT}/{path}", "scale", [thick, thick, length])

    def cloud(self, path: str, index: int, p_W: np.ndarray) -> None:
        """Draws points (n, 3) in a finger's colour."""
        cloud = PointCloud(len(p_W))
        cloud.mutable_xyzs()[:] = p_W.T
        self._meshcat.SetObject(f"{_ROOT}/{path}", cloud, 0.006 * self.size, Rgba(*rgb(finger_color(index)), 1.0))

    @property
    def scene(self) -> dict[str, Any]:
        """What the page's panel needs to know about the scene."""
        tips = [
            {"name": f.name, "color": finger_color(f.index), "path": f"stage/hand/{f.tip_link}", "p": f.p_LC.tolist()}
            for f in self._scene.hand.fingers
        ]
        force = {"m_per_n": self._force_scale, "most_n": self._most_force}
        return {"tips": tips, "look": self._look, "force": force, "ways": self._ways, "ghost": self._ghost}

    def html(self) -> str:
        """The page, which needs no server and no network."""
        self._record()
        self._meshcat.SetAnimation(self._animation)
        return self._meshcat.StaticHtml()

    def _record(self) -> None:
        """Records the motions, as finely as there is room for."""
        coarse, room = 1.0, False
        while not room:
            frames = [needed(track.rows, coarse * track.tolerance) for track in self._tracks]
            room = sum(map(len, frames)) <= _MOST_POSES
            coarse *= 1.5
        for track, chosen in zip(self._tracks, frames, strict=True):
            for k in chosen:
                self._animation.SetTransform(int(k), track.path, RigidTransform(track.X[k]))

    def _contact(self, name: str, index: int, p_O: np.ndarray, f_O: np.ndarray) -> None:
        color = finger_color(index)
        touching = np.isfinite(p_O).all(axis=1)
        if not touching.any():
            return
        X = np.tile(np.eye(4), (len(p_O), 1, 1))
        X[:, :3, 3] = last_good(p_O, touching)
        self.mark(f"object/contacts/{name}/rim", Sphere(0.016 * self.size), "#111827")
        self.mark(f"object/contacts/{name}/dot", Sphere(0.011 * self.size), color)
        self._meshcat.SetProperty(f"{_ROOT}/object/contacts/{name}/dot/<object>", "renderOrder", 2.0)
        self._move(f"object/contacts/{name}", X)
        self._show(f"object/contacts/{name}", touching)
        size = np.linalg.norm(f_O, axis=1)
        pushing = touching & (size > 1e-4)
        if not pushing.any():
            return
        X[:, :3, :3] = [RotationMatrix.MakeFromOneVector(f, 2).matrix() for f in last_good(f_O, pushing)]
        self.arrow(f"object/forces/{name}", color)
        self._move(f"object/forces/{name}", X, coarse=4.0)
        longest = _LONGEST_ARROW_RATIO * _ARROW_SHARE * self.size
        self._scale(f"object/forces/{name}", np.clip(size * self._force_scale, 1e-3 * longest, longest))
        self._show(f"object/forces/{name}", pushing)

    def _draw_body(self, path: str, body: RigidBody, *, color: str, alpha: float = 1.0) -> None:
        """Draws what a body shows (its illustration geometry), in `color` where its file names none."""
        inspector = self._scene.scene_graph.model_inspector()
        frame = self._scene.plant.GetBodyFrameIdOrThrow(body.index())
        for k, gid in enumerate(inspector.GetGeometries(frame, Role.kIllustration)):
            own = inspector.GetIllustrationProperties(gid).GetPropertyOrDefault(
                "phong", "diffuse", Rgba(*rgb(color), 1.0)
            )
            shown = Rgba(own.r(), own.g(), own.b(), own.a() * alpha)
            self._meshcat.SetObject(f"{_ROOT}/{path}/{k}", inspector.GetShape(gid), shown)
            self._meshcat.SetTransform(f"{_ROOT}/{path}/{k}", inspector.GetPoseInFrame(gid))

    def _move(self, path: str, X: np.ndarray, coarse: float = 1.0) -> None:
        path = f"{_ROOT}/{path}"
        self._meshcat.SetTransform(path, RigidTransform(X[0]))
        if len(X) < 2 or np.ptp(X, axis=0).max() < 1e-9:
            return
        rows = np.hstack([quaternions(X[:, :3, :3]), X[:, :3, 3]])
        tolerance = coarse * _RECORDING_ERROR_SHARE * np.array([1.0] * 4 + [self.size] * 3)
        self._tracks.append(_Track(path=path, X=X, rows=rows, tolerance=tolerance))

    def _scale(self, path: str, length: np.ndarray) -> None:
        self._meshcat.SetProperty(f"{_ROOT}/{path}", "scale", [float(length[0])] * 3)
        for k in needed(length[:, None], 4 * _RECORDING_ERROR_SHARE * self.size):
            self._animation.SetProperty(int(k), f"{_ROOT}/{path}", "scale", [float(length[k])] * 3)

    def _show(self, path: str, visible: np.ndarray) -> None:
        self._meshcat.SetProperty(f"{_ROOT}/{path}", "visible", bool(visible[0]))
        if visible.any() and not visible.all():
            for k in row_changes(visible):
                self._animation.SetProperty(int(k), f"{_ROOT}/{path}", "visible", bool(visible[k]))

    def _face(self, towards: np.ndarray) -> None:
        """Notes the directions from which the page may look, in V: from the object's side."""
        palm = towards / max(np.linalg.norm(towards), 1e-9)
        flat = np.array([*towards[:2], 0.0])
        front = flat / np.linalg.norm(flat) if np.linalg.norm(flat) > 1e-3 * self.size else np.array([1.0, 0, 0])
        if not palm.any():
            palm = front
        side = [-front[1], front[0], 0.0]
        self._look = {"front": front.tolist(), "side": side, "palm": (palm + 0.02 * front).tolist()}


def _quiet_meshcat() -> Meshcat:
    """A Meshcat that does not print its port, since only its page is wanted."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    finally:
        logger.setLevel(level)


def upright(gravity: np.ndarray) -> np.ndarray:
    """(3, 3) the rotation R_VW that turns gravity onto -z of the view frame V; none if there is no gravity."""
    size = np.linalg.norm(gravity)
    if size < 1e-9:
        return np.eye(3)
    up = -gravity / size
    # x of W comes nearest to x of V that way, or, when it points up or down, z does.
    forward = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0, 0, -np.sign(up[0])])
    x = _unit(forward - up * (forward @ up))
    return np.stack([x, np.cross(up, x), up])


def tubes(starts: np.ndarray, ends: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Square tubes from starts to ends (n, 3), as vertices (8 n, 3) and faces (8 n, 3), tube after tube."""
    along = ends - starts
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    other = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    u = np.cross(along, other)
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-12)
    w = np.cross(along, u)
    ring = radius * np.stack([u, w, -u, -w], axis=1)
    vertices = np.concatenate([starts[:, None] + ring, ends[:, None] + ring], axis=1)
    one = [f for i in range(4) for f in ((i, (i + 1) % 4, i + 4), ((i + 1) % 4, (i + 1) % 4 + 4, i + 4))]
    faces = np.array(one)[None] + 8 * np.arange(len(starts))[:, None, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def _unit(a: np.ndarray) -> np.ndarray:
    return a / np.linalg.norm(a)
