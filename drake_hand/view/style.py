"""One look for all figures: a column of 85 mm, readable there, colour-blind safe."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from drake_hand.files import make_folder, write_atomic
from drake_hand.plans.plan import Plan

WIDTH_MM = 85.0
"""Of a column in print."""
MOST_SWITCH_LINES = 60
"""Changes of mode up to which they are marked."""
FIGURE_FORMATS = ("svg", "pdf", "png")
_DPI = 300
_CELL = (200, 130)
"""Dots per inch of a figure in a notebook cell, and at which of them it is shown there: larger than in print."""
_RC: dict[Any, Any] = {
    "font.size": 7,
    "axes.titlesize": 7,
    "axes.labelsize": 7,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
    "lines.linewidth": 0.9,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "drake_hand",
}


class Column(Figure):
    """A figure as wide as a column; shows itself in a notebook cell, whether or not pyplot was imported."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        data = io.BytesIO()
        fine, shown = _CELL
        with in_print():
            self.savefig(data, dpi=fine)
        width, height = self.get_size_inches() * shown
        return data.getvalue(), {"width": round(width), "height": round(height)}


@contextmanager
def in_print() -> Iterator[None]:
    """Draws what is drawn inside in print style; as a decorator, what a function draws."""
    with matplotlib.rc_context(_RC):
        yield


def column(height_mm: float) -> Figure:
    """An empty figure as wide as a column."""
    return Column(figsize=(WIDTH_MM / 25.4, height_mm / 25.4), layout="constrained")


def panels(height_mm: float, rows: int, **shape: Any) -> tuple[Figure, list[Axes]]:
    """A column of panels over a common time axis; `shape` as of `Figure.subplots`."""
    figure = column(height_mm)
    axes = list(figure.subplots(rows, 1, sharex=True, squeeze=False, **shape)[:, 0])
    axes[-1].set_xlabel("time [s]")
    return figure, axes


def save(figure: Figure, folder: Path, name: str, formats: Sequence[str]) -> list[Path]:
    """Writes a figure in some formats; returns the files."""
    make_folder(folder)
    files = [folder / f"{name}.{suffix}" for suffix in formats]
    for file in files:
        dateless = {} if file.suffix == ".png" else {"Date" if file.suffix == ".svg" else "CreationDate": None}
        data = io.BytesIO()
        with in_print():
            figure.savefig(data, format=file.suffix[1:], dpi=_DPI, metadata=dateless)
        write_atomic(file, data.getvalue())
    return files


def mark_switches(ax: Axes, plan: Plan) -> None:
    """Thin lines where the mode changes, unless there are too many to tell apart."""
    at = [part.t[0] for part in plan.parts[1:] if part.events]
    for t in at if len(at) <= MOST_SWITCH_LINES else ():
        ax.axvline(t, color="0.88", lw=0.5, zorder=0)
    ax.set_xlim(0, plan.duration)


def touching(plan: Plan) -> list[int]:
    """Fingers that touch the object at any time."""
    return [i for i in range(len(plan.fingers)) if any(code[i] != "0" for code in plan.modes)]


def legend_below(figure: Figure, ax: Axes, columns: int = 5) -> None:
    """The legend of some axes, under the figure."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, columnspacing=1.2, handlelength=1.4)


def bent_arrow(ax: Axes, a: np.ndarray, b: np.ndarray, *, color: str, bend: float, clear: float) -> None:
    """An arrow from a to b (2,) in data units, bent to the left, its ends `clear` points away."""
    ax.add_patch(
        FancyArrowPatch(
            (float(a[0]), float(a[1])),
            (float(b[0]), float(b[1])),
            arrowstyle="-|>",
            mutation_scale=6,
            lw=0.8,
            color=color,
            connectionstyle=f"arc3,rad={bend}",
            shrinkA=clear,
            shrinkB=clear,
        )
    )
