"""`PositionBackend`: a set value each SYNC for an EPOS 24/1, which has neither a PVT queue nor cyclic position mode.

That the EPOS 24/1 can do no better than maxon's position mode (-1, set value 0x2062) is inferred from the mode list of
a library that drove one. Between set values it does not move: the motion is a staircase of one step per SYNC.
"""

from __future__ import annotations

from drake_hand.epos.axis import AxisState
from drake_hand.epos.csp import CspBackend
from drake_hand.epos.state import DriveState


class PositionBackend(CspBackend):
    """One EPOS 24/1 in position mode: the same frames, the set value in another object."""

    def playing(self, axis: AxisState) -> bool:
        """Enabled: the mode shows nothing else."""
        return axis.state is DriveState.OPERATION_ENABLED
