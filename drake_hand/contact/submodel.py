"""`Submodel`: how one finger relates to the object, and the Gruebler count of the chains that this closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

from drake_hand.model.hand import Finger

BODY_FREEDOM = 6
"""Freedoms of a rigid body in space, hence of the virtual joint between wrist and object."""


Model = Literal["rolling", "pivot"]
"""Of contacts that do not slip: the tip rolls over the object, or (in the paper) its centre stays where it is there."""


class Submodel(IntEnum):
    """How one finger relates to the object; the value is its digit in a mode code (paper, Figs. 6-8)."""

    FREE = 0
    """The fingertip moves through space; tip coordinates x, y, z are given."""
    ROLL = 1
    """The fingertip rolls on the object without slipping; the object's pose is given."""
    SLIDE = 2
    """The fingertip stays on the surface; the object's pose and the sliding coordinates s1, s2 are given."""

    @property
    def touches(self) -> bool:
        """Whether the finger is in contact with the object."""
        return self is not Submodel.FREE

    @property
    def word(self) -> str:
        """``free``, ``rolling`` or ``sliding``."""
        return ("free", "rolling", "sliding")[self]

    @property
    def contact_freedom(self) -> int:
        """Freedoms of the joint between fingertip and object in the paper's chain.

        Rolling is a Kardan joint (xi1, xi2; no spin about the normal); sliding adds s1 and s2 to it; a free finger
        has no contact joint at all.
        """
        return (0, 2, 4)[self]

    @property
    def constraint(self) -> str:
        """What it constrains, in words."""
        return (
            "none; tip clear of the object",
            "tip on the surface, no slip",
            "tip on the surface; s1, s2 imposed",
        )[self]


@dataclass(frozen=True, kw_only=True)
class Mechanism:
    """Joints and bodies of closed chains, counted after Gruebler.

    The chain of one finger (paper, Figs. 6-8) consists of the finger's m one-axis joints (a Kardan joint is two of
    them), the virtual six-freedom joint that carries the object on the wrist frame, and the contact joint between
    fingertip and object. The bodies that move are the finger's m links and the object. So n_G = m + 2, n_B = m + 1,
    there is n_L = 1 loop, and m + 6 + contact - 6 = m + contact freedoms are left: 6 rolling and 8 sliding for four
    axes. A free finger's chain closes as well: the virtual joint then carries the fingertip itself (x, y, z and
    orientation), object and contact joint drop out, n_G = m + 1, n_B = m, n_L = 1, and m freedoms are left: 4.
    """

    joint_freedoms: tuple[int, ...]
    """Freedoms of each joint."""
    bodies: int
    """n_B, moving bodies."""
    couplings: int = 0
    """Joints that follow another one (``<mimic>``)."""

    @property
    def joints(self) -> int:
        """n_G, number of joints."""
        return len(self.joint_freedoms)

    @property
    def loops(self) -> int:
        """n_L = n_G - n_B, number of independent loops (paper, Eq. 1)."""
        return self.joints - self.bodies

    @property
    def dof(self) -> int:
        """Freedoms after Gruebler: those of all joints less six a loop. As in the paper, couplings are not counted."""
        return sum(self.joint_freedoms) - BODY_FREEDOM * self.loops

    @property
    def commanded_dof(self) -> int:
        """Freedoms left when each coupling takes one away."""
        return self.dof - self.couplings


@dataclass(frozen=True, kw_only=True)
class JointCount:
    """Joints of one finger."""

    axes: int
    """Moving one-axis joints, coupled ones included."""
    couplings: int = 0
    """How many of them follow another one (``<mimic>``)."""

    @classmethod
    def of(cls, finger: Finger) -> JointCount:
        """The joints of a hand's finger."""
        return cls(axes=len(finger.axes), couplings=len(finger.axes) - len(finger.joints))


def finger_mechanism(finger: JointCount, submodel: Submodel) -> Mechanism:
    """The closed chain of one finger on its own (paper, "Inverse Kinematics at Position Level")."""
    return hand_mechanism([finger], [submodel], object_moves=submodel.touches)


def hand_mechanism(
    fingers: Sequence[JointCount], submodels: Sequence[Submodel], *, object_moves: bool = True
) -> Mechanism:
    """All chains of a hand together: they share the object and its virtual joint (paper, Fig. 9).

    Args:
        fingers: joints of each.
        submodels: one for each finger.
        object_moves: whether the object is among the bodies; without any contact it may stand still instead.

    Returns:
        A mechanism of one loop per finger, in contact or free.
    """
    freedoms = [BODY_FREEDOM] * object_moves
    for finger, submodel in zip(fingers, submodels, strict=True):
        freedoms += [1] * finger.axes + [submodel.contact_freedom if submodel.touches else BODY_FREEDOM]
    return Mechanism(
        joint_freedoms=tuple(freedoms),
        bodies=object_moves + sum(f.axes for f in fingers),
        couplings=sum(f.couplings for f in fingers),
    )
