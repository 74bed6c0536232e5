"""A physics replay as a page in the browser: what happened, and faintly what was planned."""

from __future__ import annotations

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.physics.run import POSITION_MM, ROTATION_DEG, Record, SimulatedRun
from drake_hand.plans.plan import Plan
from drake_hand.plans.words import figure, per_cent
from drake_hand.view.course import Course
from drake_hand.view.page import Fact, Page, Strip, add_panel, strip
from drake_hand.view.stage import Stage, frame_times


def render_replay(plan: Plan, run: SimulatedRun, record: Record) -> Page:
    """Shows one run of a plan: hand and object as they moved, contact forces, the planned object faint.

    Args:
        plan: what was simulated.
        run: what is to be said about it.
        record: what happened.

    Returns:
        The HTML page.
    """
    scene = Scene(Hand.load(plan.task.hand), Object.load(plan.task.object))
    t = frame_times(plan.duration)
    k = np.clip(np.searchsorted(record.t, t - 1e-9), 0, len(record.t) - 1)
    course = Course.of(plan, scene.hand, t)
    planned = course.states
    stage = Stage(scene, t, gravity=np.array(plan.task.physics.gravity))
    stage.hand(record.q[k], record.X_WO[k])
    stage.object(record.X_WO[k])
    stage.object(planned.X_WO, ghost=True)
    if (table := plan.task.table) is not None:
        stage.table(table, planned.X_WO[0, :3, 3])
    stage.contacts(record.p_W[k], record.f_W[k], record.X_WO[k])
    verdict = "dropped" if run.dropped else "held" if run.success else "held, off the plan"
    sentence = f"in physics: {verdict}"
    return add_panel(
        stage.html(),
        plan,
        course,
        stage.scene,
        facts=_facts(plan, run),
        strips=_error_strips(run, t),
        verdict=(verdict, "yes" if run.success else "no", sentence),
    )


def _error_strips(run: SimulatedRun, t: np.ndarray) -> list[Strip]:
    """Errors over time, with the limits of a success; none while the fixture holds."""
    known = (t >= run.free_s) & (t <= run.end_s)

    def over_time(values: list[float]) -> np.ndarray:
        return np.where(known, np.interp(t, run.errors.t, values), np.nan)

    turn = np.hypot(over_time(run.errors.tilt_deg), over_time(run.errors.rotation_deg))
    return [
        strip("off the plan", "mm", over_time(run.errors.position_mm), limit=POSITION_MM),
        strip("turned off", "deg", turn, limit=ROTATION_DEG),
    ]


def _facts(plan: Plan, run: SimulatedRun) -> list[Fact]:
    def limited(name: str, value: float, limit: float, unit: str) -> Fact:
        return name, f"{figure(value)} {unit}", per_cent(1 - value / limit), value <= limit

    return [
        limited("position error at the end", run.position_error_mm, POSITION_MM, "mm"),
        limited("tilt error", run.tilt_error_deg, ROTATION_DEG, "deg"),
        limited("rotation error", run.rotation_error_deg, ROTATION_DEG, "deg"),
        ("rotated", f"{run.rotated_deg:.1f} of {run.planned_deg:.1f} deg", "", not run.dropped),
        ("most slip", f"{figure(run.slip_mm)} mm", "", True),
        ("fixture", "none, a table" if plan.task.support else f"lets go at {run.free_s:.2f} s", "", True),
        ("stray contacts", ", ".join(run.strays) or "none", "", not run.strays),
    ]
