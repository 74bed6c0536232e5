"""How an error of the object's pose propagates through contacts that are springs.

Along a contact's normal, a finger pulls the object to where it is planned; along the surface it holds it where it was
when it took hold, since a tip that sticks, or rolls, does not slide back. A sliding tip holds nothing there. So
e = K^-1 sum G k_t a, where K is the stiffness of all contacts together, G the grasp matrix of each, k_t the tangential
part of its stiffness, and a the error of its point as it took hold. Left out are gravity, the shape of the surface
beside the contact, and slip.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from drake_hand.contact.chain import FingerKinematics, material_jacobian, skew
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand

START_MM, START_DEG = 1.0, 2.0
"""An error of this position and this rotation together has size 1."""
SCALE = 1 / np.sqrt(2) / np.repeat([np.radians(START_DEG), START_MM * 1e-3], 3)
"""(6,) what makes sizes of errors: of a rotation in rad and a displacement in m."""
_STIFFEST_M_PER_N = 1e-8
"""What a contact yields at least; a finger may be rigid in a direction."""


@dataclass(frozen=True, kw_only=True)
class ContactSpring:
    """A finger's contact, in W."""

    G: np.ndarray
    """(6, 3) grasp matrix about the object's mass centre."""
    stiffness: np.ndarray
    """(3, 3) of finger and pad, N/m."""
    nhat: np.ndarray
    """(3,) the object's outward normal."""

    @classmethod
    def of(
        cls, hand: Hand, finger: int, q: np.ndarray, surface: Surface, X_WO: np.ndarray, p_OCom: np.ndarray
    ) -> ContactSpring:
        """The contact of a finger by its index, at its joints q (m,), with an object at X_WO (4, 4)."""
        f, R_WO = hand.fingers[finger], X_WO[:3, :3]
        p_WC, _, J, Jw = FingerKinematics.of(hand, f).jacobian(q[None])
        nhat = R_WO @ surface.closest(((p_WC[0] - X_WO[:3, 3]) @ R_WO)[None])[1][0]
        J_P = material_jacobian(J, Jw, f.radius * nhat[None])[0]
        yields = J_P / hand.stiffness[f.columns] @ J_P.T + np.outer(nhat, nhat) / hand.pad.point_stiffness_n_m
        r = p_WC[0] - f.radius * nhat - (R_WO @ p_OCom + X_WO[:3, 3])
        stiffness = np.linalg.inv(yields + _STIFFEST_M_PER_N * np.eye(3))
        return cls(G=np.vstack([skew(r), np.eye(3)]), stiffness=stiffness, nhat=nhat)


@dataclass
class ErrorGrowth:
    """What has become of errors at the start."""

    gain: np.ndarray = field(default_factory=lambda: np.eye(6))
    """(6, 6) linear map: rotation in rad, displacement of the mass centre in m, in W."""
    _taken: dict[int, np.ndarray] = field(default_factory=dict)
    """(3, 6) by finger: of its contact's point as it took hold."""

    def settle(self, contacts: dict[int, ContactSpring], sliding: Collection[int] = ()) -> None:
        """The object comes to rest among contacts, by finger; those not named have let go, some may slide."""
        self._taken = {f: a for f, a in self._taken.items() if f in contacts}
        K, pulled = np.zeros((6, 6)), np.zeros((6, 6))
        for f, contact in contacts.items():
            across = np.outer(contact.nhat, contact.nhat)
            along = np.zeros((3, 3)) if f in sliding else np.eye(3) - across
            a = self._taken[f] = along @ self._taken.get(f, contact.G.T @ self.gain)
            held = contact.G @ (along + across) @ contact.stiffness
            K += held @ (along + across) @ contact.G.T
            pulled += held @ a
        self.gain = np.linalg.lstsq(K, pulled, rcond=1e-9)[0]


def worst(gain: np.ndarray) -> float:
    """Largest error that a map (6, 6) makes of one of size 1."""
    return float(np.linalg.norm(SCALE[:, None] * gain / SCALE, 2))
