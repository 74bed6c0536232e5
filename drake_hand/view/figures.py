"""Figures of a plan over time: modes, joints and speeds in their limits, object, contacts, forces, margin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan
from drake_hand.plans.tolerances import TOLERANCES
from drake_hand.view import paper_figures
from drake_hand.view.colors import SUBMODEL_COLORS, SUBMODEL_NAMES, finger_color
from drake_hand.view.course import Course
from drake_hand.view.style import FIGURE_FORMATS, column, in_print, legend_below, mark_switches, panels, save, touching

FIGURE_SAMPLES = 2000
_STYLES = ("-", "--", ":", "-.")


def drawings(plan: Plan, hand: Hand) -> dict[str, Callable[[], Figure]]:
    """What there is to draw of a plan, by name; those of the paper bear its number."""
    course = Course.of(plan, hand, np.linspace(0.0, plan.duration, FIGURE_SAMPLES))
    found: dict[str, Callable[[], Figure]] = {
        "fig11_automaton": lambda: paper_figures.draw_automaton(plan),
        "fig12_coordination": lambda: paper_figures.draw_coordination(plan, course),
        "fig13_states": lambda: paper_figures.draw_states(plan),
        "fig14_frames": lambda: paper_figures.draw_frames(plan, course),
        "fig15_path": lambda: paper_figures.draw_path(plan, course),
        "fig16_velocity": lambda: paper_figures.draw_velocity(plan, course),
        "modes": lambda: draw_modes(plan),
        "joints": lambda: draw_joints(plan, course),
        "speeds": lambda: draw_speeds(plan, course),
        "object": lambda: draw_object(plan, course),
        "contacts": lambda: draw_contacts(plan, course),
        "contact_map": lambda: paper_figures.draw_contact_map(plan, course),
    }
    if np.any(course.states.f_W):
        found["forces"] = lambda: draw_forces(plan, course)
        found["margin"] = lambda: draw_margin(plan, course)
    return found


def draw_plan(plan: Plan, hand: Hand, folder: Path, *, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draws all figures of a plan.

    Args:
        plan: the plan.
        hand: its hand, for limits and fingertips.
        folder: where to; made if missing.
        formats: of ``svg``, ``pdf`` and ``png``.

    Returns:
        The files written.

    Raises:
        InputError: an unknown format.
    """
    for suffix in formats:
        if suffix not in FIGURE_FORMATS:
            raise InputError("unknown format", key="formats", found=suffix, expected=", ".join(FIGURE_FORMATS))
    files = []
    for name, draw in drawings(plan, hand).items():
        files += save(draw(), folder, name, formats)
    return files


@in_print()
def draw_modes(plan: Plan) -> Figure:
    """Which finger is free, rolling or sliding when."""
    figure = column(14 + 5 * len(plan.fingers))
    ax = figure.subplots()
    for part in plan.parts:
        for row, code in enumerate(part.mode):
            ax.barh(row, part.t[-1] - part.t[0], left=part.t[0], height=0.72, color=SUBMODEL_COLORS[code], linewidth=0)
    ax.set_yticks(range(len(plan.fingers)), plan.fingers)
    ax.set_xlim(0, plan.duration)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    ax.set_xlabel("time [s]")
    shown = sorted({c for p in plan.parts for c in p.mode})
    figure.legend(
        handles=[Patch(color=SUBMODEL_COLORS[c], label=SUBMODEL_NAMES[c]) for c in shown],
        loc="outside lower center",
        ncols=3,
    )
    return figure


@in_print()
def draw_joints(plan: Plan, course: Course) -> Figure:
    """Where each joint is in its range, a panel per finger: 0 the lower limit, 100 the upper."""
    hand = course.hand
    figure, axes = _finger_panels(plan)
    for finger, ax in zip(hand.fingers, axes, strict=True):
        for k, i in enumerate(finger.columns):
            span = hand.q_upper[i] - hand.q_lower[i]
            share = 100 * (course.states.q[:, i] - hand.q_lower[i]) / span
            name = hand.joints[i].removeprefix(f"{finger.name}_")
            ax.plot(course.states.t, share, _STYLES[k % 4], color=f"C{k}", label=name)
        ax.axhspan(0, 100, color="0.965", zorder=-1)
        ax.set_ylim(-8, 108)
        ax.set_yticks([0, 50, 100])
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.1), handlelength=1.6)
    figure.supylabel("place in the joint's range [%]", fontsize=7)
    return figure


@in_print()
def draw_speeds(plan: Plan, course: Course) -> Figure:
    """Greatest joint speed and acceleration of each finger as a share of their limits."""
    hand, s = course.hand, course.states
    figure, axes = _finger_panels(plan)
    for finger, ax in zip(hand.fingers, axes, strict=True):
        columns = finger.columns
        ratio = np.max(np.abs(s.a[:, columns]) / hand.acceleration[columns], axis=1)
        ax.plot(s.t, 100 * ratio, label="acceleration", lw=0.5, color="#e69f00")
        speed = np.max(np.abs(s.v[:, columns]) / hand.speed[columns], axis=1)
        ax.plot(s.t, 100 * speed, label="speed", color="#0072b2")
        ax.axhline(100, color="0.3", ls="--", lw=0.6)
        ax.set_ylim(0, 112)
    figure.supylabel("share of the limit [%]", fontsize=7)
    legend_below(figure, axes[-1])
    return figure


