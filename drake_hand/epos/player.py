"""`Player`: what happens SYNC by SYNC: enable together, start together, follow the schedule, stop together.

It runs in the bus thread. Its course is a generator that yields once per SYNC; a stop drops the course and begins the
one that brings everything to rest.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator

import can

from drake_hand.epos.axis import AxisState
from drake_hand.epos.backend import Backend
from drake_hand.epos.corrected import Corrected
from drake_hand.epos.csp import CspBackend
from drake_hand.epos.grip import Grip
from drake_hand.epos.logbook import Logbook
from drake_hand.epos.objects import DriveType
from drake_hand.epos.pdo import SYNC_COB
from drake_hand.epos.position import PositionBackend
from drake_hand.epos.pvt import PvtBackend
from drake_hand.epos.record import Fault
from drake_hand.epos.schedule import CLOCK_TOLERANCE, Schedule
from drake_hand.epos.state import Control, DriveState
from drake_hand.epos.stops import MOST_MISSED_SYNCS, Watch

BACKENDS: dict[DriveType, Callable[[Schedule, int], Backend]] = {
    "epos2": PvtBackend,
    "epos4": CspBackend,
    "epos1": PositionBackend,
}
ENABLE_LADDER = (
    (Control.SHUTDOWN, DriveState.READY_TO_SWITCH_ON),
    (Control.SWITCH_ON, DriveState.SWITCHED_ON),
    (Control.ENABLE, DriveState.OPERATION_ENABLED),
)
"""Control word and the state all drives have to reach before the next."""
LISTEN_SYNCS = 5
ENABLE_S, PRIME_S, SETTLE_S, STOP_S, DISABLE_S = 1.0, 0.5, 1.0, 1.0, 0.5
"""How long each stage may take."""
START_DEADLINE_STEPS = 4
"""Step by which every PVT drive has shown that it plays."""
RECORDS_PER_SYNC = 2
"""While loading the queues: a third of the bus at 10 ms and 1 Mbit/s."""
HOLD_S = 60.0
"""How long a halted hand holds before it is stopped: motors that press get warm."""
_FELT = ("playing", "settling", "waiting", "holding")
"""Stages in which the fingers press as the plan has them press."""
_REST_SYNCS = 3
_MOST_ERRORS = 20


class _Stop(Exception):
    """Ends the course: what a stage of it could not reach."""

    def __init__(self, kind: str, text: str, axis: AxisState | None = None) -> None:
        self.kind, self.text, self.axis = kind, text, axis


class Player:
    """Plays a schedule on drives that are configured and operational.

    Args:
        schedule: the motion.
        send: puts a frame on the bus (COB-ID, data); may raise can.CanError.
        tell: called with the plan time of each SYNC once the motion has begun.
        grip: judges what the fingers press, where an object is in the hand.
        corrected: changes the schedule's rows to come by where the object is seen.
    """

    def __init__(
        self,
        schedule: Schedule,
        send: Callable[[int, bytes], None],
        tell: Callable[[float], None] = lambda _: None,
        grip: Grip | None = None,
        corrected: Corrected | None = None,
    ) -> None:
        self.schedule, self.grip, self._corrected = schedule, grip, corrected
        self.watch = Watch(schedule.drives)
        self.axes = self.watch.axes
        self.faults: list[Fault] = []
        """The first stopped the run; the others came after."""
        self.log = Logbook(schedule)
        self.done = threading.Event()
        """All reachable drives are disabled, as far as their status words tell."""
        self.stage = "listening"
        self.step = -1
        """Of the schedule, at the last SYNC."""
        self.start_skew = 0
        """SYNCs between the first and the last drive that began to play."""
        self.waiting: float | None = None
        """Plan time at which the motion holds until :meth:`go_on`; None while it does not."""
        self._go_on = threading.Event()
        self._hold_asked = threading.Event()
        self._stretch = (0, schedule.last)
        self._backends: list[Backend] = [BACKENDS[d.type](schedule, i) for i, d in enumerate(schedule.drives.drives)]
        self._send, self._tell = send, tell
        self._streams = any(not d.has_queue for d in schedule.drives.drives)
        self._course: Iterator[None] = self._play()
        self._requests: deque[tuple[str, str]] = deque()
        self._stopping = self._cutting = False
        self._moving = False
        self._first_playing: dict[int, int] = {}
        self._send_error: Exception | None = None
        self._errors = 0
        self._now = 0.0

    @property
    def plan_time(self) -> float:
        """Time in the plan at the last SYNC, s; negative before it."""
        return float(self.schedule.plan_time[self.step]) if self.step >= 0 else -1.0

    # From other threads

    def request_stop(self, kind: str, text: str) -> None:
        """Stops the group at the next SYNC at the latest; the second request takes the power off at once."""
        self._requests.append((kind, text))

    def request_hold(self) -> None:
        """Halts at the next SYNC and holds, enabled, where that is; what is not in a motion or a pause is stopped."""
        self._hold_asked.set()

    def go_on(self) -> None:
        """Ends a pause."""
        self._go_on.set()

    # In the bus thread

    def on_frame(self, cob: int, data: bytes, now: float) -> None:
        """A frame arrived."""
        self._now = now
        self._react(self.watch.frame(cob, data, now))

    def on_tick(self, now: float, late: float, skipped: int) -> None:
        """Ends a period and begins the next: SYNC first, then what the next SYNC is to latch."""
        self._now = now
        self.log.close_row(self.axes)
        self._react(self.watch.period_ends(now))
        if self.grip and self.step >= 0 and self.stage in _FELT:
            self._react(self.watch.fault("grip", text, now) for text in self.grip.look(self.step, self.axes))
        self._take_requests()
        self._take_hold()
        if self._streams and late > self.schedule.period and self._moving:
            self._stop("late", f"SYNC {late * 1e3:.1f} ms late, more than a period")
        if self.step >= 0:
            self._tell(self.plan_time)
        self._put(SYNC_COB, b"")
        self.watch.sync += 1
        if self._moving:
            self.step = min(self.step + 1 + skipped, self._stretch[1])
            self.watch.demand = self.schedule.counts[self.step].tolist()
            if self._corrected:
                self._corrected.tick(self.step)
        between = not self._moving and not self._stopping and self.step < self.schedule.last
        self.log.open_row(now, late, -1 if between else self.step, moving=self._moving)
        try:
            next(self._course, None)
        except _Stop as e:
            self._stop(e.kind, e.text, e.axis)
        if self._send_error is not None:
            error, self._send_error = self._send_error, None
            self._stop("bus", f"the bus takes no frames: {error}")

    def on_error(self, error: Exception) -> None:
        """Something raised in the bus thread: stop; when even that keeps raising, leave the rest to SDO."""
        self._errors += 1
        if self._errors > _MOST_ERRORS:
            self.done.set()
            return
        self._stop("bus" if isinstance(error, can.CanError) else "internal", f"{type(error).__name__}: {error}")

    def _put(self, cob: int, data: bytes) -> None:
        """Sends; a frame the bus does not take must not keep the next from being tried."""
        try:
            self._send(cob, data)
        except (can.CanError, OSError) as e:
            self._send_error = e

    def _command(self, i: int, controlword: int) -> None:
        axis = self.axes[i]
        payload = self._backends[i].hold(controlword, int(self.schedule.counts[max(self.step, 0), i]))
        self._put(axis.layout.command.cob_id(axis.drive.node), payload)

    def _command_at_once(self, controlword: int, axes: Iterable[int]) -> None:
        """By the PDO that acts at once; and by the latched one, so that none pending undoes it at the next SYNC."""
        axes = list(axes)
        for i in axes:
            axis = self.axes[i]
            self._put(axis.layout.stop.cob_id(axis.drive.node), axis.layout.stop.pack(controlword))
        for i in axes:
            self._command(i, controlword)

    def _react(self, faults: Iterable[Fault]) -> None:
        for fault in faults:
            if not any(f.kind == fault.kind and f.node == fault.node for f in self.faults) and not self.done.is_set():
                self.faults.append(fault)
            self._begin_stop()

    def _stop(self, kind: str, text: str, axis: AxisState | None = None) -> None:
        self._react([self.watch.fault(kind, text, self._now, axis)])

    def _take_requests(self) -> None:
        while self._requests:
            again = self._stopping
            self._stop(*self._requests.popleft())
            if again and not self._cutting:
                self._cutting = True
                self._command_at_once(Control.DISABLE_VOLTAGE, range(len(self.axes)))
                self._course = self._disable()

    def _take_hold(self) -> None:
        if not self._hold_asked.is_set() or self._stopping:
            return
        self._hold_asked.clear()
        if self.stage not in ("playing", "settling", "waiting"):
            self._stop("interrupt", "interrupted")
            return
        if self._moving:
            self.step = min(self.step + 1, self._stretch[1])  # whose targets were sent already
        self._moving, self.waiting = False, None
        self.watch.demand = None
        # That an EPOS2 leaves its interpolated motion on the halt bit, on the profile's ramp, is inferred.
        halt = Control.ENABLE | Control.HALT
        queues = [i for i, a in enumerate(self.axes) if a.drive.has_queue]
        self._command_at_once(halt, queues)
        for i in set(range(len(self.axes))) - set(queues):
            self._command(i, Control.ENABLE)
        self._course = self._hold()

    def _begin_stop(self) -> None:
        if self._stopping:
            return
        self._stopping, self._moving = True, False
        self.watch.enabled, self.watch.demand = False, None
        self._command_at_once(Control.QUICK_STOP, range(len(self.axes)))
        self._course = self._halt()

    # The course

    def _play(self) -> Iterator[None]:
        for _ in range(LISTEN_SYNCS):
            yield
        self._check_unmoved()
        self.stage = "enabling"
        for word, state in ENABLE_LADDER:
            yield from self._bring(word, state)
        self.watch.enabled, self.watch.demand = True, self.schedule.counts[0].tolist()
        first = 0
        for last in self.schedule.stops:
            self._stretch = first, last
            if self._corrected:
                self._corrected.begin(first, last)
            yield from self._prime()
            self.stage = "playing"
            yield from self._motion()
            yield from self._settle()
            if last < self.schedule.last:
                yield from self._pause()
            first = last
        self._stopping = True
        self.watch.enabled, self.watch.demand = False, None
        yield from self._disable()

    def _syncs(self, seconds: float) -> range:
        return range(max(1, round(seconds / self.schedule.period)))

    def _check_unmoved(self) -> None:
        for axis, counts in zip(self.axes, self.schedule.counts[0].tolist(), strict=True):
            if abs(axis.position - counts) > axis.drive.following_error_counts // 2:
                raise _Stop("start", f"moved by {axis.position - counts} counts before it was enabled", axis)

    def _bring(self, word: int, state: DriveState) -> Iterator[None]:
        """All drives together to a state: the next word goes out when the last has arrived."""
        for _ in self._syncs(ENABLE_S):
            late = [i for i, a in enumerate(self.axes) if a.state is not state]
            if not late:
                return
            for i in late:
                self._command(i, word)
            yield
        axis = self.axes[late[0]]
        raise _Stop("enable", f"is {axis.state.value}, does not become {state.value}", axis)

    def _prime(self) -> Iterator[None]:
        waiting = [deque(b.prime(*self._stretch)) for b in self._backends]
        while any(waiting):
            for axis, records in zip(self.axes, waiting, strict=True):
                for _ in range(min(RECORDS_PER_SYNC, len(records))):
                    self._put_record(axis, records.popleft())
            yield
        for _ in self._syncs(PRIME_S):
            late = [a for a, b in zip(self.axes, self._backends, strict=True) if not b.primed(a)]
            if not late:
                return
            yield
        raise _Stop("queue", f"holds {late[0].queued} PVT records, not those it was sent", late[0])

    def _put_record(self, axis: AxisState, record: bytes) -> None:
        assert axis.layout.record
        self._put(axis.layout.record.cob_id(axis.drive.node), record)

    def _motion(self) -> Iterator[None]:
        first, last = self._stretch
        self._first_playing.clear()
        self.step = first - 1
        self._command_step(first)
        self._moving = True
        while self.step < last:
            yield
            self._command_step(self.step + 1)
            for axis, backend in zip(self.axes, self._backends, strict=True):
                for record in backend.feed(self.step, axis):
                    self._put_record(axis, record)
                if backend.low(self.step, axis):
                    raise _Stop("queue", f"PVT queue low: {axis.queued} records", axis)
            self._check_in_step()
        self._moving = False

    def _command_step(self, j: int) -> None:
        for axis, backend in zip(self.axes, self._backends, strict=True):
            if (payload := backend.command(j)) is not None:
                self._put(axis.layout.command.cob_id(axis.drive.node), payload)

    def _check_in_step(self) -> None:
        """That the drives began to play in the same SYNC, and play to the end (which comes early on a fast clock)."""
        first, last = self._stretch
        played = self.step - first
        if played > START_DEADLINE_STEPS:
            if played < (last - first) * (1 - CLOCK_TOLERANCE) - 1:
                for axis, backend in zip(self.axes, self._backends, strict=True):
                    if not backend.playing(axis):
                        raise _Stop("skew", "does not play", axis)
            return
        for axis, backend in zip(self.axes, self._backends, strict=True):
            if axis.drive.has_queue and backend.playing(axis):
                self._first_playing.setdefault(axis.drive.node, self.step)
        if self._first_playing:
            steps = self._first_playing.values()
            self.start_skew = max(steps) - min(steps)
            if self.start_skew:
                raise _Stop("skew", f"the drives began to play {self.start_skew} SYNCs apart")

    def _pause(self) -> Iterator[None]:
        """Holds, enabled, until asked to continue."""
        for i in range(len(self.axes)):
            self._command(i, Control.ENABLE)  # bit 4 falls, so that it may rise again
        self._go_on.clear()
        self.stage, self.waiting = "waiting", float(self.schedule.plan_time[self.step])
        yield
        while not self._go_on.is_set():
            yield
        self.waiting = None

    def _hold(self) -> Iterator[None]:
        """At rest, powered, as long as somebody may want it."""
        self.stage = "holding"
        for _ in self._syncs(SETTLE_S):
            yield
            if all(a.still >= _REST_SYNCS for a in self.axes):
                break
        self.watch.demand = [a.position for a in self.axes]
        for _ in self._syncs(HOLD_S):
            yield
        raise _Stop("interrupt", f"held for {HOLD_S:.0f} s")

    def _settle(self) -> Iterator[None]:
        """Until every motor rests and no queue plays."""
        self.stage = "settling"
        for _ in self._syncs(SETTLE_S):
            yield
            busy = [a for a in self.axes if a.still < _REST_SYNCS or (a.drive.has_queue and a.active)]
            if not busy:
                return
        raise _Stop("stuck", "does not come to rest", busy[0])

    def _halt(self) -> Iterator[None]:
        """Quick stop until everything rests, then disable."""
        self.stage = "stopping"
        for _ in self._syncs(STOP_S):
            yield
            busy = self._powered()
            if all(
                self.axes[i].state is DriveState.QUICK_STOP_ACTIVE and self.axes[i].still >= _REST_SYNCS for i in busy
            ):
                break
            self._command_at_once(
                Control.QUICK_STOP, [i for i in busy if self.axes[i].state is DriveState.OPERATION_ENABLED]
            )
        yield from self._disable()

    def _powered(self) -> list[int]:
        """Drives that answer and say that they are powered."""
        return [i for i, a in enumerate(self.axes) if a.state.powered and a.missed < MOST_MISSED_SYNCS]

    def _disable(self) -> Iterator[None]:
        """Power off, at rest."""
        self.stage = "disabling"
        powered = list(range(len(self.axes)))
        for _ in self._syncs(DISABLE_S / 2):
            self._command_at_once(Control.DISABLE_VOLTAGE, powered)
            yield  # the answers to the SYNC before came from before this command
            yield
            if not (powered := self._powered()):
                break
        self.stage = "disabled"
        self.done.set()
        while True:
            yield
