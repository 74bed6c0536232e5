"""A morning with the hand, command by command: zero, home, hand over, play, a fault, off, back from here, play again.

On fifteen simulated drives that were switched on just now, whose motors move a hand in physics: nobody but its fingers
holds the object once it was handed over. Every joint stands at 0 deg, which is how the zeros are told.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_hand.cli import run
from drake_hand.cli.driven_hand import Outcome
from drake_hand.cli.drives_physics import spawn_physical_hand
from drake_hand.epos.bus import BusSpec
from drake_hand.epos.drives import Drives
from drake_hand.epos.excerpts import around_grasp
from drake_hand.epos.pdo import NMT_COB, SYNC_COB
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.sim.process import SpawnedDrives
from drake_hand.plans.plan import Plan

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
        Command(tokens=["drives", "zero", "--by-hand", "zero"], status=0),
        Command(tokens=["drives", "home"], status=0),
        Command(tokens=[*execute, "--from-here", *hand_over], status=1, fault=True),
        Command(tokens=["drives", "off"], status=0),
        Command(tokens=[*execute, "--from-here", *hand_over], status=1),
        Command(tokens=[*execute, "--from-here", "--open", *hand_over], status=0),
        Command(tokens=["drives", "status"], status=0),
    ]


def morning(plan: Path, say: Callable[[str], None] = print) -> tuple[list[int], Outcome]:
    """Types them all; the statuses with which they end, and what became of the object in the last run.

    Args:
        plan: certified, for the bundled hand; nothing is in the hand at its start.
        say: told each command before it runs.
    """
    drives = Drives.load()
    found, ended = Plan.load(plan), []
    handed_s = around_grasp(found, found.duration)[0]
    with spawn_physical_hand(drives, plan, np.zeros(len(drives.joints)), zeroed=False, handed_s=handed_s) as hand:
        spawned = hand.spawned
        bus = ["--drives", "kanguera", "--interface", spawned.interface, "--channel", spawned.channel]
        for command in commands(plan):
            say("\n$ drake-hand " + " ".join(command.tokens))
            if command.fault:
                threading.Thread(target=_fail, args=(spawned,), daemon=True).start()
            agreed = [] if command.tokens[1] in ("off", "status") else ["--yes"]
            ended.append(run([*command.tokens, *bus, *agreed]))
        outcome = hand.outcome()
    say(f"\nin the end: {outcome}")
    return ended, outcome


def _fail(spawned: SpawnedDrives) -> None:
    """Lets a drive fail in the middle of the second motion it hears: the first brings the hand to the plan's start."""
    starts = syncs = 0
    with BusSpec().open(spawned.interface, spawned.channel) as bus:
        while syncs < FAULT_AFTER_SYNCS and (message := bus.recv(60.0)):
            starts += message.arbitration_id == NMT_COB and message.data[0] == NMT_START
            syncs += message.arbitration_id == SYNC_COB and starts == 2
    spawned.inject(InjectedFault(kind="emcy", joint="ring_pip", code=0x2310))
