"""Sources of object poses for the real hand: JSON lines by UDP, a recording of such lines, a Python callable.

A line is one look at the object, in the wrist frame::

    {"xyz_mm": [53.1, -2.0, 118.7], "quaternion_wxyz": [0.5, 0.5, 0.5, -0.5], "age_ms": 12}

``rpy_deg`` may stand in place of ``quaternion_wxyz``. ``age_ms`` says how old the picture was when the line was sent;
the time the line takes to arrive is not counted. No clocks have to agree.
"""

from __future__ import annotations

import importlib
import socket
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.errors import InputError
from drake_hand.feedback.pose import PoseSeen, PoseSource

Vector = tuple[float, float, float]
_MOST_LINE_BYTES = 4096
"""Bytes of a line."""
_MOST_LINES_AT_ONCE = 64
"""Lines read at most when asked once: whoever sends faster than that is not waited for."""


class PoseLine(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One line."""

    xyz_mm: Vector
    quaternion_wxyz: tuple[float, float, float, float] | None = None
    rpy_deg: Vector | None = None
    age_ms: float = 0.0
    t: float | None = None
    """In recordings: when the line arrived, s from the start of the plan."""

    def pose(self) -> np.ndarray:
        """(4, 4).

        Raises:
            InputError: no orientation or two, or numbers that are none.
        """
        given = [x for x in (self.quaternion_wxyz, self.rpy_deg) if x is not None]
        if len(given) != 1:
            expected = "either quaternion_wxyz or rpy_deg"
            raise InputError(
                "not an orientation", key="quaternion_wxyz", found=f"{len(given)} given", expected=expected
            )
        if not np.isfinite([*self.xyz_mm, *given[0], self.age_ms]).all() or self.age_ms < 0:
            raise InputError("not a pose", key="xyz_mm", found=self, expected="finite numbers, age_ms 0 or more")
        X = np.eye(4)
        X[:3, 3] = np.array(self.xyz_mm) * 1e-3
        if self.rpy_deg is not None:
            X[:3, :3] = Rotation.from_euler("xyz", self.rpy_deg, degrees=True).as_matrix()
            return X
        length = float(np.linalg.norm(given[0]))
        if abs(length - 1) > 1e-2:
            raise InputError("not a rotation", key="quaternion_wxyz", found=given[0], expected="length 1")
        X[:3, :3] = Rotation.from_quat(np.roll(given[0], -1)).as_matrix()
        return X


def parse(line: bytes) -> PoseLine:
    """Reads a line.

    Raises:
        InputError: says what is wrong with it.
    """
    try:
        read = msgspec.json.decode(line, type=PoseLine)
    except msgspec.DecodeError as e:
        raise InputError(f"not a pose: {e}", found=line[:120], expected="a JSON object, see `execute --help`") from e
    read.pose()
    return read


def line(X_WO: np.ndarray, age_s: float) -> bytes:
    """The line of a pose X_WO (4, 4) of which the picture was taken so long ago."""
    xyzw = Rotation.from_matrix(X_WO[:3, :3]).as_quat().tolist()
    xyz_mm = (X_WO[:3, 3] * 1e3).tolist()
    pose = {"xyz_mm": xyz_mm, "quaternion_wxyz": [xyzw[3], *xyzw[:3]], "age_ms": age_s * 1e3}
    return msgspec.json.encode(pose)


def open_source(spec: str) -> PoseSource:
    """A source by its name: ``udp:[HOST:]PORT``, ``MODULE:FUNCTION``, or a recording's path.

    Raises:
        InputError: there is none such.
    """
    kind, _, rest = spec.rpartition(":")
    if not kind:
        file = Path(spec)
        if not file.is_file():
            expected = "udp:[HOST:]PORT, MODULE:FUNCTION, or a recording"
            raise InputError("no such source", key="--feedback", found=spec, expected=expected)
        return RecordedSource(file)
    if kind == "udp" or kind.startswith("udp:"):
        if not rest.isdecimal() or int(rest) > 65535:
            raise InputError("not a port", key="--feedback", found=rest, expected="0 to 65535")
        return UdpSource(kind.removeprefix("udp").removeprefix(":") or "127.0.0.1", int(rest))
    try:
        ask = getattr(importlib.import_module(kind), rest)
    except (ImportError, AttributeError) as e:
        raise InputError(f"no such function: {e}", key="--feedback", found=spec, expected="MODULE:FUNCTION") from e
    return CallableSource(ask)


class UdpSource:
    """Listens for lines; a datagram is a line. Lines that are not poses are counted and ignored."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        """Binds the port (0: any that is free).

        Raises:
            InputError: it cannot be bound.
        """
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
        except OSError as e:
            self._socket.close()
            raise InputError(f"cannot listen: {e.strerror}", key="feedback", found=f"{host}:{port}") from e
        self.refused = 0
        """Lines that were no poses."""
        self.last_refused = ""
        """Why the last of them was none."""

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._socket.getsockname()[1])

    def poll(self, t: float) -> PoseSeen | None:
        """The newest pose that has arrived."""
        seen = None
        for _ in range(_MOST_LINES_AT_ONCE):
            try:
                line = self._socket.recv(_MOST_LINE_BYTES)
            except BlockingIOError:
                break
            try:
                read = parse(line)
                seen = PoseSeen(t=t - read.age_ms * 1e-3, X_WO=read.pose())
            except InputError as e:
                self.refused, self.last_refused = self.refused + 1, e.message
        return seen

    def close(self) -> None:
        """Stops listening."""
        self._socket.close()


class CallableSource:
    """Asks a function ``f(t) -> PoseSeen | None``, for a tracker that lives in the same program."""

    def __init__(self, ask: Callable[[float], PoseSeen | None]) -> None:
        self._ask = ask

    def poll(self, t: float) -> PoseSeen | None:
        """The function's answer."""
        return self._ask(t)


class RecordedSource:
    """Plays a recording: a file of lines, each with ``t``."""

    def __init__(self, file: Path) -> None:
        """Reads it whole.

        Raises:
            InputError: a line is no pose, has no `t`, or comes before the one above it.
        """
        self._lines: list[PoseLine] = []
        for number, text in enumerate(file.read_bytes().splitlines(), start=1):
            if not text.strip():
                continue
            try:
                line = parse(text)
            except InputError as e:
                raise InputError(e.message, file=file, key=f"line {number}", found=e.found, expected=e.expected) from e
            if line.t is None or (self._lines and line.t < (self._lines[-1].t or 0.0)):
                expected = "seconds, none less than in the line before"
                raise InputError(
                    "lines need times", file=file, key=f"line {number}: t", found=line.t, expected=expected
                )
            self._lines.append(line)
        self._next = 0

    def poll(self, t: float) -> PoseSeen | None:
        """The newest line whose time has come."""
        seen = None
        while self._next < len(self._lines) and (at := self._lines[self._next].t or 0.0) <= t:
            line = self._lines[self._next]
            seen = PoseSeen(t=at - line.age_ms * 1e-3, X_WO=line.pose())
            self._next += 1
        return seen
