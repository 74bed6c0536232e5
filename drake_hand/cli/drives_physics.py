"""The simulated hand with the object in it: drives and physics in a process of their own, in step with the master."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np

from drake_hand.cli.driven_hand import DrivenHand, Mishap, MishapKind, Outcome
from drake_hand.epos.bus import IN_STEP
from drake_hand.epos.clock import SharedClock
from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.in_step import serve_in_step
from drake_hand.epos.sim.process import SpawnedDrives, begin, child, free_channel, inject, read_commands, ready
from drake_hand.errors import DrakeHandError, DriveError
from drake_hand.files import convert
from drake_hand.plans.plan import Plan


class PhysicsSetup(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """What a child simulates."""

    drives: str
    plan: str
    channel: str
    clock: str
    q: list[float]
    zeroed: bool
    handed_s: float | None
    """Plan time at which a person brings the object; it is there from the start if not given."""
    seed: int | None
    """Of what is not as planned: friction, mass, stiffness; None for nothing."""
    record: str | None
    sensor: int | None
    """UDP port to which a simulated sensor of the object's pose sends what it sees."""


@dataclass(frozen=True, kw_only=True)
class PhysicalHand:
    """Drives in physics, ready."""

    spawned: SpawnedDrives
    clock: SharedClock

    def outcome(self) -> Outcome:
        """Ends the drives; what became of the object.

        Raises:
            DriveError: nothing was played, or the simulation broke down.
        """
        process = self.spawned.process
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdin.close()
        try:
            return msgspec.json.decode(process.stdout.readline(), type=Outcome)
        except msgspec.DecodeError as e:
            said = process.stderr.read().decode().strip()
            raise DriveError(f"physics has nothing to report: {said or 'nothing was played'}") from e


@contextmanager
def spawn_physical_hand(
    drives: Drives,
    plan: Path,
    q: np.ndarray,
    *,
    zeroed: bool = True,
    handed_s: float | None = None,
    seed: int | None = None,
    record: Path | None = None,
    sensor: int | None = None,
) -> Iterator[PhysicalHand]:
    """Simulated drives whose motors move the hand of a plan in physics, its object where the plan starts.

    Args:
        drives: read from a file, which the child reads too.
        plan: file.
        q: (n,) where the joints stand, rad.
        zeroed: whether the drives' zeros are known.
        handed_s: plan time at which a person brings the object, in each run again.
        seed: of what is not as planned; everything is as planned if not given.
        sensor: UDP port on this computer to which a sensor of the object's pose sends what it sees.
        record: file for what happened (npz): plan time, object pose, joints, contact forces.

    Raises:
        DriveError: the child did not get ready.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "clock"
        channel = free_channel()
        clock = SharedClock.create(file, channel)
        setup = PhysicsSetup(
            drives=str(drives.file),
            plan=str(plan),
            channel=channel,
            clock=str(file),
            q=np.asarray(q, float).tolist(),
            zeroed=zeroed,
            handed_s=handed_s,
            seed=seed,
            record=str(record) if record else None,
            sensor=sensor,
        )
        with child(["-m", "drake_hand.cli.drives_physics"], setup, "physics") as process:
            yield PhysicalHand(
                spawned=SpawnedDrives(interface=IN_STEP, channel=str(file), process=process), clock=clock
            )


def _child() -> None:
    """Simulates until its input ends, then says what became of the object."""
    commands, setup = begin(PhysicsSetup)
    stop = threading.Event()
    try:
        drives = Drives.load(setup.drives)
        clock = SharedClock(Path(setup.clock))
        world = DrivenHand(
            drives,
            Plan.load(setup.plan),
            clock,
            np.array(setup.q),
            handed_s=setup.handed_s,
            seed=setup.seed,
            sensor=setup.sensor,
        )
        with drives.bus.open("udp_multicast", setup.channel) as bus:
            simulated = SimulatedDrives(bus, drives, q=np.array(setup.q), zeroed=setup.zeroed)
            simulated.boot(0.0)

            def take(command: dict) -> None:
                if command.get("kind") in get_args(MishapKind):
                    world.suffer(convert(command, Mishap))
                else:
                    inject(simulated, command)

            world.enabled = lambda: any(s.powered for s in simulated.states.values())
            threading.Thread(target=read_commands, args=(take, commands, stop), daemon=True).start()
            ready()
            serve_in_step(simulated, bus, clock, world, stop)
            simulated.stop()
    except (DrakeHandError, OSError, RuntimeError) as e:
        print(e, file=sys.stderr)
        sys.exit(1)
    if setup.record and world.played:
        world.save(Path(setup.record))
    if world.played:
        os.write(1, msgspec.json.encode(world.outcome()) + b"\n")


if __name__ == "__main__":
    _child()
