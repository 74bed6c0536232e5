"""A schedule corrected while it is played: by which row, for which drive, and what the motors then do."""

import numpy as np
import pytest
from fault_trials import drives_of
from swing import swing

from drake_hand.epos.corrected import Corrected
from drake_hand.epos.pvt import QUEUE_S
from drake_hand.epos.rehearsal import Rehearsal
from drake_hand.epos.schedule import Schedule
from drake_hand.feedback.pose import PoseSeen

DURATION, AGE = 2.0, 0.03


class Sees:
    """A look each time it is asked, as old as it says; notes when it was asked."""

    def __init__(self):
        self.asked = []

    def poll(self, t):
        self.asked.append(t)
        return PoseSeen(t=t - AGE, X_WO=np.eye(4))


class Ramp:
    """Adds so much a second from when it is first asked; notes what it was told."""

    def __init__(self, nq, rate):
        self.nq, self.rate, self.told = nq, rate, []

    def step(self, t, seen):
        self.told.append((t, seen))
        return np.full(self.nq, self.rate * (t - self.told[0][0]))


def corrected_run(types, *, rate=0.02, speed=1.0):
    drives = drives_of(types)
    schedule = Schedule.build(swing(drives.joints, DURATION), drives)
    planned, sees, ramp = schedule.counts.copy(), Sees(), Ramp(len(drives.joints), rate)
    rehearsal = Rehearsal(schedule)
    columns = np.arange(len(drives.joints))
    rehearsal.player._corrected = Corrected(schedule, ramp, sees, columns, speed)
    rehearsal.configure()
    for _ in range(1000):
        if rehearsal.player.done.is_set():
            return rehearsal, planned, sees, ramp
        rehearsal.tick()
    pytest.fail("did not end")


@pytest.mark.parametrize("types", ["epos2", "epos4", "epos1", "mix"])
def test_the_motors_end_where_the_correction_has_them(types):
    rehearsal, planned, _, ramp = corrected_run(types)
    schedule, drives = rehearsal.schedule, rehearsal.schedule.drives
    assert rehearsal.player.faults == []
    moved = drives.joints_from_counts(schedule.counts[-1]) - drives.joints_from_counts(planned[-1])
    np.testing.assert_allclose(moved, 0.02 * (DURATION - ramp.told[0][0]), atol=np.radians(0.2))
    there = np.array([m.position - m.origin for m in rehearsal.sim.motors])
    np.testing.assert_allclose(there, schedule.counts[-1], atol=3)


def test_every_row_is_corrected_once_before_it_is_sent_and_told_when_it_plays():
    _, _, sees, ramp = corrected_run("epos2")
    times = np.array([t for t, _ in ramp.told])
    assert (np.diff(times) > 0).all()
    looks = [(t, seen.t) for t, seen in ramp.told if seen]
    ahead = np.array([t - at for t, at in looks])
    # a look is as old as it is, and what it corrects is played after what is queued
    assert ahead.max() >= QUEUE_S + AGE
    assert ahead.max() <= QUEUE_S + AGE + 0.1
    assert len(looks) <= len(sees.asked)


def test_drives_that_are_told_where_to_be_each_sync_are_corrected_at_once():
    _, _, _, ramp = corrected_run("epos4")
    assert max(t - seen.t for t, seen in ramp.told if seen) < AGE + 0.05


def test_at_half_the_speed_a_look_is_half_as_old_in_the_plan():
    _, _, _, whole = corrected_run("epos4")
    _, _, _, half = corrected_run("epos4", speed=0.5)
    ages = [min(t - seen.t for t, seen in told if seen) for told in (whole.told, half.told)]
    assert ages[0] - ages[1] == pytest.approx(AGE / 2, abs=1e-6)


def test_speeds_are_those_of_what_is_commanded():
    """Records whose speed is not that of their positions make a motor swing about its way."""
    rehearsal, _, _, _ = corrected_run("epos2", rate=0.2)
    s = rehearsal.schedule
    counts_per_turn = np.array([d.counts_per_turn for d in s.drives.drives])
    inner = slice(s.lead + 5, s.last - 5)
    slope = (s.counts[2:] - s.counts[:-2])[inner] / (2 * s.period) * 60 / counts_per_turn
    per_count = 60 / counts_per_turn / s.period
    np.testing.assert_allclose(s.rpm[1:-1][inner], slope, atol=float(per_count.max()))
