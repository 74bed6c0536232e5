import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_hand.epos import objects as o
from drake_hand.epos import pdo
from drake_hand.epos.state import BIT12, HOMED, REMOTE, DriveState, decode_state, status_bits, status_words


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0100, DriveState.NOT_READY),
        (0x0140, DriveState.SWITCH_ON_DISABLED),
        (0x0121, DriveState.READY_TO_SWITCH_ON),
        (0x0123, DriveState.SWITCHED_ON),
        (0x0137, DriveState.OPERATION_ENABLED),
        (0x0117, DriveState.QUICK_STOP_ACTIVE),
        (0x010F, DriveState.FAULT_REACTION),
        (0x011F, DriveState.FAULT_REACTION),
        (0x0108, DriveState.FAULT),
        (0x4133, DriveState.SWITCHED_ON),
        (0x9737, DriveState.OPERATION_ENABLED),
        (0x0027, DriveState.UNKNOWN),
    ],
)
def test_status_words_of_epos2(word, state):
    assert decode_state(word, "epos2") is state
    assert decode_state(word, "epos1") is state


@pytest.mark.parametrize("kind", ["epos1", "epos2", "epos4"])
@pytest.mark.parametrize("state", [s for s in DriveState if s is not DriveState.UNKNOWN])
@given(extra=st.sampled_from([0, REMOTE, BIT12, REMOTE | BIT12 | HOMED]))
def test_every_state_is_decoded_from_its_own_word(kind, state, extra):
    assert decode_state(status_bits(state, kind) | extra, kind) is state


def test_words_for_people():
    assert status_words(0x0637, "epos4") == "0x0637 operation enabled, remote, target reached"
    assert o.emcy_words(0x8611) == "0x8611 following error"
    assert o.emcy_words(0x1234) == "0x1234 unknown error"
    assert o.abort_words(0x06020000) == "0x06020000 Object does not exist"
    assert o.register_words(0b10000001) == ["generic", "motion"]
    assert o.ip_status_words(0xC101) == ["underflow warning", "underflow error", "buffer enabled", "active"]


def test_reactions_differ_by_class():
    assert [o.reaction(c) for c in (0x2310, 0x8611, 0x8130)] == ["disable", "fault", "abort"]


@given(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**23), 2**23 - 1), st.integers(0, 255))
def test_pvt_records_come_back(counts, rpm, ms):
    data = pdo.pack_record(counts, rpm, ms)
    assert len(data) == 8
    assert pdo.unpack_record(data) == (counts, rpm, ms)


def test_pvt_record_bytes_by_hand():
    assert pdo.pack_record(0x01020304, -2, 10) == bytes([4, 3, 2, 1, 0xFE, 0xFF, 0xFF, 10])
    for bad in ((2**31, 0, 1), (0, 2**23, 1), (0, 0, 256), (0, float("nan"), 1)):
        with pytest.raises(ValueError, match=r"PVT record|NaN"):
            pdo.pack_record(*bad)


def test_layouts_use_the_predefined_cob_ids_and_fit_a_frame():
    for layout in pdo.LAYOUT.values():
        assert layout.command.cob_id(5) == 0x205
        assert layout.stop.cob_id(5) == 0x505
        assert layout.status.cob_id(5) == 0x185
        assert all(p.size <= 8 for p in layout.all)
        assert len({p.base for p in layout.all}) == len(layout.all)
    assert pdo.LAYOUT["epos2"].record.cob_id(127) == 0x37F
    assert pdo.LAYOUT["epos2"].status.mapping_index == 0x1A00
    assert pdo.LAYOUT["epos2"].command.communication_index == 0x1400
    assert o.POSITION_ACTUAL.mapping == 0x60640020


@given(st.integers(0, 0xFFFF), st.integers(-(2**31), 2**31 - 1), st.integers(0, 64))
def test_pdo_payloads_come_back(word, position, used):
    status = pdo.LAYOUT["epos2"].status
    assert status.unpack(status.pack(word, position, used)) == (word, position, used)
