"""What the fuzzer feeds: damaged files and frames, and a `Reader` that has the program read them, a method per kind."""

from __future__ import annotations

import io
import re
import shutil
from pathlib import Path

import can
import msgspec
import numpy as np

from drake_hand import api
from drake_hand.epos import pdo, preflight
from drake_hand.epos.drives import Drives
from drake_hand.epos.mirror import Mirror
from drake_hand.epos.record import RunHeader, RunRecord
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.files import bundled, data_dir
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.propose import propose_hand
from drake_hand.model.readable import readable, write_readable
from drake_hand.model.scene import Scene
from drake_hand.model.urdf import Urdf
from drake_hand.plans.plan import Contact, Part, Plan
from drake_hand.plans.task import Task
from drake_hand.plans.trajectory import Trajectory
from drake_hand.sweep.spec import load_cases

FRAMES = 40
"""Frames of one input of the kind ``frames``."""
ODD = [
    "0", "-1", "1e308", "-1e308", "1e-320", "nan", ".nan", "inf", "-.inf", "99999999999999999999", "0x7fffffff",
    "1_000", "true", "null", "~", "\"\"", "''", "[]", "{}", "[[]]", "[1]", "{a:1}", "[null]", "&a", "*a",
    "!!python/object:os.system", "!!binary", "?", "-", ":", "|", ">", "#", "---", "...", "%YAML", "<<", "=",
    "<a/>", "</robot>", "&lt;", "&bomb;", "<!--", "]]>", "../../etc/passwd", "/", ".", "..", "auto", "world",
    "object", "00111", "NaN", "Infinity", "{a: 1}", "[]: 1", "&a [*a]", "? [1]", "\x00", "\ufeff", "\u2028",
    "\U0001f590", "\t", "\r",
]  # fmt: skip
"""What stands in files where people, programs and broken disks put it."""
MJCF = """
<mujoco model="claw">
  <compiler angle="degree" autolimits="true"/>
  <default><joint damping="0.02" axis="0 1 0"/></default>
  <asset><mesh name="wedge" vertex="0 0 0  0.02 0 0  0 0.03 0  0 0 0.04"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="palm" pos="0 0 0.3" euler="10 20 30">
      <geom type="box" size="0.03 0.04 0.01"/>
      <body name="a1" pos="0.02 0 0.02">
        <joint name="a_side" axis="1 0 0" pos="0.001 0.002 0" range="-20 20"/>
        <joint name="a_bend" ref="25" range="-10 100"/>
        <geom type="capsule" fromto="0 0 0 0.01 0 0.04" size="0.008"/>
        <body name="a2" pos="0.01 0 0.045">
          <joint name="a_tip" range="0 90"/>
          <geom type="mesh" mesh="wedge"/>
        </body>
      </body>
      <body name="b1" pos="-0.02 0.01 0.02" quat="0.9 0.1 0.3 0.2">
        <inertial pos="0 0 0.01" mass="0.02" diaginertia="1e-6 1e-6 1e-6"/>
        <joint name="b_slide" type="slide" axis="0 0.6 0.8" range="-0.01 0.02"/>
        <geom type="ellipsoid" size="0.006 0.007 0.02"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="a_tip" joint2="a_bend" polycoef="0.1 0.7 0 0 0"/></equality>
  <actuator><motor joint="a_bend" ctrlrange="-1 1"/><position joint="b_slide" kp="10"/></actuator>
</mujoco>
"""
SWEEP = """
tasks: [spin]
seeds: 2
vary:
  motion.1.rotate.angle_deg: [90, 180]
  physics.friction: [0.6, 0.8]
"""
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"[A-Za-z_]\w*")


