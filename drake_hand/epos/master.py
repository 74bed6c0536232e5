"""`Master`: one CAN bus whose reception, SYNC and heartbeat belong to one thread; SDO from any other.

canopen is used for SDO and NMT. Its notifier, SYNC and EMCY consumer are not: the notifier would be a second thread
that reads the bus, its SYNC thread dies on a send error, and it loses EMCY frames shorter than 8 bytes.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, TypeVar

import can
import canopen
from canopen.sdo import SdoAbortedError, SdoCommunicationError

from drake_hand.epos import realtime
from drake_hand.epos.clock import clock_of
from drake_hand.epos.drives import BusSpec
from drake_hand.epos.objects import DEVICE_TYPE, Obj, abort_words
from drake_hand.epos.pdo import EMCY_BASE, HEARTBEAT_BASE, MASTER_NODE, NMT_COB, SDO_RX_BASE, SDO_TX_BASE
from drake_hand.errors import DriveError, DriveTimeout, InputError

NMT_OPERATIONAL, NMT_PRE_OPERATIONAL = 0x01, 0x80
"""NMT commands."""
HEARTBEAT_OPERATIONAL = 0x05
SDO_TIMEOUT_S, SDO_TRIES = 0.3, 2
_SLOW_SDO_TIMEOUT_S = 5.0
"""Of drives that go by a clock of their own: as slow as the physics they move."""
_SCAN_S, _QUIET_S, _SCAN_BURST = 1.0, 0.3, 8
_CLOSE_S = 2.0
"""Time the bus thread is given to end; one that hangs in its interface is left to die with the process."""
_FRAMES_PER_DRAIN = 256
"""Frames read before a SYNC at most, so that a flooded bus does not hold it up."""

_T = TypeVar("_T")
_R = TypeVar("_R")

logging.getLogger("canopen").addHandler(logging.NullHandler())


class SdoError(DriveError):
    """A drive refused a read or write, or did not answer."""


class SdoTimeout(SdoError, DriveTimeout):
    """A drive did not answer."""


class Cyclic(Protocol):
    """What runs in the bus thread. None of its methods may block or use SDO."""

    def on_frame(self, cob: int, data: bytes, now: float) -> None:
        """A frame arrived."""

    def on_tick(self, now: float, late: float, skipped: int) -> None:
        """The next SYNC is due; `late` seconds ago, and `skipped` whole periods were lost before it."""

    def on_error(self, error: Exception) -> None:
        """One of the above raised."""


@dataclass(frozen=True, kw_only=True)
class Emcy:
    """An emergency message."""

    node: int
    code: int
    register: int

    @classmethod
    def of(cls, cob: int, data: bytes) -> Emcy:
        """Reads a frame, also one shorter than 8 bytes."""
        return cls(node=cob - EMCY_BASE, code=int.from_bytes(data[:2], "little"), register=data[2] if data[2:] else 0)


def is_emcy(cob: int) -> bool:
    """Whether a COB-ID is that of an EMCY (0x80 alone is SYNC)."""
    return EMCY_BASE < cob < EMCY_BASE + 0x80


def is_heartbeat(cob: int) -> bool:
    """Whether a COB-ID is that of a heartbeat."""
    return HEARTBEAT_BASE < cob < HEARTBEAT_BASE + 0x80


@contextmanager
def open_bus(spec: BusSpec, interface: str | None = None, channel: str | None = None) -> Iterator[can.BusABC]:
    """Opens the bus of a drives file, or another.

    Raises:
        InputError: there is no such interface or channel.
    """
    arguments = spec.arguments(interface, channel)
    try:
        bus = spec.open(interface, channel)
    except (can.CanError, OSError, ValueError, ImportError, TypeError) as e:
        raise InputError(
            "cannot open the CAN bus",
            key="bus",
            found=f"interface {arguments['interface']}, channel {arguments['channel']}: {e}",
            expected="a python-can interface that is up (ip link set can0 up type can bitrate ...)",
        ) from e
    try:
        yield bus
    finally:
        with contextlib.suppress(Exception):
            bus.shutdown()


class Master:
    """A bus and its nodes; a context manager that starts and ends the bus thread.

    Args:
        bus: open; stays the caller's to shut down.
        heartbeat_s: period of the master's own heartbeat; none if not given. Whoever keeps one has a quiet interpreter
            and processors that stay awake: drives that watch it stop when something holds it up.
    """

    def __init__(self, bus: can.BusABC, *, heartbeat_s: float | None = None) -> None:
        self.network = canopen.Network(bus)
        self.heard: dict[int, tuple[float, int]] = {}
        """Last heartbeat of each node: when, and its NMT state."""
        self.emergencies: deque[Emcy] = deque(maxlen=1000)
        self.realtime = False
        """Whether the thread was given real-time priority."""
        self._bus, self._heartbeat_s = bus, heartbeat_s
        self._clients: dict[int, canopen.sdo.SdoClient] = {}
        self._cyclic: Cyclic | None = None
        self._period = self._next_sync = 0.0
        self.clock = clock_of(bus)
        """Of SYNC, heartbeats and everything that waits for them."""
        self._next_heartbeat = self.clock.now()
        self._closing = threading.Event()
        self._quiet = contextlib.ExitStack()
        self._thread = threading.Thread(target=self._run, name="can-bus", daemon=True)

    def __enter__(self) -> Master:
        if self._heartbeat_s and self.clock.real:
            self._quiet.enter_context(realtime.quiet_interpreter())
            self._quiet.enter_context(realtime.awake_processors())
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._closing.set()
        self._thread.join(_CLOSE_S)
        self._quiet.close()

    # Frames, NMT and SDO: from any thread

    def send(self, cob: int, data: bytes) -> None:
        """Sends a frame.

        Raises:
            can.CanError: the bus did not take it.
        """
        self.network.send_message(cob, data)

    def nmt(self, command: int, node: int = 0) -> None:
        """Sends an NMT command to a node, or to all."""
        self.send(NMT_COB, bytes([command, node]))

    def read(self, node: int, obj: Obj) -> int:
        """Reads an object by SDO.

        Raises:
            SdoError: refused, or no answer.
        """
        data = self._sdo(node, obj, lambda sdo: sdo.upload(obj.index, obj.sub))
        if len(data) < obj.size:
            raise SdoError(f"node {node}: {obj} has {len(data)} bytes, {obj.size} expected")
        return obj.unpack(data[: obj.size])

    def write(self, node: int, obj: Obj, value: int) -> None:
        """Writes an object by SDO.

        Raises:
            SdoError: refused, or no answer.
        """
        self._sdo(node, obj, lambda sdo: sdo.download(obj.index, obj.sub, obj.pack(value)))

    def _sdo(self, node: int, obj: Obj, transfer: Callable[[canopen.sdo.SdoClient], _R]) -> _R:
        try:
            return transfer(self._client(node))
        except SdoAbortedError as e:
            raise SdoError(f"node {node}: {obj}: {abort_words(e.code)}") from e
        except (SdoCommunicationError, can.CanError) as e:
            raise SdoTimeout(f"node {node}: {obj}: no answer ({e})") from e

    def _client(self, node: int) -> canopen.sdo.SdoClient:
        if node not in self._clients:
            remote = canopen.RemoteNode(node, canopen.ObjectDictionary())
            remote.sdo.RESPONSE_TIMEOUT = SDO_TIMEOUT_S if self.clock.real else _SLOW_SDO_TIMEOUT_S
            remote.sdo.MAX_RETRIES = SDO_TRIES
            self.network.add_node(remote)
            self._clients[node] = remote.sdo
        return self._clients[node]

    def scan(self) -> list[int]:
        """Node ids that answer a read of their device type: until nobody new has for a while, a second at most."""
        request = b"\x40" + DEVICE_TYPE.index.to_bytes(2, "little") + bytes(5)
        self.network.scanner.reset()
        for node in range(1, MASTER_NODE):
            try:
                self.send(SDO_RX_BASE + node, request)
            except can.CanError as e:
                raise DriveError(
                    f"the bus takes no frames: {e}; is it powered, terminated, at the right bitrate?"
                ) from e
            if node % _SCAN_BURST == 0:
                time.sleep(2e-3)
        found, end = 0, time.monotonic() + _SCAN_S
        until = time.monotonic() + _QUIET_S
        while (now := time.monotonic()) < min(until, end):
            if len(self.network.scanner.nodes) > found:
                found, until = len(self.network.scanner.nodes), now + _QUIET_S
            time.sleep(0.01)
        return sorted(n for n in self.network.scanner.nodes if n < MASTER_NODE)

    # The bus thread

    def attach(self, cyclic: Cyclic, period: float) -> None:
        """Lets something run in the bus thread; ticks begin now."""
        self._period, self._next_sync = period, self.clock.now() + period
        self._cyclic = cyclic

    def detach(self) -> None:
        """Ends the ticks."""
        self._cyclic = None

    def _run(self) -> None:
        self.realtime = self.clock.real and realtime.claim()
        while not self._closing.is_set():
            try:
                self._step()
            except Exception as e:
                if self._cyclic:
                    self._cyclic.on_error(e)
                else:
                    logging.getLogger(__name__).debug("bus thread: %s", e)
                    self._closing.wait(0.01)

    def _step(self) -> None:
        """Waits for a frame until something is due, then does what is due."""
        now = self.clock.now()
        due = now + 0.05
        if self._heartbeat_s:
            due = min(due, self._next_heartbeat)
        if self._cyclic:
            due = min(due, self._next_sync)
        message = self.clock.receive(self._bus, max(0.0, due - now))
        if message is not None:
            self._receive(message)
        now = self.clock.now()
        if self._heartbeat_s and now >= self._next_heartbeat:
            self._next_heartbeat = max(self._next_heartbeat + self._heartbeat_s, now)
            self.send(HEARTBEAT_BASE + MASTER_NODE, bytes([HEARTBEAT_OPERATIONAL]))
        if self._cyclic and now >= self._next_sync:
            for _ in range(_FRAMES_PER_DRAIN):
                if (message := self._bus.recv(0)) is None:
                    break
                self._receive(message)
            now = self.clock.now()
            late = now - self._next_sync
            skipped = int(late / self._period)
            self._next_sync += (1 + skipped) * self._period  # never a burst to catch up
            if self._cyclic:
                self._cyclic.on_tick(now, late, skipped)

    def _receive(self, message: can.Message) -> None:
        if message.is_error_frame or message.is_remote_frame or message.is_extended_id:
            return
        now, cob, data = self.clock.now(), message.arbitration_id, bytes(message.data)
        if SDO_TX_BASE < cob < SDO_RX_BASE:
            self.network.notify(cob, bytearray(data), now)
        elif is_emcy(cob):
            self.emergencies.append(Emcy.of(cob, data))
        elif is_heartbeat(cob) and data:
            self.heard[cob - HEARTBEAT_BASE] = now, data[0]
        if self._cyclic:
            self._cyclic.on_frame(cob, data, now)


def for_all(function: Callable[[_T], _R], items: Iterable[_T]) -> list[_R]:
    """Calls a function on all items at once, a thread each (every SDO client then has one user); in their order."""
    items = list(items)
    with ThreadPoolExecutor(max_workers=max(1, len(items))) as pool:
        return list(pool.map(function, items))
