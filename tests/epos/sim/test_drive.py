import pytest
from sim_bench import MASTER, Bench

from drake_hand.epos import objects as o
from drake_hand.epos import pdo
from drake_hand.epos.state import BIT12, TARGET_REACHED, DriveState, decode_state

KINDS = ["epos1", "epos2", "epos4"]


@pytest.fixture
def one(tmp_path):
    return lambda kind="epos2", **options: Bench(tmp_path, [kind], **options)


def test_boots_up_and_tells_who_it_is(one):
    bench = one("epos4")
    assert bench.bus.sent == [(0x701, b"\0")]
    assert bench.read(1, o.VENDOR) == 0xFB
    assert bench.read(1, o.PRODUCT) == 0x61500000
    assert bench.state(1) is DriveState.SWITCH_ON_DISABLED


# --- SDO


def test_sdo_aborts_say_why(one):
    bench = one()
    assert bench.read(1, o.Obj(0x5555, 0, "u8")) == -0x06020000
    assert bench.read(1, o.Obj(0x1018, 9, "u8")) == -0x06090011
    assert bench.read(1, o.Obj(0x20C1, 0, "u32")) == -0x06010001
    assert bench.write(1, o.STATUSWORD, 0) == 0x06010002
    assert bench.write(1, o.Obj(0x6040, 0, "u8"), 0) == 0x06070010
    assert bench.write(1, o.MODE, 8) == 0x06090030
    assert bench.read(1, o.FOLLOWING_ERROR["epos4"]) == -0x06020000
    (answer,) = bench.send(0x601, b"\xc6" + bytes(7))
    assert answer[1][0] == 0x80


def test_segments_carry_more_than_four_bytes(one):
    bench = one()
    head = bytes([0x40, 0x04, 0x20, 0])
    ((_, first),) = bench.send(0x601, head + bytes(4))
    assert first == bytes([0x41, 4, 0x20, 0, 8, 0, 0, 0])
    ((_, a),) = bench.send(0x601, bytes([0x60]) + bytes(7))
    ((_, b),) = bench.send(0x601, bytes([0x70]) + bytes(7))
    assert (a[0], b[0]) == (0x00, 0x1D)
    assert int.from_bytes(a[1:] + b[1:2], "little") == 0x1000_0000_0001
    # a toggle bit that does not alternate ends the transfer
    bench.send(0x601, head + bytes(4))
    ((_, abort),) = bench.send(0x601, bytes([0x70]) + bytes(7))
    assert abort[0] == 0x80
    assert int.from_bytes(abort[4:], "little") == 0x05030000


# --- NMT


def test_heartbeat_is_produced_at_its_period(one):
    bench = one()
    assert bench.write(1, o.PRODUCER_HEARTBEAT, 100) == 0
    beats = [f for f in bench.wait(1.005) if f[0] == 0x701]
    assert len(beats) in (9, 10)
    assert {d for _, d in beats} == {b"\x7f"}
    bench.send(0, b"\1\1")
    assert (0x701, b"\5") in bench.wait(0.2)


def test_no_pdo_before_operational_and_none_after_stop(one):
    bench = one()
    assert bench.sync() == {}
    bench.send(0, b"\1\0")
    bench.map(1)
    assert list(bench.sync()) == [1]
    bench.send(0, b"\2\1")
    assert bench.sync() == {}
    assert bench.send(0x601, bytes([0x40, 0, 0x10, 0]) + bytes(4)) == []


def test_reset_boots_up_with_what_was_saved(one):
    bench = one()
    bench.write(1, o.FOLLOWING_WINDOW, 77)
    bench.write(1, o.STORE_ALL, o.SAVE_SIGNATURE)
    bench.write(1, o.FOLLOWING_WINDOW, 88)
    bench.write(1, o.CONTROLWORD, 6)
    assert bench.send(0, b"\x81\1") == [(0x701, b"\0")]
    assert bench.read(1, o.FOLLOWING_WINDOW) == 77
    assert bench.state(1) is DriveState.SWITCH_ON_DISABLED
    assert bench.write(1, o.STORE_ALL, 1234) == 0x08000020
    bench.write(1, o.RESTORE_ALL, o.LOAD_SIGNATURE)
    bench.send(0, b"\x81\0")
    assert bench.read(1, o.FOLLOWING_WINDOW) == 2000


