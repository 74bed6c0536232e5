"""CiA 402 state machine of a simulated drive, with option codes and the three classes of error reaction.

The abort options (0x6007) are 0 nothing, 1 fault, 2 disable voltage, 3 quick stop; that a drive after option 3 waits in
quick stop (and after an error reset needs no fault reset) is inferred.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from drake_hand.epos import objects as o
from drake_hand.epos.drives import Drive
from drake_hand.epos.objects import Obj
from drake_hand.epos.pdo import EMCY_BASE
from drake_hand.epos.sim.axis import SimulatedAxis
from drake_hand.epos.sim.dictionary import Dictionary
from drake_hand.epos.state import HOMED, REMOTE, Control, DriveState, status_bits

_READY, _ON, _ENABLED = DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED
_OFF, _QUICK = DriveState.SWITCH_ON_DISABLED, DriveState.QUICK_STOP_ACTIVE
_REGISTER_BIT = {0x2: 1, 0x3: 2, 0x4: 3, 0x7: 5, 0x81: 4, 0x82: 4, 0x86: 7, 0x8A: 7, 0xFF: 7}


class StateMachine:
    """States, control and status word, errors of one drive.

    Args:
        drive: which.
        dictionary: its objects.
        axis: what it switches.
        send: puts a frame on the bus (COB-ID, data).
        tell: reports (event, what) for the timeline.
    """

    def __init__(
        self,
        drive: Drive,
        dictionary: Dictionary,
        axis: SimulatedAxis,
        send: Callable[[int, bytes], None],
        tell: Callable[[str, str], None],
    ) -> None:
        self._drive, self._dictionary, self._axis, self._send, self._tell = drive, dictionary, axis, send, tell
        self.state = DriveState.NOT_READY
        self._then: DriveState | None = None
        self._word = 0
        self._errors: list[int] = []
        dictionary.hook(o.CONTROLWORD, write=self.control)
        dictionary.hook(o.STATUSWORD, read=self.statusword)
        dictionary.hook(o.ERROR_HISTORY_COUNT, read=lambda: len(self._errors), write=lambda _: self._errors.clear())
        for n in range(1, o.ERROR_HISTORY_DEPTH + 1):
            dictionary.hook(o.error_history(n), read=partial(self._stored_error, n))

    def _stored_error(self, n: int) -> int:
        return self._errors[n - 1] if n <= len(self._errors) else 0

    def boot(self) -> None:
        """Power-on: no error, no power, switch-on disabled."""
        self._errors.clear()
        self._word = 0
        self._go(_OFF)

    def statusword(self) -> int:
        """0x6041."""
        homed = HOMED if self._axis.homed else 0
        return status_bits(self.state, self._drive.type) | REMOTE | self._axis.status() | homed

    def control(self, word: int) -> None:
        """Takes a control word (0x6040)."""
        before, self._word = self._word, word
        if word & ~before & Control.FAULT_RESET:
            self._reset_fault()
            return
        if self.state.faulty or self.state is DriveState.NOT_READY:
            return
        if not word & 0x02:
            if self.state is not _OFF:
                self._go(_OFF)
        elif not word & 0x04:
            if self.state is _ENABLED:
                self._quick_stop()
            elif self.state in (_READY, _ON):
                self._go(_OFF)
        elif not word & 0x01:
            if self.state is _ENABLED:
                self._leave(_READY, o.SHUTDOWN_OPTION)
            elif self.state in (_OFF, _ON):
                self._go(_READY)
        elif not word & 0x08:
            if self.state is _ENABLED:
                self._leave(_ON, o.DISABLE_OPTION)
            elif self.state is _READY:
                self._go(_ON)
        elif self.state in (_READY, _ON, _QUICK):
            self._go(_ENABLED)
        elif self.state is _ENABLED and self._then is None:
            self._axis.command(word)

    def _go(self, state: DriveState) -> None:
        before, self.state, self._then = self.state, state, None
        if state is _ENABLED:
            self._axis.hold() if before is _QUICK else self._axis.power()
        elif not state.powered:
            self._axis.release()
        if state is not before:
            self._tell("state", state.value)

    def _leave(self, to: DriveState, option: Obj) -> None:
        """Ends the operation: at once, or on the slow-down ramp."""
        if self._dictionary[option] == 0:
            self._go(to)
        elif self._then is not to:
            self._axis.ramp(o.PROFILE_DECELERATION)
            self._then = to

    def _quick_stop(self) -> None:
        has_option = o.QUICK_STOP_OPTION in self._dictionary
        option = self._dictionary[o.QUICK_STOP_OPTION] if has_option else 6
        if option == 0:
            self._go(_OFF)
            return
        self._go(_QUICK)
        self._axis.ramp(o.PROFILE_DECELERATION if option in (1, 5) else o.QUICK_STOP_DECELERATION)
        self._then = _OFF if option in (1, 2) else None

    def fail(self, code: int) -> None:
        """An error occurred: stores it, sends the EMCY, reacts by its class."""
        self._errors.insert(0, code)
        del self._errors[o.ERROR_HISTORY_DEPTH :]
        bit = _REGISTER_BIT.get(code >> 12, _REGISTER_BIT.get(code >> 8, 0))
        self._dictionary[o.ERROR_REGISTER] |= 1 | 1 << bit
        self._emcy(code)
        kind = o.reaction(code)
        if kind == "disable":
            self._go(DriveState.FAULT)
        elif kind == "fault":
            self._fault()
        else:
            self.abort()

    def abort(self) -> None:
        """Communication is lost: does what the abort option says."""
        option = self._dictionary[o.ABORT_OPTION]
        if option == 1:
            self._fault()
        elif option == 2 and not self.state.faulty:
            self._go(_OFF)
        elif option == 3 and self.state is _ENABLED:
            self._quick_stop()

    def _fault(self) -> None:
        option = self._dictionary[o.FAULT_OPTION]
        if self.state.faulty:
            return
        if not self.state.powered or option == 0:
            self._go(DriveState.FAULT)
            return
        self._go(DriveState.FAULT_REACTION)
        self._axis.ramp(o.PROFILE_DECELERATION if option == 1 else o.QUICK_STOP_DECELERATION)
        self._then = DriveState.FAULT

    def _reset_fault(self) -> None:
        if self.state is DriveState.FAULT:
            self._go(_OFF)
        if not self.state.faulty and self._dictionary[o.ERROR_REGISTER]:
            self._dictionary[o.ERROR_REGISTER] = 0
            self._emcy(0)

    def _emcy(self, code: int) -> None:
        register = self._dictionary[o.ERROR_REGISTER]
        self._send(EMCY_BASE + self._drive.node, code.to_bytes(2, "little") + bytes([register]) + bytes(5))
        self._tell("emcy", o.emcy_words(code))

    def advance(self) -> None:
        """After a step of the motion: ends ramps, reacts to what went wrong."""
        if self._then is not None and self._axis.resting:
            self._go(self._then)
        code = self._axis.error()
        if code and not self.state.faulty:
            self.fail(code)
