"""Figure of a plan replayed in physics: how far the object is off the plan, over time, in each engine."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from drake_hand.physics.run import POSITION_MM, ROTATION_DEG, SimulatedRun
from drake_hand.plans.plan import Plan
from drake_hand.view.style import in_print, legend_below, mark_switches, panels

_LEAST_ERROR = 0.01
"""mm and deg; less is drawn as this."""
_STYLES = (("#0072b2", "-"), ("#d55e00", "--"))


@in_print()
def draw_replay_errors(plan: Plan, runs: Mapping[str, SimulatedRun]) -> Figure:
    """Errors over time from where the fixture lets go, with what a success may be off at the end.

    Args:
        plan: what was replayed.
        runs: by the engine's name.
    """
    figure, axes = panels(82, 3)
    rows = (
        ("off the plan", "mm", "position_mm", POSITION_MM),
        ("tilt", "deg", "tilt_deg", ROTATION_DEG),
        ("turn", "deg", "rotation_deg", ROTATION_DEG),
    )
    for ax, (label, unit, key, limit) in zip(axes, rows, strict=True):
        for (engine, run), (color, style) in zip(runs.items(), _STYLES, strict=False):
            off = np.maximum(np.abs(getattr(run.errors, key)), _LEAST_ERROR)
            name = f"{engine}, dropped" if run.dropped else engine
            ax.semilogy(run.errors.t, off, style, color=color, label=name)
        ax.axhline(limit, color="0.3", ls="--", lw=0.6)
        words = f"a success ends below {limit:g} {unit}"
        ax.annotate(words, (0.01 * plan.duration, limit), va="bottom", fontsize=6.5)
        ax.set_ylim(_LEAST_ERROR, 6 * limit)
        ax.set_ylabel(f"{label} [{unit}]")
        mark_switches(ax, plan)
    legend_below(figure, axes[0])
    return figure
