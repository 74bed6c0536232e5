"""What the engines have in common: `Engine`, perturbations of a run, and the forces of fingertips on the object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand, PadSpec
from drake_hand.model.table import Table

EngineName = Literal["drake", "mujoco"]


@dataclass(frozen=True, kw_only=True)
class PushForce:
    """A force that acts once in a run, from any side, while the plan is played. A short one is a tap."""

    push_n: float = 2.0
    """How hard."""
    push_ms: float = 50.0
    """For how long."""

    def __post_init__(self) -> None:
        for key, value, most in (("push_n", self.push_n, 100.0), ("push_ms", self.push_ms, 1000.0)):
            if not 0.0 < value <= most:
                raise InputError("impossible push", key=key, found=value, expected=f"above 0 to {most:g}")


@dataclass(frozen=True, kw_only=True)
class Perturbation:
    """How a run deviates from the plan."""

    friction: float = 1.0
    """Factor."""
    mass: float = 1.0
    """Factor on the object's mass."""
    stiffness: float = 1.0
    """Factor on servo and pad stiffness."""
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the object's start position, in W."""
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector of the object's start orientation, in W."""
    push_n: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Force on the object's mass centre, in W ..."""
    push_s: tuple[float, float] = (0.0, 0.0)
    """... from when to when."""

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Perturbation:
        """Friction, mass and stiffness within 20 %, the start 1 mm and 2 deg off in random directions."""
        friction, mass, stiffness = (float(x) for x in rng.uniform(0.8, 1.2, 3))
        shift, turn = _direction(rng, 1.0), _direction(rng, 2.0)
        return cls(friction=friction, mass=mass, stiffness=stiffness, shift_mm=shift, turn_deg=turn)

    def pushed(self, push: PushForce, window: tuple[float, float], rng: np.random.Generator) -> Perturbation:
        """The same with a push from a random direction, in the middle third of a time window, s."""
        begin = window[0] + float(rng.uniform(1 / 3, 2 / 3)) * (window[1] - window[0])
        return replace(self, push_n=_direction(rng, push.push_n), push_s=(begin, begin + push.push_ms * 1e-3))

    def push_during(self, start: float, end: float) -> np.ndarray:
        """(3,) mean of the push between two times, N."""
        both = max(0.0, min(end, self.push_s[1]) - max(start, self.push_s[0]))
        return np.array(self.push_n) * both / (end - start)

    def start(self, X_WO: np.ndarray, table: Table | None = None) -> np.ndarray:
        """The (4, 4) start pose in place of the planned one; still on the table, if there is one."""
        turn, shift = np.array(self.turn_deg), np.array(self.shift_mm) * 1e-3
        if table is not None:
            turn, shift = table.up_W * (table.up_W @ turn), shift - table.up_W * (table.up_W @ shift)
        X = X_WO.copy()
        X[:3, :3] = Rotation.from_rotvec(turn, degrees=True).as_matrix() @ X_WO[:3, :3]
        X[:3, 3] += shift
        return X


@dataclass(frozen=True, kw_only=True)
class Touch:
    """What the fingertips do to the object at an instant. Fingers in the hand's order."""

    f_W: np.ndarray
    """(fingers, 3) force on the object, N; zero where a tip does not touch."""
    p_W: np.ndarray
    """(fingers, 3) point where it acts, m; NaN where a tip does not touch."""
    slip_W: np.ndarray
    """(fingers, 3) velocity of the tip's surface over the object's, m/s; zero where a tip does not touch."""
    strays: tuple[str, ...]
    """Pairs of links that touch, other than a fingertip and the object."""


class Engine(Protocol):
    """A simulated hand that follows commands over time, and the object, held by a fixture until :meth:`let_go`."""

    def let_go(self) -> None:
        """Takes the fixture away."""

    def take_back(self) -> None:
        """Has the fixture hold the object again, where it is."""

    def advance(self, t: float) -> None:
        """Simulates up to time t, s."""

    def correct(self, dq: np.ndarray) -> None:
        """Adds dq (nq,) to the commands from now on."""

    def push(self, f_W: np.ndarray) -> None:
        """Has a force f_W (3,) act on the object's mass centre from now on, N."""

    @property
    def q(self) -> np.ndarray:
        """(nq,) joints now, rad."""
        ...

    @property
    def X_WO(self) -> np.ndarray:
        """(4, 4) object pose now."""
        ...

    def touch(self) -> Touch:
        """Contacts now."""
        ...


def _direction(rng: np.random.Generator, size: float) -> tuple[float, float, float]:
    a = rng.normal(size=3)
    x, y, z = size * a / np.linalg.norm(a)
    return float(x), float(y), float(z)


def joint_values(hand: Hand, q: np.ndarray) -> dict[str, float]:
    """Positions of every joint of the fingers, those that follow others too, at commanded joints q (nq,)."""
    return {
        axis.joint: axis.multiplier * q[finger.columns[axis.source]] + axis.offset
        for finger in hand.fingers
        for axis in finger.axes
    }


def stiffer(pad: PadSpec, stiffness: float) -> PadSpec:
    """A pad whose material is stiffer by a factor."""
    return msgspec.structs.replace(
        pad,
        hydroelastic_modulus_pa=pad.hydroelastic_modulus_pa * stiffness,
        point_stiffness_n_m=pad.point_stiffness_n_m * stiffness,
    )
