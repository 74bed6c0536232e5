"""A physics replay as a page in the browser: what happened, and faintly what was planned."""

from __future__ import annotations

import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.physics.run import POSITION_MM, ROTATION_DEG, Record, Run
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory
from drake_hand.view.page import Fact, add_panel
from drake_hand.view.stage import Stage, frame_times


def render_replay(plan: Plan, run: Run, record: Record) -> str:
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
    planned = Trajectory(plan).at(t)
    stage = Stage(scene, t, gravity=np.array(plan.task.physics.gravity))
    stage.hand(record.q[k], record.X_WO[k])
    stage.object(record.X_WO[k])
    stage.object(planned.X_WO, ghost=True)
    for i, name in enumerate(plan.fingers):
        stage.contact(name, i, record.p_W[k, i], record.f_W[k, i])
    verdict = "dropped" if run.dropped else "held" if run.success else "held, off the plan"
    return add_panel(stage.html(), plan, facts=_facts(run), verdict=(verdict, run.success))


def _facts(run: Run) -> list[Fact]:
    return [
        ("position error", f"{run.position_error_mm:.2f} mm", run.position_error_mm <= POSITION_MM),
        ("tilt error", f"{run.tilt_error_deg:.2f} deg", run.tilt_error_deg <= ROTATION_DEG),
        ("rotation error", f"{run.rotation_error_deg:.2f} deg", run.rotation_error_deg <= ROTATION_DEG),
        ("rotated", f"{run.rotated_deg:.1f} of {run.planned_deg:.1f} deg", not run.dropped),
        ("most slip", f"{run.slip_mm:.2f} mm", True),
        ("fixture lets go", f"{run.free_s:.2f} s", True),
        ("stray contacts", ", ".join(run.strays) or "none", not run.strays),
    ]
