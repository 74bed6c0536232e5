"""`Watch`: looks at every frame and every SYNC for a reason to stop; one method per row of the fault table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drake_hand.epos.axis import AxisState
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import HEARTBEAT_OPERATIONAL, Emcy, is_emcy, is_heartbeat
from drake_hand.epos.objects import emcy_words, ip_status_words
from drake_hand.epos.pdo import EMCY_BASE, HEARTBEAT_BASE
from drake_hand.epos.record import Fault
from drake_hand.epos.state import DriveState

MOST_MISSED_SYNCS = 3
"""So many SYNCs in a row without an answer stop the group."""
FOLLOWING_SHARE = 0.7
"""Share of a drive's following-error window at which the master stops, before the drive faults."""
_OVERFLOW_WARNING = 1 << 1
_BOOT_UP_BYTE = 0x00


class Watch:
    """Keeps the state of all drives up to date and yields the faults it sees.

    Args:
        drives: the drives.
    """

    def __init__(self, drives: Drives) -> None:
        self.axes = [AxisState(d) for d in drives.drives]
        self.enabled = False
        """Whether every drive has to be in operation enabled."""
        self.demand: Sequence[int] | None = None
        """Where the drives should be at the last SYNC, counts; None while that does not matter."""
        self.sync = 0
        """SYNCs sent."""
        self._by_node = {a.drive.node: a for a in self.axes}
        self._index = {a.drive.node: i for i, a in enumerate(self.axes)}
        self._status = {a.layout.status.cob_id(a.drive.node): a for a in self.axes}
        self._interpolation = {
            a.layout.interpolation.cob_id(a.drive.node): a for a in self.axes if a.layout.interpolation
        }
        self._current = {a.layout.current.cob_id(a.drive.node): a for a in self.axes}
        self._limit = [FOLLOWING_SHARE * d.following_error_counts for d in drives.drives]
        self._consumer_s = drives.bus.heartbeat_consumer_ms * 1e-3
        self._begun: float | None = None

    def fault(self, kind: str, text: str, now: float, axis: AxisState | None = None, code: int = 0) -> Fault:
        """A fault of a drive, or of none."""
        time_s = now - (self._begun if self._begun is not None else now)
        if axis is None:
            return Fault(kind=kind, text=text, time_s=time_s, sync=self.sync)
        joint, node = axis.drive.joint, axis.drive.node
        return Fault(
            kind=kind, text=f"{axis}: {text}", time_s=time_s, sync=self.sync, joint=joint, node=node, code=code
        )

    # Frames

    def frame(self, cob: int, data: bytes, now: float) -> Iterator[Fault]:
        """Takes a frame."""
        if axis := self._status.get(cob):
            if axis.take_status(data):
                yield from self._check_state(axis, now)
                yield from self._check_following(axis, now)
        elif axis := self._current.get(cob):
            axis.take_current(data)
        elif axis := self._interpolation.get(cob):
            if axis.take_interpolation(data):
                yield from self._check_queue(axis, now)
        elif is_emcy(cob) and (axis := self._by_node.get(cob - EMCY_BASE)):
            if code := Emcy.of(cob, data).code:
                yield self.fault("emcy", f"EMCY {emcy_words(code)}", now, axis, code)
        elif is_heartbeat(cob) and data and (axis := self._by_node.get(cob - HEARTBEAT_BASE)):
            axis.heard = now
            yield from self._check_network(axis, data[0], now)

    def _check_state(self, axis: AxisState, now: float) -> Iterator[Fault]:
        if axis.state.faulty:
            yield self.fault("fault", axis.state.value, now, axis)
        elif self.enabled and axis.state is not DriveState.OPERATION_ENABLED:
            yield self.fault("fault", f"left operation enabled: {axis.state.value}", now, axis)

    def _check_following(self, axis: AxisState, now: float) -> Iterator[Fault]:
        if self.demand is None:
            return
        i = self._index[axis.drive.node]
        error = self.demand[i] - axis.position
        if abs(error) > self._limit[i]:
            window = axis.drive.following_error_counts
            yield self.fault("following", f"following error {error} counts, the drive's window is {window}", now, axis)

    def _check_queue(self, axis: AxisState, now: float) -> Iterator[Fault]:
        if axis.queue_error or axis.ip_status & _OVERFLOW_WARNING:
            yield self.fault("queue", "PVT queue: " + ", ".join(ip_status_words(axis.ip_status)), now, axis)

    def _check_network(self, axis: AxisState, state: int, now: float) -> Iterator[Fault]:
        if state == _BOOT_UP_BYTE:
            yield self.fault("reboot", "booted: it has lost its configuration", now, axis)
        elif state != HEARTBEAT_OPERATIONAL:
            yield self.fault("reboot", f"NMT state 0x{state:02X}, not operational", now, axis)

    # SYNCs

    def period_ends(self, now: float) -> Iterator[Fault]:
        """Before a SYNC: who has not answered the last one, or is not heard any more."""
        if self._begun is None:
            self._begun = now
            for axis in self.axes:
                axis.heard = now
            return
        for axis in self.axes:
            axis.missed = 0 if axis.answered else axis.missed + 1
            axis.answered = False
            if axis.missed == MOST_MISSED_SYNCS:
                yield self.fault("silent", f"no answer to {MOST_MISSED_SYNCS} SYNCs in a row", now, axis)
            if now - axis.heard > self._consumer_s:
                axis.heard = now
                yield self.fault("heartbeat", f"no heartbeat for {self._consumer_s * 1e3:.0f} ms", now, axis)
