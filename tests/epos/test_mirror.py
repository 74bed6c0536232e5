import itertools
import json
import signal
import subprocess
import sys
import urllib.request
import uuid

import can
import numpy as np
import pytest
from sim_bench import Bench

from drake_hand.cli.mirror import describe_pose
from drake_hand.epos import objects as o
from drake_hand.epos import pdo
from drake_hand.epos.mirror import HandPose, Mirror, poses_from_bus, poses_from_record
from drake_hand.epos.record import RunHeader, RunRecord
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.sim.motor import LAG_S
from drake_hand.epos.state import DriveState
from drake_hand.errors import InputError

SPEED = 500.0  # counts/s


class Overheard(Bench):
    """A bench whose frames, both ways, a mirror hears."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.mirror = Mirror(self.drives)

    def send(self, cob, data=b""):
        self.mirror.hear(cob, data, self.t)
        answers = super().send(cob, data)
        for cob, data in answers:
            self.mirror.hear(cob, data, self.t)
        return answers

    def pose(self):
        return self.mirror.pose(self.t)


def play(bench, n, *, first=0):
    """A ramp of SPEED on all three types; PVT records 100 ms ahead."""
    for k in range(first, first + n):
        bench.send(0x301, pdo.pack_record(round(SPEED * 0.01 * (k + 10)), SPEED * 60 / 64, 10))
        bench.send(0x201, b"\x1f\0")
        for node, kind in ((2, "epos4"), (3, "epos1")):
            bench.send(0x200 + node, pdo.LAYOUT[kind].command.pack(0x0F, round(SPEED * 0.01 * k)))
        bench.sync()


@pytest.fixture
def bench(tmp_path):
    found = Overheard(tmp_path, ["epos2", "epos4", "epos1"])
    found.enable()
    found.write(1, o.IP_BUFFER_CLEAR, 0)
    found.write(1, o.IP_BUFFER_CLEAR, 1)
    for k in range(10):
        found.send(0x301, pdo.pack_record(round(SPEED * 0.01 * k), SPEED * 60 / 64 if k else 0, 10))
    found.sync()
    return found


def counts(bench, q):
    return np.asarray(bench.drives.counts_from_joints(np.nan_to_num(q, nan=-99.0)), float)


def test_nothing_is_known_before_anything_is_heard(bench):
    pose = Mirror(bench.drives).pose(0.0)
    assert np.isnan(pose.measured).all()
    assert np.isnan(pose.commanded).all()
    assert set(pose.states) == {DriveState.UNKNOWN}


def test_commanded_and_measured_of_all_three_types(bench):
    play(bench, 50)
    pose = bench.pose()
    assert pose.states == (DriveState.OPERATION_ENABLED,) * 3
    assert counts(bench, pose.measured) == pytest.approx(
        [round(s.axis.motor.position) for s in bench.sim._simulated], abs=1
    )
    # the queue is where its own clock is, the others where they were last told to go
    assert counts(bench, pose.commanded) == pytest.approx([SPEED * 0.49] * 3, abs=1)
    assert counts(bench, pose.error)[0] == pytest.approx(SPEED * LAG_S, abs=1.5)


def test_queue_is_followed_between_syncs_and_to_its_end(bench):
    play(bench, 20)
    assert counts(bench, bench.mirror.pose(bench.t + 0.005).commanded)[0] == pytest.approx(SPEED * 0.195, abs=1)
    bench.send(0x301, pdo.pack_record(round(SPEED * 0.3), 0, 0))
    bench.sync(20)
    assert counts(bench, bench.pose().commanded)[0] == pytest.approx(SPEED * 0.3, abs=1)
    assert not np.isnan(bench.pose().error[0])


def test_a_second_motion_waits_behind_the_end_of_the_first(bench):
    bench.send(0x301, pdo.pack_record(40, 0, 0))
    for k in range(21):
        bench.send(0x301, pdo.pack_record(40 + 5 * k, SPEED * 60 / 64 if 0 < k < 20 else 0, 10 if k < 20 else 0))
    bench.send(0x201, b"\x1f\0")
    bench.sync(30)
    assert counts(bench, bench.pose().commanded)[0] == 40
    bench.send(0x201, b"\x0f\0")
    bench.sync()
    bench.send(0x201, b"\x1f\0")
    bench.sync(11)
    assert counts(bench, bench.pose().commanded)[0] == pytest.approx(90, abs=1)
    assert bench.sync(30)[1][1] == pytest.approx(140, abs=1)


def test_joins_a_motion_midway(bench):
    play(bench, 20)
    bench.mirror = late = Mirror(bench.drives)
    play(bench, 20, first=20)
    assert bench.mirror is late
    assert counts(bench, bench.pose().commanded) == pytest.approx([SPEED * 0.39] * 3, abs=SPEED * 0.011)


def test_a_drive_that_is_not_enabled_has_no_commanded_position(bench):
    play(bench, 20)
    bench.sim.inject(InjectedFault(kind="emcy", joint="j2"))
    bench.sync(2)
    pose = bench.pose()
    assert pose.states[1] is DriveState.FAULT
    assert list(np.isnan(pose.commanded)) == [False, True, False]
    assert "fault: j2" in describe_pose(pose, bench.drives.joints)


def test_short_and_foreign_frames_are_ignored(bench):
    bench.mirror = Mirror(bench.drives)
    for cob in (0x181, 0x182, 0x201, 0x203, 0x301, 0x601, 0x7FF):
        bench.mirror.hear(cob, b"\1", bench.t)
    assert np.isnan(bench.pose().measured[0])


def test_coupled_joints_are_unknown_together(tmp_path):
    file = tmp_path / "x.drives.yaml"
    file.write_text("joints: {a: {node: 1}, b: {node: 2}, c: {node: 3}}\ncoupling: {b: {a: 0.5, b: 1}}")
    from drake_hand.epos.drives import Drives

    mirror = Mirror(Drives.load(file))
    for node in (2, 3):
        mirror.hear(0x180 + node, pdo.LAYOUT["epos2"].status.pack(0x0140, 100, 0), 0.0)
    assert list(np.isnan(mirror.pose(0.0).measured)) == [True, True, False]


def test_never_sends_a_frame(tmp_path):
    """Two more listeners on its bus count what they hear: only what the test itself sent."""
    channel = uuid.uuid4().hex
    buses = [can.Bus(interface="virtual", channel=channel) for _ in range(3)]
    own, talker, witness = buses
    drives = Bench(tmp_path, ["epos2", "epos4", "epos1"]).drives
    sent = [(0x80, b""), (0x601, bytes(8)), (0x181, bytes(8)), (0x082, bytes(8)), (0x701, b"\0"), (0x000, b"\1\0")]
    poses = poses_from_bus(own, Mirror(drives), 0.01)
    try:
        for cob, data in sent:
            talker.send(can.Message(arbitration_id=cob, data=data, is_extended_id=False))
            assert len(list(itertools.islice(poses, 3))) == 3
        poses.close()
        heard = []
        while (message := witness.recv(0)) is not None:
            heard.append((message.arbitration_id, bytes(message.data)))
        assert heard == sent
        assert talker.recv(0) is None
    finally:
        for bus in buses:
            bus.shutdown()


def test_listening_needs_nothing_of_a_bus_but_recv(bench):
    class Ears:
        def recv(self, timeout):
            return can.Message(
                arbitration_id=0x182, data=pdo.LAYOUT["epos4"].status.pack(0x40, 7), is_extended_id=False
            )

    pose = next(itertools.islice(poses_from_bus(Ears(), Mirror(bench.drives), 0.0), 2, None))
    assert counts(bench, pose.measured)[1] == 7


def ramp_record():
    header = RunHeader(
        version="0",
        started="",
        plan_hash="",
        hand="kanguera",
        joints=["index_pip", "thumb_mcp"],
        nodes=[1, 2],
        types=["epos2", "epos2"],
        sync_ms=10,
        bus="virtual",
        realtime=False,
        ok=True,
        faults=[],
        not_disabled=[],
    )
    k = 20
    ramp = np.column_stack([np.linspace(0, 1, k), np.zeros(k)])
    zeros = np.zeros(k)
    return RunRecord(
        header=header,
        t=np.arange(k) * 0.01,
        late_ms=zeros,
        step=np.arange(k),
        plan_time=np.arange(k) * 0.01,
        playing=np.ones(k, bool),
        commanded=ramp,
        measured=ramp - 0.1,
        status=np.zeros((k, 2), np.uint16),
        current_ma=np.zeros((k, 2), np.float32),
        queued=np.zeros((k, 2), np.int16),
    )


def test_replays_a_record():
    poses = list(poses_from_record(ramp_record(), 0.02))
    assert 3 <= len(poses) <= 10
    assert poses[0].commanded[0] == 0.0
    assert all(np.allclose(p.error, 0.1) for p in poses)
    assert np.all(np.diff([p.commanded[0] for p in poses]) > 0)
    assert "error 5.7 deg at index_pip" in describe_pose(poses[0], ("index_pip", "thumb_mcp"))


VIEW = """
import json, socket, sys, threading, urllib.request
from pathlib import Path
import numpy as np
from drake_hand.epos.drives import Drives
from drake_hand.epos.mirror import HandPose
from drake_hand.epos.mirror_view import open_view
from drake_hand.model.hand import Hand
drives, urdf = Drives.load(), Hand.load("kanguera").urdf.file
q = np.full(15, 0.2)
with open_view(urdf, drives.joints) as view:
    sent = []
    inner = view._server.send
    view._server.send = lambda command: (sent.append(command.lower()), inner(command))
    view.show(HandPose(t=0.0, commanded=q, measured=np.where(np.arange(15) == 0, np.nan, 0.0)))
    view.show(HandPose(t=0.0, commanded=q, measured=np.zeros(15)))
    n = len(sent)
    half = np.where(np.arange(15) == 2, np.radians(2.5), q * 1.1)
    view.show(HandPose(t=0.0, commanded=half, measured=np.zeros(15)), words="here")
    again = len(sent) - n
    page = urllib.request.urlopen(view.url).status
    state = json.loads(urllib.request.urlopen(view.url.replace("lab", "state")).read())
    moved = sorted({c["path"].split("/")[3] for c in sent if c["type"] == "set_transform"})
    colours = {c["path"].split("/")[4]: c["value"] for c in sent if c["type"] == "set_property"}
    port = int(view.url.split(":")[2].split("/")[0])
    with socket.socket() as other:  # another address of this computer
        elsewhere = other.connect_ex(("127.0.0.2", port))
