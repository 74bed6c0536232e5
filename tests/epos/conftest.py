import itertools
import sys
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from drake_hand.epos.master import Master
from drake_hand.epos.sim import SimulatedDrives

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))  # swing, fault_table: used by both

_channels = itertools.count()


@contextmanager
def _virtual(drives, **options):
    """A bus for the master, and drives at the other end of it."""
    channel = f"test-{next(_channels)}"
    with (
        can.Bus(interface="virtual", channel=channel) as ours,
        can.Bus(interface="virtual", channel=channel) as theirs,
        SimulatedDrives(theirs, drives, **options) as sim,
    ):
        yield ours, sim


@pytest.fixture
def virtual():
    """``with virtual(drives) as (bus, sim)``."""
    return _virtual


@pytest.fixture
def mastered():
    """``with mastered(drives) as (master, sim)``."""

    @contextmanager
    def made(drives, heartbeat_s=0.1, **options):
        with _virtual(drives, **options) as (bus, sim), Master(bus, heartbeat_s=heartbeat_s) as master:
            yield master, sim

    return made
