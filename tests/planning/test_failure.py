"""A failure names mode, finger, constraint and pose, in words and as evidence."""

import msgspec
import numpy as np

from drake_hand.errors import Evidence, NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.planning.failure import Stopped, after_the_motion, code, no_plan

HAND = Hand.load("trio")
X_WO = np.eye(4)
X_WO[:3, 3] = [0.001, -0.02, 0.08]


def test_a_mode_code_has_a_digit_for_every_finger():
    assert code(HAND, ()) == "000"
    assert code(HAND, {0, 2}) == "101"
    assert code(HAND, {0, 1, 2}, {1}) == "121"
    assert len(code(Hand.load("quartet"), {3})) == 4


def test_words_and_evidence_say_the_same():
    error = no_plan("it slips", mode="101", finger="left", constraint="hold", X_WO=X_WO, progress=0.25)
    for word in ("it slips", "mode 101", "1.0", "-20.0", "80.0", "mm"):
        assert word in str(error)
    assert error.status == "infeasible"
    assert error.evidence.mode == "101"
    assert error.evidence.finger == "left"
    assert error.evidence.constraint == "hold"
    assert error.evidence.progress == 0.25
    np.testing.assert_array_equal(error.evidence.X_WO, X_WO)
    assert msgspec.json.decode(msgspec.json.encode(error.evidence), type=Evidence) == error.evidence


def test_time_that_runs_out_is_told_apart():
    assert no_plan("late", mode="000", constraint="time", X_WO=X_WO, status="timeout").status == "timeout"


def test_where_the_motion_was_found_what_failed_after_it_is_told():
    def path():
        raise NotImplementedError

    why = no_plan("out of time at 100 % of the motion", mode="111", constraint="reach", X_WO=X_WO, status="timeout",
                  progress=1.0, expansions=9)  # fmt: skip
    end, later = Stopped(why, path), no_plan("it cannot let go", mode="101", constraint="collision", X_WO=X_WO)
    assert after_the_motion(end, []) is end
    assert after_the_motion(why, [later]) is why, "no search: nothing was found"
    told = after_the_motion(end, [later, later])
    assert isinstance(told, Stopped)
    assert told.path is path
    assert told.reason == f"out of time: the motion was found 2 times, but then {later.reason}"
    assert (told.status, told.evidence.constraint, told.progress, told.evidence.expansions) == (
        "timeout", "collision", 1.0, 9,
    )  # fmt: skip
    assert (
        "nothing left to try: the motion was found once"
        in after_the_motion(Stopped(NoPlanFound("", evidence=why.evidence), path), [later]).reason
    )
