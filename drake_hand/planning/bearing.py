"""How much of the object's weight single contacts can bear: what heavy objects are held by.

Of forces inside the friction cone, along the normal and near the edge of the cone, as much as servos' efforts allow. Of
the most that is 99 % in the median, seldom less than 90, and as quickly asked as a contact is found.
"""

from __future__ import annotations

import numpy as np

from drake_hand.contact.chain import material_jacobian
from drake_hand.contact.forces import tangents_to
from drake_hand.planning.moves import Moves

AMPLE_BEARING_RATIO = 2.5
"""So many times the object's weight the best contacts of all fingers together have to bear for none to be short of it:
each of them is at its best elsewhere, and they also have to balance torques."""
DIRECTIONS, FRICTION_SHARES = 8, (0.5, 1.0)
"""Of forces looked at: so many all round, at these shares of the friction there is; and the normal."""
_LEAST_TORQUE_M = 1e-6
"""Lever of a force that a servo does not feel, m."""


def bearing(moves: Moves, finger: int, q: np.ndarray, n_W: np.ndarray) -> np.ndarray:
    """(N,) how much of the object's weight single contacts of a finger can bear, torques left aside.

    Args:
        moves: which know what has to be held.
        finger: its index.
        q: (N, m) rad.
        n_W: (N, 3) outward normals.

    Returns:
        In weights of the object; infinite where only kinematics counts.
    """
    load, f = moves.load, moves.clearance.hand.fingers[finger]
    weight, m = np.linalg.norm(load.force_W), len(f.columns)
    if load.kinematic or weight == 0.0:
        return np.full(len(q), np.inf)
    _, _, J, Jw = moves.clearance.kinematics[finger].jacobian(q[:, :m])
    around = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    circle = load.friction * np.stack([np.cos(around), np.sin(around)], axis=1)
    sideways = np.concatenate([np.zeros((1, 2)), *(share * circle for share in FRICTION_SHARES)])
    f_W = -n_W[:, None] + sideways @ np.stack(tangents_to(n_W), axis=1)
    torque = np.abs(f_W @ material_jacobian(J, Jw, f.radius * n_W))
    most = (load.effort[finger, :m] / np.maximum(torque, _LEAST_TORQUE_M)).min(axis=2)
    return np.maximum((most * (f_W @ -load.force_W)).max(axis=1, initial=0.0) / weight**2, 0.0)
