"""Figures of a run on drives: commanded and measured joints, tracking error, lateness of the SYNC, faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_hand.epos.record import RunRecord

FAULT = "#c0392b"


def draw_run(record: RunRecord, folder: Path) -> list[Path]:
    """Draws a run's figures as PNG files.

    Args:
        record: of the run.
        folder: where to; made if missing.

    Returns:
        The files written.
    """
    folder.mkdir(exist_ok=True)
    files = []
    for name, draw in {"tracking": draw_tracking, "errors": draw_errors}.items():
        files.append(folder / f"{name}.png")
        draw(record).savefig(files[-1], dpi=130)
    return files


def draw_tracking(record: RunRecord) -> Figure:
    """Commanded and measured position, a panel per joint."""
    joints = record.header.joints
    rows = -(-len(joints) // 3)
    figure = Figure(figsize=(12, 1.0 + 1.5 * rows), layout="constrained")
    axes = figure.subplots(rows, 3, sharex=True, squeeze=False).ravel()
    for j, (name, ax) in enumerate(zip(joints, axes, strict=False)):
        ax.plot(record.t, np.rad2deg(record.measured[:, j]), color="#2a6fbb", label="measured")
        ax.plot(record.t, np.rad2deg(record.commanded[:, j]), color="0.15", lw=0.8, ls="--", label="commanded")
        ax.set_title(name, loc="left", fontsize=9)
        low, high = ax.get_ylim()
        middle, half = (low + high) / 2, max((high - low) / 2, 1.0)
        ax.set_ylim(middle - half, middle + half)
        _mark_stop(ax, record)
    for ax in axes[len(joints) :]:
        ax.set_visible(False)
    figure.supylabel("position [deg]", fontsize=10)
    figure.supxlabel("time [s]", fontsize=10)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, fontsize=8, frameon=False)
    return figure


def draw_errors(record: RunRecord) -> Figure:
    """Tracking error of every joint, and how late each SYNC was."""
    figure = Figure(figsize=(10, 6), layout="constrained")
    error, late = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    styles = ("-", "--", ":")
    for j, name in enumerate(record.header.joints):
        error.plot(record.t, record.error_deg[:, j], lw=0.9, ls=styles[j // 10 % 3], label=name)
    error.set_ylabel("commanded - measured [deg]")
    error.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    late.plot(record.t, record.late_ms, color="0.3", lw=0.7)
    late.axhline(record.header.sync_ms, color=FAULT, ls="--", lw=0.8)
    late.set_ylabel("SYNC late [ms]")
    late.set_xlabel("time [s]")
    for ax in (error, late):
        _mark_stop(ax, record)
    for fault in record.header.faults[:1]:
        error.set_title(f"stopped: {fault.text}", loc="left", fontsize=9, color=FAULT)
    return figure


def _mark_stop(ax: Axes, record: RunRecord) -> None:
    """A line where a fault ended the motion."""
    if record.header.faults and record.playing.any():
        ax.axvline(record.t[np.flatnonzero(record.playing)[-1]], color=FAULT, lw=0.8)
    ax.spines[["top", "right"]].set_visible(False)
