"""The moving part of a simulated drive: mode, set-point generator, motor, and the objects that show them."""

from __future__ import annotations

import math

from canopen.sdo import SdoAbortedError

from drake_hand.epos import objects as o
from drake_hand.epos.drives import Drive
from drake_hand.epos.objects import Obj
from drake_hand.epos.pdo import unpack_record
from drake_hand.epos.sim.dictionary import OUT_OF_RANGE, WRONG_STATE, Dictionary, fits
from drake_hand.epos.sim.motion import CyclicMotion, Demand, Generator, Homing, Profile, Ramp, Standstill
from drake_hand.epos.sim.motor import Motor
from drake_hand.epos.sim.pvt import Limits, PvtQueue, PvtRecord
from drake_hand.epos.state import BIT12, TARGET_REACHED, Control

STEP_S = 1e-3
"""Longest step of the drive's own clock."""
_RUN, _AT_ONCE, _RELATIVE = 1 << 4, 1 << 5, 1 << 6
_MODES = {t: (o.MODE_PROFILE, o.MODE_HOMING, mode) for t, mode in o.STREAM_MODE.items()}
_FOLLOWING_ERROR, _QUEUE_ERROR = 0x8611, 0xFF0C
_SOFT_LIMIT = {"epos1": 0xFF09, "epos2": 0xFF09, "epos4": 0x8A82}


