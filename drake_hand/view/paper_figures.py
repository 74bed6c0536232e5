"""The figures of Caurin & Pedro (2009), from a plan of our own, and the contact map."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from drake_hand.modes.code import Mode
from drake_hand.modes.graph import layout
from drake_hand.plans.plan import Plan
from drake_hand.view.colors import finger_color
from drake_hand.view.course import Course
from drake_hand.view.sketch import Sketch
from drake_hand.view.style import bent_arrow, column, in_print, legend_below, mark_switches, panels, touching

_VISITED_COLOR = "#d55e00"
PAPER_FRAMES = 4


@in_print()
def draw_automaton(plan: Plan) -> Figure:
    """All modes, a ring per number of fingers in contact, and the path of the plan through them (Fig. 11)."""
    figure = column(85)
    ax = figure.subplots()
    ax.set_aspect("equal")
    ax.set_axis_off()
    places, radii = layout(len(plan.fingers))
    points = np.array(list(places.values()))
    ax.plot(points[:, 0], points[:, 1], ".", ms=2.2, color="0.72")
    fingers = len(plan.fingers)
    between = np.pi / 2 + (2 * (fingers // 2) + 1) * np.pi / fingers  # two spokes, near the bottom
    for k, radius in enumerate(radii[1:], start=1):
        at = radius * np.array([np.cos(between), np.sin(between)])
        box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"}
        ax.text(at[0], at[1], str(k), ha="center", va="center", fontsize=6, color="0.35", bbox=box, zorder=2.5)
    for before, after in sorted(set(_changes(plan))):
        a, b = places[Mode.parse(before, plan.fingers)], places[Mode.parse(after, plan.fingers)]
        bent_arrow(ax, a, b, color=_VISITED_COLOR, bend=0.12, clear=3)
    for code in dict.fromkeys(plan.modes):
        x, y = places[Mode.parse(code, plan.fingers)]
        ax.plot(x, y, "o", ms=3.5, color=_VISITED_COLOR)
        left = code.count("0") % 2  # rings by turns, or labels of one spoke would cover each other
        clear = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
        ax.annotate(
            code,
            (x, y),
            xytext=(-4 if left else 4, 2),
            ha="right" if left else "left",
            textcoords="offset points",
            fontsize=6,
            family="monospace",
            bbox=clear,
            zorder=3,
        )
    ax.set_title(f"{len(places)} modes; rings: fingers in contact; in colour: the path of the plan", fontsize=6.5)
    return figure


@in_print()
def draw_coordination(plan: Plan, course: Course) -> Figure:
    """Which finger is active when, above how far the object has turned, or moved where it does not turn (Fig. 12)."""
    s = course.states
    used = touching(plan)
    figure, axes = panels(32 + 8 * len(used), len(used) + 1, height_ratios=[1.0] * len(used) + [2.2])
    active = np.array([[c != "0" for c in part.mode] for part in plan.parts], dtype=float)[s.part]
    for i, ax in zip(reversed(used), axes, strict=False):
        ax.fill_between(s.t, 0, active[:, i], step="post", color=finger_color(i), alpha=0.25, lw=0)
        ax.plot(s.t, active[:, i], drawstyle="steps-post", color=finger_color(i))
        ax.set_ylim(-0.1, 1.25)
        ax.set_yticks([0, 1], ["free", "active"])
        ax.set_title(plan.fingers[i], loc="left", pad=2)
    angle = course.turn[0]
    far = 1e3 * np.linalg.norm(s.X_WO[:, :3, 3] - s.X_WO[0, :3, 3], axis=1)
    axes[-1].plot(s.t, angle if angle.any() else far, color="0.2")
    axes[-1].set_ylabel("object\n[deg]" if angle.any() else "object\n[mm]")
    if angle.min(initial=0.0) > -1.0:  # one that turns forward does not sway below the axis
        axes[-1].set_ylim(bottom=0)
    if 180 <= np.abs(angle).max() <= 720:
        axes[-1].yaxis.set_major_locator(MultipleLocator(180))
    for ax in axes:
        mark_switches(ax, plan)
    return figure


@in_print()
def draw_states(plan: Plan) -> Figure:
    """The modes a plan goes through and the events between them (Fig. 13); A is the one without contact."""
    visited = sorted(dict.fromkeys(plan.modes), key=lambda c: (c.strip("0") != "", [-int(digit) for digit in c]))
    hub = max(visited, key=lambda c: len({b for a, b in _changes(plan) if a == c}))
    around = [c for c in visited if c != hub]
    places = {hub: np.zeros(2)}
    for i, code in enumerate(around):
        angle = np.pi / 2 + 2 * np.pi * i / len(around)
        places[code] = np.array([np.cos(angle), np.sin(angle)])
    figure = column(92)
    ax = figure.subplots()
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.set_xlim(-1.3, 1.3)
    ax.set_ylim(-1.25, 1.25)
    colors = {}
    for (before, after), events in _events(plan).items():
        fingers = {event.split()[1] for event in events}
        who = fingers.pop() if len(fingers) == 1 else "several fingers"
        colors[who] = finger_color(plan.fingers.index(who)) if who in plan.fingers else "0.35"
        bent_arrow(ax, places[before], places[after], color=colors[who], bend=0.18, clear=15)
    for i, code in enumerate(visited):
        box = {"boxstyle": "circle,pad=0.35", "facecolor": "#eaf2fb", "edgecolor": "#0072b2", "linewidth": 0.8}
        letter = chr(ord("A") + i) if i < 26 else str(i)
        x, y = places[code]
        ax.text(
            x, y, f"{letter}\n{code}", ha="center", va="center", fontsize=6.5, family="monospace", bbox=box, zorder=3
        )
    ax.set_title("an arrow's colour: the finger that takes hold or lets go", fontsize=6.5)
    handles = [Line2D([], [], color=color, label=who) for who, color in colors.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, handlelength=1.4, columnspacing=1.2)
    return figure


@in_print()
def draw_frames(plan: Plan, course: Course) -> Figure:
    """Hand and object at four instants: before the grasp, in the first grasp, in a regrasp, at the end (Fig. 14)."""
    touching = [len(p.mode) - p.mode.count("0") for p in plan.parts]
    grasped = int(np.argmax(np.array(touching) > 0))
    again = [i for i in range(grasped + 1, len(plan.parts)) if touching[i] < max(touching)]
    regrasp = plan.parts[again[len(again) // 2]] if again else plan.parts[-1]
    times = [0.0, plan.parts[grasped].t[0], (regrasp.t[0] + regrasp.t[-1]) / 2, plan.duration]
    sketch = Sketch(plan, course)
    figure = column(80)
    for ax, t, number in zip(figure.subplots(2, 2).ravel(), times, ("I", "II", "III", "IV"), strict=True):
        sketch.draw(ax, t)
        mode = plan.parts[int(plan.at(t).part[0])].mode
        ax.set_title(f"{number}   {t:.1f} s   {mode}", loc="left", pad=1)
    return figure


@in_print()
def draw_path(plan: Plan, course: Course, finger: str = "") -> Figure:
    """The spatial path of a fingertip from its first contact on, with where it lets go and takes hold (Fig. 15)."""
    i = _finger(plan, finger)
    held = np.isfinite(course.gap[:, i])
    first = max(int(np.argmax(held)) - 1, 0)  # the way there is longer than all that follows
    figure = column(72)
    ax = figure.add_subplot(projection="3d")
    p, held = 1e3 * course.p_WC[first:, i], held[first:]
    for rows, color, label in ((held, finger_color(i), "in contact"), (~held, "0.6", "free")):
        ax.plot(*np.where(rows[:, None], p, np.nan).T, color=color, lw=1.1, label=label)
    change = np.flatnonzero(np.diff(held.astype(int)))
    for sign, marker, label in ((-1, "v", "lets go"), (1, "^", "takes hold")):
        at = change[np.diff(held.astype(int))[change] == sign]
        ax.plot(*p[at].T, marker, ms=3.5, color="#d55e00" if sign < 0 else "#009e73", label=label, ls="none")
    for name, set_label in zip("xyz", (ax.set_xlabel, ax.set_ylabel, ax.set_zlabel), strict=True):
        set_label(f"{name} [mm]", labelpad=-7)
    ax.tick_params(pad=-3)
    ax.zaxis.set_tick_params(pad=1)  # its numbers grow towards the axis
    ax.zaxis.labelpad = -1
    ax.locator_params(nbins=4)
    ax.set_title(f"tip of the {plan.fingers[i]} finger")
    ax.legend(loc="upper left", bbox_to_anchor=(-0.12, 1.0))
    return figure


@in_print()
def draw_velocity(plan: Plan, course: Course, finger: str = "") -> Figure:
    """Speed of a fingertip over the longest stretch in which it pushes the object on (Fig. 16)."""
    i = _finger(plan, finger)
    s = course.states
    moving = np.linalg.norm(s.V_WO, axis=1) > 1e-6
    pushing = np.isfinite(course.gap[:, i]) & moving
    edges = np.flatnonzero(np.diff(np.r_[False, pushing, False]))
    stretches = list(zip(edges[::2], edges[1::2], strict=True))
    a, b = max(stretches, key=lambda ab: ab[1] - ab[0]) if stretches else (0, len(s.t))
    a, b = max(a - 5, 0), min(b + 5, len(s.t))
    speed = 1e3 * np.linalg.norm(np.gradient(course.p_WC[:, i], s.t, axis=0), axis=1)
    figure = column(45)
    ax = figure.subplots()
    ax.plot(s.t[a:b], speed[a:b], color=finger_color(i))
    ax.set_ylim(bottom=0)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("speed of the tip [mm/s]")
    ax.set_title(f"{plan.fingers[i]} finger pushing the object", loc="left")
    return figure


@in_print()
def draw_contact_map(plan: Plan, course: Course) -> Figure:
    """Where each finger touched the object, unrolled: along its long axis, and around it; lines where contacts roll."""
    p = course.states.p_OP
    known = p[np.isfinite(p).all(axis=2)]
    figure = column(62)
    ax = figure.subplots()
    along = int(np.argmax(np.ptp(known, axis=0))) if len(known) else 2
    u, v = (along + 1) % 3, (along + 2) % 3
    for i in touching(plan):
        angle = np.degrees(np.arctan2(p[:, i, v], p[:, i, u]))
        wrapped = np.abs(np.diff(angle, prepend=angle[:1])) > 180
        ax.plot(
            1e3 * p[:, i, along], np.where(wrapped, np.nan, angle), color=finger_color(i), lw=1.6, label=plan.fingers[i]
        )
        first = np.flatnonzero(np.isfinite(angle) & ~np.isfinite(np.r_[np.nan, angle[:-1]]))
        ax.plot(1e3 * p[first, i, along], angle[first], "o", ms=3, mfc="white", color=finger_color(i), clip_on=False)
    ax.set_ylim(-180, 180)
    ax.set_yticks(range(-180, 181, 90))
    ax.set_title("a ring is where a finger takes hold", loc="left")
    ax.set_xlabel(f"along {'xyz'[along]} of the object [mm]")
    ax.set_ylabel(f"around {'xyz'[along]} [deg]")
    legend_below(figure, ax)
    return figure


def _finger(plan: Plan, name: str) -> int:
    """The finger asked for; else the middle finger, as in the paper, or the first one that touches."""
    used = [plan.fingers[i] for i in touching(plan)]
    return plan.fingers.index(name or ("middle" if "middle" in used else (used or plan.fingers)[0]))


def _changes(plan: Plan) -> list[tuple[str, str]]:
    return [(a, b) for a, b in zip(plan.modes, plan.modes[1:], strict=False) if a != b]


def _events(plan: Plan) -> dict[tuple[str, str], list[str]]:
    """Events by the modes before and after them."""
    pairs = zip(plan.parts, plan.parts[1:], strict=False)
    return {(a.mode, b.mode): b.events for a, b in pairs if a.mode != b.mode and b.events}
