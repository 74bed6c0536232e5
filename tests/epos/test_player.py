"""The player against simulated drives, in step with them: no bus, no threads, no clock."""

from dataclasses import replace

import numpy as np
import pytest
from fault_trials import drives_of
from swing import swing

from drake_hand.epos import pdo, player, pvt
from drake_hand.epos.pvt import LOW_S, QUEUE_S
from drake_hand.epos.rehearsal import Rehearsal
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.sim.faults import InjectedFault, kind_of
from drake_hand.epos.state import Control, DriveState

TYPES = ["epos2", "epos4", "epos1", "mix"]
DURATION = 0.6


def begin(types: str, **options) -> Rehearsal:
    drives = drives_of(types, **options)
    rehearsal = Rehearsal(Schedule.build(swing(drives.joints, DURATION), drives))
    rehearsal.configure()
    return rehearsal


def until(rehearsal: Rehearsal, condition, most: int = 400) -> None:
    for _ in range(most):
        if condition():
            return
        rehearsal.tick()
    pytest.fail("did not get there")


def playing(rehearsal: Rehearsal, step: int) -> Rehearsal:
    until(rehearsal, lambda: rehearsal.player.step >= step)
    return rehearsal


def ended(rehearsal: Rehearsal) -> Rehearsal:
    until(rehearsal, rehearsal.player.done.is_set)
    assert not any(s.powered for s in rehearsal.sim.states.values())
    return rehearsal


@pytest.fixture(scope="module", params=TYPES)
def clean(request) -> Rehearsal:
    return ended(begin(request.param))


def test_a_clean_run_plays_to_the_end_without_a_fault(clean):
    player = clean.player
    assert player.faults == []
    assert player.step == clean.schedule.last
    assert player.stage == "disabled"


def test_the_motors_follow_the_schedule_with_the_lag_of_the_servo(clean):
    rows = clean.player.log
    k = rows.rows
    error = clean.schedule.counts[rows._step[:k]] - rows._position[:k]
    fastest = np.abs(np.diff(clean.schedule.counts, axis=0)).max() / clean.schedule.period
    assert np.abs(error).max() <= fastest * 0.02 + 3  # 9 ms of lag, and what the staircase of position mode adds
    assert np.abs(error[-1]).max() <= 2


def test_no_drive_is_enabled_before_all_are_switched_on(clean):
    enable, answers = None, {}
    for frame in clean.frames:
        kind = kind_of(frame.cob)
        if kind == "command" and frame.data[0] == Control.ENABLE and enable is None:
            enable = frame
            break
        if kind == "status":
            answers[frame.cob & 0x7F] = int.from_bytes(frame.data[:2], "little")
    assert enable is not None
    assert len(answers) == 15
    assert all(status & 0x7F in (0x23, 0x33) for status in answers.values())  # switched on


def test_all_start_in_the_same_sync(clean):
    """The frames that start them lie between the same two SYNCs, one for each drive; PVT drives then say so at once."""
    sync, starts = 0, {}
    moving = [clean.schedule.counts[:, i] for i in range(15)]
    by_node = dict(zip(clean.schedule.drives.nodes, moving, strict=True))
    assert len(by_node) == 15
    for frame in clean.frames:
        sync += frame.cob == pdo.SYNC_COB
        if kind_of(frame.cob) == "command" and frame.data[0] == Control.ENABLE_RUN:
            starts[frame.cob & 0x7F] = sync
    pvt = {d.node for d in clean.schedule.drives.drives if d.type == "epos2"}
    assert set(starts) == pvt
    assert len(set(starts.values())) == (1 if pvt else 0)
    assert clean.player.start_skew == 0


def test_types_of_a_mix_move_together():
    """No type is ahead of another by as much as a period."""
    rehearsal = ended(begin("mix"))
    k, log = rehearsal.player.log.rows, rehearsal.player.log
    schedule = rehearsal.schedule
    speed = np.gradient(schedule.counts.astype(float), schedule.period, axis=0)[log._step[:k]]
    error = schedule.counts[log._step[:k]] - log._position[:k]
    delay = (error * speed).sum(axis=0) / (speed**2).sum(axis=0)
    assert np.ptp(delay) < schedule.period


