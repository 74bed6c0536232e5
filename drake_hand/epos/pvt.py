"""`PvtBackend`: streams position-velocity-time records into the queue of an EPOS2, which does the timing itself.

The queue is kept near `QUEUE_S` seconds: long enough for a late master, short enough that a drive whose master is
gone does not play on for long.
"""

from __future__ import annotations

from drake_hand.epos.axis import AxisState
from drake_hand.epos.objects import IP_DEPTH
from drake_hand.epos.pdo import LAYOUT, pack_record
from drake_hand.epos.schedule import CLOCK_TOLERANCE, Schedule
from drake_hand.epos.state import Control

QUEUE_S = 0.4
"""Time kept queued; 0.5 s at most."""
LOW_S = 0.1
"""Less than this queued before the end stops the group: the drive would fault at two records."""


def _queued(schedule: Schedule) -> int:
    """Number of records to keep queued."""
    ms = schedule.record_steps * schedule.drives.bus.sync_ms
    return min(max(4, int(QUEUE_S * 1e3 / ms)), IP_DEPTH - 4)


def most_ahead(schedule: Schedule) -> int:
    """Steps that a record may be sent before it is played, at most: a full queue and what is sent to a fast one."""
    return (_queued(schedule) + 3) * schedule.record_steps


class PvtBackend:
    """One EPOS2.

    Args:
        schedule: the motion.
        column: of the drive.
    """

    def __init__(self, schedule: Schedule, column: int) -> None:
        rows = slice(None, None, schedule.record_steps)
        ms = schedule.record_steps * schedule.drives.bus.sync_ms
        self._counts, self._rpm, self._ms = schedule.counts[rows, column], schedule.rpm[rows, column], ms
        self._every, self._phase = schedule.record_steps, column
        self._target = _queued(schedule)
        self._low = min(max(3, int(LOW_S * 1e3 / ms)), self._target - 1)
        self._first = self._next = self._flying = 0
        self._count = len(self._counts)
        self._command = LAYOUT[schedule.drives.drives[column].type].command

    def prime(self, first: int, last: int) -> list[bytes]:
        """The first records of the stretch, up to the target.

        That an EPOS2 whose queue was played to its end takes records for another motion without being cleared is
        inferred.
        """
        self._first, self._count = first, (last - first) // self._every + 1
        self._next = self._flying = 0
        return self._take(min(self._target, self._count))

    def _take(self, count: int) -> list[bytes]:
        """The next records; the last of all ends the motion."""
        begin, self._next = self._next, self._next + count
        row, last = self._first // self._every, self._count - 1
        return [
            pack_record(int(self._counts[row + i]), float(self._rpm[row + i]), self._ms if i < last else 0)
            for i in range(begin, self._next)
        ]

    def primed(self, axis: AxisState) -> bool:
        """All of them queued, no error."""
        return axis.queued == self._next and not axis.queue_error

    def hold(self, controlword: int, counts: int) -> bytes:
        """The control word alone: outside the motion the drive holds by itself."""
        return self._command.pack(controlword)

    def command(self, j: int) -> bytes | None:
        """Run, once: the drive's clock does the rest."""
        return self._command.pack(Control.ENABLE_RUN) if j == self._first else None

    def feed(self, j: int, axis: AxisState) -> list[bytes]:
        """One record when there is room, on this drive's turn; one more when it falls behind.

        Drives take turns so that the records of all do not come in the same period.
        """
        room = self._target - axis.queued - self._flying
        turn = (j - self._first + self._phase) % self._every == 0
        count = min(2 if room > 2 else 1 if room > 0 and turn else 0, self._count - self._next)
        self._flying = count + (self._flying if axis.missed else 0)
        return self._take(count)

    def playing(self, axis: AxisState) -> bool:
        """As bit 12 of the status word says."""
        return axis.active

    def low(self, j: int, axis: AxisState) -> bool:
        """Few records queued, and fewer than the motion still needs by the drive's own clock.

        Records in transit do not count: they may not arrive.
        """
        played = (j - self._first) // self._every
        ahead = int(CLOCK_TOLERANCE * played)
        return axis.queued < min(self._low, self._count - played - ahead - 2)