def test_settings_last_over_a_restart(one, tmp_path):
    file = tmp_path / "settings.json"
    bench = one(settings=file)
    bench.write(1, o.FOLLOWING_WINDOW, 77)
    bench.write(1, o.STORE_ALL, o.SAVE_SIGNATURE)
    bench.sim.stop()
    assert one(settings=file).read(1, o.FOLLOWING_WINDOW) == 77


# --- PDO


def test_mapping_is_checked(one):
    bench = one()
    count, slot = o.Obj(0x1A01, 0, "u8"), o.Obj(0x1A01, 1, "u32")
    assert bench.write(1, slot, 0x55550008) == 0x06040041
    assert bench.write(1, slot, o.STATUSWORD.mapping + 8) == 0x06040041
    assert bench.write(1, slot, o.POSITION_ACTUAL.mapping) == 0
    assert bench.write(1, o.Obj(0x1A01, 2, "u32"), o.POSITION_DEMAND.mapping) == 0
    assert bench.write(1, o.Obj(0x1A01, 3, "u32"), o.STATUSWORD.mapping) == 0
    assert bench.write(1, count, 3) == 0x06040042
    assert bench.write(1, count, 2) == 0
    assert bench.write(1, slot, o.POSITION_ACTUAL.mapping) == 0x08000022
    assert bench.write(1, o.Obj(0x1801, 2, "u8"), 17) == 0x06090030


def test_command_waits_for_sync_and_status_is_sampled_before(one):
    bench = one()
    bench.map(1)
    bench.send(0, b"\1\0")
    bench.send(0x201, b"\6\0")
    assert bench.state(1) is DriveState.SWITCH_ON_DISABLED
    word, position, used = bench.sync()[1]
    assert (decode_state(word, "epos2"), position, used) == (DriveState.SWITCH_ON_DISABLED, 0, 0)
    assert bench.state(1) is DriveState.READY_TO_SWITCH_ON
    # the stop PDO does not wait, and what was latched is used up
    bench.send(0x501, b"\0\0")
    assert bench.state(1) is DriveState.SWITCH_ON_DISABLED
    bench.sync()
    assert bench.state(1) is DriveState.SWITCH_ON_DISABLED


def test_a_short_pdo_is_an_error(one):
    bench = one()
    bench.map(1)
    bench.send(0, b"\1\0")
    bench.send(0x501, b"\6")
    assert bench.emcys() == [(1, 0x8210)]


def test_epos4_notices_that_its_commands_stay_away(one):
    bench = one("epos4")
    bench.enable()
    assert bench.write(1, o.Obj(0x1400, 5, "u16"), 50) == 0
    for _ in range(5):
        bench.send(0x201, pdo.LAYOUT["epos4"].command.pack(0x0F, 0))
        bench.sync()
    assert bench.state(1) is DriveState.OPERATION_ENABLED
    bench.sync(8)
    assert bench.emcys() == [(1, 0x8250)]
    assert bench.state(1) is DriveState.QUICK_STOP_ACTIVE


# --- CiA 402


@pytest.mark.parametrize("kind", KINDS)
def test_walks_through_its_states(one, kind):
    bench = one(kind)
    for word, state in [
        (0x07, DriveState.SWITCH_ON_DISABLED),
        (0x06, DriveState.READY_TO_SWITCH_ON),
        (0x07, DriveState.SWITCHED_ON),
        (0x06, DriveState.READY_TO_SWITCH_ON),
        (0x0F, DriveState.OPERATION_ENABLED),
        (0x02, DriveState.QUICK_STOP_ACTIVE),
        (0x0F, DriveState.OPERATION_ENABLED),
        (0x00, DriveState.SWITCH_ON_DISABLED),
    ]:
        bench.write(1, o.CONTROLWORD, word)
        assert bench.state(1) is state


