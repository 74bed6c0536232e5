import os
import signal
import subprocess
import sys
import threading
import time
import uuid

import can
import canopen
import numpy as np
import pytest
from canopen.objectdictionary import ODArray, ODVariable, datatypes
from canopen.profiles.p402 import BaseNode402

from drake_hand.epos import objects as o
from drake_hand.epos.bus import BusSpec
from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.faults import FaultsFile, InjectedFault
from drake_hand.epos.sim.process import spawn_simulated_drives
from drake_hand.epos.state import DriveState
from drake_hand.errors import DriveError, InputError
from tests.epos.timelines import read_timeline

pytestmark = pytest.mark.clocked

KANGUERA = Drives.load()
TYPES = {
    "u8": datatypes.UNSIGNED8,
    "i8": datatypes.INTEGER8,
    "u16": datatypes.UNSIGNED16,
    "i16": datatypes.INTEGER16,
    "u32": datatypes.UNSIGNED32,
    "i32": datatypes.INTEGER32,
    "u64": datatypes.UNSIGNED64,
}


@pytest.fixture
def network():
    """canopen's network and simulated drives on one virtual bus."""
    channel = uuid.uuid4().hex
    with can.Bus(interface="virtual", channel=channel) as bus, SimulatedDrives(bus, KANGUERA) as simulated:
        net = canopen.Network(can.Bus(interface="virtual", channel=channel))
        net.connect()
        yield net, simulated
        bus_of_net = net.bus
        net.disconnect()
        bus_of_net.shutdown()


def dictionary_of(objects):
    """The same objects, as canopen's client wants to have them."""
    od = canopen.ObjectDictionary()
    for obj in sorted(objects, key=lambda x: (x.index, x.sub)):
        variable = ODVariable(str(obj), obj.index, obj.sub)
        variable.data_type = TYPES[obj.type]
        if any(x.index == obj.index and x.sub for x in objects):
            if obj.index not in od:
                od.add_object(ODArray(f"0x{obj.index:04X}", obj.index))
            od[obj.index].add_member(variable)
        else:
            od.add_object(variable)
    return od


