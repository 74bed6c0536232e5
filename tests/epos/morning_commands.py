"""A morning with the hand, command by command: zero, home, hand over, play, a fault, off, back from here, play again.

On fifteen simulated drives that were switched on just now, in a process and on a bus of their own.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_hand.cli import run
from drake_hand.epos.drives import Drives
from drake_hand.epos.pdo import NMT_COB, SYNC_COB
from drake_hand.epos.sim.faults import Fault
from drake_hand.epos.sim.process import SpawnedDrives, spawn_simulated_drives

NMT_START = 1
FAULT_AFTER_SYNCS = 500
"""Of the plan's own run: in the middle of it."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """What is typed, and with which status it has to end."""

    tokens: list[str]
    status: int
    fault: bool = False
    """Whether a drive fails while it runs."""


def commands(plan: Path) -> list[Command]:
    """The morning."""
    execute = ["execute", str(plan)]
    hand_over = ["--pause", "grasp", "--go-after", "0.5"]
    return [
        Command(tokens=execute, status=1),
        Command(tokens=["drives", "zero"], status=0),
        Command(tokens=["drives", "home"], status=0),
        Command(tokens=[*execute, "--from-here", *hand_over], status=1, fault=True),
        Command(tokens=["drives", "off"], status=0),
        Command(tokens=[*execute, "--from-here", *hand_over], status=1),
        Command(tokens=[*execute, "--from-here", "--open", *hand_over], status=0),
        Command(tokens=["drives", "status"], status=0),
    ]


def morning(plan: Path, say: Callable[[str], None] = print) -> list[int]:
    """Types them all; the statuses with which they end.

    Args:
        plan: certified, for the bundled hand; nothing is in the hand at its start.
        say: told each command before it runs.
    """
    drives = Drives.load()
    q = np.radians(np.where(np.char.find(drives.joints, "flexion") >= 0, 20.0, 8.0))  # as somebody left it
    ended = []
    with spawn_simulated_drives(drives, q=q, zeroed=False) as spawned:
        bus = ["--drives", "kanguera", "--interface", spawned.interface, "--channel", spawned.channel]
        for command in commands(plan):
            say("\n$ drake-hand " + " ".join(command.tokens))
            if command.fault:
                threading.Thread(target=_fail, args=(spawned,), daemon=True).start()
            agreed = [] if command.tokens[1] in ("off", "status") else ["--yes"]
            ended.append(run([*command.tokens, *bus, *agreed]))
    return ended


def _fail(spawned: SpawnedDrives) -> None:
    """Lets a drive fail in the middle of the second motion it hears: the first brings the hand to the plan's start."""
    starts = syncs = 0
    with spawned.open_bus() as bus:
        while syncs < FAULT_AFTER_SYNCS and (message := bus.recv(60.0)):
            starts += message.arbitration_id == NMT_COB and message.data[0] == NMT_START
            syncs += message.arbitration_id == SYNC_COB and starts == 2
    spawned.inject(Fault(kind="emcy", joint="ring_pip", code=0x2310))
