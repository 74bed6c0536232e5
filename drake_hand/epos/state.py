"""The CiA 402 state machine as EPOS drives show it: states, control words, decoding of status words."""

from __future__ import annotations

from enum import Enum

from drake_hand.epos.objects import DriveType


class DriveState(Enum):
    """States of a drive; the value is how a person reads it."""

    NOT_READY = "not ready"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY_TO_SWITCH_ON = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION = "fault reaction"
    FAULT = "fault"
    UNKNOWN = "unknown"

    @property
    def powered(self) -> bool:
        """Whether the power stage is on."""
        return self in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION)

    @property
    def faulty(self) -> bool:
        """Whether it is in fault or about to be."""
        return self in (DriveState.FAULT, DriveState.FAULT_REACTION)


class Control:
    """Control words (0x6040)."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE = 0x0F
    ENABLE_RUN = 0x1F
    """Enabled + bit 4: interpolation runs, new set-point, homing starts."""
    ENABLE_RUN_AT_ONCE = 0x3F
    """Profile position: new set-point that replaces the running one."""
    HALT = 0x100
    """Bit 8, to be or-ed."""
    FAULT_RESET = 0x80
    """Acts on the rising edge of bit 7."""


REMOTE, TARGET_REACHED, INTERNAL_LIMIT, BIT12, FOLLOWING = 1 << 9, 1 << 10, 1 << 11, 1 << 12, 1 << 13
"""Further bits of the status word; BIT12 is interpolation active, set-point acknowledged or CSP followed."""
HOMED = 1 << 15

_EPOS_MASK = 0x417F
EPOS_STATUS = {
    DriveState.NOT_READY: 0x0100,
    DriveState.SWITCH_ON_DISABLED: 0x0140,
    DriveState.READY_TO_SWITCH_ON: 0x0121,
    DriveState.SWITCHED_ON: 0x0123,
    DriveState.OPERATION_ENABLED: 0x0137,
    DriveState.QUICK_STOP_ACTIVE: 0x0117,
    DriveState.FAULT_REACTION: 0x010F,
    DriveState.FAULT: 0x0108,
}
"""State bits of EPOS 24/1 and EPOS2; bit 8 is always set after boot."""
_EPOS_DECODE = {v: k for k, v in EPOS_STATUS.items()} | {0x011F: DriveState.FAULT_REACTION}
_REFRESH = {0x4123: DriveState.SWITCHED_ON, 0x4133: DriveState.SWITCHED_ON}

_CIA_MASK = 0x006F
EPOS4_STATUS = {
    DriveState.NOT_READY: 0x0000,
    DriveState.SWITCH_ON_DISABLED: 0x0040,
    DriveState.READY_TO_SWITCH_ON: 0x0021,
    DriveState.SWITCHED_ON: 0x0023,
    DriveState.OPERATION_ENABLED: 0x0037,
    DriveState.QUICK_STOP_ACTIVE: 0x0017,
    DriveState.FAULT_REACTION: 0x001F,
    DriveState.FAULT: 0x0008,
}
"""State bits of the EPOS4: plain CiA 402, bit 4 (voltage) with the power stage on."""
_CIA_DECODE = {v & _CIA_MASK: k for k, v in EPOS4_STATUS.items()} | {0x0060: DriveState.SWITCH_ON_DISABLED}


def decode_state(statusword: int, drive_type: DriveType) -> DriveState:
    """The state that a status word (0x6041) means; `State.UNKNOWN` for a word the type never shows."""
    if drive_type == "epos4":
        return _CIA_DECODE.get(statusword & _CIA_MASK, DriveState.UNKNOWN)
    word = statusword & _EPOS_MASK
    return _EPOS_DECODE.get(word) or _REFRESH.get(word, DriveState.UNKNOWN)


def status_bits(state: DriveState, drive_type: DriveType) -> int:
    """The status word of a state, without mode-specific bits: the inverse of :func:`decode_state`."""
    return (EPOS4_STATUS if drive_type == "epos4" else EPOS_STATUS)[state]


def status_words(statusword: int, drive_type: DriveType) -> str:
    """A status word in words: ``0x0637 operation enabled, remote, target reached``."""
    extra = {REMOTE: "remote", TARGET_REACHED: "target reached", INTERNAL_LIMIT: "internal limit", BIT12: "bit 12"}
    extra |= {FOLLOWING: "bit 13", HOMED: "homed"}
    words = [decode_state(statusword, drive_type).value, *(w for bit, w in extra.items() if statusword & bit)]
    return f"0x{statusword:04X} " + ", ".join(words)
