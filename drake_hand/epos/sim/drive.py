"""One simulated EPOS drive: puts dictionary, SDO server, PDO engine, NMT, state machine and axis together."""

from __future__ import annotations

from collections.abc import Callable

from canopen.sdo import SdoAbortedError

from drake_hand.epos import objects as o
from drake_hand.epos import pdo
from drake_hand.epos.drives import Drive
from drake_hand.epos.sim import nmt as nmt_module
from drake_hand.epos.sim.axis import SimulatedAxis
from drake_hand.epos.sim.dictionary import NOT_STORED, Dictionary
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.sim.nmt import Nmt
from drake_hand.epos.sim.pdo import PdoEngine
from drake_hand.epos.sim.sdo import SdoServer
from drake_hand.epos.sim.state import StateMachine
from drake_hand.epos.state import DriveState

BUS_OFF = 0x81FD


class SimulatedDrive:
    """A drive that is given frames and the passing of time.

    Args:
        drive: which.
        serial: its serial number.
        position: where its motor stands, counts.
        send: puts a frame on the bus (COB-ID, data).
        tell: reports (event, what) for the timeline.
        rewire: called when the drive listens to other COB-IDs than before.
    """

    def __init__(
        self,
        drive: Drive,
        *,
        serial: int,
        position: float,
        send: Callable[[int, bytes], None],
        tell: Callable[[str, str], None],
        rewire: Callable[[], None],
    ) -> None:
        self.drive = drive
        self.on_bus = True
        self.heartbeat = True
        self._send_frame, self._tell, self._rewire = send, tell, rewire
        self.dictionary = Dictionary(drive, serial)
        self._sdo = SdoServer(self.dictionary)
        self.axis = SimulatedAxis(drive, self.dictionary, position)
        self.machine = StateMachine(drive, self.dictionary, self.axis, self._send, tell)
        self.nmt = Nmt(drive.node, self.dictionary, self._send, self.machine.fail)
        self.pdos = PdoEngine(self.dictionary, self._send, self.machine.fail)
        self.dictionary.hook(o.STORE_ALL, write=self._store)
        self.dictionary.hook(o.RESTORE_ALL, write=self._restore)

    def _send(self, cob: int, data: bytes) -> None:
        silent = cob & 0x780 == pdo.HEARTBEAT_BASE and not self.heartbeat and data[0] != nmt_module.BOOT_UP
        if self.on_bus and not silent:
            self._send_frame(cob, data)

    def _store(self, signature: int) -> None:
        if signature != o.SAVE_SIGNATURE:
            raise SdoAbortedError(NOT_STORED)
        self.dictionary.save()

    def _restore(self, signature: int) -> None:
        if signature != o.LOAD_SIGNATURE:
            raise SdoAbortedError(NOT_STORED)
        self.dictionary.restore_defaults()

    def boot(self, t: float) -> None:
        """Powers up, or resets: stored values, no errors, no power stage, boot-up frame."""
        self.dictionary.reset()
        self.axis.homed = False
        self.axis.count_from(0.0)
        self.axis.queue.clear(enable=False)
        self.machine.boot()
        self._configure()
        self.nmt.boot(t)
        self._tell("boot", "")

    def _configure(self) -> None:
        self.pdos.configure()
        self._rewire()

    @property
    def cob_ids(self) -> list[int]:
        """COB-IDs only this drive (or a few) listens to."""
        return [pdo.SDO_RX_BASE + self.drive.node, *self.pdos.cob_ids]

    def receive(self, cob: int, data: bytes, t: float) -> None:
        """Takes a frame that is for this drive."""
        if cob == pdo.SYNC_COB:
            if self.nmt.state == nmt_module.OPERATIONAL:
                self.pdos.sample()
                self.pdos.actuate()
        elif cob == pdo.NMT_COB:
            if len(data) >= 2 and data[1] in (0, self.drive.node):
                self._command_network(data[0], t)
        elif cob == pdo.SDO_RX_BASE + self.drive.node:
            if len(data) == 8 and self.nmt.state in (nmt_module.OPERATIONAL, nmt_module.PRE_OPERATIONAL):
                answer = self._sdo.answer(data)
                if self.pdos.changed:
                    self._configure()
                if answer is not None:
                    self._send(pdo.SDO_TX_BASE + self.drive.node, answer)
        elif cob & 0x780 == pdo.HEARTBEAT_BASE:
            self.nmt.heard(cob & 0x7F, t)
        elif self.nmt.state == nmt_module.OPERATIONAL:
            self.pdos.receive(cob, data, t)

    def _command_network(self, command: int, t: float) -> None:
        if command == nmt_module.START:
            self.nmt.state = nmt_module.OPERATIONAL
        elif command == nmt_module.STOP:
            self.nmt.state = nmt_module.STOPPED
            self.machine.abort()
        elif command == nmt_module.ENTER_PRE_OPERATIONAL:
            self.nmt.state = nmt_module.PRE_OPERATIONAL
        elif command == nmt_module.RESET_NODE:
            self.boot(t)
        elif command == nmt_module.RESET_COMMUNICATION:
            self.dictionary.reset(communication_only=True)
            self.machine.abort()
            self._configure()
            self.nmt.boot(t)

    def advance(self, dt: float) -> None:
        """Lets dt seconds pass."""
        self.axis.advance(dt)
        self.machine.advance()

    def housekeep(self, t: float) -> None:
        """Heartbeats and event-driven PDOs that are due at time t."""
        self.nmt.housekeep(t)
        if self.nmt.state == nmt_module.OPERATIONAL:
            self.pdos.housekeep(t)

    def suffer(self, fault: InjectedFault, t: float) -> None:
        """A fault of the drive itself begins."""
        motor = self.axis.motor
        if fault.kind == "emcy":
            self.machine.fail(fault.code)
        elif fault.kind == "following_error":
            motor.slip = fault.rate_counts_s
        elif fault.kind == "stuck":
            motor.stuck = True
        elif fault.kind == "heartbeat_loss":
            self.heartbeat = False
        elif fault.kind == "nmt_reset":
            self.boot(t)
        elif fault.kind == "wrong_identity":
            self.dictionary.be(fault.vendor, fault.product)
        elif fault.kind == "bus_off":
            self.on_bus = False
            self.machine.fail(BUS_OFF)

    def recover(self) -> None:
        """Every fault of the drive itself ends; its state machine stays where that brought it."""
        self.axis.motor.slip, self.axis.motor.stuck = 0.0, False
        self.heartbeat = self.on_bus = True
        self.dictionary.be(self.drive.identity.vendor, self.drive.identity.product or 0)

    @property
    def moving(self) -> bool:
        """Whether it is enabled and its demand moves."""
        return self.machine.state is DriveState.OPERATION_ENABLED and not self.axis.resting