def test_the_queue_holds_half_a_second_at_most_and_never_runs_low():
    rehearsal = begin("epos2")
    log = ended(rehearsal).player.log
    queued = log._queued[: log.rows]
    record_s = rehearsal.schedule.record_steps * rehearsal.schedule.period
    assert queued.max() * record_s <= min(0.5, QUEUE_S + 1e-9)
    remaining = (rehearsal.schedule.last - log._step[: log.rows]) * rehearsal.schedule.period
    assert queued[remaining > QUEUE_S].min() * record_s > LOW_S


def test_after_lost_periods_the_queue_is_filled_up_again_but_not_beyond():
    rehearsal = playing(begin("epos2"), 30)
    rehearsal.tick(late=0.09, skipped=9)
    assert rehearsal.player.step == 40
    low = [a.queued for a in rehearsal.player.axes]
    seen = []
    for _ in range(8):
        rehearsal.tick()
        seen.append([a.queued for a in rehearsal.player.axes])
    assert max(low) <= 16
    assert np.min(seen[-1]) >= 18
    assert np.max(seen) <= 20
    assert ended(rehearsal).player.faults == []


@pytest.mark.parametrize("types", TYPES)
@pytest.mark.parametrize(
    "fault",
    [
        InjectedFault(kind="emcy", code=0x2310),
        InjectedFault(kind="emcy", code=0x8120),
        InjectedFault(kind="nmt_reset"),
        InjectedFault(kind="bus_off"),
    ],
    ids=lambda f: f"{f.kind}-{f.code:X}",
)
def test_what_one_drive_suffers_stops_all(types, fault):
    rehearsal = playing(begin(types), 40)
    joint = rehearsal.schedule.drives.joints[7]
    rehearsal.sim.inject(InjectedFault(kind=fault.kind, code=fault.code, joint=joint))
    reaction = rehearsal.ticks
    until(rehearsal, lambda: all(s is not DriveState.OPERATION_ENABLED for s in rehearsal.sim.states.values()))
    assert rehearsal.ticks - reaction <= (5 if fault.kind == "bus_off" else 2)
    until(rehearsal, rehearsal.player.done.is_set)
    assert rehearsal.player.faults[0].joint == joint
    others = {j: s for j, s in rehearsal.sim.states.items() if j != joint}
    assert not any(s.powered for s in others.values())


@pytest.mark.parametrize("types", TYPES)
def test_a_stop_is_not_undone_by_a_command_that_waits_for_the_sync(types):
    rehearsal = playing(begin(types), 40)
    rehearsal.player.request_stop("interrupt", "SIGINT")
    rehearsal.tick()  # the latched commands of this period were pending
    rehearsal.tick()
    assert set(rehearsal.sim.states.values()) == {DriveState.QUICK_STOP_ACTIVE}
    for _ in range(2):
        rehearsal.tick()
        assert DriveState.OPERATION_ENABLED not in rehearsal.sim.states.values()


def test_drives_are_at_rest_before_the_power_goes():
    rehearsal = playing(begin("mix"), 45)
    rehearsal.player.request_stop("interrupt", "SIGINT")
    until(rehearsal, lambda: rehearsal.player.stage == "disabling")
    before = rehearsal.sim.q
    until(rehearsal, rehearsal.player.done.is_set)
    assert rehearsal.sim.q == pytest.approx(before, abs=np.radians(0.2))


def test_the_second_request_takes_the_power_off_at_once():
    rehearsal = playing(begin("epos4"), 45)
    rehearsal.player.request_stop("interrupt", "SIGINT")
    rehearsal.player.request_stop("interrupt", "SIGINT")
    rehearsal.tick()
    assert not any(s.powered for s in rehearsal.sim.states.values())


def test_a_late_sync_stops_streamed_targets_but_not_queued_ones():
    late = playing(begin("epos4"), 40)
    late.tick(late=0.011)
    assert [f.kind for f in late.player.faults] == ["late"]
    queued = playing(begin("epos2"), 40)
    queued.tick(late=0.011)
    assert ended(queued).player.faults == []


def test_a_late_sync_before_the_motion_does_not_matter():
    rehearsal = begin("epos4")
    for _ in range(3):
        rehearsal.tick(late=0.05)
    assert ended(rehearsal).player.faults == []