@in_print()
def draw_object(plan: Plan, course: Course) -> Figure:
    """Turn of the object about the axis it turns about, with the angle asked for, and its displacement."""
    s = course.states
    (angle, axis), asked = course.turn, course.asked_deg
    turns = bool(asked or angle.any())
    figure, axes = panels(62 if turns else 38, 2 if turns else 1)
    shift = axes[-1]
    if turns:
        turn = axes[0]
        turn.plot(s.t, angle, color="#0072b2")
        turn.set_title(f"turn about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}) of W", loc="left")
        turn.set_ylabel("[deg]")
    if asked:
        turn.axhline(asked, color="0.3", ls="--", lw=0.6)
        turn.annotate(f"asked: {asked:g} deg", (0.01 * plan.duration, asked), va="bottom", fontsize=6.5)
        turn.margins(y=0.12)
    position = 1e3 * (s.X_WO[:, :3, 3] - s.X_WO[0, :3, 3])
    for i, (name, style) in enumerate(zip("xyz", _STYLES, strict=False)):
        shift.plot(s.t, position[:, i], style, color=f"C{i}", label=f"{name} of W")
    shift.set_title("displacement", loc="left")
    shift.set_ylabel("[mm]")
    low, high = shift.get_ylim()
    shift.set_ylim(min(low, -1.0), max(high, 1.0))
    for ax in axes:
        mark_switches(ax, plan)
    legend_below(figure, shift)
    return figure


@in_print()
def draw_contacts(plan: Plan, course: Course) -> Figure:
    """Distance between fingertip and contact point, with what the certificate allows."""
    figure, (ax,) = panels(48, 1)
    for i in touching(plan):
        gap = np.maximum(1e3 * np.abs(course.gap[:, i]), 1e-6)
        ax.semilogy(course.states.t, gap, _STYLES[i % 4], color=finger_color(i), label=plan.fingers[i])
    allowed = TOLERANCES["contact_mm"]
    ax.axhline(allowed, color="0.3", ls="--", lw=0.6)
    ax.annotate(f"allowed: {allowed:g} mm", (0.01 * plan.duration, allowed), va="bottom", fontsize=6.5)
    ax.set_ylim(top=10 * allowed)
    ax.set_ylabel("contact gap [mm]")
    mark_switches(ax, plan)
    legend_below(figure, ax)
    return figure


@in_print()
def draw_forces(plan: Plan, course: Course) -> Figure:
    """Planned contact force of each finger, the share of its friction cone left, and its joints' torque."""
    s = course.states
    figure, axes = panels(85, 3)
    rows = (
        ("force [N]", np.linalg.norm(s.f_W, axis=2)),
        ("friction left [%]", 100 * course.margin),
        ("torque, of effort [%]", 100 * course.effort),
    )
    for ax, (label, values) in zip(axes, rows, strict=True):
        for i in touching(plan):
            ax.plot(s.t, values[:, i], color=finger_color(i), label=plan.fingers[i])
        ax.set_ylabel(label)
        ax.set_ylim(bottom=0)
        mark_switches(ax, plan)
    legend_below(figure, axes[0])
    return figure


@in_print()
def draw_margin(plan: Plan, course: Course) -> Figure:
    """The least share of any friction cone left, over time, its worst instant marked."""
    figure, (ax,) = panels(42, 1)
    least, t = 100 * course.least_margin, course.states.t
    ax.plot(t, least, color="#0072b2")
    worst = int(np.nanargmin(least))
    finger = plan.fingers[int(np.nanargmin(course.margin[worst]))]
    ax.plot(t[worst], least[worst], "o", color="#d55e00", ms=4)
    right = t[worst] > 0.6 * plan.duration
    ax.annotate(
        f"worst: {least[worst]:.0f} %, {finger}, {t[worst]:.2f} s",
        (t[worst], least[worst]),
        xytext=(-4 if right else 4, -9),
        textcoords="offset points",
        ha="right" if right else "left",
        fontsize=6.5,
    )
    ax.set_ylim(0, 100)
    ax.set_ylabel("friction cone left [%]")
    mark_switches(ax, plan)
    return figure


def _finger_panels(plan: Plan) -> tuple[Figure, list[Axes]]:
    """One panel per finger, thumb (last) on top, in the order of the hand."""
    figure, axes = panels(16 + 17 * len(plan.fingers), len(plan.fingers))
    axes = axes[::-1]
    for name, ax in zip(plan.fingers, axes, strict=True):
        ax.set_title(name, loc="left")
        mark_switches(ax, plan)
    return figure, axes
