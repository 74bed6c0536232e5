"""PDO layouts per drive type: the convention master, simulated drives and mirror share.

| PDO | COB-ID | when | entries |
|---|---|---|---|
| command, RPDO1 | 0x200 + node | latched by SYNC | controlword; epos4: + target 0x607A; epos1: + set value 0x2062 |
| record, RPDO2 | 0x300 + node | at once | epos2: PVT record 0x20C1 |
| stop, RPDO4 | 0x500 + node | at once | controlword |
| status, TPDO1 | 0x180 + node | every SYNC | statusword, position 0x6064; epos2: + records queued 0x60C4:04 |
| interpolation, TPDO2 | 0x280 + node | on change | epos2: interpolation status 0x20C4:01 |
| current, TPDO3 | 0x380 + node | every SYNC | motor current |

A drive applies the last command received before a SYNC when that SYNC arrives, and samples its status at the same SYNC.
PDOs that a type does not use are disabled (bit 31 of the COB-ID).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

from drake_hand.epos import objects as od
from drake_hand.epos.objects import DriveType, Obj

SYNC_COB = 0x080
NMT_COB = 0x000
EMCY_BASE = 0x080
SDO_TX_BASE = 0x580
SDO_RX_BASE = 0x600
HEARTBEAT_BASE = 0x700
MASTER_NODE = 127
"""Node id of the master's own heartbeat, which the drives consume."""

ON_SYNC, ON_EVENT = 1, 255
Direction = Literal["rx", "tx"]
"""As the drive sees it: ``rx`` master to drive, ``tx`` drive to master."""
PDO_DISABLED = 1 << 31


@dataclass(frozen=True, kw_only=True)
class Pdo:
    """One PDO of a drive: what is in it and when it acts."""

    direction: Direction
    number: int
    """1 to 4."""
    transmission: int
    """`ON_SYNC` or `ON_EVENT`."""
    entries: tuple[Obj, ...]

    @property
    def base(self) -> int:
        """COB-ID without the node id."""
        return (0x100 if self.direction == "rx" else 0x080) + 0x100 * self.number

    def cob_id(self, node: int) -> int:
        """COB-ID at a node."""
        return self.base + node

    @property
    def communication_index(self) -> int:
        """Index of its communication parameters (:01 COB-ID u32, :02 transmission type u8)."""
        return (0x1400 if self.direction == "rx" else 0x1800) + self.number - 1

    @property
    def mapping_index(self) -> int:
        """Index of its mapping (:00 count u8, :01.. entries u32)."""
        return (0x1600 if self.direction == "rx" else 0x1A00) + self.number - 1

    @property
    def size(self) -> int:
        """Bytes of payload."""
        return sum(o.size for o in self.entries)

    def pack(self, *values: int) -> bytes:
        """Payload of one value per entry."""
        return b"".join(o.pack(int(v)) for o, v in zip(self.entries, values, strict=True))

    def unpack(self, data: bytes) -> tuple[int, ...]:
        """Values of a payload, one per entry; struct.error when it is too short."""
        values, at = [], 0
        for o in self.entries:
            values.append(o.unpack(bytes(data[at : at + o.size])))
            at += o.size
        return tuple(values)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The PDOs of one drive type; `record` and `interpolation` only where there is a PVT queue."""

    command: Pdo
    stop: Pdo
    status: Pdo
    current: Pdo
    record: Pdo | None = None
    interpolation: Pdo | None = None

    @property
    def all(self) -> tuple[Pdo, ...]:
        """Those in use."""
        return tuple(
            p for p in (self.command, self.record, self.stop, self.status, self.interpolation, self.current) if p
        )


_STOP = Pdo(direction="rx", number=4, transmission=ON_EVENT, entries=(od.CONTROLWORD,))


def _command(*target: Obj) -> Pdo:
    return Pdo(direction="rx", number=1, transmission=ON_SYNC, entries=(od.CONTROLWORD, *target))


def _status(*more: Obj) -> Pdo:
    return Pdo(direction="tx", number=1, transmission=ON_SYNC, entries=(od.STATUSWORD, od.POSITION_ACTUAL, *more))


def _current(type_: DriveType) -> Pdo:
    return Pdo(direction="tx", number=3, transmission=ON_SYNC, entries=(od.CURRENT_ACTUAL[type_],))


LAYOUT: dict[DriveType, Layout] = {
    "epos2": Layout(
        command=_command(),
        record=Pdo(direction="rx", number=2, transmission=ON_EVENT, entries=(od.IP_RECORD,)),
        stop=_STOP,
        status=_status(od.IP_BUFFER_USED),
        interpolation=Pdo(direction="tx", number=2, transmission=ON_EVENT, entries=(od.IP_STATUS,)),
        current=_current("epos2"),
    ),
    "epos4": Layout(command=_command(od.TARGET_POSITION), stop=_STOP, status=_status(), current=_current("epos4")),
    "epos1": Layout(
        command=_command(od.POSITION_MODE_SETTING), stop=_STOP, status=_status(), current=_current("epos1")
    ),
}


def pack_record(counts: int, rpm: float, ms: int) -> bytes:
    """A PVT record (0x20C1): position [counts], velocity [rpm, rounded], time to the next record [ms], 0 = last.

    Raises:
        ValueError: a value does not fit (position s32, velocity s24, time 0 to 255 ms).
    """
    try:
        return struct.pack("<i", int(counts)) + round(rpm).to_bytes(3, "little", signed=True) + struct.pack("<B", ms)
    except (struct.error, OverflowError) as e:
        raise ValueError(f"no PVT record: {counts} counts, {rpm} rpm, {ms} ms") from e


def unpack_record(data: bytes) -> tuple[int, int, int]:
    """Position [counts], velocity [rpm] and time [ms] of a PVT record of 8 bytes."""
    return struct.unpack("<i", data[:4])[0], int.from_bytes(data[4:7], "little", signed=True), data[7]