def damaged(text: str, rng: np.random.Generator) -> str:
    """A text with one to four things wrong."""
    for _ in range(min(rng.geometric(0.6), 4)):
        lines = text.split("\n")
        i, j = (int(k) for k in rng.integers(len(lines), size=2))
        odd = ODD[rng.integers(len(ODD))]
        match rng.integers(10):
            case 0 | 1:
                text = _exchanged(text, _NUMBER, odd, rng)
            case 2:
                words = _WORD.findall(text) or [odd]
                text = _exchanged(text, _WORD, words[rng.integers(len(words))], rng)
            case 3:
                text = _exchanged(text, _WORD, odd, rng)
            case 4:
                text = "\n".join([*lines[:i], *lines[i + 1 :]])
            case 5:
                text = "\n".join([*lines[:i], lines[j], *lines[i:]])
            case 6:
                lines[i], lines[j] = lines[j], lines[i]
                text = "\n".join(lines)
            case 7:
                a, b = sorted(int(k) for k in rng.integers(len(text) + 1, size=2))
                text = text[:a] + text[min(b, a + 20) :]
            case 8:
                a = int(rng.integers(len(text) + 1))
                text = text[:a] + odd + text[a:]
            case _:
                text = text[: int(rng.integers(len(text) + 1))] if rng.random() < 0.2 else _numbers_cut(text, rng)
    return text


def _exchanged(text: str, what: re.Pattern[str], new: str, rng: np.random.Generator) -> str:
    found = list(what.finditer(text))
    if not found:
        return text
    at = found[rng.integers(len(found))]
    return text[: at.start()] + new + text[at.end() :]


def _numbers_cut(text: str, rng: np.random.Generator) -> str:
    """One number fewer in some list of numbers."""
    return _exchanged(text, re.compile(r"(?<=[\d\]])[ ,]+-?\d[\d.]*"), "", rng)


