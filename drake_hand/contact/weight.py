"""The effect of the hand's own weight on position servos, and the commands that compensate for it."""

from __future__ import annotations

import numpy as np

from drake_hand.model.scene import Scene


def weight_offsets(scene: Scene, q: np.ndarray, gravity_W: np.ndarray) -> np.ndarray:
    """What to add to q so that servos of finite stiffness hold the fingers up: -K^-1 g(q).

    A finger of 16 g sags 0.2 mm at the tip otherwise, as much as a preload of 0.1 N moves it.

    Args:
        scene: the hand with its link masses; left at the last row of q.
        q: (n, nq) joints, rad.
        gravity_W: (3,) m/s^2.

    Returns:
        (n, nq) rad.
    """
    from pydrake.multibody.tree import JacobianWrtVariable

    plant, context, hand, model = scene.plant, scene.plant_context, scene.hand, [scene.hand_model]
    W = plant.world_frame()
    mass = plant.CalcTotalMass(context, model)
    columns = [plant.get_joint(j) for j in plant.GetJointIndices(scene.hand_model)]
    velocities = sorted(j.velocity_start() for j in columns if j.num_velocities() == 1)
    coupling = scene.expand(np.eye(hand.nq)) - scene.expand(np.zeros(hand.nq))
    q, place = np.unique(q, axis=0, return_inverse=True)
    torque = np.empty_like(q)
    for i, row in enumerate(q):
        scene.set(row)
        J = plant.CalcJacobianCenterOfMassTranslationalVelocity(context, model, JacobianWrtVariable.kV, W, W)
        torque[i] = coupling @ J[:, velocities].T @ (mass * gravity_W)
    return (-torque / hand.stiffness)[place]
