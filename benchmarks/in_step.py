"""A plan through the whole chain, many times: CAN, encoders, motors, cables, contacts, with things not as planned.

    python benchmarks/in_step.py spin.plan.json --runs 10 [--logs DIR]

Friction, mass and stiffness are within 20 %, as in ``simulate --runs``. Success: not dropped, not stopped by the
monitor of contact forces or anything else, at the end within 1 mm, 3 deg of tilt and 8 deg of turn. The factor to real
time is that of this computer and what else it does; the one in brackets counts the seconds of processor that drives and
physics took. Last, how near the run came to a fault of its grip: the longest time one finger pressed too little and too
hard, and the least that all pressed together (``epos/grip.py``).
"""

from __future__ import annotations

import argparse
import resource
import sys
from pathlib import Path

from drake_hand.cli.drives_grip import feel
from drake_hand.cli.drives_physics import spawn_physical_hand
from drake_hand.epos.bus import BusSpec
from drake_hand.epos.drives import Drives
from drake_hand.epos.executor import execute
from drake_hand.epos.schedule import Schedule
from drake_hand.plans.plan import Plan

POSITION_MM, TILT_DEG, TURN_DEG = 1.0, 3.0, 8.0


def main() -> int:
    """Plays and prints; 1 unless every run succeeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan", type=Path)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--logs", type=Path, help="folder for a .run.npz and a .physics.npz of each run")
    options = parser.parse_args()
    plan, drives = Plan.load(options.plan), Drives.load()
    q, good = Schedule.build(plan, drives).q[0], 0
    print("run         position mm  tilt deg  turn deg   x slower than real time   grip: lost s  hard s  together")
    for seed in range(options.seed, options.seed + options.runs):
        name = options.logs / f"{seed}" if options.logs else None
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        record = name.with_suffix(".physics.npz") if name else None
        with spawn_physical_hand(drives, options.plan, q, seed=seed, record=record) as hand:
            with BusSpec().open(hand.spawned.interface, hand.spawned.channel) as bus:
                run = execute(plan, drives, bus, log=name and name.with_suffix(".run.npz"), feel=feel(plan, drives))
            found = hand.outcome()
        assert run.grip is not None
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = (used.ru_utime - before.ru_utime) / plan.duration
        fits = (
            run.ok
            and not found.dropped
            and found.position_error_mm <= POSITION_MM
            and found.tilt_error_deg <= TILT_DEG
            and found.rotation_error_deg <= TURN_DEG
        )
        good += fits
        print(
            f"{seed:3} {'ok' if fits else 'DROPPED' if found.dropped else 'no':8}"
            f" {found.position_error_mm:10.2f} {found.tilt_error_deg:9.2f} {found.rotation_error_deg:9.2f}"
            f"   {found.slowed:22.1f} ({cpu:.1f})   {run.grip.lost_s:12.2f} {run.grip.hard_s:7.2f}"
            f" {run.grip.together:9.2f}",
            *(f.text for f in run.record.header.faults),
            flush=True,
        )
    print(f"{good} of {options.runs}")
    return int(good < options.runs)


if __name__ == "__main__":
    sys.exit(main())