def damaged_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes of which up to eight are others, or that end too early."""
    out = bytearray(data)
    for at in rng.integers(len(out), size=rng.integers(1, 9)):
        out[at] = rng.integers(256)
    return bytes(out[: rng.integers(len(out))] if rng.random() < 0.1 else out)


class Reader:
    """Writes inputs to a folder and reads them as the program does, a method per kind.

    Args:
        folder: where inputs and what they name are kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hand = Hand.load()
        self.drives = Drives.load()
        self.bundled = {
            "urdf": [self.hand.urdf.file],
            "hand": [self.hand.file],
            "task": list(bundled("tasks", ".task.yaml").values()),
            "object": list(bundled("objects", ".urdf").values()),
            "drives": [self.drives.file],
        }
        for meshes in data_dir().rglob("meshes"):
            shutil.copytree(meshes, folder / "meshes", dirs_exist_ok=True)
        self.plan = small_plan(self.hand)

    def text(self, kind: str, rng: np.random.Generator) -> str:
        """A bundled file of that kind, damaged."""
        files = self.bundled[kind]
        return damaged(files[rng.integers(len(files))].read_text(encoding="utf-8"), rng)

    def write(self, name: str, content: str | bytes) -> Path:
        """The input as a file."""
        path = self.folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
        return path

    def urdf(self, rng: np.random.Generator) -> None:
        """`hand check my_hand.urdf`, Drake apart."""
        urdf = Urdf.load(self.write("input.urdf", self.text("urdf", rng)))
        readable(urdf, lambda mesh: mesh.name)
        Hand.build(propose_hand(urdf).spec, urdf, urdf.file)

    def mjcf(self, rng: np.random.Generator) -> None:
        """`hand convert my_hand.xml`."""
        write_readable(self.write("input.xml", damaged(MJCF, rng)), self.folder / "converted")

    def scene(self, rng: np.random.Generator) -> None:
        """Hand and object in Drake."""
        file = self.write("input.urdf", self.text("urdf", rng) if rng.random() < 0.5 else self._text("urdf"))
        object_ = self.write("object.urdf", self.text("object", rng))
        urdf = Urdf.load(file)
        scene = Scene(Hand.build(propose_hand(urdf).spec, urdf, file), Object.load(object_))
        scene.set(scene.hand.q_home, np.eye(4))
        scene.penetrations()

    def _text(self, kind: str) -> str:
        return self.bundled[kind][0].read_text(encoding="utf-8")

    def hand_file(self, rng: np.random.Generator) -> None:
        """A hand file, its URDF beside it."""
        (self.folder / "kanguera.urdf").write_text(self._text("urdf"), encoding="utf-8")
        Hand.load(self.write("input.hand.yaml", self.text("hand", rng)))

    def task(self, rng: np.random.Generator) -> None:
        """A task file."""
        Task.load(self.write("input.task.yaml", self.text("task", rng)))

    def sweep_file(self, rng: np.random.Generator) -> None:
        """A sweep file."""
        load_cases(self.write("input.sweep.yaml", damaged(SWEEP, rng)))

    def object(self, rng: np.random.Generator) -> None:
        """An object's URDF."""
        Object.load(self.write("input.urdf", self.text("object", rng)))

    def mesh(self, rng: np.random.Generator) -> None:
        """An object as mesh file: OBJ, STL as text or bytes."""
        import trimesh

        box = trimesh.creation.box((0.02, 0.03, 0.04))
        match rng.integers(3):
            case 0:
                file = self.write("input.obj", damaged(box.export(file_type="obj"), rng))
            case 1:
                file = self.write("input.stl", damaged(box.export(file_type="stl_ascii"), rng))
            case _:
                file = self.write("input.stl", damaged_bytes(box.export(file_type="stl"), rng))
        Object.load(file)

    def plan_file(self, rng: np.random.Generator) -> None:
        """A plan file: read, evaluated, and compared with the drives."""
        text = damaged(msgspec.json.format(msgspec.json.encode(self.plan), indent=1).decode(), rng)
        plan = Plan.load(self.write("input.plan.json", text))
        Trajectory(plan).at(np.linspace(0.0, plan.duration, 50))
        preflight.plan_problems(plan, self.drives)

    def certificate(self, rng: np.random.Generator) -> None:
        """A plan file, proved."""
        text = damaged(msgspec.json.format(msgspec.json.encode(self.plan), indent=1).decode(), rng)
        api.check(Plan.load(self.write("input.plan.json", text)))

    def drives_file(self, rng: np.random.Generator) -> None:
        """A drives file."""
        drives = Drives.load(self.write("input.drives.yaml", self.text("drives", rng)))
        drives.joints_from_counts(np.zeros(len(drives.drives)))

    def run(self, rng: np.random.Generator) -> None:
        """The record of a run, damaged before it is packed or after."""
        arrays, header = self._run()
        if rng.random() < 0.5:
            header = damaged(header, rng)
        name = list(arrays)[rng.integers(len(arrays))]
        match rng.integers(5):
            case 0:
                arrays[name] = arrays[name][: rng.integers(3)]
            case 1:
                arrays[name] = arrays[name].T.astype(["U3", "c16", "?", "f2"][rng.integers(4)])
            case 2:
                arrays[name] = np.array(np.nan)
            case 3:
                arrays = {k: v[:0] for k, v in arrays.items()}
            case _:
                pass
        buffer = io.BytesIO()
        arrays["header"] = np.frombuffer(header.encode("utf-8", "surrogatepass"), dtype=np.uint8)
        np.savez(buffer, **arrays)  # type: ignore[arg-type]  # its stubs take arrays by name for options
        packed = buffer.getvalue()
        if rng.random() < 0.3:
            packed = damaged_bytes(packed, rng)
        record = RunRecord.load(self.write("input.run.npz", packed))
        record.lag()
        np.nanmax(np.abs(record.error_deg), initial=0.0)

    def _run(self) -> tuple[dict[str, np.ndarray], str]:
        k, joints = 12, list(self.drives.joints)
        header = RunHeader(
            version="1",
            started="2026-01-01T00:00:00Z",
            plan_hash="0",
            hand="kanguera",
            joints=joints,
            nodes=list(self.drives.nodes),
            types=[d.type for d in self.drives.drives],
            sync_ms=10,
            bus="virtual",
            realtime=False,
            ok=True,
            faults=[],
            not_disabled=[],
        )
        steps = np.arange(k)
        wide = np.linspace(0.0, 1.0, k)[:, None] * np.ones(len(joints))
        record = RunRecord(
            header=header,
            t=steps * 0.01,
            late_ms=0.1 * steps,
            step=steps,
            plan_time=steps * 0.01,
            playing=steps > 1,
            commanded=wide,
            measured=wide + 0.01,
            current_ma=wide.astype(np.float32),
            status=wide.astype(np.uint16),
            queued=wide.astype(np.int16),
        )
        return {k: v for k, v in vars(record).items() if k != "header"}, msgspec.json.encode(header).decode()

    def frames(self, rng: np.random.Generator) -> None:
        """CAN frames, at simulated drives and at the mirror; half of them near what a master sends."""
        with can.Bus(interface="virtual", channel="fuzz") as bus:
            sim, mirror = SimulatedDrives(bus, self.drives, seed=int(rng.integers(1 << 31))), Mirror(self.drives)
            t = 1000.0
            sim.boot(t)
            for cob, data in (self._frame(rng) for _ in range(FRAMES)):
                t += float(rng.choice([0.0, 0.001, 0.01, 0.3]))
                sim.step(t, can.Message(arbitration_id=cob, data=data, is_extended_id=False, check=False))
                mirror.hear(cob, data, t)
                mirror.pose(t)

    def _frame(self, rng: np.random.Generator) -> tuple[int, bytes]:
        node = int(rng.choice(self.drives.nodes))
        data = rng.bytes(int(rng.integers(9)))
        match rng.integers(8):
            case 0:
                return pdo.SYNC_COB, b""
            case 1:
                return pdo.NMT_COB, bytes([rng.choice([1, 2, 128, 129, 130, 7]), rng.choice([0, node])])
            case 2 | 3:
                index = int(
                    rng.choice([0x6040, 0x6041, 0x6060, 0x607A, 0x2062, 0x20C1, 0x20C4, 0x1010, 0x1600, 0x1A00])
                )
                index += int(rng.integers(4))
                order = bytes([rng.choice([0x40, 0x2F, 0x2B, 0x27, 0x23, 0x22, 0x80, 0x60, 0x21])])
                return pdo.SDO_RX_BASE + node, order + index.to_bytes(2, "little") + bytes([rng.integers(6)]) + data[:4]
            case 4:
                word = int(rng.choice([0x06, 0x07, 0x0F, 0x1F, 0x02, 0x80, 0x00, 0x0B]))
                return int(rng.choice([0x200, 0x500])) + node, word.to_bytes(2, "little") + data[:6]
            case 5:
                return 0x300 + node, pdo.pack_record(int(rng.integers(-9999, 9999)), 0.0, int(rng.integers(256)))
            case 6:
                return int(rng.choice([0x180, 0x280, 0x580, 0x700, 0x080])) + node, data
            case _:
                return int(rng.integers(0x800)), data


