"""The automaton's graph drawn as rings of modes by fingers in contact, as in the paper's Fig. 11."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import write_atomic
from drake_hand.modes.code import Mode, all_modes, contact_counts
from drake_hand.modes.switch import switches

GRAPH_FORMATS = ("svg", "png", "pdf")
MOST_FINGERS = 6
NODE_SPACING_IN = 0.46
"""Between neighbours on a ring, inches."""
RING_GAP_IN = 1.05
"""Between rings at least, inches: room to tell the edges apart."""
MARGIN_IN, HEADER_IN = 0.7, 0.8
"""Around the rings and above them, inches."""
FILLS = ("#ffffff", "#b5d6f2", "#f9d9a8")
"""Of a mode without contact, with rolling contacts only, with sliding ones."""
EDGE_COLOUR, BEFORE_COLOUR, AFTER_COLOUR = "#a0a0a0", "#c0392b", "#2471a3"


def layout(n: int) -> tuple[dict[Mode, np.ndarray], list[float]]:
    """Where the modes are drawn: one ring per number of fingers in contact, the mode without any in the middle.

    Returns:
        Position (2,) of every mode and the radius of every ring, in inches. Neighbours on a ring share which
        fingers touch, and differ in how.
    """
    radii = [0.0]
    for count in contact_counts(n)[1:]:
        radii.append(max(radii[-1] + RING_GAP_IN, count * NODE_SPACING_IN / math.tau))
    places: dict[Mode, np.ndarray] = {}
    for k, radius in enumerate(radii):
        ring = sorted((m for m in all_modes(n) if len(m.touching) == k), key=lambda m: (m.touching, m))
        for i, mode in enumerate(ring):
            angle = math.pi / 2 - math.tau * i / len(ring)
            places[mode] = radius * np.array([math.cos(angle), math.sin(angle)])
    return places, radii


def draw(path: Path, fingers: Sequence[str], *, title: str, highlight: Mode | None = None) -> None:
    """Draws all modes and the switches on which one finger changes.

    Args:
        path: to write, .svg, .png or .pdf.
        fingers: names of the hand's fingers.
        title: above the drawing.
        highlight: a mode whose switches are drawn strong.

    Raises:
        InputError: the suffix is none of these, or the hand has too many fingers to be drawn.
    """
    suffix = path.suffix.removeprefix(".").lower()
    if suffix not in GRAPH_FORMATS:
        raise InputError(
            "cannot draw this kind of file", file=path, found=path.suffix, expected=", ".join(GRAPH_FORMATS)
        )
    n = len(fingers)
    if n > MOST_FINGERS:
        raise InputError(
            f"{3**n} modes are too many to draw", found=f"{n} fingers", expected=f"at most {MOST_FINGERS} fingers"
        )
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Patch

    places, radii = layout(n)
    half = radii[-1] + MARGIN_IN
    height = 2 * half + HEADER_IN
    figure = Figure(figsize=(2 * half, height))
    axes = figure.add_axes((0, 0, 1, 2 * half / height))
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    axes.set_axis_off()

    edges = [(places[mode], places[s.after]) for mode in places for s in switches(mode, fingers) if mode < s.after]
    axes.add_collection(LineCollection(edges, colors=EDGE_COLOUR, linewidths=0.35, alpha=0.55, zorder=1))
    for k, radius in enumerate(radii[1:], start=1):
        axes.add_patch(Circle((0, 0), radius, fill=False, color="#707070", linewidth=0.6, linestyle=":", zorder=2))
        label = f"{k} finger{'s' if k > 1 else ''}: {contact_counts(n)[k]} modes"
        axes.text(0, radius + 0.2, label, ha="center", va="bottom", fontsize=11, weight="bold", zorder=5)
    strong = {s.after for s in switches(highlight, fingers)} if highlight else set()
    if highlight:
        lines = [(places[highlight], places[after]) for after in strong]
        axes.add_collection(LineCollection(lines, colors=AFTER_COLOUR, linewidths=1.6, zorder=3))
    for mode, (x, y) in places.items():
        outline = BEFORE_COLOUR if mode == highlight else AFTER_COLOUR if mode in strong else "#606060"
        width = 0.5 if mode != highlight and mode not in strong else 2.0
        fill = FILLS[max(mode.submodels)]
        box = {"boxstyle": "round,pad=0.22", "facecolor": fill, "edgecolor": outline, "linewidth": width}
        axes.text(x, y, mode.code, ha="center", va="center", fontsize=7, family="monospace", bbox=box, zorder=4)
    figure.suptitle(title, fontsize=15, y=1 - 0.15 / height, va="top")
    words = ("no contact", "rolling contacts only", "with sliding contacts")
    figure.legend(
        handles=[Patch(facecolor=c, edgecolor="#606060", label=w) for c, w in zip(FILLS, words, strict=True)],
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - 0.4 / height),
        ncols=3,
        frameon=False,
        fontsize=11,
    )
    data = io.BytesIO()
    figure.savefig(data, format=suffix, dpi=110)
    write_atomic(path, data.getvalue())
