"""`State` of hand and object, and the `Situation` it makes in a scene: gaps, relative velocities, clearances."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.kinematics import ObjectMotion, slip_velocity
from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError

if TYPE_CHECKING:
    from drake_hand.model.object import Object
    from drake_hand.model.scene import Scene


@dataclass(frozen=True, kw_only=True)
class State:
    """Values of the automaton's variables X and of their rates.

    Raises:
        InputError: an array has the wrong shape or a number is not finite.
    """

    q: np.ndarray
    """(nq,) commanded joints, rad."""
    X_WO: np.ndarray
    """(4, 4) object pose."""
    v: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(nq,) rad/s; at rest if not given."""
    V_WO: np.ndarray = field(default_factory=lambda: np.zeros(6))
    """(6,) angular and translational velocity of the object in W, rad/s and m/s."""

    def __post_init__(self) -> None:
        if not self.v.size:
            object.__setattr__(self, "v", np.zeros_like(self.q))
        for name, shape in {"q": self.q.shape, "X_WO": (4, 4), "v": self.q.shape, "V_WO": (6,)}.items():
            value = getattr(self, name)
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise InputError("not a state", key=name, found=value, expected=f"finite numbers of shape {shape}")


@dataclass(frozen=True, kw_only=True)
class RelativeVelocity:
    """Of a fingertip relative to the object, in W, m/s."""

    contact: np.ndarray
    """(3,) of the tip's material at the contact point."""
    centre: np.ndarray
    """(3,) of the tip centre."""
    nhat_W: np.ndarray
    """(3,) outward normal of the object."""

    @property
    def normal(self) -> float:
        """Along the normal, positive where the tip departs."""
        return float(self.contact @ self.nhat_W)


@dataclass(frozen=True, kw_only=True)
class Situation:
    """A state of a scene, and the one after it where a jump is in question; what predicates measure."""

    scene: Scene
    state: State
    after: State | None = None
    """X' of a jump; X itself if not given."""

    @cached_property
    def gaps(self) -> dict[str, float]:
        """Signed distance of every finger's spherical tip from the object, m."""
        fingers = self.scene.hand.fingers
        distances = self._nearest[1]
        return {f.name: float(d) - f.radius for f, d in zip(fingers, distances, strict=True)}

    def velocity(self, name: str) -> RelativeVelocity:
        """How a fingertip moves relative to the object."""
        hand, state = self.scene.hand, self.state
        finger = hand.finger(name)
        kinematics = FingerKinematics.of(hand, finger)
        q, v = state.q[None, finger.columns], state.v[None, finger.columns]
        motion = ObjectMotion(X_WO=state.X_WO[None], V_WO=state.V_WO[None], A_WO=np.zeros((1, 6)))
        p_WC, _, J, _ = kinematics.jacobian(q)
        carried = state.V_WO[3:] + np.cross(state.V_WO[:3], p_WC[0] - state.X_WO[:3, 3])
        return RelativeVelocity(
            contact=slip_velocity(kinematics, Surface.of(object_of(self.scene)), q, v, motion)[0],
            centre=J[0] @ v[0] - carried,
            nhat_W=state.X_WO[:3, :3] @ self._nearest[0][finger.index],
        )

    @cached_property
    def _nearest(self) -> tuple[np.ndarray, np.ndarray]:
        """Outward normal in O (n, 3) at the surface point nearest to each tip centre, and its distance (n,)."""
        self.scene.set(self.state.q, self.state.X_WO)
        p_WC = np.stack([self.scene.tip_position(f) for f in self.scene.hand.fingers])
        p_OC = (p_WC - self.state.X_WO[:3, 3]) @ self.state.X_WO[:3, :3]
        return Surface.of(object_of(self.scene)).closest(p_OC)[1:]

    @cached_property
    def clearance(self) -> tuple[float, str]:
        """Smallest distance of all pairs that may not overlap, fingertips on the object left out, m, and the pair."""
        hand = self.scene.hand
        self.scene.set(self.state.q, self.state.X_WO)
        pairs = self.scene.clearances(0.02, exclude=[f.name for f in hand.fingers])
        a, b, distance = min(pairs, key=lambda pair: pair[2], default=("nothing", "nothing", 0.02))
        return distance, f"{a} and {b}"

    @cached_property
    def limit_margin(self) -> tuple[float, str]:
        """Smallest distance of a joint from its limits, rad, and the joint."""
        hand, q = self.scene.hand, self.state.q
        margins = np.minimum(q - hand.q_lower, hand.q_upper - q)
        worst = int(margins.argmin())
        return float(margins[worst]), hand.joints[worst]

    @cached_property
    def speed(self) -> tuple[float, str]:
        """Largest joint speed, rad/s, and the joint."""
        worst = int(np.abs(self.state.v).argmax())
        return float(abs(self.state.v[worst])), self.scene.hand.joints[worst]


def object_of(scene: Scene) -> Object:
    """The object of a scene.

    Raises:
        InputError: it has none.
    """
    if scene.object is None:
        raise InputError("the scene has no object", expected="a scene made with one")
    return scene.object
