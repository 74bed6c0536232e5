"""`Situation`: a state as predicates measure it in a scene, with the planner's kinematics of finger and surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kinematics import ObjectMotion, slip_velocity
from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.modes.measured import Joints, Measured, RelativeVelocity, State

if TYPE_CHECKING:
    from drake_hand.model.object import Object
    from drake_hand.model.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Situation(Measured):
    """One state of a scene, and the one after it where a jump is in question."""

    scene: Scene
    state: State
    after: State | None = None

    @property
    def joints(self) -> Joints:  # type: ignore[override]
        """Of the scene's hand."""
        hand = self.scene.hand
        return Joints(names=hand.joints, lower=hand.q_lower, upper=hand.q_upper)

    @cached_property
    def gaps(self) -> dict[str, np.ndarray]:
        """Signed distance of every finger's spherical tip from the object, m."""
        fingers = self.scene.hand.fingers
        return {f.name: d - f.radius for f, d in zip(fingers, self._nearest[1], strict=True)}

    def velocity(self, finger: str) -> RelativeVelocity:
        """How a fingertip moves relative to the object."""
        hand, state = self.scene.hand, self.state
        f = hand.finger(finger)
        kinematics = FingerKinematics.of(hand, f)
        q, v = state.q[None, f.columns], state.v[None, f.columns]
        motion = ObjectMotion(X_WO=state.X_WO[None], V_WO=state.V_WO[None], A_WO=np.zeros((1, 6)))
        p_WC, _, J, _ = kinematics.jacobian(q)
        carried = state.V_WO[3:] + np.cross(state.V_WO[:3], p_WC[0] - state.X_WO[:3, 3])
        return RelativeVelocity(
            contact=slip_velocity(kinematics, Surface.of(object_of(self.scene)), q, v, motion)[0],
            centre=J[0] @ v[0] - carried,
            nhat_W=state.X_WO[:3, :3] @ self._nearest[0][f.index],
        )

    @cached_property
    def _nearest(self) -> tuple[np.ndarray, np.ndarray]:
        """Outward normal in O (n, 3) at the surface point nearest to each tip centre, and its distance (n,)."""
        self.scene.set(self.state.q, self.state.X_WO)
        p_WC = np.stack([self.scene.tip_position(f) for f in self.scene.hand.fingers])
        p_OC = (p_WC - self.state.X_WO[:3, 3]) @ self.state.X_WO[:3, :3]
        return Surface.of(object_of(self.scene)).closest(p_OC)[1:]

    @cached_property
    def clearance(self) -> tuple[np.ndarray, str]:
        """Smallest distance of all pairs that may not overlap, fingertips on the object left out, m, and the pair."""
        hand = self.scene.hand
        self.scene.set(self.state.q, self.state.X_WO)
        pairs = self.scene.clearances(0.02, exclude=[f.name for f in hand.fingers])
        a, b, distance = min(pairs, key=lambda pair: pair[2], default=("nothing", "nothing", 0.02))
        return np.array(distance), f"{a} and {b}"


def object_of(scene: Scene) -> Object:
    """The object of a scene.

    Raises:
        InputError: it has none.
    """
    if scene.object is None:
        raise InputError("the scene has no object", expected="a scene made with one")
    return scene.object
