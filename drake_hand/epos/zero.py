"""Zeros of the joints: taken from the posture the hand was put into, or found on mechanical stops at limited current.

Both are the drive's own homing (CiA 402 mode 6), so that the drive itself keeps the zero, and the knowledge that it has
one (bit 15 of its status word), for as long as it is powered.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from drake_hand.epos import objects as od
from drake_hand.epos.configure import configure
from drake_hand.epos.discovery import conditions, mismatches, not_ready
from drake_hand.epos.drives import Drive, Drives
from drake_hand.epos.master import Master, SdoError
from drake_hand.epos.off import switch_off
from drake_hand.epos.preflight import Refused
from drake_hand.epos.state import BIT12, FOLLOWING, HOMED, Control, DriveState, decode_state, status_words
from drake_hand.errors import DriveError

OFF_STOP_DEG = 3.0
"""How far a joint moves off its stop."""
_RANGE_SPARE_RAD = math.radians(15.0)
"""By how much a joint may turn further than its range before it meets its stop."""
_HOMING_RPM_S = 10_000
"""Of homing, rpm/s: slow enough not to be taken for a stop."""
_STEP_S, _HERE_S = 0.02, 2.0
_AT_HOME_COUNTS = 3
MOST_PASSES, AGREEMENT_RAD = 3, math.radians(2.0)
"""A finger in the way may be mistaken for a stop; once the others are at their stops, it is no longer in the way."""
_LADDER = (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE)


def by_hand(master: Master, drives: Drives, q: np.ndarray) -> None:
    """Takes the present posture for q; the drives are powered, one after the other, for as long as that takes.

    Args:
        master: on their bus.
        drives: which.
        q: (n,) the posture the hand was put into, rad.

    Raises:
        Refused: not all drives are there and at rest.
        DriveError: a drive did not take it; all are off.
    """
    with _prepared(master, drives):
        for drive, counts in zip(drives.drives, drives.counts_from_joints(q).tolist(), strict=True):
            _home(master, drive, od.HOME_HERE[drive.type], home=counts, turn=0, within_s=_HERE_S)


def on_stops(
    master: Master, drives: Drives, order: Sequence[str], limits: Mapping[str, tuple[float, float]]
) -> Iterator[tuple[str, float]]:
    """Seeks the joints' stops, one after the other, until a pass over all finds them where the one before did.

    Yields each joint and how far it turned, rad.

    Args:
        master: on their bus.
        drives: which; each has a stop and shares no cables.
        order: of the joints: such that none collides with another as it turns, as far as is known.
        limits: of each joint, rad: it may turn little further than from one to the other.

    Raises:
        Refused: not all drives are there and at rest, or one cannot be homed.
        DriveError: a drive found no stop, or another each time; all are off.
    """
    lacking = [
        f"{d.joint} (node {d.node}): " + ("shares cables: zero it by hand" if d.stop is not None else "no stop_deg")
        for i, d in enumerate(drives.drives)
        if d.stop is None or not drives.alone(i)
    ]
    if lacking:
        raise Refused(lacking, wrong_input=True)
    with _prepared(master, drives):
        for number in range(MOST_PASSES):
            found = []
            for joint in order:
                turned = _seek(master, drives, drives.joints.index(joint), limits[joint])
                found.append(turned)
                yield joint, turned
            if number and max(abs(x - math.radians(OFF_STOP_DEG)) for x in found) < AGREEMENT_RAD:
                return
        raise DriveError("a joint finds its stop somewhere else each time: is something in the hand?")


def _seek(master: Master, drives: Drives, i: int, limits: tuple[float, float]) -> float:
    """Homes drive i on its joint's stop; how far the joint turned, rad."""
    drive = drives.drives[i]
    assert drive.stop is not None
    q = np.zeros(len(drives.drives))
    q[i] = drive.stop - drive.stop_side * math.radians(OFF_STOP_DEG)
    per_rad = drive.cable_ratio * drive.gear * drive.counts_per_turn / (2 * math.pi)
    turn = (limits[1] - limits[0] + _RANGE_SPARE_RAD) * per_rad
    turned = _home(
        master,
        drive,
        od.HOME_ON_STOP[drive.stop_side * drive.direction],
        home=int(drives.counts_from_joints(q)[i]),
        turn=turn,
        within_s=turn / (drive.homing_speed_rpm / 60 * drive.counts_per_turn) + _HERE_S,
    )
    return turned / per_rad


