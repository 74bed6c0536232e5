"""An upper bound, over all postures, of the joint torques due to the hand's own weight. Needs no Drake."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np

from drake_hand.model.gravity import STANDARD_GRAVITY
from drake_hand.model.inertia import Inertial
from drake_hand.model.meshes import find_mesh
from drake_hand.model.urdf import Joint, Urdf
from drake_hand.model.xml import Source


def weight_torques(urdf: Urdf, joints: Iterable[Joint]) -> float:
    """Largest torque that the links beyond any of these joints can put on it in the stretched finger, Nm.

    Raises:
        InputError: an inertia with wrong numbers.
    """
    centre: dict[str, tuple[float, np.ndarray]] = {}
    for name, link in urdf.link_elements.items():
        key = f"link {name}: inertial"
        stated = Inertial.read(
            link, Source(file=urdf.file, key=key, find_mesh=partial(find_mesh, file=urdf.file, key=key))
        )
        centre[name] = stated.mass, stated.p_LCom
    most = 0.0
    for joint in joints:
        torque, beyond = 0.0, [(joint.child, np.eye(4))]
        for name, X_JL in beyond:
            mass, p_LCom = centre[name]
            torque += STANDARD_GRAVITY * mass * float(np.linalg.norm(X_JL[:3, :3] @ p_LCom + X_JL[:3, 3]))
            beyond += [(j.child, X_JL @ j.X_PC) for j in urdf.joints.values() if j.parent == name]
        most = max(most, torque)
    return most