print(json.dumps({
    "page": page,
    "state": state,
    "colours": colours,
    "elsewhere": elsewhere,
    "moved": moved,
    "again": again,
    "links": sum("little" in c["path"] for c in sent),
    "left": [t.name for t in threading.enumerate() if t.name == "mirror server"],
    "loaded": [m for m in ("pydrake", "matplotlib.pyplot") if m in sys.modules],
}))
"""


def test_view_moves_the_ghost_serves_a_page_and_ends():
    done = subprocess.run([sys.executable, "-c", VIEW], capture_output=True, text=True, timeout=60, check=True)
    said = json.loads(done.stdout.splitlines()[-1])
    assert said["page"] == 200
    assert said["moved"] == ["commanded"]
    assert said["links"] >= 3
    assert said["elsewhere"] != 0
    assert (said["state"]["words"], len(said["state"]["rows"])) == ("here", 15)
    assert said["state"]["rows"][2] == ["little_pip", 2.5, 0.0, 2.5, ""]
    red, half = said["colours"]["index_proximal"], said["colours"]["little_middle"]
    assert red == pytest.approx([0.85, 0.1, 0.1, 1.0])
    assert half == pytest.approx([0.815, 0.45, 0.46, 1.0])
    assert "palm" not in said["colours"]
    assert said["again"] >= 15
    assert said["left"] == []
    assert said["loaded"] == []


@pytest.mark.filterwarnings("ignore:zmq.eventloop")
def test_view_refuses_the_drives_of_another_hand():
    from drake_hand.epos.mirror_view import open_view
    from drake_hand.model.hand import Hand

    with pytest.raises(InputError, match="no joint 'elbow'"), open_view(Hand.load("kanguera").urdf.file, ["elbow"]):
        pass


def test_modules_of_the_mirror_are_light():
    code = "import sys, drake_hand.epos.mirror, drake_hand.epos.mirror_view; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"pydrake", "trimesh", "matplotlib", "yourdfpy", "meshcat"} & set(loaded)


def test_pose_error_is_commanded_minus_measured():
    pose = HandPose(t=0.0, commanded=np.array([1.0, np.nan]), measured=np.array([0.25, 0.0]))
    assert pose.error[0] == 0.75
    assert np.isnan(pose.error[1])


def test_command_replays_until_interrupted(tmp_path):
    ramp_record().save(tmp_path / "x.run.npz")
    code = "import sys; from drake_hand.cli import run; sys.exit(run(['mirror', sys.argv[1]]))"
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "x.run.npz")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    url = process.stdout.readline().strip()
    assert urllib.request.urlopen(url).status == 200
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 0
    assert "Traceback" not in said
