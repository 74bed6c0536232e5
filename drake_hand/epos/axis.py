"""`AxisState`: what the master knows of one drive while the SYNC runs, from its frames."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass

from drake_hand.epos.drives import Drive
from drake_hand.epos.objects import IP_ERRORS
from drake_hand.epos.pdo import LAYOUT, Layout
from drake_hand.epos.state import BIT12, DriveState, decode_state


@dataclass(slots=True)
class AxisState:
    """Last known state of one drive; owned by the bus thread."""

    drive: Drive
    statusword: int = 0
    state: DriveState = DriveState.UNKNOWN
    position: int = 0
    """counts."""
    current_ma: int = 0
    queued: int = 0
    """PVT records waiting in the drive when it last answered."""
    ip_status: int = 0
    answered: bool = False
    """Whether it answered the last SYNC."""
    missed: int = 0
    """SYNCs in a row it did not answer."""
    heard: float = 0.0
    """Time of its last heartbeat, s."""
    still: int = 0
    """Answers in a row with the position of the one before."""

    @property
    def layout(self) -> Layout:
        """The PDOs of its drive type."""
        return LAYOUT[self.drive.type]

    @property
    def active(self) -> bool:
        """Bit 12 of the status word: in the motion (PVT), following (CSP)."""
        return bool(self.statusword & BIT12)

    @property
    def queue_error(self) -> bool:
        """Whether its PVT queue reports an error."""
        return bool(self.ip_status & IP_ERRORS)

    def take_status(self, data: bytes) -> bool:
        """Takes a status PDO; false for one of the wrong length."""
        try:
            self.statusword, position, *queued = self.layout.status.unpack(data)
        except struct.error:
            return False
        self.still = self.still + 1 if abs(position - self.position) <= 1 else 0
        self.position, self.state = position, decode_state(self.statusword, self.drive.type)
        if queued:
            self.queued = queued[0]
        self.answered, self.missed = True, 0
        return True

    def take_current(self, data: bytes) -> None:
        """Takes a current PDO; one of the wrong length is left."""
        with suppress(struct.error):
            (self.current_ma,) = self.layout.current.unpack(data)

    def take_interpolation(self, data: bytes) -> bool:
        """Takes an interpolation status PDO; false for one of the wrong length."""
        if len(data) < 2:
            return False
        self.ip_status = int.from_bytes(data[:2], "little")
        return True

    def __str__(self) -> str:
        return f"{self.drive.joint} (node {self.drive.node})"
