"""`Sketch`: hand and object as lines, seen from where the page sees them; for figures and moving pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon
from scipy.spatial import ConvexHull

from drake_hand.contact.chain import FingerKinematics
from drake_hand.files import require_folder
from drake_hand.model.object import Object
from drake_hand.plans.plan import Plan
from drake_hand.view.colors import finger_color
from drake_hand.view.course import Course
from drake_hand.view.style import column, in_print

_EYE = np.array([0.75, 0.75, 0.25])
"""From where one looks, in W: out of the palm and from the thumb's side."""


class Sketch:
    """Draws a plan at any time, without shading."""

    def __init__(self, plan: Plan, course: Course) -> None:
        self._plan, self._hand = plan, course.hand
        self._outlines = [np.asarray(g.to_trimesh().vertices) for g in Object.load(plan.task.object).geometries]
        eye = _EYE / np.linalg.norm(_EYE)
        right = np.cross([0, 0, 1.0], eye)
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(eye, right)])
        ends = np.vstack([course.p_WC.reshape(-1, 3), np.zeros((1, 3)), self._object(course.states.X_WO[0])])
        seen = ends @ self._axes.T
        self._low, self._high = seen.min(axis=0), seen.max(axis=0)

    def draw(self, ax: Axes, t: float) -> None:
        """Draws the state at a time, s."""
        states = self._plan.at(t)
        for outline in self._outlines:
            flat = (outline @ states.X_WO[0, :3, :3].T + states.X_WO[0, :3, 3]) @ self._axes.T
            ax.add_patch(Polygon(flat[ConvexHull(flat).vertices], fc="#f3dfa0", ec="#8a6d1d", lw=0.6, zorder=2))
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

    def _object(self, X_WO: np.ndarray) -> np.ndarray:
        return np.vstack(self._outlines) @ X_WO[:3, :3].T + X_WO[:3, 3]


def write_gif(plan: Plan, course: Course, file: Path, *, seconds: float = 8.0, frames: int = 64) -> None:
    """Writes a moving picture of a whole plan, which lasts `seconds`."""
    from matplotlib.animation import FuncAnimation, PillowWriter

    require_folder(file)
    with in_print():
        figure = column(70)
        ax = figure.subplots()
        sketch = Sketch(plan, course)

        def draw(t: float) -> list:
            ax.clear()
            sketch.draw(ax, t)
            mode = plan.parts[int(plan.at(t).part[0])].mode
            ax.set_title(f"{t:.1f} s   {mode}", loc="left", family="monospace")
            return []

        times = np.linspace(0, plan.duration, frames)
        FuncAnimation(figure, draw, frames=times, blit=False).save(
            file, PillowWriter(fps=round(frames / seconds)), dpi=150
        )