def test_canopens_own_node402_drives_it_through_its_states_and_a_move(network):
    """A second opinion: nobody who wrote this client knew these drives."""
    net, simulated = network
    node = BaseNode402(7, dictionary_of(simulated._simulated[6].dictionary.objects))
    net.add_node(node)
    node.nmt.state = "PRE-OPERATIONAL"
    node.setup_402_state_machine()
    assert node.rpdo[1].cob_id == 0x207
    node.nmt.state = "OPERATIONAL"
    net.sync.start(0.01)
    node.rpdo[1].start(0.01)
    try:
        node.op_mode = "PROFILED POSITION"
        for state in ("SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
            node.state = state
            assert node.state == state
        assert simulated.states["middle_abduction"] is DriveState.OPERATION_ENABLED
        node.sdo[0x607A].raw = 300
        node.controlword = 0x1F
        end = time.monotonic() + 3.0
        while node.tpdo_values[0x6064] != 300 and time.monotonic() < end:
            time.sleep(0.01)
        assert node.tpdo_values[0x6064] == 300
        assert node.sdo[0x6041].raw & 0x400
        node.state = "QUICK STOP ACTIVE"
        simulated.inject(InjectedFault(kind="emcy", joint="middle_abduction", code=0x2310))
        assert node.emcy.wait(0x2310, timeout=2.0) is not None
        while not node.is_faulted():
            node.check_statusword()
        node.state = "SWITCH ON DISABLED"
        assert simulated.states["middle_abduction"] is DriveState.SWITCH_ON_DISABLED
    finally:
        node.rpdo[1].stop()
        net.sync.stop()


def test_canopens_sdo_client_reads_every_object_there_is(network):
    net, simulated = network
    drive = simulated._simulated[0]
    node = net.add_node(1, canopen.ObjectDictionary())
    for obj in drive.dictionary.objects:
        if drive.dictionary.entry(obj.index, obj.sub).access != "wo":
            assert len(node.sdo.upload(obj.index, obj.sub)) == obj.size
    assert node.sdo.upload(0x2004, 0) == o.SERIAL64["epos2"].pack(0x1000_0000_0001)
    with pytest.raises(canopen.SdoAbortedError, match="0x06010001"):
        node.sdo.upload(0x60C4, 6)
    node.sdo.download(0x6065, 0, b"\x11\0\0\0", force_segment=True)
    assert drive.dictionary[o.FOLLOWING_WINDOW] == 0x11
    with pytest.raises(canopen.SdoAbortedError, match="0x05040001"):
        node.sdo.open(0x2004, 0, "rb", block_transfer=True)


def test_starts_where_it_is_told_and_refuses_other_joints():
    q = np.linspace(-0.5, 1.0, 15)
    with can.Bus(interface="virtual", channel=uuid.uuid4().hex) as bus:
        assert SimulatedDrives(bus, KANGUERA, q=q).q == pytest.approx(q, abs=0.003)
        with pytest.raises(InputError, match="position of these joints"):
            SimulatedDrives(bus, KANGUERA, q=q[:3])


def test_a_bus_that_breaks_is_reported_at_the_end():
    class Broken:
        def recv(self, timeout):
            raise can.CanOperationError("gone")

        def send(self, message):
            pass

    simulated = SimulatedDrives(Broken(), KANGUERA)
    simulated.start()
    with pytest.raises(can.CanOperationError, match="gone"):
        simulated.stop()
    assert not simulated.running


# --- the child process


def ask(bus, cob, data, answer, seconds=3.0):
    """Sends a frame until an answer comes."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        bus.send(can.Message(arbitration_id=cob, data=data, is_extended_id=False))
        again = time.monotonic() + 0.3
        while (left := again - time.monotonic()) > 0:
            message = bus.recv(left)
            if message and message.arbitration_id == answer:
                return bytes(message.data)
    raise AssertionError("no answer")


READ_STATUS = bytes([0x40, 0x41, 0x60, 0]) + bytes(4)


def test_child_serves_a_bus_of_its_own_and_ends_with_its_parent(tmp_path):
    log = tmp_path / "log.jsonl"
    faults = FaultsFile(faults=[InjectedFault(kind="emcy", joint="ring_pip", since="boot")])
    with spawn_simulated_drives(KANGUERA, q=np.full(15, 0.3), log=log, faults=faults) as spawned:
        with BusSpec().open(spawned.interface, spawned.channel) as bus:
            assert ask(bus, 0x601, READ_STATUS, 0x581)[4:6] == b"\x40\x83"
            assert ask(bus, 0x606, READ_STATUS, 0x586)[4:6] == b"\x08\x83"
            spawned.inject(InjectedFault(kind="emcy", joint="little_abduction", code=0x8611))
            end = time.monotonic() + 3.0
            while ask(bus, 0x601, READ_STATUS, 0x581)[4:6] != b"\x08\x83":
                assert time.monotonic() < end
            counts = ask(bus, 0x601, bytes([0x40, 0x64, 0x60, 0]) + bytes(4), 0x581)[4:]
            assert int.from_bytes(counts, "little", signed=True) == KANGUERA.counts_from_joints(np.full(15, 0.3))[0]
        assert spawned.process.poll() is None
    assert spawned.process.returncode == 0
    _, rows, events = read_timeline(log)
    assert rows
    assert [(e.joint, e.what) for e in events if e.event == "emcy"] == [
        ("ring_pip", "0x2310 over-current"),
        ("little_abduction", "0x8611 following error"),
    ]


PARENT = """
import sys, time
from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.process import spawn_simulated_drives
with spawn_simulated_drives(Drives.load()) as spawned:
    print(spawned.process.pid, flush=True)
    time.sleep(60)
"""


def test_child_dies_when_its_parent_is_killed():
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE)
    pid = int(parent.stdout.readline())
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        try:
            with open(f"/proc/{pid}/stat") as f:
                if f.read().rpartition(")")[2].split()[0] == "Z":
                    return
        except FileNotFoundError:
            return
        time.sleep(0.02)
    raise AssertionError("the child lives on")


def test_child_that_cannot_start_says_why():
    with pytest.raises(DriveError, match="32 bits"), spawn_simulated_drives(KANGUERA, q=np.full(15, 1e9)):
        pass


def test_command_serves_until_a_signal(tmp_path):
    code = "import sys; from drake_hand.cli.drives_simulate import simulate; sys.exit(simulate(**eval(sys.argv[1])))"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        port = 20000 + os.getpid() % 20000
        options = f"dict(channel='239.74.163.2:{port}')"
        process = subprocess.Popen(
            [sys.executable, "-c", code, options], stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert "15 simulated drives" in process.stderr.readline()
        process.stdin.write('{"kind": "emcy", "joint": "nope"}\n')
        process.stdin.flush()
        assert "no drive for 'nope'" in process.stderr.readline()
        with can.Bus(**KANGUERA.bus.arguments("udp_multicast", f"239.74.163.2:{port}")) as bus:
            assert ask(bus, 0x601, READ_STATUS, 0x581)[4:6] == b"\x40\x83"
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=10)
        assert process.returncode == 0


def test_nothing_is_left_running(network):
    _, simulated = network
    assert simulated.running
    simulated.stop()
    assert not [t for t in threading.enumerate() if t.name == "simulated drives"]
    simulated.stop()
