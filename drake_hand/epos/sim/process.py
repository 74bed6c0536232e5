"""Simulated drives in a process of their own: for ``drives simulate``, and as a child that dies with its parent.

Commands are lines of JSON on standard input, one `Fault` each (see `faults`); a line that is wrong is answered on
standard error. The child's first line of input is its `Setup`, its one line of output says that it is ready.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import FileIO, RawIOBase
from pathlib import Path

import can
import msgspec
import numpy as np

from drake_hand.epos.bus import UDP_GROUP, BusSpec
from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.faults import Fault, FaultsFile
from drake_hand.errors import DrakeHandError, DriveError
from drake_hand.files import convert

_READY = b"ready\n"
_END_S, _LOOK_S = 5.0, 0.2


class Setup(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """What a child simulates."""

    drives: str
    channel: str
    q: list[float] | None
    zeroed: bool
    log: str | None
    faults: list[Fault]
    seed: int


@dataclass(frozen=True, kw_only=True)
class SpawnedDrives:
    """A child process of simulated drives, ready."""

    channel: str
    """Of ``udp_multicast``, with its port: what ``--channel`` takes."""
    process: subprocess.Popen

    interface = "udp_multicast"

    def open_bus(self) -> can.BusABC:
        """Opens a bus to them; the caller shuts it down."""
        return BusSpec().open(self.interface, self.channel)

    def inject(self, fault: Fault) -> None:
        """Lets a fault happen now."""
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
        q: (n,) where the joints stand, rad (the plan's first way-point, so that it may start).
        zeroed: whether their zeros are known.
        log: file for the timeline.
        faults: scheduled faults.
        seed: of everything random.

    Raises:
        DriveError: the child did not get ready.
    """
    channel = free_channel()
    setup = Setup(
        drives=str(drives.file),
        channel=channel,
        q=None if q is None else np.asarray(q, float).tolist(),
        zeroed=zeroed,
        log=str(log) if log else None,
        faults=faults.faults if faults else [],
        seed=seed,
    )
    # a session of its own: Ctrl-C reaches the master alone, which still has to stop these drives
    process = subprocess.Popen(
        [sys.executable, "-m", "drake_hand.epos.sim.process"],
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
            raise DriveError(f"the simulated drives did not start: {process.stderr.read().decode().strip()}")
        yield SpawnedDrives(channel=channel, process=process)
    finally:
        end(process)


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


def standard_input() -> FileIO:
    """Unbuffered, so that a thread that still waits for it does not hold up the end of the process."""
    return FileIO(0, closefd=False)


def listen(simulated: SimulatedDrives, commands: RawIOBase, ended: threading.Event) -> None:
    """Injects faults that come in as JSON lines; sets `ended` when no more can come."""
    for line in commands:
        try:
            if line.strip():
                simulated.inject(convert(msgspec.json.decode(line), Fault, file="(standard input)"))
        except (DrakeHandError, msgspec.DecodeError) as e:
            print(f"drake-hand: {e}", file=sys.stderr, flush=True)
    ended.set()


def serve(simulated: SimulatedDrives, commands: RawIOBase, stop: threading.Event, *, until_eof: bool) -> None:
    """Waits until `stop`, while faults come in as JSON lines.

    Args:
        simulated: started.
        commands: where the lines come from.
        stop: ends it.
        until_eof: whether the end of `commands` ends it too.
    """
    ended = stop if until_eof else threading.Event()
    threading.Thread(target=listen, args=(simulated, commands, ended), name="fault commands", daemon=True).start()
    while simulated.running and not stop.wait(_LOOK_S):
        pass


def _child() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    commands = standard_input()
    setup = msgspec.json.decode(commands.readline(), type=Setup)
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
            with simulated:
                os.write(1, _READY)
                serve(simulated, commands, threading.Event(), until_eof=True)
    except (DrakeHandError, can.CanError, OSError) as e:
        print(e, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_child())
