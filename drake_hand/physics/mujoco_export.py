"""A plan for MuJoCo: a model with the plan's start as keyframe, and the controls that replay it."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.files import write_atomic
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.mujoco_model import MUJOCO_STEP_S, OBJECT_NAME, build_model, controls, put
from drake_hand.physics.pads import pad_stiffness
from drake_hand.physics.replay import commands
from drake_hand.plans.holds import free_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

FIXTURE = "fixture"
"""Name of the weld that holds the object until the grasp is complete."""
START_KEY = "start"
"""Name of the keyframe."""


@dataclass(frozen=True, kw_only=True)
class MujocoExport:
    """Everything needed to replay a plan in MuJoCo."""

    xml: str
    """The model (MJCF). Its weld `fixture` is active; it holds the object where it starts, to about 0.1 mm. There is
    none where the object lies on a table."""
    t: np.ndarray
    """(k,) times of the controls, one a step of the model, s."""
    ctrl: np.ndarray
    """(k, nq) what goes into ``data.ctrl``: q + q_offset + D / K of their rates, so that damping follows the plan."""
    free: np.ndarray
    """(m, 2) from when to when no fixture holds the object and the weld is to be inactive, s."""
    joints: list[str]
    """Names of the actuators, in the order of `ctrl`'s columns."""


def export_mujoco(plan: Plan) -> MujocoExport:
    """Makes model and controls of a plan.

    Raises:
        InputError: the plan is for other models, or its fingers never hold the object.
    """
    hand = Hand.load(plan.task.hand)
    object_ = Object.load(plan.task.object).with_mass(plan.object_mass_kg)
    spec = build_model(
        hand,
        object_,
        gravity=np.array(plan.task.physics.gravity),
        friction=plan.task.physics.friction,
        pad_stiffness=pad_stiffness(plan, hand, object_),
        relaxation=hand.pad.relaxation_time_s,
        table=plan.task.table,
    )
    trajectory = Trajectory(plan)
    first = trajectory.at(0.0)
    X_WO = first.X_WO[0]
    thing = spec.body(OBJECT_NAME)  # a weld holds bodies as they stand in the model
    thing.pos, thing.quat = X_WO[:3, 3], np.roll(Rotation.from_matrix(X_WO[:3, :3]).as_quat(), 1)
    if plan.task.table is None:
        spec.add_equality(
            name=FIXTURE,
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=OBJECT_NAME,
            name2="world",
            solref=[2 * MUJOCO_STEP_S, 1.0],
            solimp=[0.9999, 0.9999, 1e-3, 0.5, 2.0],
        )
    model = spec.compile()
    t = np.arange(0.0, plan.duration, MUJOCO_STEP_S)
    ctrl = controls(hand, commands(trajectory), t)
    qpos = np.zeros(model.nq)
    put(model, qpos, hand, first.q[0], X_WO)
    spec.add_key(name=START_KEY, qpos=qpos, ctrl=ctrl[0])
    spec.compile()
    return MujocoExport(xml=spec.to_xml(), t=t, ctrl=ctrl, free=np.array(free_windows(plan)), joints=list(hand.joints))


def write(exported: MujocoExport, file: Path) -> Path:
    """Writes the model to `file` (.xml) and the controls beside it (.npz: t, ctrl, free, joints).

    Returns:
        The file of the controls.
    """
    write_atomic(file, exported.xml)
    controls = file.with_suffix(".npz")
    out = io.BytesIO()
    np.savez_compressed(out, t=exported.t, ctrl=exported.ctrl, free=exported.free, joints=np.array(exported.joints))
    write_atomic(controls, out.getvalue())
    return controls
