"""Object facts of EPOS drives: indices and types, identities, EMCY and abort codes and error register in words.

Our own selection, written down from facts about the drives; no vendor file is shipped.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

from canopen.sdo import SdoAbortedError

DriveType = Literal["epos2", "epos4", "epos1"]
"""EPOS2 (PVT queue), EPOS4 (cyclic synchronous position), EPOS 24/1 (position mode)."""

_FORMATS = {"u8": "<B", "i8": "<b", "u16": "<H", "i16": "<h", "u32": "<I", "i32": "<i", "u64": "<Q"}


@dataclass(frozen=True, slots=True)
class Obj:
    """An object dictionary entry: index, subindex, type (``u8 i8 u16 i16 u32 i32 u64``)."""

    index: int
    sub: int
    type: str

    @property
    def size(self) -> int:
        """Size in bytes."""
        return int(self.type[1:]) // 8

    @property
    def mapping(self) -> int:
        """Its entry in a PDO mapping (index, subindex, bits)."""
        return self.index << 16 | self.sub << 8 | self.size * 8

    def pack(self, value: int) -> bytes:
        """Little-endian bytes of a value; struct.error when it does not fit."""
        return struct.pack(_FORMATS[self.type], value)

    def unpack(self, data: bytes) -> int:
        """Value of `size` little-endian bytes."""
        return struct.unpack(_FORMATS[self.type], data)[0]

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.sub:02X}"


# Communication (CiA 301)
DEVICE_TYPE = Obj(0x1000, 0, "u32")
ERROR_REGISTER = Obj(0x1001, 0, "u8")
ERROR_HISTORY_COUNT = Obj(0x1003, 0, "u8")
"""Number of stored errors; writing 0 clears them. Newest at :01, up to :05."""
SYNC_COB_ID = Obj(0x1005, 0, "u32")
STORE_ALL = Obj(0x1010, 1, "u32")
RESTORE_ALL = Obj(0x1011, 1, "u32")
EMCY_COB_ID = Obj(0x1014, 0, "u32")
CONSUMER_HEARTBEAT = Obj(0x1016, 1, "u32")
"""Watched node id in bits 16-23, time in ms in bits 0-15; 0 is off."""
PRODUCER_HEARTBEAT = Obj(0x1017, 0, "u16")
VENDOR = Obj(0x1018, 1, "u32")
PRODUCT = Obj(0x1018, 2, "u32")
REVISION = Obj(0x1018, 3, "u32")
SERIAL = Obj(0x1018, 4, "u32")

SAVE_SIGNATURE = int.from_bytes(b"save", "little")
LOAD_SIGNATURE = int.from_bytes(b"load", "little")
ERROR_HISTORY_DEPTH = 5


def error_history(n: int) -> Obj:
    """The n-th newest stored error (1 to 5): code in the low 16 bits."""
    return Obj(0x1003, n, "u32")


# Device control (CiA 402)
CONTROLWORD = Obj(0x6040, 0, "u16")
STATUSWORD = Obj(0x6041, 0, "u16")
ABORT_OPTION = Obj(0x6007, 0, "i16")
"""Reaction to lost communication."""
QUICK_STOP_OPTION = Obj(0x605A, 0, "i16")
SHUTDOWN_OPTION = Obj(0x605B, 0, "i16")
DISABLE_OPTION = Obj(0x605C, 0, "i16")
FAULT_OPTION = Obj(0x605E, 0, "i16")
MODE = Obj(0x6060, 0, "i8")
MODE_DISPLAY = Obj(0x6061, 0, "i8")
POSITION_DEMAND = Obj(0x6062, 0, "i32")
POSITION_ACTUAL = Obj(0x6064, 0, "i32")
FOLLOWING_WINDOW = Obj(0x6065, 0, "u32")
VELOCITY_ACTUAL = Obj(0x606C, 0, "i32")
TARGET_POSITION = Obj(0x607A, 0, "i32")
SOFT_LIMIT_MIN = Obj(0x607D, 1, "i32")
SOFT_LIMIT_MAX = Obj(0x607D, 2, "i32")
MAX_PROFILE_VELOCITY = Obj(0x607F, 0, "u32")
PROFILE_VELOCITY = Obj(0x6081, 0, "u32")
PROFILE_ACCELERATION = Obj(0x6083, 0, "u32")
PROFILE_DECELERATION = Obj(0x6084, 0, "u32")
QUICK_STOP_DECELERATION = Obj(0x6085, 0, "u32")
MAX_ACCELERATION = Obj(0x60C5, 0, "u32")
HOME_OFFSET = Obj(0x607C, 0, "i32")
"""How far a drive moves off the stop it found before it calls that place `HOME_POSITION`, counts."""
HOMING_METHOD = Obj(0x6098, 0, "i8")
HOMING_SPEED = Obj(0x6099, 1, "u32")
HOMING_SPEED_ZERO = Obj(0x6099, 2, "u32")
HOMING_ACCELERATION = Obj(0x609A, 0, "u32")
SUPPORTED_MODES = Obj(0x6502, 0, "u32")
"""Bit n - 1 means mode n."""

# Interpolated position (EPOS2), cycle time (EPOS4)
IP_SUBMODE = Obj(0x60C0, 0, "i16")
IP_PERIOD_VALUE = Obj(0x60C2, 1, "u8")
IP_PERIOD_INDEX = Obj(0x60C2, 2, "i8")
IP_BUFFER_SIZE = Obj(0x60C4, 1, "u32")
IP_BUFFER_FREE = Obj(0x60C4, 2, "u32")
IP_BUFFER_ORGANISATION = Obj(0x60C4, 3, "u8")
IP_BUFFER_USED = Obj(0x60C4, 4, "u16")
IP_BUFFER_CLEAR = Obj(0x60C4, 6, "u8")
IP_RECORD = Obj(0x20C1, 0, "u64")
IP_STATUS = Obj(0x20C4, 1, "u16")
IP_UNDERFLOW_WARNING = Obj(0x20C4, 2, "u16")
IP_OVERFLOW_WARNING = Obj(0x20C4, 3, "u16")
IP_DEPTH = 64

# Where the types differ
POSITION_MODE_SETTING = Obj(0x2062, 0, "i32")
"""Set value of maxon's position mode (EPOS 24/1)."""
FOLLOWING_ERROR = {"epos1": Obj(0x20F4, 0, "i16"), "epos2": Obj(0x20F4, 0, "i16"), "epos4": Obj(0x60F4, 0, "i32")}
CURRENT_ACTUAL = {"epos1": Obj(0x6078, 0, "i16"), "epos2": Obj(0x6078, 0, "i16"), "epos4": Obj(0x30D1, 2, "i32")}
"""Current in mA."""
SERIAL64 = {"epos1": Obj(0x2004, 0, "u64"), "epos2": Obj(0x2004, 0, "u64"), "epos4": Obj(0x2100, 1, "u64")}
"""64-bit serial number; that of the EPOS 24/1 is inferred from the EPOS2."""
HOME_POSITION = {"epos1": Obj(0x2081, 0, "i32"), "epos2": Obj(0x2081, 0, "i32"), "epos4": Obj(0x30B0, 0, "i32")}
"""What the position becomes where homing ends, counts."""
HOMING_CURRENT = {"epos1": Obj(0x2080, 0, "u16"), "epos2": Obj(0x2080, 0, "u16"), "epos4": Obj(0x30B2, 0, "u16")}
"""Current that indicates a stop, mA. That EPOS4 has these two at 0x30B0 and 0x30B2 is from memory, not from its EDS."""

