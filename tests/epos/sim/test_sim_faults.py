import numpy as np
import pytest
from sim_bench import MASTER, Bench

from drake_hand.epos import objects as o
from drake_hand.epos import pdo
from drake_hand.epos.sim.faults import FaultsFile, FrameFaults, InjectedFault, draw_open_values, kind_of
from drake_hand.epos.state import DriveState
from drake_hand.errors import InputError
from tests.epos.timelines import read_timeline, rows_as_arrays


@pytest.fixture
def three(tmp_path):
    def make(kinds=("epos4", "epos4", "epos4"), **options):
        bench = Bench(tmp_path, list(kinds), **options)
        bench.enable()
        return bench

    return make


def test_kinds_of_frames():
    assert [kind_of(c) for c in (0, 0x80, 0x81, 0x181, 0x201, 0x281, 0x301, 0x501, 0x581, 0x601, 0x701)] == [
        "nmt",
        "sync",
        "emcy",
        "status",
        "command",
        "interpolation",
        "record",
        "stop",
        "sdo",
        "sdo",
        "heartbeat",
    ]


def test_frames_are_lost_late_or_doubled():
    frames = FrameFaults(np.random.default_rng(1))
    assert frames.delays("tx", 0x181, 0.0) == [0.0]
    frames.add(InjectedFault(kind="duplicate", frames=["status"]), 0.0)
    frames.add(InjectedFault(kind="late", delay_ms=30, direction="rx"), 0.0)
    assert frames.delays("tx", 0x181, 0.0) == [0.0, 0.0]
    assert frames.delays("rx", 0x201, 0.0) == [0.03]
    frames.add(InjectedFault(kind="lost", probability=0.25, duration_s=1.0), 0.0)
    lost = sum(frames.delays("tx", 0x701, 0.5) == [] for _ in range(2000))
    assert 400 < lost < 600
    assert frames.delays("tx", 0x701, 1.5) == [0.0]


def test_what_is_open_is_drawn_by_the_seed(three):
    drives = three().drives
    fault = InjectedFault(kind="stuck", between_s=(1.0, 2.0))
    drawn = [draw_open_values(fault, drives, np.random.default_rng(s)) for s in (1, 1, 2, 3, 4)]
    assert drawn[0] == drawn[1]
    assert len({f.joint for f in drawn}) > 1
    assert all(1.0 <= f.at_s <= 2.0 for f in drawn)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("faults: [{kind: stuck, joint: j9}]", ["faults[0].joint", "j9", "j1"]),
        ("faults: [{kind: struck}]", ["struck"]),
        ("faults: [{kind: stuck, between_s: [2, 1]}]", ["faults[0].between_s"]),
    ],
)
def test_wrong_faults_are_refused(three, tmp_path, text, words):
    file = tmp_path / "faults.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as e:
        FaultsFile.load(file, three().drives)
    for word in [*words, str(file)]:
        assert word in str(e.value)


def run(bench, n, nodes=(1, 2, 3)):
    for k in range(1, n + 1):
        for node in nodes:
            bench.send(0x200 + node, pdo.LAYOUT["epos4"].command.pack(0x0F, 3 * k))
        status = bench.sync()
    return status


def test_a_schedule_waits_for_the_motion(three):
    schedule = FaultsFile(faults=[InjectedFault(kind="emcy", joint="j2", code=0x3210, at_s=0.2)])
    bench = three(faults=schedule)
    bench.sync(50)
    assert bench.emcys() == []
    run(bench, 10)
    assert bench.emcys() == []
    run(bench, 15)
    assert bench.emcys() == [(2, 0x3210)]
    assert [bench.state(n) for n in (1, 2, 3)] == [
        DriveState.OPERATION_ENABLED,
        DriveState.FAULT,
        DriveState.OPERATION_ENABLED,
    ]


def test_a_drive_in_fault_at_start(three, tmp_path):
    schedule = FaultsFile(faults=[InjectedFault(kind="emcy", joint="j1", since="boot")])
    bench = Bench(tmp_path, ["epos2"], faults=schedule)
    bench.wait(0.1)
    assert bench.state(1) is DriveState.FAULT


@pytest.mark.parametrize("kind", ["following_error", "stuck"])
def test_motor_faults_grow_into_following_errors(three, kind):
    bench = three()
    bench.write(2, o.FOLLOWING_WINDOW, 40)
    run(bench, 5)
    bench.sim.inject(InjectedFault(kind=kind, joint="j2"))
    run(bench, 8)
    assert bench.emcys() == []
    assert bench.read(2, o.FOLLOWING_ERROR["epos4"]) != 0
    run(bench, 100)
    assert (2, 0x8611) in bench.emcys()


