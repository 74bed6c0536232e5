"""Simulated drives in a process of their own: for ``drives simulate``, and as a child that dies with its parent.

Commands are lines of JSON on standard input, one `InjectedFault` each (see `faults`); a wrong line is answered on
standard error. The child's first line of input is its `DrivesSetup`, its one line of output says that it is ready.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from io import FileIO, RawIOBase
from pathlib import Path
from typing import TypeVar

import can
import msgspec
import numpy as np

from drake_hand.epos.bus import UDP_GROUP
from drake_hand.epos.drives import Drives
from drake_hand.epos.realtime import quiet_interpreter
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.faults import FaultsFile, InjectedFault
from drake_hand.errors import DrakeHandError, DriveError
from drake_hand.files import convert

_READY = b"ready\n"
_Setup = TypeVar("_Setup", bound=msgspec.Struct)
_END_S, _LOOK_S = 5.0, 0.2


class DrivesSetup(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """What a child simulates."""

    drives: str
    channel: str
    q: list[float] | None
    zeroed: bool
    log: str | None
    faults: list[InjectedFault]
    seed: int


@dataclass(frozen=True, kw_only=True)
class SpawnedDrives:
    """A child process of simulated drives, ready."""

    channel: str
    """What ``--channel`` takes."""
    process: subprocess.Popen
    interface: str = "udp_multicast"

    def inject(self, fault: msgspec.Struct) -> None:
        """Lets a fault happen now: a `InjectedFault`, or what else they know to suffer."""
        assert self.process.stdin is not None
        self.process.stdin.write(msgspec.json.encode(fault) + b"\n")
        self.process.stdin.flush()


@contextmanager
def spawn_simulated_drives(
    drives: Drives,
    *,
    q: np.ndarray | None = None,
    zeroed: bool = True,
    log: Path | None = None,
    faults: FaultsFile | None = None,
    seed: int = 0,
) -> Iterator[SpawnedDrives]:
    """Simulated drives in a child process on a udp_multicast port of their own; it dies with this process.

    Args:
        drives: read from a file, which the child reads too.
        q: (n,) initial joint positions, rad (the plan's first waypoint, so that it may start).
        zeroed: whether their zeros are known.
        log: file for the timeline.
        faults: scheduled faults.
        seed: of everything random.

    Raises:
        DriveError: the child did not get ready.
    """
    channel = free_channel()
    setup = DrivesSetup(
        drives=str(drives.file),
        channel=channel,
        q=None if q is None else np.asarray(q, float).tolist(),
        zeroed=zeroed,
        log=str(log) if log else None,
        faults=faults.faults if faults else [],
        seed=seed,
    )
    with child(["-m", "drake_hand.epos.sim.process"], setup, "the simulated drives") as process:
        yield SpawnedDrives(channel=channel, process=process)


@contextmanager
def child(arguments: Sequence[str], setup: msgspec.Struct, who: str) -> Iterator[subprocess.Popen]:
    """A Python process that is given its setup and says when it is ready; it ends when its input does.

    Args:
        arguments: of the interpreter.
        setup: its first line of input; see :func:`begin`.
        who: it is, in an error.

    Raises:
        DriveError: it did not get ready.
    """
    # a session of its own: Ctrl-C reaches the master alone, which still has to stop these drives
    process = subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        process.stdin.write(msgspec.json.encode(setup) + b"\n")
        process.stdin.flush()
        if process.stdout.readline() != _READY:
            raise DriveError(f"{who} did not start: {process.stderr.read().decode().strip()}")
        yield process
    finally:
        end(process)


def begin(setup: type[_Setup]) -> tuple[FileIO, _Setup]:
    """In a child: its input, from which more may come, and its setup. Ctrl-C is the parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    commands = standard_input()
    return commands, msgspec.json.decode(commands.readline(), type=setup)


def standard_input() -> FileIO:
    """Unbuffered, so that a thread that still waits for it does not hold up the end of the process."""
    return FileIO(0, closefd=False)


def ready() -> None:
    """In a child: says that it is."""
    os.write(1, _READY)


def end(process: subprocess.Popen) -> None:
    """Closes its input, which ends it; kills it if that does not."""
    for stream in (process.stdin, process.stdout, process.stderr):
        with suppress(OSError):  # it may have gone already, with our last line unread
            if stream:
                stream.close()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def free_channel() -> str:
    """A udp_multicast channel nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("", 0))
        return f"{UDP_GROUP}:{s.getsockname()[1]}"


def read_commands(take: Callable[[dict], None], commands: RawIOBase, ended: threading.Event) -> None:
    """Hands on what comes in as JSON lines; sets `ended` when no more can come."""
    for line in commands:
        try:
            if line.strip():
                take(msgspec.json.decode(line, type=dict))
        except (DrakeHandError, msgspec.DecodeError) as e:
            print(f"drake-hand: {e}", file=sys.stderr, flush=True)
    ended.set()


def inject(simulated: SimulatedDrives, command: dict) -> None:
    """Lets a fault that came in happen.

    Raises:
        InputError: it is none.
    """
    simulated.inject(convert(command, InjectedFault, file="(standard input)"))


def serve(simulated: SimulatedDrives, commands: RawIOBase, stop: threading.Event, *, until_eof: bool) -> None:
    """Waits until `stop`, while faults come in as JSON lines.

    Args:
        simulated: started.
        commands: where the lines come from.
        stop: ends it.
        until_eof: whether the end of `commands` ends it too.
    """
    ended = stop if until_eof else threading.Event()
    take = partial(inject, simulated)
    threading.Thread(target=read_commands, args=(take, commands, ended), name="fault commands", daemon=True).start()
    while simulated.running and not stop.wait(_LOOK_S):
        pass


def _child() -> int:
    commands, setup = begin(DrivesSetup)
    try:
        drives = Drives.load(setup.drives)
        with drives.bus.open("udp_multicast", setup.channel) as bus:
            simulated = SimulatedDrives(
                bus,
                drives,
                q=None if setup.q is None else np.array(setup.q),
                zeroed=setup.zeroed,
                log=Path(setup.log) if setup.log else None,
                faults=FaultsFile(faults=setup.faults),
                seed=setup.seed,
            )
            with simulated, quiet_interpreter():
                ready()
                serve(simulated, commands, threading.Event(), until_eof=True)
    except (DrakeHandError, can.CanError, OSError) as e:
        print(e, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_child())
