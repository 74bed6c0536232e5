"""A certified path of the empty hand from where it is, planned and certified in a process with Drake."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import can
import msgspec
import numpy as np

from drake_hand.cli.drives_person import Terminal
from drake_hand.epos import discovery, executor, preflight
from drake_hand.epos.drives import Drives
from drake_hand.epos.master import Master
from drake_hand.epos.schedule import Excerpt
from drake_hand.errors import DrakeHandError, NoPlanFound
from drake_hand.files import convert
from drake_hand.model.hand import Hand
from drake_hand.plans.holds import may_hold
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Pose, Release, Step, Task
from drake_hand.plans.trajectory import Trajectory

SPEED_SHARE = 0.3
"""Of what the hand may do: this path has not been seen before."""
_CHILD = "from drake_hand.cli.drives_way import answer_wish; answer_wish()"
_NOWHERE = Pose(xyz_mm=(1e4, 0.0, 0.0))


class Wish(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """What a path is requested for."""

    hand: str
    start: dict[str, float]
    """Joints, rad; joints that do not report are assumed to be at their goal."""
    plan: str | None
    """What was played, or will be."""
    to_start: bool
    """To where the plan starts; else home."""
    object_there: bool
    """Whether the plan's object stands where the plan starts."""
    held_s: float | None
    """Plan time at which the fingers may hold the object, s."""


def way(
    hand: str,
    joints: Sequence[str],
    q: np.ndarray,
    *,
    plan: Path | None = None,
    to_start: bool = False,
    object_there: bool = False,
    held_s: float | None = None,
) -> Plan:
    """A certified path, as a plan without contacts.

    Args:
        hand: bundled name or path of the hand file.
        joints: names of those measured.
        q: (n,) where they are, rad.
        plan: what was played, or will be.
        to_start: to where the plan starts; else home.
        object_there: whether the plan's object stands where the plan starts, to be kept clear of.
        held_s: plan time at which the fingers may hold the object, of which they let go first, s.

    Raises:
        NoPlanFound: there is none, or it does not pass its certificate; says why.
        DrakeHandError: no Drake here.
    """
    start = dict(zip(joints, q.tolist(), strict=True))
    wish = Wish(
        hand=hand,
        start=start,
        plan=str(plan) if plan else None,
        to_start=to_start,
        object_there=object_there,
        held_s=held_s,
    )
    child = subprocess.run([sys.executable, "-c", _CHILD], input=msgspec.json.encode(wish), capture_output=True)
    try:
        answer = msgspec.json.decode(child.stdout)
    except msgspec.DecodeError as e:
        last = (child.stderr.decode().strip().splitlines() or ["no answer"])[-1]
        raise DrakeHandError(f"cannot plan a path (that needs Drake): {last}") from e
    if "reason" in answer:
        raise NoPlanFound(f"no path from here: {answer['reason']}")
    return convert(answer, Plan)


def come(
    hand: str,
    drives: Drives,
    bus: can.BusABC,
    *,
    plan: Path | None = None,
    to_start: bool = False,
    object_there: bool = False,
    open_: bool = False,
    power: bool,
    progress: Callable[[executor.RunProgress], None],
) -> executor.DriveRun:
    """Brings the hand home, or to where a plan starts.

    Args:
        hand: bundled name or path of the hand file.
        drives: of the hand.
        bus: open.
        plan: what was played, or will be.
        to_start: to where the plan starts; else home.
        object_there: whether the plan's object stands where the plan starts.
        open_: whether the fingers may open where they may hold the plan's object.
        power: whether to ask before power is given.
        progress: called with how far it is.

    Raises:
        Refused: the hand may hold an object, or a drive does not tell where it is.
        NoPlanFound: there is no path.
    """
    with Master(bus) as master:
        found, silent = discovery.conditions(master, drives.drives)
    if silent:
        raise preflight.Refused(silent, wrong_input=False)
    q = drives.joints_from_counts(np.array([c.position for c in found]))
    held = may_hold(Plan.load(plan), drives.joints, q) if plan else None
    if held is not None and not open_:
        line = f"the fingers are where they hold the object at {held:.2f} s of the plan (--open lets it fall)"
        raise preflight.Refused([line], wrong_input=False, disabled=not any(c.state.powered for c in found))
    there = way(hand, drives.joints, q, plan=plan, to_start=to_start, object_there=object_there, held_s=held)
    words = describe(there) + ("; the object falls" if held is not None else "; what the hand holds falls")
    person = Terminal(lambda _: words, power=power)
    return executor.execute(there, drives, bus, excerpt=Excerpt(speed=SPEED_SHARE), person=person, progress=progress)


def answer_wish() -> None:
    """Answers a wish on standard input with a plan on standard output."""
    wish = msgspec.json.decode(sys.stdin.buffer.read(), type=Wish)
    try:
        sys.stdout.buffer.write(msgspec.json.encode(_find(wish)))
    except DrakeHandError as e:
        sys.stdout.buffer.write(msgspec.json.encode({"reason": str(e)}))


def _find(wish: Wish) -> Plan:
    from drake_hand.model.object import Object
    from drake_hand.model.scene import Scene
    from drake_hand.motion.timing import time_path
    from drake_hand.planning.way_home import HeldObject, find_way
    from drake_hand.verify.way import certify_way

    hand, X_WO, held = Hand.load(wish.hand), None, None
    goal, task = hand.q_home, Task(hand=wish.hand, object="sphere", start=_NOWHERE, motion=[])
    if wish.plan is not None:
        plan = Plan.load(wish.plan)
        trajectory, task = Trajectory(plan), plan.task
        first = trajectory.at(0.0)
        goal = first.q_command[0] if wish.to_start else goal
        X_WO = first.X_WO[0] if wish.object_there else None
        if wish.held_s is not None:
            then = trajectory.at(wish.held_s)
            held = HeldObject(q=then.q[0], X_WO=then.X_WO[0], p_OP=then.p_OP[0])
    q = np.array([wish.start.get(j, goal[i]) for i, j in enumerate(hand.joints)])
    start = msgspec.structs.replace(
        task.start if isinstance(task.start, Pose) else _NOWHERE,
        joints_deg={j: float(x) for j, x in zip(hand.joints, np.degrees(q), strict=True)},
    )
    task = msgspec.structs.replace(task, start=start, motion=[Step(release=Release())])
    scene = Scene(hand, Object.load(task.object))
    found = time_path(find_way(scene, task, q, goal, X_WO, held))
    certificate = certify_way(found, scene, q, goal)
    if not certificate.certified:
        raise NoPlanFound("the path found does not pass its certificate: " + "; ".join(certificate.failures))
    return msgspec.structs.replace(found, certificate=certificate)


def describe(found: Plan) -> str:
    """One line about a path: largest turn, duration, order of the fingers, clearance."""
    q = np.array([row for part in found.parts for row in part.q])
    turn = np.degrees(np.ptp(q, axis=0))
    hand, worst = Hand.load(found.task.hand), int(turn.argmax())
    moving = np.abs(q - q[0]).max(axis=1) > np.radians(0.1)
    first = q[min(int(moving.argmax()) + 1, len(q) - 1)] - q[0]
    movers = [f.name for f in hand.fingers if np.abs(first[f.columns]).max() > np.radians(0.1)]
    assert found.certificate is not None
    gap = -(found.certificate.worst["penetration_mm"].value or 0.0)
    return (
        f"path: {found.joints[worst]} turns most, {turn[worst]:.0f} deg; first {', '.join(movers) or 'nobody'};"
        f" {found.duration / SPEED_SHARE:.1f} s; clear by {gap:.1f} mm or more"
    )
