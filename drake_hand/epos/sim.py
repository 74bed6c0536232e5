"""`SimulatedDrives`: EPOS drives on a CAN bus that behave like the real ones; in a thread, or in a child process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import can

from drake_hand.epos.drives import Drives


class SimulatedDrives:
    """Simulated drives on an open bus; a context manager that starts and stops their one thread.

    The bus has to be the drives' own object (on ``virtual``: another `can.Bus` of the same channel than the master's).

    Args:
        bus: open python-can bus; stays the caller's to shut down.
        drives: which drives.
        log: file for the timeline (JSON lines: status words and positions at each SYNC, faults, EMCY, state changes).
        faults: file of scheduled faults.
        seed: of everything random.
        settings: folder that keeps the drives' stored parameters over a restart; memory only if not given.
    """

    def __init__(
        self,
        bus: can.BusABC,
        drives: Drives,
        *,
        log: Path | None = None,
        faults: Path | None = None,
        seed: int = 0,
        settings: Path | None = None,
    ) -> None:
        raise NotImplementedError

    def start(self) -> None:
        """Boots all drives (boot-up frames) and serves them in a thread."""
        raise NotImplementedError

    def stop(self) -> None:
        """Cuts their power: ends the thread; idempotent."""
        raise NotImplementedError

    def __enter__(self) -> SimulatedDrives:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()


@dataclass(frozen=True, kw_only=True)
class SpawnedDrives:
    """A child process of simulated drives, ready: where to reach it."""

    interface: str
    channel: str
    port: int
    pid: int

    def open_bus(self) -> can.BusABC:
        """Opens a bus to them; the caller shuts it down."""
        raise NotImplementedError


@contextmanager
def spawn_simulated_drives(
    drives: Drives, *, log: Path | None = None, faults: Path | None = None, seed: int = 0
) -> Iterator[SpawnedDrives]:
    """Simulated drives in a child process on a udp_multicast channel of their own; it dies with this process.

    Raises:
        DriveError: the child did not get ready.
    """
    raise NotImplementedError
    yield