class SimulatedAxis:
    """Demand and motor of one drive.

    Args:
        drive: which.
        dictionary: its objects.
        position: where the motor stands, counts.
    """

    def __init__(self, drive: Drive, dictionary: Dictionary, position: float) -> None:
        self._drive, self._dictionary = drive, dictionary
        self._per_rpm = drive.counts_per_turn / 60
        self.motor = Motor(drive.counts_per_turn, position)
        self.demand = Demand(position)
        self.queue = PvtQueue()
        self.powered = False
        self.homed = False
        """Whether the zero is known since power-on."""
        self._homing: Homing | None = None
        self._cyclic = CyclicMotion()
        self._generator: Generator = Standstill()
        self._next_profile: Profile | None = None
        self._word = 0
        self._hook()

    def _hook(self) -> None:
        d, kind = self._dictionary, self._drive.type
        d.hook(o.MODE, write=self._write_mode)
        d.hook(o.MODE_DISPLAY, read=lambda: d[o.MODE])
        d.hook(o.POSITION_DEMAND, read=lambda: fits(o.POSITION_DEMAND, round(self.demand.position)))
        d.hook(o.POSITION_ACTUAL, read=lambda: fits(o.POSITION_ACTUAL, round(self.motor.position)))
        d.hook(o.VELOCITY_ACTUAL, read=lambda: round(self.motor.velocity / self._per_rpm))
        d.hook(o.FOLLOWING_ERROR[kind], read=lambda: fits(o.FOLLOWING_ERROR[kind], round(self.following_error)))
        d.hook(o.CURRENT_ACTUAL[kind], read=lambda: fits(o.CURRENT_ACTUAL[kind], round(self.motor.current_ma)))
        if kind == "epos4":
            d.hook(o.TARGET_POSITION, write=self._write_target)
        if kind == "epos1":
            d.hook(o.POSITION_MODE_SETTING, write=self._write_setting)
        if self._drive.has_queue:
            d.hook(o.IP_BUFFER_USED, read=lambda: self.queue.used)
            d.hook(o.IP_BUFFER_FREE, read=lambda: o.IP_DEPTH - self.queue.used)
            d.hook(o.IP_STATUS, read=lambda: self.queue.status)
            d.hook(o.IP_RECORD, write=self._write_record)
            d.hook(o.IP_BUFFER_CLEAR, write=self._write_clear)

    @property
    def following_error(self) -> float:
        """Demand minus actual position, counts; 0 without power."""
        return self.demand.position - self.motor.position if self.powered else 0.0

    @property
    def resting(self) -> bool:
        """Whether the demand is at rest."""
        return self._generator.done and self.demand.velocity == 0.0

    def power(self) -> None:
        """Power stage on: holds the position it finds."""
        self.demand.position, self.demand.velocity = self.motor.position, 0.0
        self.powered = True
        self._become(Standstill())

    def release(self) -> None:
        """Power stage off: the motor coasts."""
        self.powered = False
        self._become(Standstill())

    def hold(self) -> None:
        """Stays at the present demand."""
        self._become(Standstill())

    def ramp(self, deceleration: Obj) -> None:
        """Slows down with the deceleration [rpm/s] an object holds."""
        self._become(Ramp(self._dictionary[deceleration] * self._per_rpm))

    def _become(self, generator: Generator) -> None:
        if generator is not self.queue:
            self.queue.stop()
        if generator is not self._homing:
            self._homing = None
        self._generator, self._next_profile, self._word = generator, None, 0

    def command(self, word: int) -> None:
        """Takes the mode-specific bits of a control word while the operation is enabled."""
        before, self._word = self._word, word
        mode = self._dictionary[o.MODE]
        if mode == o.MODE_PROFILE:
            self._command_profile(word, before)
        elif mode == o.MODE_HOMING:
            if word & ~before & _RUN:
                self._home()
                self._word = word
        elif mode == o.MODE_INTERPOLATED:
            runs = word & _RUN and not word & Control.HALT
            if runs and not self.queue.active and not before & _RUN:
                self.queue.limits = self._limits()
                self._generator = self.queue
                self.queue.start()
            elif not runs and self.queue.active:
                self.ramp(o.PROFILE_DECELERATION)
                self._word = word

    def _home(self) -> None:
        d, kind, method = self._dictionary, self._drive.type, self._dictionary[o.HOMING_METHOD]
        threshold = d[o.HOMING_CURRENT[kind]]
        self.homed = False
        self._homing = Homing(
            next((side for side, on_stop in o.HOME_ON_STOP.items() if method == on_stop), 0),
            speed=d[o.HOMING_SPEED] * self._per_rpm,
            acceleration=d[o.HOMING_ACCELERATION] * self._per_rpm,
            offset=d[o.HOME_OFFSET],
            stop=lambda: self.motor.position if abs(self.motor.current_ma) >= threshold else None,
        )
        self._become(self._homing)

    def _end_homing(self) -> None:
        """The place where it ended is the home position from now on."""
        self._homing = None
        self.homed = True
        home = self._dictionary[o.HOME_POSITION[self._drive.type]]
        self.count_from(home - self.following_error)
        self._generator = Standstill()

    def count_from(self, position: float) -> None:
        """The encoder shows another position from now on; demand and motor stay where they are."""
        self.demand.position += position - self.motor.position
        self.motor.count_from(position)

    def _command_profile(self, word: int, before: int) -> None:
        if word & Control.HALT:
            if not before & Control.HALT:
                self.ramp(o.PROFILE_DECELERATION)
                self._word = word
            return
        if word & ~before & _RUN:
            profile = self._profile(self._dictionary[o.TARGET_POSITION], bool(word & _RELATIVE))
            if word & _AT_ONCE or self._generator.done:
                self._generator = profile
            else:
                self._next_profile = profile

    def _profile(self, target: float, relative: bool) -> Profile:
        d = self._dictionary
        return Profile(
            target + (self.demand.position if relative else 0.0),
            speed=min(d[o.PROFILE_VELOCITY], d[o.MAX_PROFILE_VELOCITY]) * self._per_rpm,
            acceleration=d[o.PROFILE_ACCELERATION] * self._per_rpm,
            deceleration=d[o.PROFILE_DECELERATION] * self._per_rpm,
        )

    def _limits(self) -> Limits:
        d = self._dictionary
        return Limits(
            underflow_level=d[o.IP_UNDERFLOW_WARNING],
            overflow_level=d[o.IP_OVERFLOW_WARNING],
            speed_warning=d[o.PROFILE_VELOCITY] * self._per_rpm,
            speed=d[o.MAX_PROFILE_VELOCITY] * self._per_rpm,
            acceleration_warning=d[o.PROFILE_ACCELERATION] * self._per_rpm,
            acceleration=d[o.MAX_ACCELERATION] * self._per_rpm,
        )

    def _write_mode(self, mode: int) -> None:
        if mode not in _MODES[self._drive.type]:
            raise SdoAbortedError(OUT_OF_RANGE)
        if mode != self._dictionary[o.MODE]:
            self._become(Standstill())

    def _write_target(self, target: int) -> None:
        if (
            self.powered
            and self._dictionary[o.MODE] == o.MODE_CSP
            and isinstance(self._generator, CyclicMotion | Standstill)
        ):
            self._generator = self._cyclic
            self._cyclic.aim(target, self.demand, self._dictionary[o.IP_PERIOD_VALUE] * 1e-3)

    def _write_setting(self, target: int) -> None:
        if (
            self.powered
            and self._dictionary[o.MODE] == o.MODE_POSITION
            and isinstance(self._generator, CyclicMotion | Standstill)
        ):
            self._generator = self._cyclic
            self._cyclic.aim(target, self.demand, 0.0)

    def _write_record(self, raw: int) -> None:
        if not self.queue.accepts:
            raise SdoAbortedError(WRONG_STATE)
        position, rpm, ms = unpack_record(raw.to_bytes(8, "little"))
        self.queue.limits = self._limits()
        self.queue.push(PvtRecord(position, rpm * self._per_rpm, ms * 1e-3))

    def _write_clear(self, value: int) -> None:
        self.queue.clear(enable=bool(value))

    def advance(self, dt: float) -> None:
        """Lets dt seconds pass, in steps of at most `STEP_S`."""
        if not self.powered and self.motor.still and not self.motor.load:
            self.motor.velocity = self.motor.current_ma = 0.0
            return
        steps = max(1, math.ceil(dt / STEP_S - 1e-6))
        h = dt / steps
        demand, motor = self.demand, self.motor
        for _ in range(steps):
            if self._generator.done and self._next_profile:
                self._generator, self._next_profile = self._next_profile, None
            if self.powered:
                self._generator.step(demand, h)
            motor.step(demand, h, self.powered)
            if self._homing and self._homing.done:
                self._end_homing()
        if not self.powered:
            demand.position, demand.velocity = motor.position, 0.0

    def error(self) -> int:
        """Code of what goes wrong in the motion now; 0 for nothing."""
        if not self.powered:
            return 0
        if abs(self.following_error) > self._dictionary[o.FOLLOWING_WINDOW]:
            return _FOLLOWING_ERROR
        if self.queue.active and self.queue.failed:
            return _QUEUE_ERROR
        low, high = self._dictionary[o.SOFT_LIMIT_MIN], self._dictionary[o.SOFT_LIMIT_MAX]
        if low < high and not low - 0.5 <= self.demand.position <= high + 0.5:
            return _SOFT_LIMIT[self._drive.type]
        return 0

    def status(self) -> int:
        """Mode-specific bits of the status word: target reached, bit 12."""
        if not self.powered:
            return 0
        mode, generator = self._dictionary[o.MODE], self._generator
        settled = generator.done and abs(self.following_error) < 2
        if mode == o.MODE_CSP:
            return BIT12 if isinstance(generator, CyclicMotion | Standstill) else 0
        if mode == o.MODE_INTERPOLATED:
            return (BIT12 if self.queue.active else 0) | (TARGET_REACHED if settled else 0)
        if mode == o.MODE_HOMING:
            return (BIT12 if self.homed and not self._homing else 0) | (TARGET_REACHED if settled else 0)
        acknowledged = mode == o.MODE_PROFILE and self._word & _RUN
        return (BIT12 if acknowledged else 0) | (TARGET_REACHED if settled else 0)
