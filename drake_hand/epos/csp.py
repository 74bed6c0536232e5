"""`CspBackend`: a target position each SYNC for an EPOS4, which reaches it by the next SYNC."""

from __future__ import annotations

from drake_hand.epos.axis import AxisState
from drake_hand.epos.pdo import LAYOUT
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.state import Control


class CspBackend:
    """One EPOS4 in cyclic synchronous position mode; also what the position mode does.

    Args:
        schedule: the motion.
        column: of the drive.
    """

    def __init__(self, schedule: Schedule, column: int) -> None:
        self._counts, self._last = schedule.counts[:, column], schedule.last
        self._command = LAYOUT[schedule.drives.drives[column].type].command

    def prime(self, first: int, last: int) -> list[bytes]:
        """Nothing: there is no queue."""
        self._last = last
        return []

    def primed(self, axis: AxisState) -> bool:
        """Always."""
        return True

    def hold(self, controlword: int, counts: int) -> bytes:
        """Control word and the target that stays."""
        return self._command.pack(controlword, counts)

    def command(self, j: int) -> bytes | None:
        """The row after: it is reached by the next SYNC."""
        return self._command.pack(Control.ENABLE, int(self._counts[min(j + 1, self._last)]))

    def feed(self, j: int, axis: AxisState) -> list[bytes]:
        """Nothing."""
        return []

    def playing(self, axis: AxisState) -> bool:
        """As bit 12 of the status word says: it follows its target."""
        return axis.active

    def low(self, j: int, axis: AxisState) -> bool:
        """Never: there is no queue."""
        return False
