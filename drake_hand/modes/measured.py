"""`State` of hand and object, and what predicates measure of it: gaps, relative velocities, clearances."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drake_hand.errors import InputError
from drake_hand.plans.tolerances import LEVER_M

Where = str | Sequence[str] | np.ndarray
"""Joint or pair of bodies in which a value was found; one per row where there are rows."""


@dataclass(frozen=True, kw_only=True)
class State:
    """Values of the automaton's variables X and of their rates: of one state, or of N in rows (a leading axis).

    Raises:
        InputError: an array has the wrong shape or a number is not finite.
    """

    q: np.ndarray
    """(..., nq) commanded joints, rad."""
    X_WO: np.ndarray
    """(..., 4, 4) object pose."""
    v: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(..., nq) rad/s; at rest if not given."""
    V_WO: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(..., 6) angular and translational velocity of the object in W, rad/s and m/s; at rest if not given."""

    def __post_init__(self) -> None:
        rows = self.q.shape[:-1]
        if not self.v.size:
            object.__setattr__(self, "v", np.zeros_like(self.q))
        if not self.V_WO.size:
            object.__setattr__(self, "V_WO", np.zeros((*rows, 6)))
        shapes = {"q": self.q.shape, "X_WO": (*rows, 4, 4), "v": self.q.shape, "V_WO": (*rows, 6)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise InputError("not a state", key=name, found=value, expected=f"finite numbers of shape {shape}")


@dataclass(frozen=True, kw_only=True)
class RelativeVelocity:
    """Of a fingertip relative to the object, in W, m/s."""

    contact: np.ndarray
    """(..., 3) of the tip's material at the contact point."""
    centre: np.ndarray
    """(..., 3) of the tip centre."""
    nhat_W: np.ndarray
    """(..., 3) outward normal of the object."""

    @property
    def normal(self) -> np.ndarray:
        """(...) along the normal, positive where the tip departs."""
        return np.sum(self.contact * self.nhat_W, axis=-1)


@dataclass(frozen=True, kw_only=True)
class Joints:
    """Names and limits of a hand's commanded joints, in the order of q."""

    names: tuple[str, ...]
    lower: np.ndarray
    """(nq,) rad."""
    upper: np.ndarray


class Measured(ABC):
    """A state, or states in rows, and those after them where jumps are in question, as predicates see them.

    How gaps, velocities and clearances are found is up to those who derive from it: the planner and the certificate
    judge by the same clauses and share no other code.
    """

    state: State
    after: State | None
    """X' of a jump; X itself if not given."""
    joints: Joints

    @property
    @abstractmethod
    def gaps(self) -> dict[str, np.ndarray]:
        """Signed distance (...) of every finger's spherical tip from the object, m."""

    @abstractmethod
    def velocity(self, finger: str) -> RelativeVelocity:
        """How a fingertip moves relative to the object."""

    @property
    @abstractmethod
    def clearance(self) -> tuple[np.ndarray, Where]:
        """Smallest distance (...) of all pairs that may not overlap, fingertips on the object left out, m; the pair."""

    @property
    def limit_margin(self) -> tuple[np.ndarray, Where]:
        """Smallest distance (...) of a joint from its limits, rad, and the joint."""
        margins = np.minimum(self.state.q - self.joints.lower, self.joints.upper - self.state.q)
        return margins.min(axis=-1), self._names(margins.argmin(axis=-1))

    @property
    def speed(self) -> tuple[np.ndarray, Where]:
        """Largest joint speed (...), rad/s, and the joint."""
        speeds = np.abs(self.state.v)
        return speeds.max(axis=-1), self._names(speeds.argmax(axis=-1))

    @property
    def joint_jump(self) -> tuple[np.ndarray, Where]:
        """Largest change (...) of a joint, rad, and the joint."""
        change = np.abs((self.after or self.state).q - self.state.q)
        return change.max(axis=-1), self._names(change.argmax(axis=-1))

    @property
    def object_jump(self) -> np.ndarray:
        """(...) how far the object moves in a jump, m."""
        return displacement((self.after or self.state).X_WO, self.state.X_WO)

    def _names(self, column: np.ndarray) -> Where:
        return self.joints.names[int(column)] if column.ndim == 0 else np.array(self.joints.names)[column]


def displacement(X: np.ndarray, X_from: np.ndarray) -> np.ndarray:
    """(...) how far a pose (..., 4, 4) is from another, m: shift of the origin plus rotation at `LEVER_M`."""
    shift = np.linalg.norm(X[..., :3, 3] - X_from[..., :3, 3], axis=-1)
    # the chord |R - R'| / sqrt 2 is the angle where it is small
    turn = np.linalg.norm(X[..., :3, :3] - X_from[..., :3, :3], axis=(-2, -1)) / np.sqrt(2)
    return shift + LEVER_M * turn
