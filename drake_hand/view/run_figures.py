"""Figures of a run on drives: commanded and measured joints, tracking error, lateness of the SYNC, faults."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_hand.epos.record import RunRecord
from drake_hand.view.style import column, in_print, legend_below, save

FAULT_COLOR = "#c0392b"


def draw_run(record: RunRecord, folder: Path, *, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draws a run's figures.

    Args:
        record: of the run.
        folder: where to; made if missing.
        formats: of ``svg``, ``pdf`` and ``png``.

    Returns:
        The files written.
    """
    files = []
    for name, draw in {"tracking": draw_tracking, "errors": draw_errors}.items():
        files += save(draw(record), folder, name, formats)
    return files


@in_print()
def draw_tracking(record: RunRecord) -> Figure:
    """Commanded and measured position, a panel per joint."""
    joints = record.header.joints
    rows = -(-len(joints) // 3)
    figure = column(14 + 14 * rows)
    axes = figure.subplots(rows, 3, sharex=True, squeeze=False).ravel()
    for j, (name, ax) in enumerate(zip(joints, axes, strict=False)):
        ax.plot(record.t, np.rad2deg(record.measured[:, j]), color="#2a6fbb", label="measured")
        ax.plot(record.t, np.rad2deg(record.commanded[:, j]), color="0.15", lw=0.5, ls="--", label="commanded")
        ax.set_title(name, loc="left", pad=2, fontsize=6)
        low, high = ax.get_ylim()
        middle, half = (low + high) / 2, max((high - low) / 2, 1.0)
        ax.set_ylim(middle - half, middle + half)
        _mark_stop(ax, record)
    for ax in axes[len(joints) :]:
        ax.set_visible(False)
    figure.supylabel("position [deg]", fontsize=7)
    for ax in axes[3 * (rows - 1) : len(joints)]:
        ax.set_xlabel("time [s]")
    legend_below(figure, axes[0])
    return figure


@in_print()
def draw_errors(record: RunRecord) -> Figure:
    """Tracking error of every joint as a map over time, and how late each SYNC was."""
    joints = record.header.joints
    figure = column(30 + 3.2 * len(joints))
    error, late = figure.subplots(2, 1, sharex=True, height_ratios=[max(len(joints), 3), 3])
    edges = np.append(record.t, 2 * record.t[-1] - record.t[-2] if len(record.t) > 1 else record.t[-1] + 1e-3)
    rows = np.arange(len(joints) + 1) - 0.5
    shown = error.pcolormesh(edges, rows, np.abs(record.error_deg).T, cmap="viridis", vmin=0, rasterized=True)
    error.set_yticks(range(len(joints)), joints, fontsize=5.5)
    error.invert_yaxis()
    figure.colorbar(shown, ax=error, label="|commanded - measured| [deg]")
    late.plot(record.t, record.late_ms, color="0.3", lw=0.5)
    late.axhline(record.header.sync_ms, color=FAULT_COLOR, ls="--", lw=0.6)
    late.set_ylabel("SYNC late\n[ms]")
    late.set_xlabel("time [s]")
    for ax in (error, late):
        _mark_stop(ax, record)
    for fault in record.header.faults[:1]:
        error.set_title(f"stopped: {fault.text}", loc="left", fontsize=6, color=FAULT_COLOR)
    return figure


def _mark_stop(ax: Axes, record: RunRecord) -> None:
    """A line where a fault ended the motion."""
    if record.header.faults and record.playing.any():
        ax.axvline(record.t[np.flatnonzero(record.playing)[-1]], color=FAULT_COLOR, lw=0.8)