# Modes of operation
MODE_PROFILE, MODE_HOMING, MODE_INTERPOLATED, MODE_CSP, MODE_POSITION = 1, 6, 7, 8, -1
HOME_HERE = {"epos1": 35, "epos2": 35, "epos4": 37}
"""Homing method that takes the position for what it is; maxon's number before CiA 402 had one, and after."""
HOME_ON_STOP = {1: -3, -1: -4}
"""Homing methods that seek a mechanical stop at limited current, by direction; maxon's own."""
STREAM_MODE = {"epos2": MODE_INTERPOLATED, "epos4": MODE_CSP, "epos1": MODE_POSITION}
"""The mode in which each type plays a trajectory."""


@dataclass(frozen=True, kw_only=True)
class Identity:
    """What 0x1018 of a drive type says; product None where it is not known."""

    vendor: int
    product: int | None


IDENTITY = {
    "epos1": Identity(vendor=0xFB, product=None),
    "epos2": Identity(vendor=0xFB, product=0x64200000),
    "epos4": Identity(vendor=0xFB, product=0x61500000),
}

EMCY_WORDS = {
    0x0000: "no error",
    0x1000: "generic error",
    0x2310: "over-current",
    0x3210: "over-voltage",
    0x3220: "under-voltage",
    0x4210: "over-temperature",
    0x7320: "position sensor error",
    0x8120: "CAN passive mode",
    0x8130: "heartbeat lost",
    0x81FD: "CAN bus off",
    0x8210: "PDO length error",
    0x8250: "RPDO timeout",
    0x8611: "following error",
    0x8A80: "negative limit switch",
    0x8A81: "positive limit switch",
    0x8A82: "software position limit",
    0x8A88: "safe torque off",
    0xFF09: "software position limit",
    0xFF0C: "interpolated position mode error",
}

Reaction = Literal["disable", "fault", "abort"]
_DISABLE_AT_ONCE = {0x2310, 0x3210, 0x3220, 0x4210, 0x7320, 0x8A88}
_ABORT = {0x8130, 0x81FD, 0x8120, 0x8250}


def reaction(code: int) -> Reaction:
    """How a drive reacts to an error: power off at once, by fault option 0x605E, or by abort option 0x6007."""
    return "disable" if code in _DISABLE_AT_ONCE else "abort" if code in _ABORT else "fault"


def emcy_words(code: int) -> str:
    """An EMCY (or stored error) code in words: ``0x8611 following error``."""
    return f"0x{code:04X} {EMCY_WORDS.get(code, 'unknown error')}"


def abort_words(code: int) -> str:
    """An SDO abort code in words: ``0x06020000 Object does not exist``."""
    return f"0x{code:08X} {SdoAbortedError.CODES.get(code, 'unknown abort code')}"


_REGISTER = ("generic", "current", "voltage", "temperature", "communication", "device profile", "", "motion")


def register_words(register: int) -> list[str]:
    """The bits of the error register 0x1001 in words, lowest first; empty without an error."""
    return [word or f"bit {i}" for i, word in enumerate(_REGISTER) if register >> i & 1]


_STATUS = {
    0: "underflow warning",
    1: "overflow warning",
    2: "velocity warning",
    3: "acceleration warning",
    8: "underflow error",
    9: "overflow error",
    10: "velocity error",
    11: "acceleration error",
    14: "buffer enabled",
    15: "active",
}
IP_ERRORS = 0x0F00


def ip_status_words(status: int) -> list[str]:
    """The bits of the interpolation status 0x20C4:01 in words."""
    return [_STATUS.get(i, f"bit {i}") for i in range(16) if status >> i & 1]
