import itertools
from contextlib import contextmanager

import can
import pytest

from drake_hand.epos.master import Master
from drake_hand.epos.sim.drives import SimulatedDrives

_channels = itertools.count()


def pytest_itemcollected(item):
    """Whoever asks for a bus keeps time; tests that open one themselves say so."""
    if {"virtual", "mastered"} & set(item.fixturenames):
        item.add_marker("clocked")


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
def patiently():
    """``run = patiently(play)``: plays again when this machine, too busy, kept a SYNC or an answer too long."""

    def made(play):
        for _ in range(4):
            run = play()
            first = next((f for f in run.record.header.faults), None)
            if first is None or first.kind not in ("late", "silent", "heartbeat"):
                return run
            assert run.record.header.not_disabled == []
        pytest.skip(f"this machine is too busy: {first.text}")

    return made


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