def test_a_silent_drive_is_heard_again_when_cleared(three):
    bench = three()
    bench.sim.inject(InjectedFault(kind="lost", joint="j3"))
    assert set(run(bench, 3)) == {1, 2}
    bench.sim.inject(InjectedFault(kind="clear", joint="j3"))
    assert set(run(bench, 1)) == {1, 2, 3}


def test_late_status_comes_late(three):
    bench = three()
    bench.sim.inject(InjectedFault(kind="late", joint="j1", frames=["status"], delay_ms=4))
    assert set(run(bench, 1)) == {2, 3}
    bench.t += 0.003
    bench.sim.step(bench.t)
    before = len(bench.bus.sent)
    bench.t += 0.002
    bench.sim.step(bench.t)
    assert [cob for cob, _ in bench.bus.sent[before:]] == [0x181]


def test_bus_off_silences_a_drive_which_stops_by_itself(three):
    bench = three()
    run(bench, 20)
    bench.sim.inject(InjectedFault(kind="bus_off", joint="j1"))
    assert set(run(bench, 20)) == {2, 3}
    assert bench.emcys() == []  # nobody hears it
    assert bench.sim.states["j1"] is DriveState.QUICK_STOP_ACTIVE


def test_heartbeat_reset_and_identity_faults(three):
    bench = three()
    for n in (1, 2, 3):
        bench.write(n, o.PRODUCER_HEARTBEAT, 50)
    for kind, joint in (("heartbeat_loss", "j1"), ("nmt_reset", "j2"), ("wrong_identity", "j3")):
        bench.sim.inject(InjectedFault(kind=kind, joint=joint, vendor=7))
    heard = {(cob, d) for cob, d in bench.wait(0.2) if cob & 0x780 == 0x700}
    assert heard == {(0x702, b"\0"), (0x703, b"\5")}
    assert bench.state(2) is DriveState.SWITCH_ON_DISABLED
    bench.send(0, b"\x81\3")
    assert bench.read(3, o.VENDOR) == 7


def test_dead_master_all_stop_within_the_consumer_time_and_the_ramp(three, tmp_path):
    """The master falls silent in mid-motion: nobody tells the drives anything any more."""
    log = tmp_path / "log.jsonl"
    bench = three(kinds=["epos2", "epos4", "epos1"], log=log)
    for n in (1, 2, 3):
        bench.write(n, o.CONSUMER_HEARTBEAT, MASTER << 16 | 250)
    bench.write(1, o.IP_BUFFER_CLEAR, 1)
    speed = 1000.0  # counts/s, 937 rpm
    for k in range(60):
        bench.send(0x301, pdo.pack_record(round(speed * 0.02 * k), speed * 60 / 64, 20))
    for k in range(30):
        bench.send(0x201, b"\x1f\0")
        bench.send(0x202, pdo.LAYOUT["epos4"].command.pack(0x0F, round(speed * 0.01 * k)))
        bench.send(0x203, pdo.LAYOUT["epos1"].command.pack(0x0F, round(speed * 0.01 * k)))
        bench.send(0x700 + MASTER, b"\5")
        bench.sync()
    dead = bench.t
    bench.wait(1.0)
    bench.sim.stop()
    assert set(bench.emcys()) == {(n, 0x8130) for n in (1, 2, 3)}
    _, rows, events = read_timeline(log)
    t, _, position, _ = rows_as_arrays(rows)
    after = t > dead + 0.25 + 0.02 + speed / (50_000 * 64 / 60) + 0.05  # consumer, tick, ramp, the servo's lag
    assert after.sum() > 20
    assert np.ptp(position[after], axis=0).max() < 1.0
    assert np.ptp(position[(t > dead) & (t < dead + 0.2)][:, 0]) > 150  # the queue alone ran on
    stopped = {e.joint: e.t - dead for e in events if e.what == "quick stop active"}
    assert sorted(stopped) == ["j1", "j2", "j3"]
    assert all(0.24 < s < 0.265 for s in stopped.values())  # the last heartbeat came 10 ms before the last SYNC


def test_timeline_has_every_sync_and_every_change(three, tmp_path):
    log = tmp_path / "log.jsonl"
    bench = three(log=log)
    run(bench, 20)
    bench.sim.stop()
    header, rows, events = read_timeline(log)
    assert header.nodes == [1, 2, 3]
    synced = [r for r in rows if r.sync is not None]
    assert [r.sync for r in synced] == list(range(1, 21))
    assert np.diff(rows_as_arrays(synced)[0]) == pytest.approx(0.01)
    assert [e.what for e in events if e.event == "mark"] == ["boot", "enabled", "motion"]