def test_a_drive_that_will_not_enable_keeps_the_others_from_it():
    rehearsal = begin("epos2")
    joint = rehearsal.schedule.drives.joints[2]
    rehearsal.sim.inject(InjectedFault(kind="lost", joint=joint, frames=["command"], direction="rx"))
    enabled = set()
    while not rehearsal.player.done.is_set():
        rehearsal.tick()
        enabled |= {j for j, s in rehearsal.sim.states.items() if s is DriveState.OPERATION_ENABLED}
    assert enabled == set()
    assert [(f.kind, f.joint) for f in rehearsal.player.faults] == [("enable", joint)]


def test_records_that_do_not_arrive_keep_the_motion_from_starting():
    rehearsal = begin("epos2")
    joint = rehearsal.schedule.drives.joints[2]
    rehearsal.sim.inject(InjectedFault(kind="lost", joint=joint, frames=["record"], direction="rx", probability=0.3))
    ended(rehearsal)
    assert [(f.kind, f.joint) for f in rehearsal.player.faults] == [("queue", joint)]
    assert rehearsal.player.step == -1


def test_a_drive_that_misses_the_start_is_noticed():
    rehearsal = begin("epos2")
    player, joint = rehearsal.player, rehearsal.schedule.drives.joints[2]
    until(rehearsal, lambda: player.watch.enabled and all(a.queued == 20 for a in player.axes))
    rehearsal.sim.inject(InjectedFault(kind="lost", joint=joint, frames=["command"], direction="rx"))
    ended(rehearsal)
    assert [(f.kind, f.joint) for f in player.faults] == [("skew", joint)]
    assert player.step < 10


def test_a_drive_that_starts_a_sync_late_is_noticed():
    rehearsal = begin("epos2")
    player, joint = rehearsal.player, rehearsal.schedule.drives.joints[2]
    until(rehearsal, lambda: player.watch.enabled and all(a.queued == 20 for a in player.axes))
    rehearsal.sim.inject(
        InjectedFault(kind="late", joint=joint, frames=["command"], direction="rx", delay_ms=12, duration_s=0.02)
    )
    ended(rehearsal)
    assert [f.kind for f in player.faults] == ["skew"]
    assert player.start_skew == 1


def test_a_hand_that_was_moved_meanwhile_is_not_enabled():
    rehearsal = begin("epos4")
    rehearsal.sim._simulated[3].axis.motor.position += 45
    ended(rehearsal)
    assert [f.kind for f in rehearsal.player.faults] == ["start"]
    assert rehearsal.player.step == -1


def test_a_bus_that_takes_no_frames_is_a_fault_and_ends():
    rehearsal = playing(begin("epos2"), 30)

    def refuse(cob, data):
        raise OSError("no buffer space")

    rehearsal.player._send = refuse
    until(rehearsal, rehearsal.player.done.is_set)
    assert rehearsal.player.faults[0].kind == "bus"


def test_an_exception_in_the_bus_thread_stops_the_group():
    rehearsal = playing(begin("mix"), 40)
    rehearsal.player.on_error(ZeroDivisionError("on purpose"))
    ended(rehearsal)
    assert [f.kind for f in rehearsal.player.faults] == ["internal"]
    assert "on purpose" in rehearsal.player.faults[0].text


@pytest.mark.parametrize("ppm", [-1900, 1900])
def test_a_drive_whose_clock_is_off_plays_to_the_end(ppm, monkeypatch):
    """Seven periods early, or late, as after some minutes with real crystals; its queue is kept by what it says."""
    for module in (player, pvt):
        monkeypatch.setattr(module, "CLOCK_TOLERANCE", 2e-3)
    all_ = drives_of("epos2")
    one = replace(all_, drives=all_.drives[:1], coupling=np.eye(1))

    class Off(Rehearsal):
        def _arrives(self, cob, data):
            now, self._now = self._now, self._now * (1 + ppm * 1e-6)
            super()._arrives(cob, data)
            self._now = now

    rehearsal = Off(Schedule.build(swing(one.joints, 40.0, swings=8), one))
    rehearsal.configure()
    until(rehearsal, rehearsal.player.done.is_set, most=6_000)
    assert rehearsal.player.faults == []
    queued = rehearsal.player.log._queued[: rehearsal.player.log.rows]
    assert queued.max() <= 20
    assert queued[:-60].min() >= 15


@pytest.mark.parametrize("sync_ms", [4, 20, 50])
def test_other_sync_periods_play_too(sync_ms):
    assert ended(begin("mix", sync_ms=sync_ms)).player.faults == []
