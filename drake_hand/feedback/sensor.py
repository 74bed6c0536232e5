"""`PoseSensor`: how well a sensor sees the object; `SimulatedSensor`: one that sees a simulated object that well."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.errors import InputError
from drake_hand.feedback.pose import PoseSeen


@dataclass(frozen=True, kw_only=True)
class PoseSensor:
    """A sensor of the object's pose. The defaults are those of a camera that tracks a marker."""

    rate_hz: float = 30.0
    """Pictures a second."""
    latency_ms: float = 30.0
    """From the picture to its pose."""
    noise_mm: float = 0.5
    """Standard deviation of the position along each axis."""
    noise_deg: float = 1.0
    """Standard deviation of the rotation about each axis."""
    dropout: float = 0.02
    """Share of pictures in which the object is not found."""

    def __post_init__(self) -> None:
        for key, value, most in (
            ("rate_hz", self.rate_hz, 1e3),
            ("latency_ms", self.latency_ms, 300.0),
            ("noise_mm", self.noise_mm, 100.0),
            ("noise_deg", self.noise_deg, 90.0),
            ("dropout", self.dropout, 1.0),
        ):
            if not (0.0 <= value <= most and (value > 0 or key != "rate_hz")):
                expected = f"{'above 0' if key == 'rate_hz' else '0'} to {most:g}"
                raise InputError("impossible sensor", key=key, found=value, expected=expected)


class SimulatedSensor:
    """Sees the object as a :class:`PoseSensor` would."""

    def __init__(self, sensor: PoseSensor, seed: int | tuple[int, ...]) -> None:
        self.sensor = sensor
        self._rng = np.random.default_rng(seed)
        self._under_way: deque[PoseSeen] = deque()
        self._taken = 0

    def observe(self, t: float, X_WO: np.ndarray) -> None:
        """Takes a picture if one is due.

        Args:
            t: now, s from the start of the plan; must not decrease.
            X_WO: (4, 4) where the object is.
        """
        if t < self._taken / self.sensor.rate_hz - 1e-9:
            return
        self._taken += 1
        shift, turn = self._rng.normal(size=(2, 3)) * [[self.sensor.noise_mm * 1e-3], [self.sensor.noise_deg]]
        if self._rng.uniform() < self.sensor.dropout:
            return
        X = X_WO.copy()
        X[:3, :3] = Rotation.from_rotvec(turn, degrees=True).as_matrix() @ X_WO[:3, :3]
        X[:3, 3] += shift
        self._under_way.append(PoseSeen(t=t, X_WO=X))

    def poll(self, t: float) -> PoseSeen | None:
        """The newest pose that has arrived, as :class:`drake_hand.feedback.pose.PoseSource` says."""
        seen = None
        while self._under_way and self._under_way[0].t + self.sensor.latency_ms * 1e-3 <= t + 1e-9:
            seen = self._under_way.popleft()
        return seen
