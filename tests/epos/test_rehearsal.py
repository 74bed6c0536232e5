from itertools import groupby

import pytest
from fault_trials import drives_of
from swing import swing

from drake_hand.epos import pdo
from drake_hand.epos.executor import execute
from drake_hand.epos.rehearsal import Frame, bus_load, lines, rehearse
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.sim.faults import kind_of

DRIVES = drives_of("mix", sync_ms=20)
PLAN = swing(DRIVES.joints, 0.5)


class Noting:
    def __init__(self, bus):
        self._bus, self.channel_info, self.sent = bus, bus.channel_info, []

    def send(self, message, timeout=None):
        self.sent.append((message.arbitration_id, bytes(message.data)))
        self._bus.send(message, timeout)

    def recv(self, timeout=None):
        return self._bus.recv(timeout)


def by_cob(frames: list[tuple[int, bytes]]) -> dict[int, list[bytes]]:
    """What each COB-ID was told, in order; repetitions left out, since a real run repeats until it is answered."""
    told: dict[int, list[bytes]] = {}
    for cob, data in frames:
        told.setdefault(cob, []).append(data)
    return {cob: [d for d, _ in groupby(all_)] for cob, all_ in told.items()}


def test_a_dry_run_has_the_frames_of_the_real_run(virtual, patiently):
    noted = []

    def play():
        with virtual(DRIVES) as (bus, _):
            noted.append(Noting(bus))
            return execute(PLAN, DRIVES, noted[-1])

    assert patiently(play).ok
    noting = noted[-1]
    real = by_cob(noting.sent)
    dry = by_cob([(f.cob, f.data) for f in rehearse(Schedule.build(PLAN, DRIVES)).frames if f.from_master])
    for d in DRIVES.drives:
        for layout in pdo.LAYOUT[d.type].all:
            if layout.direction == "rx":
                assert real[layout.cob_id(d.node)] == dry[layout.cob_id(d.node)], d
        writes = {data for data in real[pdo.SDO_RX_BASE + d.node] if data[0] in (0x23, 0x2B, 0x2F)}
        assert set(dry[pdo.SDO_RX_BASE + d.node]) <= writes


def test_every_line_has_words():
    rehearsal = rehearse(Schedule.build(PLAN, DRIVES))
    text = list(lines(rehearsal))
    assert len(text) == sum(f.from_master for f in rehearsal.frames)
    assert all(line.split("  ")[-1].strip() for line in text)
    assert sum("disable voltage at once" in line for line in text) == 15


@pytest.mark.parametrize(("size", "bits"), [(0, 55), (8, 135)])
def test_longest_frames_with_all_stuff_bits(size, bits):
    assert Frame(t=0.0, cob=0x80, data=bytes(size), from_master=True).bits == bits


def test_bus_load_of_fifteen_full_pdos_each_way():
    """4.1 ms in each 10 ms at 1 Mbit/s."""
    drives = drives_of("epos2")
    frames = [
        Frame(t=t, cob=cob, data=bytes(size), from_master=True)
        for t in (0.0, 0.01, 0.02)
        for cob, size in [(pdo.SYNC_COB, 0)] + [(0x181, 8)] * 30
    ]
    mean, largest = bus_load(frames, drives)
    assert mean == pytest.approx(0.4105)
    assert largest == pytest.approx(0.4105)
    assert kind_of(0x181) == "status"
