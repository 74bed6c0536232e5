"""Dexterous-hand manipulation planning: certified finger gaits, from a URDF to motor drives.

Everything a notebook needs is importable from here, and loads when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drake_hand.api import PlanResult, check, look, plan, show, solve
    from drake_hand.contact.chain import FingerKinematics
    from drake_hand.contact.grasp_measures import grasp_measures
    from drake_hand.contact.submodel import Submodel, finger_mechanism, hand_mechanism
    from drake_hand.errors import DrakeHandError, InputError, NoPlanFound
    from drake_hand.model.hand import Hand
    from drake_hand.model.object import Object
    from drake_hand.model.scene import Scene
    from drake_hand.modes.automaton import Automaton
    from drake_hand.modes.code import Mode
    from drake_hand.modes.situation import Situation, State
    from drake_hand.physics.replay import replay
    from drake_hand.physics.runs import simulate
    from drake_hand.plans.plan import Certificate, Plan
    from drake_hand.plans.task import Task
    from drake_hand.plans.trajectory import States, Trajectory
    from drake_hand.view import figures

__version__ = "0.1.0"

_HOME = {
    "Automaton": "modes.automaton",
    "Certificate": "plans.plan",
    "DrakeHandError": "errors",
    "FingerKinematics": "contact.chain",
    "Hand": "model.hand",
    "InputError": "errors",
    "Mode": "modes.code",
    "NoPlanFound": "errors",
    "Object": "model.object",
    "Plan": "plans.plan",
    "PlanResult": "api",
    "Scene": "model.scene",
    "Situation": "modes.situation",
    "State": "modes.situation",
    "States": "plans.trajectory",
    "Submodel": "contact.submodel",
    "Task": "plans.task",
    "Trajectory": "plans.trajectory",
    "check": "api",
    "figures": "view",
    "finger_mechanism": "contact.submodel",
    "grasp_measures": "contact.grasp_measures",
    "hand_mechanism": "contact.submodel",
    "look": "api",
    "plan": "api",
    "replay": "physics.replay",
    "show": "api",
    "simulate": "physics.runs",
    "solve": "api",
}
"""Public names, and the module below ``drake_hand`` in which each is defined."""

__all__ = [
    "Automaton",
    "Certificate",
    "DrakeHandError",
    "FingerKinematics",
    "Hand",
    "InputError",
    "Mode",
    "NoPlanFound",
    "Object",
    "Plan",
    "PlanResult",
    "Scene",
    "Situation",
    "State",
    "States",
    "Submodel",
    "Task",
    "Trajectory",
    "check",
    "figures",
    "finger_mechanism",
    "grasp_measures",
    "hand_mechanism",
    "look",
    "plan",
    "replay",
    "show",
    "simulate",
    "solve",
]


def __getattr__(name: str) -> Any:
    """Loads a public name when it is first asked for: ``import drake_hand`` alone stays fast."""
    if name == "figures":
        return import_module("drake_hand.view.figures")
    if name in _HOME:
        return getattr(import_module(f"drake_hand.{_HOME[name]}"), name)
    raise AttributeError(f"module 'drake_hand' has no attribute '{name}'")


def __dir__() -> list[str]:
    """The public names: what a notebook offers behind the dot."""
    return [*__all__, "__version__"]
