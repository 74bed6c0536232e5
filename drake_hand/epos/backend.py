"""`Backend`: how one drive is made to follow its column of the schedule; one class per drive type."""

from __future__ import annotations

from typing import Protocol

from drake_hand.epos.axis import AxisState


class Backend(Protocol):
    """Plays one column of a schedule on one drive.

    It is played stretch by stretch, from rest to rest. Step j is latched by the SYNC at which the demand is row j.
    """

    def prime(self, first: int, last: int) -> list[bytes]:
        """Takes up the stretch from row `first` to `last`; records to load before it, payloads of the record PDO."""

    def primed(self, axis: AxisState) -> bool:
        """Whether the drive has all of them and no complaint."""

    def hold(self, controlword: int, counts: int) -> bytes:
        """Command PDO outside the motion: a control word, the target staying at `counts`."""

    def command(self, j: int) -> bytes | None:
        """Command PDO of step j; None where the drive needs no new one."""

    def feed(self, j: int, axis: AxisState) -> list[bytes]:
        """Records to send after the SYNC of step j, payloads of the record PDO."""

    def playing(self, axis: AxisState) -> bool:
        """Whether the drive is in the motion, as far as it shows."""

    def low(self, j: int, axis: AxisState) -> bool:
        """Whether the drive is about to run out of set values at step j."""
