"""A replay before a plan is handed out: one that physics does not hold is no plan for a hand without eyes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drake_hand.errors import InputError
from drake_hand.physics.engine import EngineName
from drake_hand.physics.replay import check_simulated, replay
from drake_hand.physics.run import SimulatedRun
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Task


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What became of a plan that was replayed as planned, without feedback."""

    engine: EngineName
    run: SimulatedRun

    @property
    def outcome(self) -> str:
        """How it ended, in words."""
        run = self.run
        if run.dropped:
            return f"dropped in {self.engine} after {run.end_s:.1f} s"
        off = f"{run.position_error_mm:.2g} mm, {run.tilt_error_deg:.2g} deg of tilt, {run.rotation_error_deg:.2g} deg"
        return f"held in {self.engine}, ends {off} of turn off the plan"


def check_tried(task: Task, engine: EngineName) -> None:
    """That plans for a task can be replayed in an engine.

    Raises:
        InputError: they state no forces, push, or the engine is not installed.
    """
    if task.options.hold != "equilibrium":
        message, found = "physics drops what no forces are planned for", task.options.hold
        raise InputError(message, key="task.options.hold", found=found, expected="equilibrium")
    check_simulated(task, engine, key="--replay")


def try_out(plan: Plan, engine: EngineName, progress: Callable[[float], None] | None = None) -> Trial:
    """Replays a plan as planned.

    Args:
        plan: in equilibrium.
        engine: whose physics.
        progress: called with the fraction done.

    Raises:
        DrakeHandError: the simulation broke down.
    """
    return Trial(engine=engine, run=replay(plan, engine=engine, progress=progress)[0])