def test_disabling_slows_down_first_and_shutdown_does_not(one):
    bench = one()
    bench.enable(mode=o.MODE_PROFILE)
    bench.write(1, o.PROFILE_DECELERATION, 5000)
    for word, state in ((0x07, DriveState.SWITCHED_ON), (0x06, DriveState.READY_TO_SWITCH_ON)):
        bench.write(1, o.CONTROLWORD, 0x0F)
        bench.write(1, o.TARGET_POSITION, 100_000)
        bench.write(1, o.CONTROLWORD, 0x3F)
        bench.wait(0.5)
        bench.write(1, o.CONTROLWORD, word)
        # 1000 rpm at 5000 rpm/s take 0.2 s
        assert bench.state(1) is (DriveState.OPERATION_ENABLED if word == 0x07 else state)
        bench.wait(0.25)
        assert bench.state(1) is state


@pytest.mark.parametrize(
    ("code", "at_once", "later"),
    [
        (0x2310, DriveState.FAULT, DriveState.FAULT),
        (0x8611, DriveState.FAULT_REACTION, DriveState.FAULT),
        (0x8130, DriveState.QUICK_STOP_ACTIVE, DriveState.QUICK_STOP_ACTIVE),
    ],
)
def test_three_classes_of_errors(one, code, at_once, later):
    bench = one()
    bench.enable(mode=o.MODE_PROFILE)
    bench.write(1, o.TARGET_POSITION, 100_000)
    bench.write(1, o.CONTROLWORD, 0x3F)
    bench.wait(0.5)
    bench.sim._simulated[0].machine.fail(code)
    assert bench.state(1) is at_once
    bench.wait(0.1)
    assert bench.state(1) is later
    assert abs(bench.read(1, o.VELOCITY_ACTUAL)) < 10
    assert bench.emcys() == [(1, code)]
    assert bench.read(1, o.error_history(1)) == code
    assert bench.read(1, o.ERROR_REGISTER) & 1
    # fault reset acts on the rising edge, and never enables
    bench.write(1, o.CONTROLWORD, 0x80)
    assert bench.read(1, o.ERROR_REGISTER) == 0
    assert bench.state(1) is (DriveState.QUICK_STOP_ACTIVE if code == 0x8130 else DriveState.SWITCH_ON_DISABLED)
    assert bench.emcys()[-1] == (1, 0)
    assert bench.write(1, o.ERROR_HISTORY_COUNT, 0) == 0
    assert bench.read(1, o.error_history(1)) == 0


@pytest.mark.parametrize(("option", "state"), [(0, "ENABLED"), (1, "FAULT"), (2, "OFF"), (3, "QUICK")])
def test_lost_master_is_met_by_the_abort_option(one, option, state):
    bench = one()
    bench.enable(mode=o.MODE_PROFILE)
    bench.write(1, o.ABORT_OPTION, option)
    bench.write(1, o.CONSUMER_HEARTBEAT, MASTER << 16 | 250)
    bench.wait(0.5)
    assert bench.emcys() == []  # never heard: not yet supervised
    bench.wait(0.5, heartbeat=True)
    bench.wait(0.24)
    assert bench.emcys() == []
    bench.wait(0.05)
    assert bench.emcys() == [(1, 0x8130)]
    expected = {
        "ENABLED": DriveState.OPERATION_ENABLED,
        "FAULT": DriveState.FAULT,
        "OFF": DriveState.SWITCH_ON_DISABLED,
        "QUICK": DriveState.QUICK_STOP_ACTIVE,
    }
    bench.wait(0.1)
    assert bench.state(1) is expected[state]


# --- motion


@pytest.mark.parametrize("kind", KINDS)
def test_profile_move_arrives(one, kind):
    bench = one(kind)
    bench.enable(mode=o.MODE_PROFILE)
    bench.write(1, o.TARGET_POSITION, 500)
    bench.write(1, o.CONTROLWORD, 0x1F)
    assert bench.read(1, o.STATUSWORD) & BIT12
    bench.wait(0.2)
    assert not bench.read(1, o.STATUSWORD) & TARGET_REACHED
    bench.wait(1.0)
    assert bench.read(1, o.STATUSWORD) & TARGET_REACHED
    assert bench.read(1, o.POSITION_ACTUAL) == 500
    bench.write(1, o.CONTROLWORD, 0x0F)
    bench.write(1, o.TARGET_POSITION, -100)
    bench.write(1, o.CONTROLWORD, 0x7F)  # relative
    bench.wait(1.0)
    assert bench.read(1, o.POSITION_ACTUAL) == 400


