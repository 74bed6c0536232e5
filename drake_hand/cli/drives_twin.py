"""The twin: a hand in physics that follows the measured joints of another, live, and says where the two differ.

It listens on the bus, in a process of its own, and never sends a frame. What the drives show as current and what the
twin's joints turn with has to be the same: they hold the same object.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import numpy as np

from drake_hand.cli.drives_person import say
from drake_hand.cli.output import tunnel
from drake_hand.epos.drives import Drives
from drake_hand.epos.mirror import HandPose, Mirror, poses_from_bus
from drake_hand.epos.mirror_view import open_view
from drake_hand.epos.sim.process import begin, child, read_commands, ready
from drake_hand.errors import DrakeHandError
from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory
from drake_hand.plans.whereabouts import Whereabouts

BOUND_NM = 0.045
"""Difference between a finger's drives and the twin's that is reported: half of what one joint can do."""
BOUND_S = 0.3
"""Time over which it is averaged."""
FAR_MM = 10.0
"""From the plan: so far the twin's object has left the hand, or nearly."""
_STEP_S = 0.01
"""Of physics: so it keeps up. With points for contacts it would, too, but they creep, and within seconds the fingers
press half as much as they should."""
_PERIOD_S = 0.02
_MOST_S = 0.1
"""Followed at once, at most: what a busy computer missed is not made up for."""


class TwinSetup(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """What a twin follows."""

    drives: str
    plan: str
    interface: str | None
    channel: str | None


@contextmanager
def spawn_twin(drives: Drives, plan: str, interface: str | None, channel: str | None) -> Iterator[None]:
    """A twin in a process of its own; its page's address, and what it has to say, go to stderr.

    Raises:
        DriveError: it did not get ready.
    """
    setup = TwinSetup(drives=str(drives.file), plan=plan, interface=interface, channel=channel)
    with child(["-m", "drake_hand.cli.drives_twin"], setup, "the twin") as process:
        out = process.stdout
        assert out is not None

        def tell() -> None:
            for line in out:
                say(line.decode().rstrip())

        reader = threading.Thread(target=tell, daemon=True)
        reader.start()
        yield
        assert process.stdin is not None
        process.stdin.close()
        reader.join()


def _child() -> None:
    """Follows until its input ends."""
    commands, setup = begin(TwinSetup)
    over = threading.Event()
    try:
        drives, plan = Drives.load(setup.drives), Plan.load(setup.plan)
        twin = Twin(plan, drives)
        threading.Thread(target=read_commands, args=(lambda _: None, commands, over), daemon=True).start()
        with (
            drives.bus.open(setup.interface, setup.channel) as bus,
            open_view(twin.hand.urdf.file, drives.joints) as view,
        ):
            from drake_hand.cli.mirror import mesh

            view.add_object(*mesh(plan))
            view.add_twin()
            ready()
            for line in (view.url, *tunnel(view.url)):
                os.write(1, f"twin: {line}\n".encode())
            for pose in poses_from_bus(bus, Mirror(drives), _PERIOD_S):
                if over.is_set():
                    break
                for line in twin.follow(pose):
                    os.write(1, f"twin: {line}\n".encode())
                view.show(pose, twin.X_WO, twin.words, twin.q)
    except (DrakeHandError, OSError, RuntimeError) as e:
        print(e, file=sys.stderr)
        sys.exit(1)


class Twin:
    """A hand in physics that follows the motors of another.

    Args:
        plan: what is played.
        drives: of the other hand.
    """

    def __init__(self, plan: Plan, drives: Drives) -> None:
        from drake_hand.model.hand import Hand
        from drake_hand.model.object import Object
        from drake_hand.physics.replay import commands
        from drake_hand.physics.simulation import DrakeSimulation

        self.hand = hand = Hand.load(plan.task.hand)
        self._trajectory = Trajectory(plan)
        self.physics = DrakeSimulation(
            hand,
            Object.load(plan.task.object).with_mass(plan.object_mass_kg),
            commands(self._trajectory),
            self._trajectory.at(0.0).X_WO[0],
            gravity=np.array(plan.task.physics.gravity),
            friction=plan.task.physics.friction,
            step=_STEP_S,
            table=plan.task.table,
        )
        self._on_table = plan.task.support is not None
        if self._on_table:
            self.physics.let_go()
        self._drives, self._where = drives, Whereabouts(plan, drives.joints)
        self._columns, self._windows = drives.columns(hand.joints), hold_windows(plan)
        self._told: tuple[float, np.ndarray] | None = None
        self._fingers = {f.name: [i for i, j in enumerate(drives.joints) if j in f.joints] for f in hand.fingers}
        self._held, self._shown, self._turns = False, *np.zeros((2, len(drives.joints)))
        self._said: set[str] = set()

    @property
    def q(self) -> np.ndarray:
        """(n,) its joints, in the order of the drives, rad."""
        return self.physics.q[self._columns]

    @property
    def X_WO(self) -> np.ndarray:
        """(4, 4) its object."""
        return self.physics.X_WO

    @property
    def words(self) -> str:
        """Where it is, and what is different."""
        if self._told is None:
            return "listening: not all drives are heard yet"
        return f"{self._where.words}; twin: {', '.join(sorted(self._said)) or 'the same'}"

    def follow(self, pose: HandPose) -> Iterator[str]:
        """Moves on to where the other hand is; what is different from now on."""
        if not np.isfinite(pose.measured).all():
            return
        self._where.look(pose.commanded)
        before, was = self._told or (pose.t, pose.measured)
        dt, self._told = min(pose.t - before, _MOST_S), (pose.t, pose.measured)
        if dt <= 0:
            return
        q, v = self.physics.q, np.zeros(self.hand.nq)
        q[self._columns], v[self._columns] = was, (pose.measured - was) / dt
        self.physics.command(q, v)
        self.physics.advance(self.physics.time + dt)
        self._hold()
        yield from self._compare(pose, dt)

    def _hold(self) -> None:
        """A fixture has the object until the fingers hold it, unless it lies on a table."""
        t = self._where.time_s
        held = t is not None and any(a <= t <= b for a, b in self._windows)
        if held and not self._held and not self._on_table:
            self.physics.let_go()
        elif self._held and not held and not self._on_table:
            self.physics.take_back()
        self._held = held

    def _compare(self, pose: HandPose, dt: float) -> Iterator[str]:
        assert pose.current_ma is not None
        shown = self._drives.torque_per_ma @ pose.current_ma
        c, physics = self._columns, self.physics
        turns = self.hand.stiffness[c] * (pose.measured - physics.q[c]) - self.hand.damping[c] * physics.v[c]
        share, found = min(dt / BOUND_S, 1.0), {}
        self._shown += (shown - self._shown) * share
        self._turns += (turns - self._turns) * share
        for name, own in self._fingers.items():
            drives, twin = self._shown[own], self._turns[own]
            if self._held and np.linalg.norm(drives - twin) > BOUND_NM:
                sizes = (f"{1e3 * np.linalg.norm(x):.0f} mNm" for x in (drives, twin))
                found[name] = "{}: the drives turn with {}, the twin with {}".format(name, *sizes)
        t = self._where.time_s
        if (self._held or self._on_table) and t is not None:
            away = np.linalg.norm(self.X_WO[:3, 3] - self._trajectory.at(t).X_WO[0, :3, 3]) * 1e3
            if away > FAR_MM:
                found["object"] = f"its object is {away:.0f} mm off the plan"
        for what in found.keys() - self._said:
            yield f"{found[what]} ({self._where.words})"
        self._said = set(found)


if __name__ == "__main__":
    _child()
