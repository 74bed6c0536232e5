"""What each drive is given before a run: heartbeats, limits, option codes, mode, PDOs; every object read back."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import get_args

import can

from drake_hand.epos import objects as od
from drake_hand.epos.drives import BusSpec, Drive
from drake_hand.epos.master import NMT_PRE_OPERATIONAL, Master, SdoError, for_all
from drake_hand.epos.objects import Obj
from drake_hand.epos.pdo import LAYOUT, MASTER_NODE, ON_EVENT, PDO_DISABLED, SDO_RX_BASE, SYNC_COB, Direction, Pdo

ABORT_BY_QUICK_STOP, QUICK_STOP_AND_STAY, FAULT_BY_QUICK_STOP = 3, 6, 2
"""Option codes 0x6007, 0x605A, 0x605E: on lost communication or a fault, slow down on the quick-stop ramp."""
_DOWNLOAD = {1: 0x2F, 2: 0x2B, 4: 0x23}
_PDO_COUNT = 4


@dataclass(frozen=True, kw_only=True)
class Write:
    """One object and what it has to hold."""

    obj: Obj
    value: int
    read_back: bool = True
    """Whether it can be read: all but the clearing of the PVT queue."""

    def frame(self, node: int) -> tuple[int, bytes]:
        """COB-ID and data of the SDO request that writes it."""
        head = bytes([_DOWNLOAD[self.obj.size]]) + self.obj.index.to_bytes(2, "little") + bytes([self.obj.sub])
        return SDO_RX_BASE + node, (head + self.obj.pack(self.value)).ljust(8, b"\0")


def writes(drive: Drive, bus: BusSpec) -> list[Write]:
    """Everything a drive is given for a run, in order."""
    speed, acceleration = int(drive.max_speed_rpm), int(drive.max_acceleration_rpm_s)
    values: list[tuple[Obj, int]] = [
        (od.PRODUCER_HEARTBEAT, bus.heartbeat_ms),
        (od.CONSUMER_HEARTBEAT, MASTER_NODE << 16 | bus.heartbeat_consumer_ms),
        (od.SYNC_COB_ID, SYNC_COB),
        (od.ABORT_OPTION, ABORT_BY_QUICK_STOP),
        (od.FAULT_OPTION, FAULT_BY_QUICK_STOP),
        (od.FOLLOWING_WINDOW, drive.following_error_counts),
        (od.MAX_PROFILE_VELOCITY, speed),
        (od.PROFILE_VELOCITY, speed),
        (od.PROFILE_ACCELERATION, acceleration),
        (od.PROFILE_DECELERATION, acceleration),
        (od.QUICK_STOP_DECELERATION, acceleration),
    ]
    if drive.type != "epos1":
        values.append((od.MAX_ACCELERATION, acceleration))
    if drive.type == "epos4":
        values += [(od.QUICK_STOP_OPTION, QUICK_STOP_AND_STAY), (od.IP_PERIOD_VALUE, bus.sync_ms)]
        values.append((od.IP_PERIOD_INDEX, -3))
    if drive.has_queue:
        values += [(od.IP_SUBMODE, -1), (od.IP_UNDERFLOW_WARNING, 4), (od.IP_OVERFLOW_WARNING, 60)]
    found = [Write(obj=o, value=v) for o, v in values]
    found.append(Write(obj=od.MODE, value=od.STREAM_MODE[drive.type]))
    if drive.has_queue:
        found += [Write(obj=od.IP_BUFFER_CLEAR, value=v, read_back=False) for v in (0, 1)]
    used: dict[tuple[str, int], Pdo] = {(p.direction, p.number): p for p in LAYOUT[drive.type].all}
    for direction in get_args(Direction):
        for number in range(1, _PDO_COUNT + 1):
            unused = Pdo(direction=direction, number=number, transmission=ON_EVENT, entries=())
            found += _pdo_writes(drive.node, used.get((direction, number), unused))
    return found


def _pdo_writes(node: int, pdo: Pdo) -> list[Write]:
    """Off; then, if it has entries: no entries, entries, their number, transmission type, on."""
    cob = Obj(pdo.communication_index, 1, "u32")
    off = Write(obj=cob, value=pdo.cob_id(node) | PDO_DISABLED)
    if not pdo.entries:
        return [off]
    count = Obj(pdo.mapping_index, 0, "u8")
    return [
        off,
        Write(obj=count, value=0),
        *(Write(obj=Obj(pdo.mapping_index, i, "u32"), value=o.mapping) for i, o in enumerate(pdo.entries, 1)),
        Write(obj=count, value=len(pdo.entries)),
        Write(obj=Obj(pdo.communication_index, 2, "u8"), value=pdo.transmission),
        Write(obj=cob, value=pdo.cob_id(node)),
    ]


def configure(master: Master, drives: Sequence[Drive], bus: BusSpec) -> list[str]:
    """Writes and reads back everything, all drives at once.

    Returns:
        What did not take, one line each; empty when every drive holds what it was given.
    """
    master.nmt(NMT_PRE_OPERATIONAL)
    return [line for lines in for_all(lambda d: _configure(master, d, bus), drives) for line in lines]


def _configure(master: Master, drive: Drive, bus: BusSpec) -> list[str]:
    problems = []
    for w in writes(drive, bus):
        try:
            master.write(drive.node, w.obj, w.value)
            got = master.read(drive.node, w.obj) if w.read_back else w.value
        except SdoError as e:
            problems.append(f"{drive.joint} (node {drive.node}): {w.obj} := {w.value}: {e}")
            continue
        if got != w.value:
            problems.append(f"{drive.joint} (node {drive.node}): {w.obj} was given {w.value} and reads {got}")
    return problems


def release_heartbeat(master: Master, drives: Sequence[Drive]) -> list[str]:
    """Takes the drives off the master's heartbeat, so that they do not fault when it leaves; what did not take."""

    def one(drive: Drive) -> str | None:
        try:
            master.write(drive.node, od.CONSUMER_HEARTBEAT, 0)
        except SdoError as e:
            return f"{drive.joint} (node {drive.node}): still watches the master: {e}"
        return None

    problems = [line for line in for_all(one, drives) if line]
    with suppress(can.CanError):
        master.nmt(NMT_PRE_OPERATIONAL)
    return problems
