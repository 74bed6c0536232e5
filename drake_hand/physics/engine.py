"""What the engines have in common: `Engine`, what is not as planned in a run, and what fingertips do to the object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.model.hand import PadSpec

EngineName = Literal["drake", "mujoco"]


@dataclass(frozen=True, kw_only=True)
class Perturbation:
    """What is not as planned in a run."""

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

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Perturbation:
        """Friction, mass and stiffness within 20 %, the start 1 mm and 2 deg off in random directions."""

        def direction(size: float) -> tuple[float, float, float]:
            a = rng.normal(size=3)
            x, y, z = size * a / np.linalg.norm(a)
            return float(x), float(y), float(z)

        friction, mass, stiffness = (float(x) for x in rng.uniform(0.8, 1.2, 3))
        return cls(friction=friction, mass=mass, stiffness=stiffness, shift_mm=direction(1.0), turn_deg=direction(2.0))

    def start(self, X_WO: np.ndarray) -> np.ndarray:
        """The (4, 4) start pose in place of the planned one."""
        X = X_WO.copy()
        X[:3, :3] = Rotation.from_rotvec(self.turn_deg, degrees=True).as_matrix() @ X_WO[:3, :3]
        X[:3, 3] += np.array(self.shift_mm) * 1e-3
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


def stiffer(pad: PadSpec, stiffness: float) -> PadSpec:
    """A pad whose material is stiffer by a factor."""
    return msgspec.structs.replace(
        pad,
        hydroelastic_modulus_pa=pad.hydroelastic_modulus_pa * stiffness,
        point_stiffness_n_m=pad.point_stiffness_n_m * stiffness,
    )
