"""Dexterous-hand manipulation planning: certified finger gaits, from a URDF to motor drives."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drake_hand.api import check, plan, show
    from drake_hand.contact.grasp_measures import grasp_measures
    from drake_hand.model.hand import Hand
    from drake_hand.model.object import Object
    from drake_hand.physics.runs import simulate
    from drake_hand.plans.plan import Plan
    from drake_hand.plans.task import Task

__version__ = "0.1.0"

_HOME = {
    "Hand": "drake_hand.model.hand",
    "Object": "drake_hand.model.object",
    "Plan": "drake_hand.plans.plan",
    "Task": "drake_hand.plans.task",
    "check": "drake_hand.api",
    "grasp_measures": "drake_hand.contact.grasp_measures",
    "plan": "drake_hand.api",
    "show": "drake_hand.api",
    "simulate": "drake_hand.physics.runs",
}

__all__ = ["Hand", "Object", "Plan", "Task", "check", "grasp_measures", "plan", "show", "simulate"]


def __getattr__(name: str) -> Any:
    """Loads a public name when it is first asked for: ``import drake_hand`` alone stays fast."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'drake_hand' has no attribute '{name}'")