def small_plan(hand: Hand) -> Plan:
    """A plan of two short parts at rest: every array there is, in a file of a few pages."""
    still = {"q": [hand.q_home.tolist()] * 2, "v": [[0.0] * hand.nq] * 2, "q_offset": [[0.0] * hand.nq] * 2}
    still |= {"X_WO": [[0.5**0.5, 0.5**0.5, 0.0, 0.0, 0.055, 0.015, 0.115]] * 2, "V_WO": [[0.0] * 7] * 2}
    touch = {"thumb": Contact(p_OP=[[0.008, 0.0, 0.0]] * 2, f_W=[[0.0, 0.0, 0.1]] * 2)}
    object_ = Object.load("pencil_r8")
    plan = Plan(
        task=Task.load("spin"),
        hand=hand.name,
        urdf_sha256=hand.urdf_sha256,
        object_sha256=object_.sha256,
        fingers=[f.name for f in hand.fingers],
        joints=list(hand.joints),
        object_mass_kg=object_.mass,
        parts=[
            Part(mode="00000", events=[], t=[0.0, 0.1], contacts={}, **still),
            Part(mode="00001", events=["make thumb"], t=[0.1, 0.2], contacts=touch, **still),
        ],
        seed=0,
        versions={},
    )
    return msgspec.structs.replace(plan, certificate=api.check(plan))
