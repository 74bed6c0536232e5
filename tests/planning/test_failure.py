"""A failure names mode, finger, constraint and pose, in words and as evidence."""

import msgspec
import numpy as np

from drake_hand.errors import Evidence
from drake_hand.model.hand import Hand
from drake_hand.planning.failure import code, no_plan

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
