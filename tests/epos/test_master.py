import gc
import time

import can
import pytest
from fault_trials import drives_of

from drake_hand.epos import objects as od
from drake_hand.epos.master import Emcy, Master, SdoError, for_all
from drake_hand.epos.objects import Obj
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.state import Control
from drake_hand.errors import DriveError

pytestmark = pytest.mark.clocked

DRIVES = drives_of("mix")


@pytest.fixture(scope="module")
def shared():
    from tests.epos.conftest import _virtual

    with _virtual(DRIVES) as (bus, sim), Master(bus, heartbeat_s=0.1) as master:
        yield master, sim


def test_objects_of_all_sizes_are_read_and_written(shared):
    master, _ = shared
    for obj, value in (
        (od.PROFILE_VELOCITY, 123456),
        (od.ABORT_OPTION, 3),
        (od.PRODUCER_HEARTBEAT, 250),
        (od.MODE, 1),
    ):
        master.write(1, obj, value)
        assert master.read(1, obj) == value
    assert master.read(1, od.SERIAL64["epos2"]) == 0x1000_0000_0001
    assert master.read(1, od.POSITION_ACTUAL) == 0


def test_a_refusal_is_told_in_words(shared):
    master, _ = shared
    with pytest.raises(SdoError, match=r"node 2: 0x5555:00: 0x06020000 Object does not exist"):
        master.read(2, Obj(0x5555, 0, "u8"))
    with pytest.raises(SdoError, match="0x06010002"):
        master.write(2, od.VENDOR, 1)


def test_a_node_that_is_not_there_does_not_answer(shared):
    master, _ = shared
    with pytest.raises(SdoError, match=r"node 77: .*no answer") as e:
        master.read(77, od.STATUSWORD)
    assert isinstance(e.value, TimeoutError)


def test_scan_finds_every_node_within_a_second(shared):
    master, _ = shared
    begun = time.monotonic()
    assert master.scan() == list(range(1, 16))
    assert time.monotonic() - begun < 2.0


def test_many_drives_are_asked_at_once_and_answers_keep_their_order(shared):
    master, _ = shared
    assert for_all(lambda d: master.read(d.node, od.SERIAL), DRIVES.drives) == list(range(1, 16))


def test_heartbeats_and_emergencies_are_noted(shared):
    master, sim = shared
    master.write(3, od.PRODUCER_HEARTBEAT, 20)
    sim.inject(InjectedFault(kind="emcy", joint=DRIVES.joints[2], code=0x4210))
    end = time.monotonic() + 3
    while time.monotonic() < end and not (3 in master.heard and master.emergencies):
        time.sleep(0.01)
    assert master.heard[3][1] in (0x7F, 0x00)
    assert [(e.node, e.code) for e in master.emergencies] == [(3, 0x4210)]


@pytest.mark.parametrize("size", range(9))
def test_emcy_of_any_length_is_read(size):
    emcy = Emcy.of(0x85, bytes.fromhex("1186210000000000")[:size])
    assert emcy.node == 5
    assert emcy.code == [0, 0x11][size == 1] if size < 2 else emcy.code == 0x8611
    assert emcy.register == (0x21 if size > 2 else 0)


class Wire:
    """A bus of nothing; may refuse."""

    channel_info = "nothing"

    def __init__(self):
        self.sent, self.refuses = [], False

    def send(self, message, timeout=None):
        if self.refuses:
            raise can.CanOperationError("Transmit buffer full")
        self.sent.append(message)

    def recv(self, timeout=None):
        time.sleep(timeout)


def test_a_bus_without_power_is_told_as_such():
    wire = Wire()
    wire.refuses = True
    with Master(wire) as master, pytest.raises(DriveError, match="powered"):
        master.scan()


def test_the_masters_heartbeat_goes_on_after_the_bus_refused_it():
    wire = Wire()
    wire.refuses = True
    with Master(wire, heartbeat_s=0.01):
        time.sleep(0.05)
        wire.refuses = False
        end = time.monotonic() + 3
        while len(wire.sent) < 3 and time.monotonic() < end:
            time.sleep(0.01)
    assert {(m.arbitration_id, bytes(m.data)) for m in wire.sent} == {(0x77F, b"\5")}


class Counter:
    def __init__(self, fail=False):
        self.ticks, self.skipped, self.errors, self.fail, self.hold_s = [], 0, [], fail, 0.0

    def on_frame(self, cob, data, now):
        pass

    def on_tick(self, now, late, skipped):
        self.ticks.append(now - late)
        self.skipped += skipped
        if self.hold_s:
            time.sleep(self.hold_s)
            self.hold_s = 0.0
        if self.fail:
            raise ZeroDivisionError

    def on_error(self, error):
        self.errors.append(error)


def test_ticks_stay_on_their_grid_and_are_never_made_up_for():
    counter = Counter()
    with Master(Wire()) as master:
        master.attach(counter, 0.01)
        time.sleep(0.1)
        counter.hold_s = 0.055
        time.sleep(0.3)
        master.detach()
    grid = [round((t - counter.ticks[0]) / 0.01, 3) for t in counter.ticks]
    assert all(g == round(g) for g in grid)
    assert len(set(grid)) == len(grid)
    assert counter.skipped >= 4
    assert grid[-1] == len(grid) - 1 + counter.skipped


def test_an_error_in_the_bus_thread_is_handed_over_and_the_thread_lives():
    counter = Counter(fail=True)
    with Master(Wire()) as master:
        master.attach(counter, 0.01)
        time.sleep(0.1)
        master.detach()
    assert len(counter.errors) >= 2
    assert all(isinstance(e, ZeroDivisionError) for e in counter.errors)


def test_the_control_word_is_an_object_like_others(shared):
    master, _ = shared
    master.write(5, od.CONTROLWORD, Control.SHUTDOWN)
    assert master.read(5, od.STATUSWORD) & 0x6F == 0x21
    master.write(5, od.CONTROLWORD, Control.DISABLE_VOLTAGE)


def test_what_a_program_has_loaded_does_not_hold_up_its_heartbeat(mastered):
    """A full collection of a million objects takes longer than the drives wait for a heartbeat, but not meanwhile."""
    ballast = [[i] for i in range(1_000_000)]

    def collection_s():
        begun = time.monotonic()
        gc.collect()
        return time.monotonic() - begun

    usual = collection_s()
    with mastered(DRIVES):
        assert collection_s() < usual / 5
    assert collection_s() > usual / 5
    assert ballast
