"""The joint torques that hold up the links along a plan, and those that press. Needs no Drake."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from drake_hand.contact.chain import FingerKinematics, cross, material_jacobian
from drake_hand.model.hand import Hand
from drake_hand.model.inertia import Inertial
from drake_hand.model.meshes import find_mesh
from drake_hand.model.xml import Source
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class Press:
    """Torques of a hand's servos at k times, Nm; statically, as plans are made."""

    contact: np.ndarray
    """(k, nq) J^T f, what presses the object."""
    weight: np.ndarray
    """(k, nq) what holds up the links."""


def press(plan: Plan, hand: Hand, t: np.ndarray) -> Press:
    """The torques that a plan asks of the joints.

    Args:
        plan: with forces, or without (then nothing presses).
        hand: the plan's.
        t: (k,) times, s.
    """
    states = Trajectory(plan).at(t)
    gravity = np.array(plan.task.physics.gravity, float)
    contact, weight = np.zeros_like(states.q), np.zeros_like(states.q)
    for i, finger in enumerate(hand.fingers):
        kinematics, q = FingerKinematics.of(hand, finger), states.q[:, finger.columns]
        p_WC, _, J, Jw = kinematics.jacobian(q)
        p_WP = np.einsum("kij,kj->ki", states.X_WO[:, :3, :3], states.p_OP[:, i]) + states.X_WO[:, :3, 3]
        lever_W = np.nan_to_num(p_WC - p_WP)  # a finger that is free presses nothing
        contact[:, finger.columns] = np.einsum(
            "kij,ki->kj", material_jacobian(J, Jw, lever_W), np.nan_to_num(states.f_W[:, i])
        )
        weight[:, finger.columns] = _weight(kinematics, hand, q, gravity)
    return Press(contact=contact, weight=weight)


def _weight(kinematics: FingerKinematics, hand: Hand, q: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """(k, m) torques that hold up the links of a finger."""
    p_WJ, R_WJ = kinematics.frames(q)
    axes, torque = kinematics.finger.axes, np.zeros_like(q)
    for beyond, axis in enumerate(axes):
        body = _moved(hand, axis.joint)
        p_WCom = p_WJ[beyond] + R_WJ[beyond] @ body.p_LCom
        for a in range(beyond + 1):
            along = axes[a].multiplier * (R_WJ[a] @ axes[a].axis)
            moves = along if axes[a].prismatic else cross(along, p_WCom - p_WJ[a])
            torque[:, axes[a].source] -= moves @ (body.mass * gravity)
    return torque


def _moved(hand: Hand, joint: str) -> Inertial:
    """The links that move with a joint and with none after it, in the frame of its child; massless if all are."""
    joints, links = hand.urdf.joints, hand.urdf.link_elements
    parts, beyond = [], [(joints[joint].child, np.eye(4))]
    for name, X_JL in beyond:
        key = f"link {name}: inertial"
        source = Source(file=hand.urdf.file, key=key, find_mesh=partial(find_mesh, file=hand.urdf.file, key=key))
        parts.append(Inertial.read(links[name], source).seen_from(X_JL))
        beyond += [(j.child, X_JL @ j.X_PC) for j in joints.values() if j.parent == name and not j.moves]
    return Inertial.sum(parts) if any(p.mass for p in parts) else parts[0]
