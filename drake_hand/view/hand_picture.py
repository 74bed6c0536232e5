"""A hand as a picture to check it by: palm direction, order of the fingers, tip spheres, how far each joint goes."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.fingertip import body_shapes
from drake_hand.model.hand import Finger, Hand
from drake_hand.view.colors import finger_color

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

_SWEEP = 25
"""Points along the way of a fingertip when one joint goes from limit to limit."""
_FACES = 250
"""Most triangles drawn of a shape."""


def draw_hand(hand: Hand) -> bytes:
    """A PNG: the hand at home, seen from before its palm and from its side.

    Raises:
        InputError: a shape cannot be read.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    closing = hand.closing
    figure = plt.figure(figsize=(14, 7.5))
    views = (closing.palm + 0.35 * closing.side, closing.side + 0.25 * closing.palm)
    for k, towards in enumerate(views, start=1):
        ax = figure.add_subplot(1, 2, k, projection="3d", proj_type="ortho")
        points = [_draw_finger(ax, hand, f) for f in hand.fingers]
        for _, _, g in body_shapes(hand.urdf, hand.palm, hand.held):
            mesh = g.to_trimesh()
            _triangles(ax, np.asarray(mesh.triangles), "0.75", 0.25)
            points.append(np.asarray(mesh.vertices))
        everything = np.concatenate(points)
        low, high = everything.min(axis=0), everything.max(axis=0)
        middle, half = (low + high) / 2, float((high - low).max()) / 2
        ax.quiver(*np.zeros(3), *(closing.palm * half), color="black", linewidth=2)
        ax.text(*(closing.palm * half * 1.1), "palm faces", color="black")
        ax.set(xlim=middle[0] + half * np.array([-1, 1]), ylim=middle[1] + half * np.array([-1, 1]))
        ax.set(zlim=middle[2] + half * np.array([-1, 1]), xlabel="x m", ylabel="y m", zlabel="z m")
        ax.set_box_aspect((1, 1, 1), zoom=1.5)
        ax.locator_params(nbins=4)
        ax.view_init(
            elev=np.degrees(np.arcsin(towards[2] / np.linalg.norm(towards))),
            azim=np.degrees(np.arctan2(towards[1], towards[0])),
        )
    figure.suptitle(
        f"{hand.name}: at home; thin lines are the ways of a fingertip as one joint goes from limit to limit"
    )
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    plt.close(figure)
    return out.getvalue()


def _draw_finger(ax: Axes3D, hand: Hand, finger: Finger) -> np.ndarray:
    """Draws a finger at home; returns points (N, 3) of it."""
    color, kin = finger_color(finger.index), FingerKinematics.of(hand, finger)
    home = hand.q_home[finger.columns]
    p_J, _ = kin.frames(home[None])
    p_WC, R_WT = kin.fk(home[None])
    bones = np.concatenate([p_J[:, 0], p_WC])
    ax.plot(*bones.T, color=color, linewidth=3, marker="o", markersize=3)
    last = np.eye(4)
    last[:3, :3], last[:3, 3] = R_WT[0], p_WC[0] - R_WT[0] @ finger.p_LC
    for _, _, g in body_shapes(hand.urdf, finger.tip_link, hand.held):
        _triangles(ax, np.asarray(g.to_trimesh().apply_transform(last).triangles), color, 0.12)
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 18), np.linspace(0, np.pi, 10))
    ball = finger.radius * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    ax.plot_surface(*(ball + p_WC[0][:, None, None]), color=color, alpha=0.55, linewidth=0)
    ax.text(*(p_WC[0] + 1.6 * finger.radius * hand.closing.fingers), f"{finger.index + 1} {finger.name}", color=color)
    for j in range(len(home)):
        q = np.repeat(home[None], _SWEEP, axis=0)
        q[:, j] = np.linspace(hand.q_lower[finger.columns[j]], hand.q_upper[finger.columns[j]], _SWEEP)
        ax.plot(*kin.fk(q)[0].T, color=color, linewidth=0.8)
    return bones


def _triangles(ax: Axes3D, triangles: np.ndarray, color: str, alpha: float) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    some = triangles[:: max(1, len(triangles) // _FACES)]
    ax.add_collection3d(Poly3DCollection(some, facecolor=color, edgecolor="none", alpha=alpha))
