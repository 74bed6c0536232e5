"""Parts of a path that were timed before, with the object turned on since: gaits repeat them many times."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.plans.path import Leg
from drake_hand.plans.plan import Contact, Part

_PLAN_DECIMALS = 10
_ALIKE_DECIMALS = 9
"""To which legs are alike: rad, m, N."""


def rounded(values: np.ndarray) -> list:
    """Numbers as a plan states them."""
    return np.round(values, _PLAN_DECIMALS).tolist()


def likeness(legs: Sequence[Leg]) -> bytes:
    """What is the same for the legs of two parts if all that differs is a turn of the object about its own origin.

    Joints, forces, contact points in the world, where the object is and how it turns are.
    """
    R_WO = legs[0].X_WO[0, :3, :3]
    parts = [b"%s %s" % (leg.mode.encode(), " ".join(leg.events).encode()) for leg in legs]
    for leg in legs:
        names = sorted(leg.p_OP)
        X = leg.X_WO[:, :3].copy()
        X[:, :, :3] = X[:, :, :3] @ R_WO.T
        values = [leg.q, X, *(leg.p_OP[name] @ R_WO.T for name in names)]
        values += [] if leg.f_W is None else [leg.f_W[name] for name in names]
        values += [] if leg.q_offset is None else [leg.q_offset]
        parts += [(np.round(x, _ALIKE_DECIMALS) + 0.0).tobytes() for x in values]
    return b"|".join(parts)


def again(leg: Leg, part: Part, now: Leg, before: Part) -> Part:
    """A part as it was, the object turned on.

    Args:
        leg: the first of the part.
        part: as it was.
        now: the first leg of what is like it.
        before: the part that `now` follows.
    """
    R_OO = leg.X_WO[0, :3, :3].T @ now.X_WO[0, :3, :3]
    turn = Rotation.from_matrix(R_OO).as_quat(scalar_first=True)
    X, V = np.array(part.X_WO), np.array(part.V_WO)
    X[:, :4], V[:, :4] = _times(X[:, :4], turn), _times(V[:, :4], turn)
    if np.dot(X[0, :4], before.X_WO[-1][:4]) < 0:
        X[:, :4], V[:, :4] = -X[:, :4], -V[:, :4]
    contacts = {f: Contact(p_OP=rounded(np.array(c.p_OP) @ R_OO), f_W=c.f_W) for f, c in part.contacts.items()}
    t = rounded(np.array(part.t) - part.t[0] + before.t[-1])
    return msgspec.structs.replace(part, t=t, X_WO=rounded(X), V_WO=rounded(V), contacts=contacts)


def _times(quaternions: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(n, 4) quaternions w x y z, or their rates, times another."""
    w, x, y, z = turn
    return quaternions @ np.array([[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
