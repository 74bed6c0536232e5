"""`PoseSeen`: where the object was seen, and when; `PoseSource`: whatever sees it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True, kw_only=True)
class PoseSeen:
    """One measurement of the object's pose."""

    t: float
    """When the picture was taken, s from the start of the plan; not when it arrived."""
    X_WO: np.ndarray
    """(4, 4) pose of the object in the wrist frame."""


class PoseSource(Protocol):
    """Something that sees the object: a camera, motion capture, a recording, a simulated sensor."""

    def poll(self, t: float) -> PoseSeen | None:
        """The newest pose that has arrived since it was last asked, or None. Never waits.

        Args:
            t: now, s from the start of the plan.
        """
        ...
