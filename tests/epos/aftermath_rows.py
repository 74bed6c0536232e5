"""What comes after a stop, with an object in the hand: killed and off, held, back from here, let go, lost, zero gone.

Real commands on simulated drives in a process of their own, whose motors move a hand in physics; the moment and the
joint are drawn by the seed.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_hand.cli import run
from drake_hand.cli.driven_hand import Mishap
from drake_hand.cli.drives_grip import feel
from drake_hand.cli.drives_physics import PhysicalHand, spawn_physical_hand
from drake_hand.epos.bus import BusSpec
from drake_hand.epos.drives import Drives
from drake_hand.epos.excerpts import around_grasp
from drake_hand.epos.executor import DriveRun, execute
from drake_hand.epos.grip import GONE_SHARE, LOST_S, LOST_SHARE
from drake_hand.epos.person import Person
from drake_hand.epos.schedule import Schedule
from drake_hand.epos.sim.faults import InjectedFault
from drake_hand.epos.state import DriveState
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory

HELD_S = 1.0
"""For which Ctrl-C is answered by holding, of the drives' clock."""
GONE_WITHIN_S, LOST_WITHIN_S = 0.2, 0.8
_BEFORE_END_S, _MOST_S = 1.5, 300.0


@dataclass(kw_only=True)
class Scene:
    """A plan on drives in physics, and the moment at which something happens."""

    file: Path
    plan: Plan
    drives: Drives
    hand: PhysicalHand
    at_s: float
    """Plan time."""
    rng: np.random.Generator
    record: Path
    """What happened in physics, once the drives have ended."""

    @property
    def options(self) -> list[str]:
        """Of a command on these drives."""
        spawned = self.hand.spawned
        return ["--drives", "kanguera", "--interface", spawned.interface, "--channel", spawned.channel]

    def when(self) -> None:
        """Waits for the moment."""
        known, end = self.plan.hash, time.monotonic() + _MOST_S
        while not (self.hand.clock.tells_of(known) and self.hand.clock.plan_time >= self.at_s):
            if time.monotonic() > end:
                raise TimeoutError(f"plan time {self.at_s:.2f} s never comes")
            time.sleep(2e-3)

    def play(self, act: Callable[[], None], person: Person | None = None, *, hold: bool = False) -> DriveRun:
        """Plays the plan; something is done at the moment."""

        def then() -> None:
            self.when()
            act()

        threading.Thread(target=then, daemon=True).start()
        interface, channel = self.hand.spawned.interface, self.hand.spawned.channel
        with BusSpec().open(interface, channel) as bus:
            judge = feel(self.plan, self.drives)
            return execute(self.plan, self.drives, bus, feel=judge, person=person or Person(), hold=hold)

    def type(self, *tokens: str) -> tuple[int, str]:
        """Runs a command on these drives; its status and what it prints."""
        out = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            status = run([*tokens, *self.options])
        return status, out.getvalue()

    def powered(self) -> list[str]:
        """Joints whose drive is not read back as off."""
        _, said = self.type("drives", "status", "--json")
        states = {d["joint"]: d["state"] for d in json.loads(said)["drives"]}
        off = {DriveState.SWITCH_ON_DISABLED.value, DriveState.FAULT.value}
        return [j for j in self.drives.joints if states.get(j) not in off]


