"""A hand as a picture to check it by: palm direction, order of the fingers, tip spheres, how far each joint goes."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.fingertip import body_shapes
from drake_hand.model.hand import Finger, Hand
from drake_hand.view.colors import finger_color, rgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SWEEP_POINTS = 25
"""Points along the path of a fingertip as one joint moves from limit to limit."""
_PALM_COLOR = (0.80, 0.82, 0.85)
_WHITE_SHARE = 0.55
"""How much of white there is in the colour of a finger's links."""
_INK, _SOFT = "#1d2430", "#5d6674"
_SCALE_BAR_M = 0.05
"""m; the scale bar."""


def draw_hand(hand: Hand) -> bytes:
    """A PNG: the hand at home, seen from before its palm and from its side, and the ranges of its joints.

    Raises:
        InputError: a shape cannot be read.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, (front, side, ranges) = plt.subplots(1, 3, figsize=(16, 7.2), width_ratios=(1, 1, 0.62))
    closing, triangles, colors = hand.closing, *shapes_at_home(hand)
    across = closing.side
    _draw_view(front, hand, triangles, colors, closing.palm + 0.45 * across + 0.25 * closing.fingers, names=True)
    _draw_view(side, hand, triangles, colors, across + 0.3 * closing.palm, names=False)
    front.set_title("towards the palm", color=_SOFT)
    side.set_title("from the side", color=_SOFT)
    _draw_ranges(ranges, hand)
    figure.suptitle(f"{hand.name}, at home", fontsize=15, color=_INK)
    figure.text(
        *(0.36, 0.02),
        "balls: the fingertips as spheres, numbered as in mode codes; lines: the path of a fingertip as one joint goes "
        "from limit to limit",
        ha="center",
        color=_SOFT,
    )
    figure.subplots_adjust(left=0.01, right=0.87, top=0.88, bottom=0.08, wspace=0.02)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    plt.close(figure)
    return out.getvalue()


def sweeps(hand: Hand, finger: Finger) -> list[np.ndarray]:
    """By joint: (k, 3) the path of the tip centre in W as that joint moves from limit to limit, the others at home."""
    kin, home = FingerKinematics.of(hand, finger), hand.q_home[finger.columns]
    ways = []
    for j, column in enumerate(finger.columns):
        q = np.repeat(home[None], _SWEEP_POINTS, axis=0)
        q[:, j] = np.linspace(hand.q_lower[column], hand.q_upper[column], _SWEEP_POINTS)
        ways.append(kin.fk(q)[0])
    return ways


def shapes_at_home(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """All collision shapes as triangles: (M, 3, 3) corners in W, and a colour (M, 3) of each."""
    moved = {a.joint: a.multiplier * hand.q_home[f.columns[a.source]] + a.offset for f in hand.fingers for a in f.axes}
    finger_of = {link: f for f in hand.fingers for link in f.links}
    triangles, colors = [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    for body in hand.urdf.bodies(hand.held):
        link = hand.palm if hand.palm in body else body[0]
        chain = hand.urdf.chain(hand.palm, link)
        if chain is None:
            continue
        X_WL = np.eye(4)
        for joint in chain:
            X_JJ, x = np.eye(4), moved.get(joint.name, 0.0)
            if joint.prismatic:
                X_JJ[:3, 3] = joint.axis * x
            else:
                X_JJ[:3, :3] = Rotation.from_rotvec(joint.axis * x).as_matrix()
            X_WL = X_WL @ joint.X_PC @ X_JJ
        finger = finger_of.get(link)
        color = (
            _PALM_COLOR
            if finger is None
            else (1 - _WHITE_SHARE) * np.array(rgb(finger_color(finger.index))) + _WHITE_SHARE
        )
        for _, _, g in body_shapes(hand.urdf, link, hand.held):
            some = np.asarray(g.to_trimesh().apply_transform(X_WL).triangles)
            triangles.append(some)
            colors.append(np.tile(color, (len(some), 1)))
    return np.concatenate(triangles), np.concatenate(colors)


def _draw_view(
    ax: Axes, hand: Hand, triangles: np.ndarray, colors: np.ndarray, towards: np.ndarray, *, names: bool
) -> None:
    """The hand as someone sees it who is in a direction (3,) of W; far faces first, what is inside on top of them."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patheffects import withStroke

    flat = _view(hand, towards)
    depth = towards / np.linalg.norm(towards)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    order = np.argsort(triangles.mean(axis=1) @ depth)
    order = order[normal[order] @ depth > 0]
    shade = 0.62 + 0.38 * np.clip(normal[order] @ depth, 0, 1)[:, None]
    lit = colors[order] * shade
    ax.add_collection(PolyCollection(triangles[order] @ flat, facecolors=lit, edgecolors=lit, linewidths=0.3))
    glow = [withStroke(linewidth=3, foreground="white")]
    points = [(triangles @ flat).reshape(-1, 2)]
    for finger in sorted(hand.fingers, key=lambda f: _home(hand, f)[-1] @ depth):
        color, bones = finger_color(finger.index), _home(hand, finger)
        for way in sweeps(hand, finger):
            ax.plot(*(way @ flat).T, color=color, linewidth=1.0, solid_capstyle="round")
            ax.plot(*(way[[0, -1]] @ flat).T, color=color, linestyle="", marker="o", markersize=2.5)
            points.append(way @ flat)
        ax.plot(*(bones @ flat).T, color=color, linewidth=2.2, marker="o", markersize=4, markeredgecolor="white")
        tip = bones[-1] @ flat
        ax.add_patch(_ball(tip, finger.radius, color))
        ax.annotate(str(finger.index + 1), tip, color="white", weight="bold", ha="center", va="center", fontsize=9)
        if names:
            ax.annotate(
                *(finger.name, (tip[0] + 1.3 * finger.radius, tip[1] + finger.radius)),
                color=color,
                weight="bold",
                path_effects=glow,
                zorder=5,
            )
    everything = np.concatenate(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    start = np.mean([_home(hand, f)[0] for f in hand.fingers], axis=0)
    for name, way, color in _arrows(hand, 0.4 * float((high - low).max())):
        begin = np.zeros(2) if len(name) == 1 else start @ flat
        end = begin + way @ flat
        (x, y), (u, v) = end.tolist(), begin.tolist()
        ax.annotate("", (x, y), (u, v), arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 2})
        x, y = (end + 0.015 * (end - begin) / max(np.linalg.norm(end - begin), 1e-9)).tolist()
        ax.text(x, y, name, color=color, weight="bold", path_effects=glow, ha="center", va="center", zorder=5)
    ax.plot([low[0], low[0] + _SCALE_BAR_M], [low[1] - 0.02] * 2, color=_INK, linewidth=3, solid_capstyle="butt")
    ax.annotate(f"{_SCALE_BAR_M * 1e3:.0f} mm", (low[0], low[1] - 0.018), color=_INK, va="bottom")
    ax.set_aspect("equal")
    ax.margins(0.04)
    ax.axis("off")


