"""Figures of a plan: mode timeline, joints and their speeds against limits, object motion, contacts, forces."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.hand import Hand
from drake_hand.modes.code import Mode
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import States, Trajectory
from drake_hand.view.colors import SUBMODEL, finger_color

SAMPLES = 2000
GAP_MM = 0.1
"""Contact gap the certificate allows."""


def draw_plan(plan: Plan, hand: Hand, folder: Path) -> list[Path]:
    """Draws all figures of a plan as PNG files.

    Args:
        plan: the plan.
        hand: its hand, for limits and fingertips.
        folder: where to; made if missing.

    Returns:
        The files written.
    """
    states = Trajectory(plan).at(np.linspace(0.0, plan.duration, SAMPLES))
    drawings: dict[str, Callable[[], Figure]] = {
        "modes": lambda: draw_modes(plan),
        "joints": lambda: draw_joints(plan, hand, states),
        "speeds": lambda: draw_speeds(plan, hand, states),
        "object": lambda: draw_object(plan, states),
        "contacts": lambda: draw_contacts(plan, hand, states),
    }
    if np.any(states.f_W):
        drawings["forces"] = lambda: draw_forces(plan, states)
    folder.mkdir(exist_ok=True)
    files = []
    for name, draw in drawings.items():
        figure = draw()
        files.append(folder / f"{name}.png")
        figure.savefig(files[-1], dpi=130)
    return files


def draw_modes(plan: Plan) -> Figure:
    """Which finger is free, rolling or sliding when (as the paper's Fig. 12)."""
    n = len(plan.fingers)
    figure = Figure(figsize=(10, 1.2 + 0.35 * n), layout="constrained")
    ax = figure.subplots()
    mode_timeline(ax, plan)
    ax.set_xlabel("time [s]")
    merged = [p for i, p in enumerate(plan.parts) if i == 0 or p.mode != plan.parts[i - 1].mode]
    if len(merged) <= 24:
        for part in merged:
            ax.annotate(
                part.mode,
                (part.t[0], n - 0.4),
                rotation=45,
                fontsize=7,
                family="monospace",
                annotation_clip=False,
            )
        ax.set_title(" ", fontsize=22)
    shown = sorted({s for p in plan.parts for s in Mode.parse(p.mode, plan.fingers).submodels})
    figure.legend(
        handles=[Patch(color=SUBMODEL[s], label=s.word) for s in shown],
        loc="outside lower center",
        ncols=3,
        frameon=False,
    )
    return figure


def mode_timeline(ax: Axes, plan: Plan) -> None:
    """Draws the bars of the mode timeline into given axes, little finger at the bottom."""
    for part in plan.parts:
        for row, submodel in enumerate(Mode.parse(part.mode, plan.fingers).submodels):
            ax.barh(row, part.t[-1] - part.t[0], left=part.t[0], height=0.72, color=SUBMODEL[submodel], linewidth=0)
    ax.set_yticks(range(len(plan.fingers)), plan.fingers)
    ax.set_xlim(0, plan.duration)
    ax.tick_params(length=0)
    ax.spines[["top", "right", "left"]].set_visible(False)


def draw_joints(plan: Plan, hand: Hand, states: States) -> Figure:
    """Joint positions, a panel per finger, limits dashed."""
    figure, axes = _panels(plan, "position [deg]")
    for finger, ax in zip(hand.fingers, axes, strict=True):
        for k, column in enumerate(finger.columns):
            (line,) = ax.plot(states.t, np.degrees(states.q[:, column]), label=hand.joints[column])
            for limit in (hand.q_lower[column], hand.q_upper[column]):
                ax.axhline(np.degrees(limit), color=line.get_color(), ls=(k, (3, 3)), lw=0.7, alpha=0.6)
        _legend(ax)
    return figure


def draw_speeds(plan: Plan, hand: Hand, states: States) -> Figure:
    """Joint speeds and accelerations as a share of their limits; 1 is the limit."""
    figure, axes = _panels(plan, "share of limit")
    for finger, ax in zip(hand.fingers, axes, strict=True):
        columns = finger.columns
        ax.plot(states.t, np.max(np.abs(states.v[:, columns]) / hand.speed[columns], axis=1), label="speed")
        ratio = np.max(np.abs(states.a[:, columns]) / hand.acceleration[columns], axis=1)
        ax.plot(states.t, ratio, label="acceleration", lw=0.8)
        ax.axhline(1.0, color="0.3", ls="--", lw=0.8)
        ax.set_ylim(0, None)
    _legend(axes[-1])
    return figure


def draw_object(plan: Plan, states: States) -> Figure:
    """Object: rotation since the start (winding counted) about each axis of W, and displacement."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    turn, shift = figure.subplots(2, 1, sharex=True)
    steps = np.diff(states.t, prepend=states.t[0])[:, None]
    rotation = np.degrees(np.cumsum(states.V_WO[:, :3] * steps, axis=0))
    position = 1e3 * (states.X_WO[:, :3, 3] - states.X_WO[0, :3, 3])
    for ax, values, unit in ((turn, rotation, "rotation [deg]"), (shift, position, "displacement [mm]")):
        for i, axis in enumerate("xyz"):
            ax.plot(states.t, values[:, i], label=f"{axis} of W")
        ax.set_ylabel(unit)
        low, high = ax.get_ylim()
        ax.set_ylim(min(low, -1.0), max(high, 1.0))
        _switches(ax, plan)
    _legend(turn)
    shift.set_xlabel("time [s]")
    return figure


def draw_contacts(plan: Plan, hand: Hand, states: States) -> Figure:
    """Distance between fingertip and contact point: zero is touching, the band is what the certificate allows."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    ax = figure.subplots()
    p_WP = np.einsum("kij,kfj->kfi", states.X_WO[:, :3, :3], states.p_OP) + states.X_WO[:, None, :3, 3]
    for finger in hand.fingers:
        p_WC, _ = FingerKinematics.of(hand, finger).fk(states.q[:, finger.columns])
        gap = np.linalg.norm(p_WP[:, finger.index] - p_WC, axis=1) - finger.radius
        ax.plot(states.t, 1e3 * gap, color=finger_color(finger.index), label=finger.name)
    low, high = ax.get_ylim()
    ax.set_ylim(min(low, -0.15), max(high, 0.15))
    ax.axhspan(-GAP_MM, GAP_MM, color="0.94", zorder=0)
    ax.set_ylabel("contact gap [mm]")
    ax.set_xlabel("time [s]")
    _legend(ax)
    _switches(ax, plan)
    return figure


def draw_forces(plan: Plan, states: States) -> Figure:
    """Planned contact force of each finger."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    ax = figure.subplots()
    for i, name in enumerate(plan.fingers):
        ax.plot(states.t, np.linalg.norm(states.f_W[:, i], axis=1), color=finger_color(i), label=name)
    ax.set_ylabel("contact force [N]")
    ax.set_xlabel("time [s]")
    _legend(ax)
    _switches(ax, plan)
    return figure


def _panels(plan: Plan, label: str) -> tuple[Figure, list[Axes]]:
    """One panel per finger over a common time axis, thumb (last) on top."""
    n = len(plan.fingers)
    figure = Figure(figsize=(10, 1.0 + 1.5 * n), layout="constrained")
    panels = list(figure.subplots(n, 1, sharex=True, squeeze=False)[::-1, 0])
    for name, ax in zip(plan.fingers, panels, strict=True):
        ax.set_title(name, loc="left", fontsize=9)
        _switches(ax, plan)
    panels[0].set_xlabel("time [s]")
    figure.supylabel(label, fontsize=10)
    return figure, panels


def _legend(ax: Axes) -> None:
    ax.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def _switches(ax: Axes, plan: Plan) -> None:
    """Thin lines where the mode changes."""
    for part in plan.parts[1:]:
        if part.events:
            ax.axvline(part.t[0], color="0.85", lw=0.7, zorder=0)
    ax.set_xlim(0, plan.duration)
    ax.spines[["top", "right"]].set_visible(False)
