"""Configuration, on simulated drives and on a responder that nobody here wrote."""

import socket
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import can
import pytest
from fault_trials import drives_of

from drake_hand.epos import objects as od
from drake_hand.epos.configure import configure, release_heartbeat, writes
from drake_hand.epos.master import NMT_OPERATIONAL, Master
from drake_hand.epos.objects import Obj
from drake_hand.epos.pdo import LAYOUT, MASTER_NODE, PDO_DISABLED, SYNC_COB
from drake_hand.epos.state import Control

DRIVES = drives_of("mix")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("", 0))
        return s.getsockname()[1]


def test_every_drive_holds_what_it_was_given(mastered):
    with mastered(DRIVES) as (master, sim):
        assert configure(master, DRIVES.drives, DRIVES.bus) == []
        for drive, simulated in zip(DRIVES.drives, sim._simulated, strict=True):
            d = simulated.dictionary
            assert d[od.CONSUMER_HEARTBEAT] == MASTER_NODE << 16 | 250
            assert d[od.ABORT_OPTION] == 3
            assert d[od.MODE] == od.STREAM_MODE[drive.type]
            assert d[od.FOLLOWING_WINDOW] == drive.following_error_counts
            for pdo in LAYOUT[drive.type].all:
                assert d[Obj(pdo.communication_index, 1, "u32")] == pdo.cob_id(drive.node)
                mapped = [d[Obj(pdo.mapping_index, i, "u32")] for i in range(1, len(pdo.entries) + 1)]
                assert mapped == [o.mapping for o in pdo.entries]
        assert release_heartbeat(master, DRIVES.drives) == []
        assert not any(s.dictionary[od.CONSUMER_HEARTBEAT] for s in sim._simulated)


def test_what_a_drive_does_not_take_or_changes_is_listed_with_joint_and_object(mastered):
    with mastered(DRIVES) as (master, sim):
        refusing, altering = sim._simulated[3], sim._simulated[7]
        refusing.dictionary.entry(0x6007, 0).access = "ro"
        altering.dictionary.hook(od.FOLLOWING_WINDOW, read=lambda: 59)
        problems = configure(master, DRIVES.drives, DRIVES.bus)
    assert len(problems) == 2
    assert problems[0].startswith("ring_abduction (node 4): 0x6007:00 := 3: node 4: 0x6007:00: 0x06010002")
    assert problems[1] == "middle_flexion (node 8): 0x6065:00 was given 60 and reads 59"


@pytest.mark.parametrize("drive", drives_of("mix").drives[:3], ids=lambda d: d.type)
def test_everything_written_is_read_back_but_the_clearing_of_the_queue(drive):
    blind = [w for w in writes(drive, DRIVES.bus) if not w.read_back]
    assert {w.obj for w in blind} == ({od.IP_BUFFER_CLEAR} if drive.type == "epos2" else set())


def test_a_write_is_the_frame_canopen_sends():
    frames = {w.obj: w.frame(7) for w in writes(DRIVES.drives[0], DRIVES.bus)}
    assert frames[od.PRODUCER_HEARTBEAT] == (0x607, bytes.fromhex("2b171000 64000000"))
    assert frames[od.MODE] == (0x607, bytes.fromhex("2f606000 07000000"))
    assert frames[od.CONSUMER_HEARTBEAT] == (0x607, bytes.fromhex("23161001 fa007f00"))


# A second opinion: durand's CANopen responder


@contextmanager
def responder(drive, bus: can.BusABC):
    """A durand node with the objects of an EPOS4 that we map or write."""
    from durand import CANBusNetwork, MinimalNode
    from durand.datatypes import DatatypeEnum
    from durand.object_dictionary import Record, Variable
    from durand.scheduler import SyncScheduler, set_scheduler

    class Network(CANBusNetwork):
        def remove_subscription(self, cob_id, callback=None):  # its own SYNC service passes a second argument
            super().remove_subscription(cob_id)

    kinds = {"u8": DatatypeEnum.UNSIGNED8, "u16": DatatypeEnum.UNSIGNED16, "u32": DatatypeEnum.UNSIGNED32}
    kinds |= {"i8": DatatypeEnum.INTEGER8, "i16": DatatypeEnum.INTEGER16, "i32": DatatypeEnum.INTEGER32}
    scheduler = SyncScheduler()
    set_scheduler(scheduler)
    thread = threading.Thread(target=scheduler.run, daemon=True)
    thread.start()
    network = Network(bus)
    node = MinimalNode(network, drive.node)
    dictionary = node.object_dictionary
    given = [w.obj for w in writes(drive, DRIVES.bus)]
    for obj in (*given, od.STATUSWORD, od.POSITION_ACTUAL, *LAYOUT["epos4"].command.entries):
        if obj.index in (0x1005, 0x1017) or 0x1400 <= obj.index < 0x1C00:
            continue  # durand's own
        if obj.sub == 0:
            dictionary[obj.index] = Variable(kinds[obj.type], "rw", 0)
        else:
            if obj.index not in dictionary:
                dictionary[obj.index] = Record()
            dictionary[obj.index][obj.sub] = Variable(kinds[obj.type], "rw", 0)
    try:
        yield dictionary
    finally:
        dictionary.write(0x1017, 0, 0)
        scheduler.stop()
        thread.join()
        network.stop()


@pytest.mark.clocked
def test_the_master_configures_a_durand_responder_and_exchanges_pdos_with_it():
    drive = replace(drives_of("epos4").drives[0], node=9)
    place = DRIVES.bus.arguments("udp_multicast", f"239.74.163.2:{free_port()}")
    heard = []

    class Listener:
        def on_frame(self, cob, data, now):
            if cob == LAYOUT["epos4"].status.cob_id(9):
                heard.append(LAYOUT["epos4"].status.unpack(data))

        def on_tick(self, now, late, skipped):
            pass

        def on_error(self, error):
            raise error

    def until(condition):
        end = time.monotonic() + 3
        while not condition() and time.monotonic() < end:
            time.sleep(0.01)
        assert condition()

    with (
        can.Bus(**place) as ours,
        can.Bus(**place) as theirs,
        responder(drive, theirs) as dictionary,
        Master(ours, heartbeat_s=0.1) as master,
    ):
        assert master.scan() == [9]
        assert configure(master, (drive,), DRIVES.bus) == []
        assert dictionary.read(0x6007, 0) == 3
        assert dictionary.read(0x1600, 2) == od.TARGET_POSITION.mapping
        assert dictionary.read(0x1402, 1) & PDO_DISABLED
        master.nmt(NMT_OPERATIONAL)
        until(lambda: master.heard.get(9, (0, 0))[1] == 0x05)

        master.attach(Listener(), 10.0)
        dictionary.write(0x6041, 0, 0x0137)
        dictionary.write(0x6064, 0, -1234)
        master.send(SYNC_COB, b"")
        until(lambda: heard)
        assert heard[-1] == (0x0137, -1234)

        command = LAYOUT["epos4"].command
        master.send(command.cob_id(9), command.pack(Control.ENABLE, -77))
        time.sleep(0.1)
        assert dictionary.read(0x607A, 0) == 0  # waits for the SYNC
        master.send(SYNC_COB, b"")
        until(lambda: dictionary.read(0x607A, 0) == -77)
        assert dictionary.read(0x6040, 0) == Control.ENABLE
        stop = LAYOUT["epos4"].stop
        master.send(stop.cob_id(9), stop.pack(Control.QUICK_STOP))  # acts at once
        until(lambda: dictionary.read(0x6040, 0) == Control.QUICK_STOP)
        assert release_heartbeat(master, (drive,)) == []