@contextmanager
def _prepared(master: Master, drives: Drives) -> Iterator[None]:
    """All drives there, configured and watching the master; off again in any case.

    Raises:
        Refused: a drive is missing, in fault, powered, or does not hold what it is given.
    """
    problems, answering = mismatches(master, drives)
    found, silent = conditions(master, answering)
    problems += silent + not_ready(found)
    if problems:
        raise Refused(problems, wrong_input=False, disabled=not any(c.state.powered for c in found))
    try:
        if refused := configure(master, drives.drives, drives.bus):
            raise Refused(refused, wrong_input=False, disabled=True)
        yield
    finally:
        problems = [f.problem for f in switch_off(master, drives.drives) if f.problem]
        if problems:
            raise DriveError("not off: " + "; ".join(problems) + "; cut the supply")


def _home(master: Master, drive: Drive, method: int, *, home: int, turn: float, within_s: float) -> float:
    """Homes one drive; how far its motor turned before it stood on its stop, counts."""
    node, kind = drive.node, drive.type
    offset = round(math.radians(OFF_STOP_DEG) * drive.cable_ratio * drive.gear * drive.counts_per_turn / (2 * math.pi))
    values = {
        od.MODE: od.MODE_HOMING,
        od.HOMING_METHOD: method,
        od.HOMING_SPEED: round(drive.homing_speed_rpm),
        od.HOMING_SPEED_ZERO: round(drive.homing_speed_rpm),
        od.HOMING_ACCELERATION: _HOMING_RPM_S,
        od.HOMING_CURRENT[kind]: drive.homing_current_ma,
        od.HOME_OFFSET: offset,
        od.HOME_POSITION[kind]: home,
    }
    try:
        for obj, value in values.items():
            master.write(node, obj, value)
        begin, far = master.read(node, od.POSITION_ACTUAL), 0
        for word in (*_LADDER, Control.ENABLE_RUN):
            master.write(node, od.CONTROLWORD, word)
        end = master.clock.now() + within_s
        while True:
            status = master.read(node, od.STATUSWORD)
            _check(master, drive, status)
            if status & BIT12 and status & HOMED:
                break
            position = master.read(node, od.POSITION_ACTUAL)
            if abs(position - home) > _AT_HOME_COUNTS:  # it may have been renamed since the status word
                far = max(far, abs(position - begin))
            if turn and far > turn:
                raise DriveError(f"{drive.joint} (node {node}): turned beyond its range, met no stop: cable off?")
            if master.clock.now() > end:
                raise DriveError(f"{drive.joint} (node {node}): homing does not end: {status_words(status, kind)}")
            time.sleep(_STEP_S)
        master.write(node, od.CONTROLWORD, Control.DISABLE_VOLTAGE)
    except SdoError as e:
        raise DriveError(f"{drive.joint}: {e}") from e
    return far


def _check(master: Master, drive: Drive, status: int) -> None:
    """Raises if anything is wrong on any drive."""
    state = decode_state(status, drive.type)
    said = [f"node {e.node}: EMCY {od.emcy_words(e.code)}" for e in master.emergencies if e.code]
    if said or state is not DriveState.OPERATION_ENABLED or status & FOLLOWING:
        words = [f"{drive.joint} (node {drive.node}): {status_words(status, drive.type)}", *said]
        raise DriveError("; ".join(words))
