"""`RunRecord`: what was commanded and measured in a run, step by step, and its file (npz with a JSON header)."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import read_bytes, write_atomic

RECORD_SUFFIX = ".run.npz"
NO_QUEUE = -1
LATE_SHARE = 0.1
"""Of a SYNC period: later than that, a position no longer belongs to its command."""
LATE_FOR_S = 0.06
"""How long a target that came late is felt."""


class Fault(msgspec.Struct, frozen=True, kw_only=True):
    """Why a run was stopped, or what else went wrong."""

    kind: str
    """``emcy``, ``fault`` (bit or state), ``following``, ``silent``, ``queue``, ``heartbeat``, ``late``, ``reboot``,
    ``bus``, ``grip`` (a finger presses otherwise than planned), ``interrupt``, ``internal``; ``start`` (moved before
    it), ``enable``, ``skew`` (not in step), ``stuck``."""
    text: str
    """In words, with the joint."""
    time_s: float
    """Since the SYNC began."""
    sync: int
    """Number of the SYNC after which it was noticed."""
    joint: str = ""
    node: int = 0
    code: int = 0
    """EMCY code, where there is one."""
    history: list[str] = []
    """The drive's stored errors (0x1003) in words, newest first."""


class RunHeader(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a run was and how it ended."""

    schema: Literal[1] = 1
    version: str
    """Of drake_hand."""
    started: str
    """ISO 8601, UTC."""
    plan_hash: str
    hand: str
    joints: list[str]
    """Order of the columns."""
    nodes: list[int]
    types: list[str]
    sync_ms: int
    bus: str
    realtime: bool
    """Whether the bus thread ran with real-time priority."""
    ok: bool
    faults: list[Fault]
    not_disabled: list[str]
    """Joints whose drive was not read back as disabled."""


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """A run: k rows, one per SYNC from the start of the motion, over n joints and their drives."""

    header: RunHeader
    t: np.ndarray
    """(k,) when the SYNC was sent, s since the first row."""
    late_ms: np.ndarray
    """(k,) how late it was."""
    step: np.ndarray
    """(k,) row of the schedule; jumps where periods were lost, repeats where a pause ends."""
    plan_time: np.ndarray
    """(k,) time in the plan, s; negative while leading in."""
    playing: np.ndarray
    """(k,) whether the plan was being played; after it, or after a stop, the last commanded position is repeated."""
    commanded: np.ndarray
    """(k, n) rad."""
    measured: np.ndarray
    """(k, n) rad; NaN where the drive did not answer."""
    current_ma: np.ndarray
    """(k, n) float32, of the motors; NaN where the drive did not answer."""
    status: np.ndarray
    """(k, n) uint16 status words (the last heard)."""
    queued: np.ndarray
    """(k, n) int16 PVT records waiting in the drive; `NO_QUEUE` where there is none."""

    @property
    def error_deg(self) -> np.ndarray:
        """(k, n) commanded minus measured."""
        return np.rad2deg(self.commanded - self.measured)

    def lag(self) -> tuple[np.ndarray, np.ndarray]:
        """Explains the tracking error by a pure delay: ``error ~ delay * commanded speed``, joint by joint.

        Rows at and after a late SYNC are left out: their position was not read at the time of their command.

        Returns:
            (n,) delay, s (zero for a joint that does not move), and (n,) largest error left unexplained, deg.
        """
        rows, n = self.playing, self.commanded.shape[1]
        if np.count_nonzero(rows) < 3:
            return np.zeros(n), np.zeros(n)
        again = np.concatenate([[0], np.cumsum(np.diff(self.step[rows]) <= 0)])  # a pause's row counts as two
        clock = (self.step[rows] + again) * self.header.sync_ms * 1e-3
        speed = np.gradient(np.rad2deg(self.commanded[rows]), clock, axis=0)
        late = self.late_ms[rows] > LATE_SHARE * self.header.sync_ms
        after = 1 + round(LATE_FOR_S * 1e3 / self.header.sync_ms)
        late = np.convolve(late, np.ones(after))[: len(late)] > 0
        counts = np.isfinite(self.measured[rows]) & ~late[:, None]
        error = np.where(counts, self.error_deg[rows], 0.0)
        power = np.sum(speed**2 * counts, axis=0)
        delay = np.divide(np.sum(error * speed, axis=0), power, out=np.zeros_like(power), where=power > 1e-9)
        rest = np.abs(error - delay * speed) * counts
        return delay, rest.max(axis=0)

    def save(self, path: Path) -> None:
        """Writes the file whole or not at all."""
        arrays = {k: getattr(self, k) for k in _ARRAYS}
        header = np.frombuffer(msgspec.json.encode(self.header), dtype=np.uint8)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, header=header, **arrays)
        write_atomic(path, buffer.getvalue())

    @classmethod
    def load(cls, path: Path) -> RunRecord:
        """Reads a record.

        Raises:
            InputError: not a run record.
        """
        data, expected = read_bytes(path), f"a {RECORD_SUFFIX} file, as execute --log writes it"
        if not zipfile.is_zipfile(io.BytesIO(data)):
            raise InputError("not the record of a run", file=path, found="another kind of file", expected=expected)
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                header = msgspec.json.decode(file["header"].tobytes(), type=RunHeader)
                arrays = {k: file[k].astype(kind, casting="safe") for k, (kind, _) in _ARRAYS.items()}
        except Exception as e:  # zip, npy and JSON readers raise errors of their own on damaged files
            found = " ".join(str(e).split()) or type(e).__name__
            raise InputError("not the record of a run", file=path, found=found, expected=expected) from e
        k, n = arrays["t"].size, len(header.joints)
        for name, array in arrays.items():
            if array.shape != ((k,), (k, n))[_ARRAYS[name][1]]:
                raise InputError(
                    "array has the wrong shape",
                    file=path,
                    key=name,
                    found=array.shape,
                    expected=((k,), (k, n))[_ARRAYS[name][1]],
                )
        return cls(header=header, **arrays)


_ARRAYS: dict[str, tuple[type, bool]] = {
    "t": (np.float64, False),
    "late_ms": (np.float64, False),
    "step": (np.int64, False),
    "plan_time": (np.float64, False),
    "playing": (np.bool_, False),
    "commanded": (np.float64, True),
    "measured": (np.float64, True),
    "current_ma": (np.float32, True),
    "status": (np.uint16, True),
    "queued": (np.int16, True),
}
"""Element type, and whether there is a column per joint."""
