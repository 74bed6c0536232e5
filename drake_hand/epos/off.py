"""`switch_off`: every drive that can be reached to "switch on disabled", whatever state it is in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import can

from drake_hand.epos import objects as od
from drake_hand.epos.drives import Drive
from drake_hand.epos.master import NMT_PRE_OPERATIONAL, Master, SdoError, for_all
from drake_hand.epos.state import Control, DriveState, decode_state, status_words
from drake_hand.errors import DriveError

_OFF_ATTEMPTS = 3
_WORDS = (Control.DISABLE_VOLTAGE, Control.FAULT_RESET, Control.DISABLE_VOLTAGE)
"""Power off; then the rising edge that resets a fault."""


@dataclass(frozen=True, kw_only=True)
class Off:
    """What became of one drive."""

    drive: Drive
    before: str = ""
    """Its state as it was found; empty when it did not answer."""
    problem: str = ""
    """Why it is not known to be off; empty when it was read back as such."""


def switch_off(master: Master, drives: Sequence[Drive]) -> list[Off]:
    """Takes the power off at once, moving or not, resets faults, ends what an earlier master has configured.

    A drive is off when its status word reads "switch on disabled" afterwards. It no longer watches for a master then.

    Args:
        master: on the bus of the drives.
        drives: which.

    Raises:
        DriveError: the bus takes no frames.
    """
    try:
        master.nmt(NMT_PRE_OPERATIONAL)  # no pending or foreign PDO acts; a stopped node answers SDO again
    except can.CanError as e:
        raise DriveError(f"the bus takes no frames: {e}; cut the supply") from e
    return for_all(lambda d: _one(master, d), drives)


def _one(master: Master, drive: Drive) -> Off:
    before = ""
    try:
        before = decode_state(master.read(drive.node, od.STATUSWORD), drive.type).value
        for _ in range(_OFF_ATTEMPTS):
            for word in _WORDS:
                master.write(drive.node, od.CONTROLWORD, word)
            master.write(drive.node, od.CONSUMER_HEARTBEAT, 0)
            status = master.read(drive.node, od.STATUSWORD)
            if decode_state(status, drive.type) is DriveState.SWITCH_ON_DISABLED:
                return Off(drive=drive, before=before)
    except SdoError as e:
        return Off(drive=drive, before=before, problem=f"{drive.joint}: {e}")
    stays = f"{drive.joint} (node {drive.node}): stays {status_words(status, drive.type)}"
    return Off(drive=drive, before=before, problem=stays)
