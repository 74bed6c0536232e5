"""The modes' constraint sets, evaluated wherever a mode of a plan begins or ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_hand.model.scene import Scene
from drake_hand.modes.code import Mode
from drake_hand.modes.constraints import build_ik
from drake_hand.modes.corridor import pose_of
from drake_hand.modes.solve import Violation, find_violations
from drake_hand.plans.plan import Plan


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """Hand and object at an instant at which a mode begins or ends, and what they do not keep of its constraint set."""

    time_s: float
    part: int
    mode: str
    """At a switch, with a contact that is made or broken: tip and object touch at that instant."""
    violations: tuple[Violation, ...]


def at_switches(plan: Plan, scene: Scene) -> list[Configuration]:
    """Evaluates the constraint sets of a plan's modes where they begin and where they end.

    The set is that of `modes.constraints`: contacts where the plan has them, joint limits, and a clearance of all other
    pairs, the object where it is.

    Args:
        plan: of the scene's hand and object.
        scene: which is changed.
    """
    codes, last, found = plan.modes, len(plan.parts) - 1, []
    for i, code in enumerate(codes):
        if i == 0 or codes[i - 1] != code:
            found.append(_evaluated(plan, scene, i, 0, max(i - 1, 0)))
        if i == last or codes[i + 1] != code:
            found.append(_evaluated(plan, scene, i, -1, min(i + 1, last)))
    return found


def _evaluated(plan: Plan, scene: Scene, i: int, row: int, beside: int) -> Configuration:
    """At the first or last row of a part; the part beside it may have a contact more at that instant."""
    part, other = plan.parts[i], plan.parts[beside]
    q, X_WO = np.array(part.q[row]), pose_of(np.array(part.X_WO[row]))
    points = {name: contact.p_OP[row] for name, contact in part.contacts.items()}
    if beside != i:
        points = {name: contact.p_OP[-1 - row] for name, contact in other.contacts.items()} | points
    digits = [own if own != "0" or beside == i else its for own, its in zip(part.mode, other.mode, strict=True)]
    mode = Mode.parse("".join(digits), plan.fingers)
    scene.set(q, X_WO)
    contacts = {name: _tip_at(scene, name, np.array(p_OP), X_WO) for name, p_OP in points.items()}
    program = build_ik(scene, mode, X_WO, contacts, q_guess=q)
    violations = tuple(find_violations(program, q, X_WO))
    return Configuration(time_s=part.t[row], part=i, mode=mode.code, violations=violations)


def _tip_at(scene: Scene, finger: str, p_OP: np.ndarray, X_WO: np.ndarray) -> np.ndarray:
    """(3,) the tip's centre in O when it touches a point, seen from where it is: at an edge no one normal tells."""
    p_OC = (scene.tip_position(finger) - X_WO[:3, 3]) @ X_WO[:3, :3]
    way = p_OC - p_OP
    return p_OP + scene.hand.finger(finger).radius * way / max(float(np.linalg.norm(way)), 1e-9)
