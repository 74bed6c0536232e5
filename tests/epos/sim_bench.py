"""Simulated drives on a bus and a clock made of nothing: frames in, frames out, time as the test says."""

import can
import numpy as np

from drake_hand.epos import objects as o
from drake_hand.epos import pdo
from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.state import decode_state

MASTER = pdo.MASTER_NODE


class Bus:
    def __init__(self):
        self.sent = []

    def send(self, message):
        self.sent.append((message.arbitration_id, bytes(message.data)))


class Bench:
    def __init__(self, tmp_path, kinds, *, q=None, **options):
        file = tmp_path / "bench.drives.yaml"
        joints = "".join(f"  j{n}: {{node: {n}, type: {kind}}}\n" for n, kind in enumerate(kinds, 1))
        file.write_text(f"joints:\n{joints}")
        self.drives = Drives.load(file)
        self.bus, self.t = Bus(), 1000.0
        self.kinds = dict(enumerate(kinds, 1))
        self.sim = SimulatedDrives(self.bus, self.drives, q=None if q is None else np.array(q), **options)
        self.sim.boot(self.t)

    def send(self, cob, data=b""):
        """A frame arrives; what the drives send while it is handled."""
        before = len(self.bus.sent)
        self.sim.step(self.t, can.Message(arbitration_id=cob, data=data, is_extended_id=False))
        return self.bus.sent[before:]

    def wait(self, seconds, dt=0.01, *, heartbeat=False):
        """Time passes, without SYNC."""
        before = len(self.bus.sent)
        for _ in range(round(seconds / dt)):
            self.t += dt
            if heartbeat:
                self.send(0x700 + MASTER, b"\5")
            else:
                self.sim.step(self.t)
        return self.bus.sent[before:]

    def sync(self, n=1):
        """n SYNCs, 10 ms apart; status by node of the last."""
        for _ in range(n):
            self.t += 0.01
            frames = self.send(pdo.SYNC_COB)
        return {
            cob - 0x180: pdo.LAYOUT[self.kinds[cob - 0x180]].status.unpack(data)
            for cob, data in frames
            if cob & 0x780 == 0x180
        }

    def write(self, node, obj, value):
        """SDO download; the abort code, or 0."""
        head = {1: 0x2F, 2: 0x2B, 4: 0x23}[obj.size]
        data = bytes([head, *obj.index.to_bytes(2, "little"), obj.sub]) + obj.pack(value).ljust(4, b"\0")
        return self._answer(node, data)[0]

    def read(self, node, obj):
        """SDO upload of up to four bytes; the value, or minus the abort code."""
        code, data = self._answer(node, bytes([0x40, *obj.index.to_bytes(2, "little"), obj.sub]) + bytes(4))
        return -code if code else obj.unpack(data[4 : 4 + obj.size])

    def _answer(self, node, data):
        (answer,) = [d for cob, d in self.send(0x600 + node, data) if cob == 0x580 + node]
        return (int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0), answer

    def map(self, node):
        """Configures the PDOs of the layout, as a master does."""
        for p in pdo.LAYOUT[self.kinds[node]].all:
            cob, count = o.Obj(p.communication_index, 1, "u32"), o.Obj(p.mapping_index, 0, "u8")
            steps = [(cob, p.cob_id(node) | pdo.PDO_DISABLED), (count, 0)]
            steps += [(o.Obj(p.mapping_index, i, "u32"), e.mapping) for i, e in enumerate(p.entries, 1)]
            steps += [(count, len(p.entries)), (o.Obj(p.communication_index, 2, "u8"), p.transmission)]
            for obj, value in [*steps, (cob, p.cob_id(node))]:
                assert self.write(node, obj, value) == 0

    def enable(self, mode=None):
        """Maps, starts and enables all, in their stream mode or another."""
        for node, kind in self.kinds.items():
            self.map(node)
            assert self.write(node, o.MODE, o.STREAM_MODE[kind] if mode is None else mode) == 0
            assert self.write(node, o.QUICK_STOP_DECELERATION, 50_000) == 0
            assert self.write(node, o.IP_PERIOD_VALUE, 10) == 0 or kind != "epos4"
        self.send(0, b"\1\0")
        for node in self.kinds:
            for word in (0x06, 0x07, 0x0F):
                assert self.write(node, o.CONTROLWORD, word) == 0

    def state(self, node):
        return decode_state(self.read(node, o.STATUSWORD), self.kinds[node])

    def emcys(self):
        return [(cob - 0x80, int.from_bytes(d[:2], "little")) for cob, d in self.bus.sent if 0x80 < cob < 0x100]
