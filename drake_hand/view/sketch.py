"""`Sketch`: hand and object as lines, seen from where the page sees them; for figures and moving pictures."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.patches import Circle
from PIL import Image

from drake_hand.contact.chain import FingerKinematics
from drake_hand.files import require_folder, write_atomic
from drake_hand.model.object import Object
from drake_hand.plans.plan import Plan
from drake_hand.plans.progress import Progress
from drake_hand.view.colors import finger_color
from drake_hand.view.course import Course
from drake_hand.view.style import column, in_print

_EYE_DIRECTION = np.array([0.75, 0.75, 0.25])
"""From where one looks, in W: out of the palm and from the thumb's side."""
_FRAME_RATE, _DPI = 6, 130
_OBJECT_TONES = np.array([[0.95, 0.87, 0.63], [0.80, 0.62, 0.30]])
"""Of the two halves of the object, so that one sees it turn."""


class Sketch:
    """Draws a plan at any time, without shading."""

    def __init__(self, plan: Plan, course: Course) -> None:
        self._plan, self._hand = plan, course.hand
        self._meshes = [g.to_trimesh() for g in Object.load(plan.task.object).geometries]
        self._eye = _EYE_DIRECTION / np.linalg.norm(_EYE_DIRECTION)
        right = np.cross([0, 0, 1.0], self._eye)
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(self._eye, right)])
        ends = np.vstack([course.p_WC.reshape(-1, 3), np.zeros((1, 3)), *map(self._object, course.states.X_WO[::50])])
        seen = ends @ self._axes.T
        self._low, self._high = seen.min(axis=0), seen.max(axis=0)

    def draw(self, ax: Axes, t: float) -> None:
        """Draws the state at a time, s."""
        states = self._plan.at(t)
        self._draw_object(ax, states.X_WO[0])
        for finger in self._hand.fingers:
            kinematics = FingerKinematics.of(self._hand, finger)
            joints, _ = kinematics.frames(states.q[:, finger.columns])
            tip, _ = kinematics.fk(states.q[:, finger.columns])
            chain = np.vstack([np.zeros((1, 3)), joints.reshape(-1, 3), tip]) @ self._axes.T
            ax.plot(*chain.T, color="0.45", lw=1.4, solid_capstyle="round", zorder=1)
            touches = np.isfinite(states.p_OP[0, finger.index]).all()
            color = finger_color(finger.index)
            face = color if touches else "white"
            ax.add_patch(Circle(chain[-1], finger.radius, fc=face, ec=color, lw=0.9, zorder=3))
        margin = 0.08 * (self._high - self._low).max()
        ax.set_xlim(self._low[0] - margin, self._high[0] + margin)
        ax.set_ylim(self._low[1] - margin, self._high[1] + margin)
        ax.set_aspect("equal")
        ax.set_axis_off()

    def _draw_object(self, ax: Axes, X_WO: np.ndarray) -> None:
        """Draws the faces that look this way, nearest last."""
        triangles = np.vstack([m.triangles for m in self._meshes]) @ X_WO[:3, :3].T + X_WO[:3, 3]
        nhat_O = np.vstack([m.face_normals for m in self._meshes])
        facing = nhat_O @ X_WO[:3, :3].T @ self._eye
        order = np.argsort(triangles.mean(axis=1) @ self._eye)
        seen = order[facing[order] > 1e-6]
        tones = _OBJECT_TONES[(nhat_O[seen].sum(axis=1) < 0).astype(int)]
        colors = tones * (0.72 + 0.28 * facing[seen, None])
        ax.add_collection(PolyCollection(triangles[seen] @ self._axes.T, fc=colors, ec=colors, lw=0.3, zorder=2))

    def _object(self, X_WO: np.ndarray) -> np.ndarray:
        return np.vstack([m.vertices for m in self._meshes]) @ X_WO[:3, :3].T + X_WO[:3, 3]


def write_gif(
    plan: Plan, course: Course, file: Path, *, progress: Callable[[Progress], None], seconds: float = 8.0
) -> None:
    """Writes a moving picture of a whole plan, which lasts `seconds`; whole or not at all.

    Args:
        plan: what to show.
        course: the plan at any times.
        file: the picture.
        progress: called after every frame.
        seconds: how long it takes to watch.
    """
    require_folder(file)
    sketch, images = Sketch(plan, course), []
    times = np.linspace(0, plan.duration, round(_FRAME_RATE * seconds))
    with in_print():
        figure = column(70)
        figure.set_layout_engine("none")  # it would measure every frame
        figure.set_dpi(_DPI)
        ax = figure.add_axes((0.02, 0.02, 0.96, 0.88))
        canvas = FigureCanvasAgg(figure)
        for i, t in enumerate(times, start=1):
            ax.clear()
            sketch.draw(ax, t)
            mode = plan.parts[int(plan.at(t).part[0])].mode
            ax.set_title(f"{t:.1f} s   {mode}", loc="left", family="monospace")
            canvas.draw()
            images.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3].copy()).quantize(64))
            progress(Progress(stage="moving picture", fraction=i / len(times)))
    out = BytesIO()
    images[0].save(out, "gif", save_all=True, append_images=images[1:], duration=1000 / _FRAME_RATE, loop=0)
    write_atomic(file, out.getvalue())
