"""Faults of simulated drives: injected by command or by a seeded schedule; lost, late and duplicated frames.

A fault is one line of JSON (``{"kind": "emcy", "joint": "index_pip", "code": 8976}``) or an item of a faults file:

    faults:
      - {kind: stuck, joint: any, since: motion, between_s: [0.5, 3.0]}
      - {kind: lost, joint: all, since: boot, at_s: 0, probability: 0.01, frames: [status]}
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from drake_hand.epos import pdo
from drake_hand.epos.drives import Drives
from drake_hand.errors import InputError, nearest
from drake_hand.files import load

FrameKind = Literal[
    "nmt", "sync", "emcy", "command", "record", "stop", "status", "interpolation", "current", "sdo", "heartbeat"
]
_BY_BASE: dict[int, FrameKind] = {
    0x200: "command",
    0x300: "record",
    0x500: "stop",
    0x180: "status",
    0x280: "interpolation",
    0x380: "current",
    0x580: "sdo",
    0x600: "sdo",
    0x700: "heartbeat",
}

_Probability = Annotated[float, Meta(ge=0, le=1)]
_Seconds = Annotated[float, Meta(ge=0)]


class InjectedFault(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One fault, now or later."""

    kind: Literal[
        "emcy",
        "following_error",
        "stuck",
        "lost",
        "late",
        "duplicate",
        "heartbeat_loss",
        "nmt_reset",
        "wrong_identity",
        "bus_off",
        "clear",
    ]
    """``following_error`` lets the motor run away from its demand; ``bus_off`` takes the drive off the bus, and it
    notices; ``lost`` with probability 1 is a cable cut; ``clear`` ends all that lasts (of the drives named)."""
    joint: str = "any"
    """Joint name, ``all``, or ``any``: one drawn by the seed."""
    since: Literal["boot", "enabled", "motion"] = "motion"
    """What the times count from: boot-up, the first drive enabled, the first set-point that moves."""
    at_s: _Seconds | None = None
    between_s: tuple[_Seconds, _Seconds] | None = None
    """Instead of `at_s`: a moment drawn by the seed. Neither in a command: at once."""
    duration_s: _Seconds | None = None
    """Of ``lost``, ``late`` and ``duplicate``; without it, and all others, until cleared."""
    code: Annotated[int, Meta(ge=1, le=0xFFFF)] = 0x2310
    """Of ``emcy``."""
    rate_counts_s: float = 200.0
    """Of ``following_error``."""
    probability: _Probability = 1.0
    """Of each frame being ``lost``, ``late`` or ``duplicate``."""
    delay_ms: Annotated[float, Meta(gt=0)] = 20.0
    """Of ``late``."""
    frames: list[FrameKind] = []
    """Kinds of frames ``lost``, ``late`` or ``duplicate``; empty: all."""
    direction: Literal["rx", "tx", "both"] = "both"
    """Of those frames, as the drive sees it."""
    vendor: int = 0
    product: int = 0
    """Of ``wrong_identity``."""


class FaultsFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A faults.yaml file."""

    faults: list[InjectedFault]

    @classmethod
    def load(cls, path: Path, drives: Drives) -> FaultsFile:
        """Reads a faults file.

        Raises:
            InputError: unknown key, joint or kind.
        """
        file = load(path, cls)
        for i, fault in enumerate(file.faults):
            check_fault(fault, drives, file=path, key=f"faults[{i}]")
        return file


def check_fault(fault: InjectedFault, drives: Drives, *, file: Path | None = None, key: str = "") -> None:
    """Refuses a fault of a joint that is not there, or of a moment given twice.

    Raises:
        InputError: naming file and key.
    """
    known = ["any", "all", *drives.joints]
    prefix = f"{key}." if key else ""
    if fault.joint not in known:
        raise InputError(
            f"no drive for '{fault.joint}'",
            file=file,
            key=f"{prefix}joint",
            found=fault.joint,
            expected=nearest(fault.joint, known),
        )
    if fault.between_s and (fault.at_s is not None or fault.between_s[0] > fault.between_s[1]):
        raise InputError(
            "no moment for a fault", file=file, key=f"{prefix}between_s", expected="[from, to] with from <= to, or at_s"
        )


def draw_open_values(fault: InjectedFault, drives: Drives, rng: np.random.Generator) -> InjectedFault:
    """Draws what the fault leaves open: the joint and the moment."""
    joint = str(rng.choice(drives.joints)) if fault.joint == "any" else fault.joint
    at_s = float(rng.uniform(*fault.between_s)) if fault.between_s else fault.at_s
    return msgspec.structs.replace(fault, joint=joint, at_s=at_s, between_s=None)


def kind_of(cob: int) -> FrameKind | None:
    """Kind of a frame by its COB-ID."""
    if cob == pdo.NMT_COB:
        return "nmt"
    if cob == pdo.SYNC_COB:
        return "sync"
    return _BY_BASE.get(cob & 0x780, "emcy" if cob & 0x780 == pdo.EMCY_BASE else None)


class FrameFaults:
    """What happens to the frames of one drive."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._active: list[tuple[InjectedFault, float]] = []

    def add(self, fault: InjectedFault, t: float) -> None:
        """Begins at time t."""
        self._active.append((fault, math.inf if fault.duration_s is None else t + fault.duration_s))

    def clear(self) -> None:
        """Ends all."""
        self._active.clear()

    def delays(self, direction: Literal["rx", "tx"], cob: int, t: float) -> list[float]:
        """Seconds after which a frame arrives, once per copy: ``[0]`` untouched, ``[]`` lost."""
        if not self._active:
            return [0.0]
        self._active = [(f, end) for f, end in self._active if t < end]
        copies = [0.0]
        for fault, _ in self._active:
            touched = fault.direction in ("both", direction) and (not fault.frames or kind_of(cob) in fault.frames)
            if not touched or self._rng.random() >= fault.probability:
                continue
            if fault.kind == "lost":
                return []
            copies = [c + fault.delay_ms * 1e-3 for c in copies] if fault.kind == "late" else copies * 2
        return copies


class FaultSchedule:
    """Faults that wait for their moment.

    Args:
        faults: resolved, with `at_s`.
    """

    def __init__(self, faults: list[InjectedFault]) -> None:
        self._waiting = faults

    def due(self, marks: dict[str, float], t: float) -> list[InjectedFault]:
        """Takes out those whose moment has come.

        Args:
            marks: when ``boot``, ``enabled`` and ``motion`` happened, as far as they have.
            t: now.
        """
        if not self._waiting:
            return []
        due = [f for f in self._waiting if f.since in marks and t >= marks[f.since] + (f.at_s or 0.0)]
        self._waiting = [f for f in self._waiting if f not in due]
        return due
