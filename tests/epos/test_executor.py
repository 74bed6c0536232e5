"""From plan to motors that moved and are disabled again: whole runs, and a master that is killed or hangs."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fault_trials import STAMP_S
from playing import Listening, drives_20ms, explained
from swing import swing

from drake_hand.epos import executor, master
from drake_hand.epos import objects as od
from drake_hand.epos.bus import BusSpec
from drake_hand.epos.clock import OwnClock
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute
from drake_hand.epos.record import RunRecord
from drake_hand.epos.sim.process import spawn_simulated_drives
from drake_hand.epos.state import DriveState, decode_state
from drake_hand.errors import DriveError
from tests.epos.timelines import read_timeline

pytestmark = pytest.mark.clocked

KANGUERA = Drives.load()


def alone(types):
    """Drives of one type: all three are on the mixed bus, too, whose test is the quick one."""
    return pytest.param(types, marks=pytest.mark.slow)


@pytest.mark.parametrize("types", ["mix", alone("epos2"), alone("epos4"), alone("epos1")])
def test_a_plan_is_played_and_every_drive_is_disabled(types, virtual, patiently, tmp_path):
    drives = drives_20ms(types)
    plan = swing(drives.joints, 0.6)
    file = tmp_path / "x.run.npz"
    seen, ends = [], []

    def play():
        with virtual(drives) as (bus, sim):
            run = execute(plan, drives, bus, log=file, progress=seen.append)
            assert not any(s.powered for s in sim.states.values())
            assert not any(s.dictionary[od.CONSUMER_HEARTBEAT] for s in sim._simulated)
            ends.append(sim.q)
        return run

    run = patiently(play)
    assert ends[-1] == pytest.approx(np.zeros(15), abs=np.radians(0.4))
    answer = run.answer()
    assert answer["faults"] == []
    assert (answer["ok"], answer["drives"], answer["disabled"], answer["start_skew_syncs"]) == (True, 15, True, 0)
    assert 0 < answer["max_tracking_error_deg"] < 3
    assert set(answer["sync_late_ms"]) == {"p50", "p99", "max"}
    explained(answer, [d.type for d in drives.drives], 0.02)
    record = RunRecord.load(file)
    assert record.header == run.record.header
    assert record.header.plan_hash == plan.hash
    assert record.plan_time[record.playing][-1] == pytest.approx(0.6, abs=0.021)
    assert {p.stage for p in seen} >= {"looking for drives", "configuring", "playing"}
    assert msgspec.json.encode(answer)


def test_fifteen_drives_in_another_process(tmp_path, patiently):
    plan = swing(KANGUERA.joints, 0.6)
    timeline = tmp_path / "timeline.jsonl"

    def play():
        with (
            spawn_simulated_drives(KANGUERA, log=timeline) as spawned,
            BusSpec().open(spawned.interface, spawned.channel) as bus,
        ):
            return execute(plan, KANGUERA, bus)

    answer = patiently(play).answer()
    assert answer["faults"] == []
    assert (answer["ok"], answer["disabled"], answer["start_skew_syncs"]) == (True, True, 0)
    explained(answer, ["epos2"] * 15, 0.01)
    _, rows, _ = read_timeline(timeline)
    active = np.array([[word >> 12 & 1 for word in r.status] for r in rows if r.sync is not None])
    first = active.argmax(axis=0)
    assert active.any(axis=0).all()
    assert np.ptp(first) == 0  # SYNC periods, as the drives themselves saw it
    assert set(_last_states(timeline).values()) == {DriveState.SWITCH_ON_DISABLED.value}


def _last_states(timeline) -> dict[str, str]:
    _, _, events = read_timeline(timeline)
    return {e.joint: e.what for e in events if e.event == "state"}


PLAYER = """
import sys
sys.path.insert(0, {here!r})
from swing import swing
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute
from drake_hand.epos.master import open_bus

def progress(p):
    print(p.stage, flush=True)

drives = Drives.load()
with open_bus(drives.bus, "udp_multicast", sys.argv[1]) as bus:
    execute(swing(drives.joints, 6.0, swings=6, amplitude_deg=40), drives, bus, progress=progress)
"""


def test_a_master_that_is_killed_leaves_drives_that_stop_by_themselves(tmp_path):
    timeline = tmp_path / "timeline.jsonl"
    code = PLAYER.format(here=str(Path(__file__).parent))
    with (
        spawn_simulated_drives(KANGUERA, log=timeline) as spawned,
        subprocess.Popen([sys.executable, "-c", code, spawned.channel], stdout=subprocess.PIPE, text=True) as player,
    ):
        assert player.stdout is not None
        for line in player.stdout:
            if line.strip() == "playing":
                break
        time.sleep(0.8)
        killed = time.time()
        player.send_signal(signal.SIGKILL)
        player.wait()
        time.sleep(0.6)
    header, rows, events = read_timeline(timeline)
    before = [r for r in rows if r.t < killed][-1]
    assert {decode_state(word, "epos2") for word in before.status} == {DriveState.OPERATION_ENABLED}
    stopped = {e.joint: e.t for e in events if e.event == "state" and e.t > killed and e.what == "quick stop active"}
    assert set(stopped) == set(header.joints)
    limit = KANGUERA.bus.heartbeat_consumer_ms * 1e-3 + 1.5 * KANGUERA.bus.sync_ms * 1e-3 + STAMP_S
    assert max(stopped.values()) - killed < limit
    at_rest = np.array([r.position for r in rows if r.t > killed + limit + 0.1])
    assert len(at_rest) > 10
    assert np.ptp(at_rest, axis=0).max() < 1.0


def test_drives_that_are_not_read_back_go_on_watching_the_master(virtual, monkeypatch):
    """Also when the run ends by an exception."""
    drives = drives_20ms("epos2")
    monkeypatch.setattr(executor.discovery, "disable_all", lambda master, all_: ["little_pip"])

    def fail(progress):
        if progress.stage == "playing":
            raise RuntimeError("on purpose")

    with virtual(drives) as (bus, sim):
        with pytest.raises(DriveError, match="not read back as disabled: little_pip") as e:
            execute(swing(drives.joints, 1.0), drives, bus, progress=fail)
        assert isinstance(e.value.__cause__, RuntimeError)
        watching = [s.drive.joint for s in sim._simulated if s.dictionary[od.CONSUMER_HEARTBEAT]]
    assert watching == ["little_pip"]


def test_an_interface_that_hangs_is_given_up_and_every_drive_is_named(virtual, monkeypatch):
    monkeypatch.setattr(OwnClock, "hangs_s", 0.5)
    monkeypatch.setattr(executor, "STOP_WITHIN_S", 0.1)
    monkeypatch.setattr(master, "_CLOSE_S", 0.1)
    drives = drives_20ms("epos2")
    with virtual(drives) as (bus, sim):

        class Hanging(Listening):
            over = False

            def recv(self, timeout=None):
                while 0x201 in self.sent and not self.over:
                    time.sleep(0.01)
                return super().recv(timeout)

        hanging = Hanging(bus)
        with pytest.raises(DriveError, match="not read back as disabled: little_abduction, little_flexion"):
            execute(swing(drives.joints, 1.0), drives, hanging)
        hanging.over = True
        assert not any(s is DriveState.OPERATION_ENABLED for s in sim.states.values())


def test_the_executor_loads_light():
    code = "import sys, drake_hand.epos.executor; print(*{m.split('.')[0] for m in sys.modules})"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"pydrake", "trimesh", "matplotlib", "yourdfpy"} & set(out)
    assert executor.__doc__