def stream(bench, n, ms=20):
    for k in range(n):
        p = 0.5 * k * k
        bench.send(0x301, pdo.pack_record(round(p), k * 1e3 / ms * 60 / 64, 0 if k == n - 1 else ms))


def test_pvt_motion_from_start_to_end(one):
    bench = one("epos2")
    bench.enable()
    bench.send(0x301, pdo.pack_record(0, 0, 20))
    assert bench.read(1, o.IP_BUFFER_USED) == 0  # input is off
    bench.write(1, o.IP_BUFFER_CLEAR, 0)
    bench.write(1, o.IP_BUFFER_CLEAR, 1)
    stream(bench, 21)
    assert bench.read(1, o.IP_BUFFER_USED) == 21
    assert bench.read(1, o.IP_STATUS) == 1 << 14
    bench.send(0x201, b"\x1f\0")
    bench.sync()
    assert bench.read(1, o.STATUSWORD) & BIT12
    _, position, used = bench.sync(21)[1]
    assert used == 11
    assert position == pytest.approx(0.5 * 10.5**2, abs=6)
    bench.sync(25)
    assert bench.read(1, o.POSITION_ACTUAL) == 200
    assert bench.read(1, o.STATUSWORD) & (BIT12 | TARGET_REACHED) == TARGET_REACHED
    assert bench.emcys() == []
    # interpolation status is sent when it changes
    assert [d for c, d in bench.bus.sent if c == 0x281][-2:] == [b"\x01\xc0", b"\x00\x40"]


def test_pvt_queue_that_runs_dry_faults(one):
    bench = one("epos2")
    bench.enable()
    bench.write(1, o.IP_BUFFER_CLEAR, 1)
    for k in range(6):
        bench.send(0x301, pdo.pack_record(20 * k, 1000 * 60 / 64, 20))
    bench.send(0x201, b"\x1f\0")
    bench.sync(13)
    assert bench.emcys() == [(1, 0xFF0C)]
    bench.sync(10)
    assert bench.state(1) is DriveState.FAULT
    assert "underflow error" in o.ip_status_words(bench.read(1, o.IP_STATUS))


def test_csp_follows_targets_and_stays_when_they_stay_away(one):
    bench = one("epos4")
    bench.enable()
    for k in range(1, 51):
        bench.send(0x201, pdo.LAYOUT["epos4"].command.pack(0x0F, 5 * k))
        status = bench.sync()[1]
    # 500 counts/s trail by 8.9 ms, and a target is reached one period after its SYNC
    assert status[1] == pytest.approx(245 - 4.5, abs=1)
    bench.sync(20)
    assert bench.read(1, o.POSITION_ACTUAL) == 250
    assert bench.read(1, o.STATUSWORD) & BIT12


def test_position_mode_steps(one):
    bench = one("epos1")
    bench.enable()
    bench.send(0x201, pdo.LAYOUT["epos1"].command.pack(0x0F, 30))
    bench.sync(10)
    assert bench.read(1, o.POSITION_ACTUAL) == 30


@pytest.mark.parametrize("kind", ["epos1", "epos4"])
def test_a_target_far_off_trips_the_following_error(one, kind):
    bench = one(kind)
    bench.enable()
    bench.write(1, o.FOLLOWING_WINDOW, 60)
    bench.send(0x201, pdo.LAYOUT[kind].command.pack(0x0F, 500))
    bench.sync(3)
    assert bench.emcys() == [(1, 0x8611)]


@pytest.mark.parametrize(("kind", "code"), [("epos1", 0xFF09), ("epos4", 0x8A82)])
def test_soft_limits(one, kind, code):
    bench = one(kind)
    bench.enable()
    bench.write(1, o.SOFT_LIMIT_MIN, -10)
    bench.write(1, o.SOFT_LIMIT_MAX, 10)
    for target in (9, 14):
        bench.send(0x201, pdo.LAYOUT[kind].command.pack(0x0F, target))
        bench.sync(5)
    assert bench.emcys() == [(1, code)]