def _draw_ranges(ax: Axes, hand: Hand) -> None:
    """A bar per joint from limit to limit, home as a dot."""
    rows, home = [hand.nq - i for i in range(hand.nq)], np.degrees(hand.q_home)
    for finger in hand.fingers:
        for column in finger.columns:
            low, high = np.degrees([hand.q_lower[column], hand.q_upper[column]])
            y = rows[column]
            ax.plot([low, high], [y, y], color=finger_color(finger.index), linewidth=5, solid_capstyle="butt")
            ax.plot(home[column], y, color="white", marker="o", markersize=5, markeredgecolor=_INK)
    ax.set_yticks(rows, hand.joints, fontsize=8 if hand.nq < 22 else 6)
    ax.yaxis.tick_right()
    ax.axvline(0, color=_SOFT, linewidth=0.6, zorder=0)
    ax.tick_params(length=0, colors=_SOFT)
    ax.spines[:].set_visible(False)
    ax.set_ylim(0, hand.nq + 1)
    sliding = any(hand.urdf.joints[j].prismatic for j in hand.joints)
    ax.set_title("limits, deg" + (" (of sliding joints degrees stand for rad as m)" if sliding else ""), color=_SOFT)


def _view(hand: Hand, towards: np.ndarray) -> np.ndarray:
    """(3, 2) right and up of a picture, in W: fingers upright, or downwards where they point down in W."""
    depth, along = towards / np.linalg.norm(towards), hand.closing.fingers
    up = along * np.sign(along[np.abs(along).argmax()])
    if np.linalg.norm(np.cross(up, depth)) < 0.6:  # they point at the viewer, as those of a tripod do
        up = hand.closing.side
    up = up - depth * (up @ depth)
    up /= np.linalg.norm(up)
    return np.column_stack([np.cross(up, depth), up])


def _arrows(hand: Hand, size: float) -> list[tuple[str, np.ndarray, str]]:
    """Name, vector in W and colour: the axes of W, and where the palm faces."""
    axes = [("x", "#c0392b"), ("y", "#1e8449"), ("z", "#2471a3")]
    frame = [(name, 0.35 * size * e, color) for (name, color), e in zip(axes, np.eye(3), strict=True)]
    return [*frame, ("palm faces", size * hand.closing.palm, _INK)]


def _home(hand: Hand, finger: Finger) -> np.ndarray:
    """(k, 3) the joints of a finger and its tip centre, in W, at home."""
    kin, home = FingerKinematics.of(hand, finger), hand.q_home[finger.columns][None]
    return np.concatenate([kin.frames(home)[0][:, 0], kin.fk(home)[0]])


def _ball(centre: np.ndarray, radius: float, color: str):
    from matplotlib.patches import Circle

    return Circle((float(centre[0]), float(centre[1])), radius, facecolor=color, edgecolor="white", zorder=3)
