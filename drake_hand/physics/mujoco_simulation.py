"""`MujocoSimulation`: the hand with servos and soft fingertips and the free object, in MuJoCo: a second opinion."""

from __future__ import annotations

import mujoco
import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from drake_hand.model.hand import Hand
from drake_hand.model.mujoco_warnings import mujoco_warnings
from drake_hand.model.object import Object
from drake_hand.model.table import Table
from drake_hand.physics.engine import Perturbation, Touch
from drake_hand.physics.mujoco_model import MUJOCO_STEP_S, OBJECT_NAME, TABLE, build_model, controls, put, tip_shapes

_FIXTURE_INERTIA = 1.0e6
"""Inertia (kg, kg m^2) added to the object while the fixture has it: it then stays where it is, whatever pushes it."""


class MujocoSimulation:
    """One simulation, as :class:`drake_hand.physics.simulation.DrakeSimulation` is one in Drake.

    A fingertip touches in a point, its pad a spring and damper in parallel.
    """

    def __init__(
        self,
        hand: Hand,
        object_: Object,
        commands: PiecewisePolynomial,
        X_WO: np.ndarray,
        *,
        gravity: np.ndarray,
        friction: float,
        pad_stiffness: np.ndarray,
        perturbation: Perturbation | None = None,
        table: Table | None = None,
    ) -> None:
        """Builds the simulation, the object held at its start pose.

        Args:
            hand: with servo gains, efforts and pad.
            object_: of the mass planned with.
            commands: (nq,) commanded joints over time; the simulation starts where they start.
            X_WO: (4, 4) start pose.
            gravity: (3,) in W, m/s^2.
            friction: between tip and object.
            pad_stiffness: (fingers,) of the pads as they are in this run, N/m.
            perturbation: what differs from all this.
            table: what the object lies on at first.
        """
        change = perturbation or Perturbation()
        self.hand = hand
        spec = build_model(
            hand,
            object_.with_mass(object_.mass * change.mass),
            gravity=gravity,
            friction=friction * change.friction,
            pad_stiffness=pad_stiffness,
            relaxation=hand.pad.relaxation_time_s,
            table=table,
        )
        self.model = model = spec.compile()
        model.actuator_gainprm[:, 0] *= change.stiffness
        model.actuator_biasprm[:, 1] *= change.stiffness
        self.data = mujoco.MjData(model)
        times = np.arange(commands.start_time(), commands.end_time(), MUJOCO_STEP_S)
        self._ctrl = controls(hand, commands, times, stiffness=change.stiffness)
        self._start, self._done = commands.start_time(), 0
        self._dq = np.zeros(hand.nq)
        self._columns = np.array([model.joint(name).qposadr[0] for name in hand.joints])
        thing = model.joint(OBJECT_NAME)
        self._pose, self._dofs = (
            slice(thing.qposadr[0], thing.qposadr[0] + 7),
            slice(thing.dofadr[0], thing.dofadr[0] + 6),
        )
        self._M0 = model.dof_M0[self._dofs].copy()
        self._body = model.body(OBJECT_NAME).id
        self._finger = {model.geom(name).id: i for i, name in enumerate(tip_shapes(hand))}
        self._table = model.geom(TABLE).id if table else None
        self._tips = [model.body(finger.tip_link).id for finger in hand.fingers]
        put(model, self.data.qpos, hand, commands.value(commands.start_time())[:, 0], change.start(X_WO, table))
        self.take_back()
        mujoco.mj_forward(model, self.data)

    def let_go(self) -> None:
        """Takes the fixture away."""
        self._weigh(0.0)

    def take_back(self) -> None:
        """Has the fixture hold the object again, where it is."""
        self._weigh(_FIXTURE_INERTIA)
        self.data.qvel[self._dofs] = 0.0

    def advance(self, t: float) -> None:
        """Simulates up to time t, s.

        Raises:
            RuntimeError: the simulation became unstable.
        """
        until = round((t - self._start) / MUJOCO_STEP_S)
        with mujoco_warnings() as warnings:
            for k in range(self._done, until):
                self.data.ctrl[:] = self._ctrl[min(k, len(self._ctrl) - 1)] + self._dq
                mujoco.mj_step(self.model, self.data)
        self._done = max(until, self._done)
        if self.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(self.data.qpos).all():
            raise RuntimeError("; ".join(["MuJoCo became unstable", *warnings]))

    def correct(self, dq: np.ndarray) -> None:
        """Adds dq (nq,) to the commands from now on."""
        self._dq = dq

    def push(self, f_W: np.ndarray) -> None:
        """Has a force f_W (3,) act on the object's mass centre from now on, N."""
        self.data.xfrc_applied[self._body, :3] = f_W

    @property
    def q(self) -> np.ndarray:
        """(nq,) joints now, rad."""
        return self.data.qpos[self._columns].copy()

    @property
    def X_WO(self) -> np.ndarray:
        """(4, 4) object pose now."""
        pose, X, R = self.data.qpos[self._pose], np.eye(4), np.zeros(9)
        mujoco.mju_quat2Mat(R, pose[3:])
        X[:3, :3], X[:3, 3] = R.reshape(3, 3), pose[:3]
        return X

    def touch(self) -> Touch:
        """Contacts, as they were in the last step."""
        n, contact = len(self._tips), self.data.contact
        f, p, slip, strays = np.zeros((n, 3)), np.full((n, 3), np.nan), np.zeros((n, 3)), set()
        first = contact.efc_address
        pressed = np.flatnonzero(
            (first >= 0) & (self.data.efc_force[np.maximum(first, 0)] > 0) if len(first) else first
        )
        for i in pressed:
            a, b = geoms = contact.geom[i]
            bodies = self.model.geom_bodyid[geoms]
            if self._table in geoms and self._body in bodies:
                continue
            finger = self._finger.get(a, self._finger.get(b))
            if finger is None or self._body not in bodies:
                strays.add(" - ".join(sorted(self.model.body(body).name for body in bodies)))
                continue
            frame, pos = contact.frame[i].reshape(3, 3), contact.pos[i]
            force = self.data.efc_force[first[i] : first[i] + 3] @ frame
            f[finger] = (
                force if bodies[1] == self._body else -force
            )  # the frame's x points from the first to the second
            p[finger] = pos
            v = self._velocity(self._tips[finger], pos) - self._velocity(self._body, pos)
            slip[finger] = v - frame[0] * (frame[0] @ v)
        return Touch(f_W=f, p_W=p, slip_W=slip, strays=tuple(sorted(strays)))

    def _weigh(self, inertia: float) -> None:
        """Adds inertia to the object; MuJoCo keeps that of a body whose axes are its frame's in a place of its own."""
        self.model.dof_armature[self._dofs] = inertia
        self.model.dof_M0[self._dofs] = self._M0 + inertia

    def _velocity(self, body: int, p_W: np.ndarray) -> np.ndarray:
        """Of a body's material at a point; MuJoCo keeps velocities at the mass centre of the whole tree."""
        w, v = self.data.cvel[body].reshape(2, 3)
        x, y, z = p_W - self.data.subtree_com[self.model.body_rootid[body]]
        return v + np.array([w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x])
