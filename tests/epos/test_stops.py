import math

import pytest
from fault_trials import drives_of
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_hand.epos import pdo
from drake_hand.epos.state import REMOTE, DriveState, status_bits
from drake_hand.epos.stops import FOLLOWING_SHARE, MOST_MISSED_SYNCS, Watch

DRIVES = drives_of("mix")
NODE = 4  # an epos2
LAYOUT = pdo.LAYOUT["epos2"]


def watch(enabled: bool = True) -> Watch:
    made = Watch(DRIVES)
    list(made.period_ends(0.0))
    made.enabled = enabled
    return made


def status(state: DriveState = DriveState.OPERATION_ENABLED, position: int = 0, queued: int = 20) -> tuple[int, bytes]:
    data = LAYOUT.status.pack(status_bits(state, "epos2") | REMOTE, position, queued)
    return LAYOUT.status.cob_id(NODE), data


def kinds(faults) -> list[str]:
    return [f.kind for f in faults]


def answer_all(w: Watch, but: int | None = None) -> None:
    for a in w.axes:
        a.answered = a.drive.node != but


def test_a_healthy_drive_says_nothing():
    w = watch()
    assert kinds(w.frame(*status(), 0.01)) == []
    assert w.axes[3].answered
    assert (w.axes[3].queued, w.axes[3].state) == (20, DriveState.OPERATION_ENABLED)


@pytest.mark.parametrize("size", [2, 3, 5, 8])
def test_emcy_of_any_length_is_a_fault_with_its_code(size):
    (fault,) = watch().frame(0x80 + NODE, bytes.fromhex("1023010000000000")[:size], 0.5)
    assert (fault.kind, fault.code, fault.node, fault.joint) == ("emcy", 0x2310, NODE, "ring_abduction")
    assert fault.text == "ring_abduction (node 4): EMCY 0x2310 over-current"
    assert fault.time_s == pytest.approx(0.5)


def test_an_error_reset_is_no_fault():
    assert kinds(watch().frame(0x80 + NODE, bytes(8), 0.0)) == []


@pytest.mark.parametrize("state", [DriveState.FAULT, DriveState.FAULT_REACTION])
@pytest.mark.parametrize("enabled", [True, False])
def test_the_fault_bit_is_a_fault(state, enabled):
    assert kinds(watch(enabled).frame(*status(state), 0.0)) == ["fault"]


def test_leaving_operation_enabled_is_a_fault_once_all_are_enabled():
    assert kinds(watch(False).frame(*status(DriveState.SWITCHED_ON), 0.0)) == []
    assert kinds(watch().frame(*status(DriveState.SWITCHED_ON), 0.0)) == ["fault"]


@pytest.mark.parametrize("sign", [-1, 1])
def test_following_error_stops_before_the_drive_does(sign):
    window = DRIVES.drives[3].following_error_counts
    allowed = math.floor(FOLLOWING_SHARE * window)
    w = watch()
    w.demand = [100] * 15
    assert kinds(w.frame(*status(position=100 - sign * allowed), 0.0)) == []
    (fault,) = w.frame(*status(position=100 - sign * (allowed + 1)), 0.0)
    assert fault.kind == "following"
    assert allowed + 1 < window
    w.demand = None
    assert kinds(w.frame(*status(position=5000), 0.0)) == []


@pytest.mark.parametrize("bit", [8, 9, 10, 11, 1])
def test_queue_errors_stop(bit):
    (fault,) = watch().frame(LAYOUT.interpolation.cob_id(NODE), (1 << bit | 1 << 15).to_bytes(2, "little"), 0.0)
    assert fault.kind == "queue"


@pytest.mark.parametrize("bit", [0, 2, 3, 14])
def test_other_queue_bits_do_not(bit):
    assert kinds(watch().frame(LAYOUT.interpolation.cob_id(NODE), (1 << bit).to_bytes(2, "little"), 0.0)) == []


def test_boot_up_and_leaving_operational_are_faults():
    w = watch()
    assert kinds(w.frame(0x700 + NODE, b"\5", 0.0)) == []
    assert kinds(w.frame(0x700 + NODE, b"\0", 0.0)) == ["reboot"]
    assert kinds(w.frame(0x700 + NODE, b"\x7f", 0.0)) == ["reboot"]


def test_three_missing_answers_in_a_row_are_a_fault_and_one_between_is_not():
    w = watch()
    for _ in range(MOST_MISSED_SYNCS - 1):
        answer_all(w, but=NODE)
        assert kinds(w.period_ends(0.0)) == []
    answer_all(w)
    assert kinds(w.period_ends(0.0)) == []
    for i in range(MOST_MISSED_SYNCS):
        answer_all(w, but=NODE)
        found = list(w.period_ends(0.0))
        assert kinds(found) == (["silent"] if i == MOST_MISSED_SYNCS - 1 else [])
    assert found[0].node == NODE


def test_a_heartbeat_that_stays_away_is_a_fault():
    w = watch()
    for a in w.axes:
        list(w.frame(0x700 + a.drive.node, b"\5", 0.1))
    list(w.frame(0x700 + NODE, b"\5", 0.09))
    answer_all(w)
    assert kinds(w.period_ends(0.34)) == []
    answer_all(w)
    found = list(w.period_ends(0.345))
    assert [(f.kind, f.node) for f in found] == [("heartbeat", NODE)]


@given(cob=st.integers(0, 0x7FF), data=st.binary(max_size=8))
@settings(max_examples=500, deadline=None)
def test_no_frame_whatever_breaks_it(cob, data):
    w = watch()
    w.demand = [0] * 15
    list(w.frame(cob, data, 0.0))


@given(data=st.binary(max_size=5))
def test_a_status_too_short_counts_as_no_answer(data):
    w = watch()
    list(w.frame(LAYOUT.status.cob_id(NODE), data, 0.0))
    assert not w.axes[3].answered


def test_three_syncs_in_a_row_without_an_answer_are_a_fault():
    """At the third, not at the fourth: docs/faults.md promises how fast a silent drive stops the others."""
    w = watch()
    told = []
    for sync in range(1, 5):
        answer_all(w, but=NODE)
        told.append(kinds(w.period_ends(0.01 * sync)))
    assert told == [[], [], ["silent"], []]


def test_an_answer_in_between_starts_the_count_anew():
    w = watch()
    for sync in range(1, 12):
        answer_all(w, but=NODE if sync % 3 else None)
        assert kinds(w.period_ends(0.01 * sync)) == []
