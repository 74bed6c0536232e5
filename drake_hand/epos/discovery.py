"""Who is on the bus: identity, state, position and stored errors of drives, compared with the drives file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from drake_hand.epos import objects as od
from drake_hand.epos.drives import Drive, Drives
from drake_hand.epos.master import Master, SdoError, for_all
from drake_hand.epos.objects import DriveType, Obj
from drake_hand.epos.state import HOMED, Control, DriveState, decode_state, status_words
from drake_hand.errors import DriveError

TYPES: tuple[DriveType, ...] = get_args(DriveType)
_READ_ATTEMPTS = 3


@dataclass(frozen=True, kw_only=True)
class Identification:
    """What a node says it is; fields it would not give are None."""

    node: int
    vendor: int | None
    product: int | None
    revision: int | None
    serial: int | None
    """64-bit, or the 32-bit one of 0x1018 where the drive type is not known."""
    type: DriveType | None
    """As far as vendor and product tell."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """How a drive is."""

    drive: Drive
    statusword: int
    mode: int
    position: int
    """counts."""
    soft_limits: tuple[int, int]
    """counts; (0, 0) is off."""
    register: int
    errors: tuple[int, ...]
    """Stored error codes (0x1003), newest first."""

    @property
    def state(self) -> DriveState:
        """Its CiA 402 state."""
        return decode_state(self.statusword, self.drive.type)

    @property
    def words(self) -> str:
        """Status word in words."""
        return status_words(self.statusword, self.drive.type)

    @property
    def error_words(self) -> list[str]:
        """Stored errors in words."""
        return [od.emcy_words(e) for e in self.errors]


def identify(master: Master, node: int) -> Identification:
    """Reads the identity of a node; what it refuses to say is None."""

    def ask(obj: Obj) -> int | None:
        try:
            return master.read(node, obj)
        except SdoError:
            return None

    vendor, product = ask(od.VENDOR), ask(od.PRODUCT)
    said = od.Identity(vendor=vendor or 0, product=product)
    type_ = next((t for t in TYPES if product and od.IDENTITY[t] == said), None)
    serial = ask(od.SERIAL64[type_]) if type_ else ask(od.SERIAL)
    return Identification(
        node=node, vendor=vendor, product=product, revision=ask(od.REVISION), serial=serial, type=type_
    )


def mismatches(master: Master, drives: Drives) -> tuple[list[str], list[Drive]]:
    """Compares the bus with the drives file.

    Returns:
        Drives missing, extra, of the wrong type or serial, one line each; and the drives that answer.
    """
    try:
        present = set(master.scan())
    except DriveError as e:
        return [str(e)], []
    if not present:
        return ["no node answers: is the bus powered, terminated, and at the bitrate of the drives?"], []
    expected = {d.node: d for d in drives.drives}
    problems = [f"{d.joint} (node {n}): no answer" for n, d in expected.items() if n not in present]
    strangers = present - set(expected) - {d.node for d in drives.spared}
    problems += [f"node {n}: on the bus, but not in {drives.file.name}" for n in sorted(strangers)]
    answering = [d for d in drives.drives if d.node in present]
    return problems + [p for lines in for_all(lambda d: _wrong(master, d), answering) for p in lines], answering


def _wrong(master: Master, drive: Drive) -> list[str]:
    wanted = [("vendor", od.VENDOR, drive.identity.vendor), ("product", od.PRODUCT, drive.identity.product)]
    wanted.append(("serial", od.SERIAL64[drive.type], drive.serial))
    problems = []
    for what, obj, value in wanted:
        if value is None:
            continue
        try:
            found = master.read(drive.node, obj)
        except SdoError as e:
            problems.append(f"{drive.joint} (node {drive.node}): {what}: {e}")
            continue
        if found != value:
            problems.append(
                f"{drive.joint} (node {drive.node}): {what} 0x{found:X}, expected 0x{value:X} ({drive.type})"
            )
    return problems


def condition(master: Master, drive: Drive) -> Condition:
    """Reads how a drive is.

    Raises:
        SdoError: it does not tell.
    """

    def read(obj: Obj) -> int:
        return master.read(drive.node, obj)

    return Condition(
        drive=drive,
        statusword=read(od.STATUSWORD),
        mode=read(od.MODE_DISPLAY),
        position=read(od.POSITION_ACTUAL),
        soft_limits=(read(od.SOFT_LIMIT_MIN), read(od.SOFT_LIMIT_MAX)),
        register=read(od.ERROR_REGISTER),
        errors=read_error_history(master, drive.node),
    )


def read_error_history(master: Master, node: int) -> tuple[int, ...]:
    """Stored error codes (0x1003), newest first.

    Raises:
        SdoError: no answer.
    """
    count = min(master.read(node, od.ERROR_HISTORY_COUNT), od.ERROR_HISTORY_DEPTH)
    return tuple(master.read(node, od.error_history(i)) & 0xFFFF for i in range(1, count + 1))


def conditions(master: Master, drives: Sequence[Drive]) -> tuple[list[Condition], list[str]]:
    """The condition of all drives, asked at the same time; and those that would not answer, one line each."""

    def one(drive: Drive) -> Condition | str:
        try:
            return condition(master, drive)
        except SdoError as e:
            return f"{drive.joint}: {e}"

    answers = for_all(one, drives)
    return [a for a in answers if isinstance(a, Condition)], [a for a in answers if isinstance(a, str)]


def not_ready(found: Sequence[Condition]) -> list[str]:
    """Drives in fault, or already powered by somebody else, one line each with their stored errors."""
    problems = []
    for c in found:
        if c.state.faulty:
            errors = "; ".join(c.error_words) or "no stored error"
            problems.append(f"{c.drive.joint} (node {c.drive.node}): in fault: {errors} (--reset-faults resets it)")
        elif c.state.powered:
            problems.append(f"{c.drive.joint} (node {c.drive.node}): already powered: {c.words}")
        elif c.state is DriveState.UNKNOWN:
            problems.append(f"{c.drive.joint} (node {c.drive.node}): status word {c.words} is none of its type")
    return problems


def without_zero(found: Sequence[Condition]) -> list[str]:
    """Drives whose zero is not known since they were switched on, one line each."""
    return [
        f"{c.drive.joint} (node {c.drive.node}): its zero is not known since it was switched on (drives zero)"
        for c in found
        if not c.statusword & HOMED
    ]


def outside_soft_limits(found: Sequence[Condition], drives: Drives, counts: np.ndarray) -> list[str]:
    """Drives whose own soft position limits (0x607D) a motion (k, n) [counts] leaves."""
    problems = []
    for c in found:
        low, high = c.soft_limits
        column = counts[:, drives.nodes.index(c.drive.node)]
        if (low, high) != (0, 0) and (column.min() < low or column.max() > high):
            problems.append(
                f"{c.drive.joint} (node {c.drive.node}): goes from {column.min()} to {column.max()} counts,"
                f" its soft limits 0x607D are {low} to {high}"
            )
    return problems


def reset_faults(master: Master, drives: Sequence[Drive]) -> list[str]:
    """Resets faults by a rising edge of control word bit 7; enables nothing. What is still in fault, one line each."""

    def one(drive: Drive) -> str | None:
        try:
            for _ in range(_READ_ATTEMPTS):
                for word in (Control.DISABLE_VOLTAGE, Control.FAULT_RESET, Control.DISABLE_VOLTAGE):
                    master.write(drive.node, od.CONTROLWORD, word)
                status = master.read(drive.node, od.STATUSWORD)
                if not decode_state(status, drive.type).faulty:
                    return None
        except SdoError as e:
            return f"{drive.joint}: {e}"
        return f"{drive.joint} (node {drive.node}): stays in fault: {status_words(status, drive.type)}"

    return [line for line in for_all(one, drives) if line]


def disable_all(master: Master, drives: Sequence[Drive]) -> list[str]:
    """Checks that every drive is without power, and disables any that is not; returns the joints where that failed."""

    def one(drive: Drive) -> bool:
        try:
            for _ in range(_READ_ATTEMPTS):
                if not decode_state(master.read(drive.node, od.STATUSWORD), drive.type).powered:
                    return True
                master.write(drive.node, od.CONTROLWORD, Control.DISABLE_VOLTAGE)
        except SdoError:
            return False
        return False

    return [d.joint for d, off in zip(drives, for_all(one, drives), strict=True) if not off]