class _Holds(Person):
    """Lets the hand hold for a while, then has it switched off."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now, self._until = now, np.inf

    def decides(self):
        if self._until == np.inf:
            self._until = self._now() + HELD_S
        return "off" if self._now() >= self._until else None


Answer = Iterator[str]


def killed_then_off(scene: Scene) -> Answer:
    """SIGKILL: the drives stop by themselves, powered, and `drives off` takes the power from all."""
    program = Path(sys.executable).with_name("drake-hand")
    command = [str(program), "execute", str(scene.file), "--trust", "--yes", *scene.options]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    scene.when()
    process.kill()
    process.wait()
    killed_s = scene.hand.clock.now()
    while scene.hand.clock.now() < killed_s + 0.5:
        time.sleep(0.01)
    if len(left := scene.powered()) != len(scene.drives.joints):
        yield f"{len(left)} drives are powered after the kill, not all"
    status, said = scene.type("drives", "off")
    if status or "15 of 15 drives are off" not in said:
        yield f"drives off: {status}, {said.strip()}"


def interrupted_and_held(scene: Scene) -> Answer:
    """Ctrl-C: the hand holds the object until it is told to let go."""
    person = _Holds(scene.hand.clock.now)
    found = scene.play(lambda: os.kill(os.getpid(), signal.SIGINT), person, hold=True)
    faults = [f.text for f in found.record.header.faults]
    if faults != ["interrupted, then off"]:
        yield f"stopped by {faults}"
    if left := scene.powered():
        yield f"still powered: {left}"
    if scene.hand.outcome().dropped:  # looked at as long as a drive was powered
        yield "the object was dropped while the hand held it"


def cable_out_then_from_here(scene: Scene) -> Answer:
    """The bus is cut and put back: the run refuses to go on, and comes back by a path once it may open the hand.

    A person hands the object over again.
    """
    inject = scene.hand.spawned.inject
    scene.play(lambda: inject(InjectedFault(kind="lost", joint="all")))
    inject(InjectedFault(kind="clear", joint="all"))
    scene.type("drives", "off")
    again = ["execute", str(scene.file), "--from-here", "--yes", "--trust", "--pause", "grasp", "--go-after", "0.3"]
    refused, said = scene.type(*again)
    if refused != 1 or "--open" not in said:
        yield f"with the object in the hand: {refused}, {said.strip()[-200:]}"
    status, said = scene.type(*again, "--open")
    if status:
        yield f"from here: {status}, {said.strip()[-200:]}"


def object_taken(scene: Scene) -> Answer:
    """Somebody takes the object away."""
    found = scene.play(lambda: scene.hand.spawned.inject(Mishap(kind="object_taken")))
    faults = [f.text for f in found.record.header.faults]
    if not faults or not faults[0].startswith("the object is gone"):
        yield f"stopped by {faults}"
    after = float(found.record.plan_time[found.record.playing][-1]) - scene.at_s
    if after > GONE_WITHIN_S:
        yield f"noticed after {after:.2f} s"


def contact_lost(scene: Scene) -> Answer:
    """A cable of a finger that presses comes off its drum: whoever touches no more, in physics, is named, nobody else.

    That may be its neighbour, which it pressed against, or nobody: the finger's other joints may go on pressing.
    """
    finger = str(scene.rng.choice(["little", "ring", "middle", "index"]))
    mishap = Mishap(kind="cable_off", joint=f"{finger}_flexion")
    found = scene.play(lambda: scene.hand.spawned.inject(mishap))
    if left := scene.powered():
        yield f"still powered: {left}"
    scene.hand.outcome()  # ends the drives, and writes what happened
    with np.load(scene.record) as record:
        t, force = record["plan_time"], np.linalg.norm(record["f_W"], axis=2)
    planned = np.linalg.norm(Trajectory(scene.plan).at(t).f_W, axis=2)
    share = np.where(planned > 0.1, force / np.maximum(planned, 0.1), 1.0)
    rows = t >= scene.at_s
    lost = {name: _longest(t[rows], share[rows, i] < LOST_SHARE) for i, name in enumerate(scene.plan.fingers)}
    faults = [f.text for f in found.record.header.faults]
    named = [name for name in lost if faults and faults[0].startswith(f"{name} lost contact")]
    together = np.minimum(force, planned)[-1].sum() / planned[-1].sum()
    gone = faults and faults[0].startswith("the object is gone") and together < 2 * GONE_SHARE
    if faults and not named and not gone:
        yield f"stopped by {faults}"
    if named and lost[named[0]] < LOST_S / 2:
        yield f"{named[0]} was named, but touches: {lost}"
    if max(lost.values()) > LOST_WITHIN_S:
        yield f"without contact, s: {lost}; stopped by {faults}"


def _longest(t: np.ndarray, yes: np.ndarray) -> float:
    """Longest stretch of times for which something is so, s."""
    longest, since = 0.0, None
    for now, so in zip(t, yes, strict=True):
        since = (now if since is None else since) if so else None
        longest = max(longest, 0.0 if since is None else float(now - since))
    return longest


def zero_lost(scene: Scene) -> Answer:
    """A drive boots in mid-run: it has lost its zero, and the next run is refused."""
    joint = str(scene.rng.choice(scene.drives.joints))
    found = scene.play(lambda: scene.hand.spawned.inject(InjectedFault(kind="nmt_reset", joint=joint)))
    if found.ok:
        yield "the run went on"
    status, said = scene.type("execute", str(scene.file), "--yes", "--trust")
    if status != 1 or f"{joint} (node" not in said or "its zero is not known" not in said:
        yield f"the next run: {status}, {said.strip()[-200:]}"


ROWS: dict[str, Callable[[Scene], Answer]] = {
    "killed, then drives off": killed_then_off,
    f"Ctrl-C, held for {HELD_S:g} s, then off": interrupted_and_held,
    "cable out, then from here": cable_out_then_from_here,
    "object taken away": object_taken,
    "a finger's contact lost": contact_lost,
    "zero lost": zero_lost,
}


def violations(row: str, seed: int, file: Path) -> list[str]:
    """Runs a row; what was not as it has to be, and what is still powered.

    Args:
        row: of `ROWS`.
        seed: of the moment and the joint.
        file: certified plan of the bundled hand, which holds an object for two seconds or more at its end.
    """
    rng = np.random.default_rng([seed, list(ROWS).index(row)])
    plan, drives, what = Plan.load(file), Drives.load(), ROWS[row]
    at_s = float(rng.uniform(hold_windows(plan)[0][0] + 0.2, plan.duration - _BEFORE_END_S))
    handed_s = around_grasp(plan, plan.duration)[0] if what is cable_out_then_from_here else None
    q = Schedule.build(plan, drives).q[0]
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "x.physics.npz"
        with spawn_physical_hand(drives, file, q, handed_s=handed_s, record=record) as hand:
            scene = Scene(file=file, plan=plan, drives=drives, hand=hand, at_s=at_s, rng=rng, record=record)
            found = list(what(scene))
            asked = what in (interrupted_and_held, contact_lost)  # and have ended the drives
            if not asked and (left := scene.powered()):
                found.append(f"still powered: {left}")
    return found
