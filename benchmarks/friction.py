"""How little friction a plan gets by with: the bundled spin, planned for 0.8 or less, replayed with less.

Usage::

    python benchmarks/friction.py
    python benchmarks/friction.py --engine mujoco --feedback
    python benchmarks/friction.py --stated 0.6     # forces planned anew, for slippery fingers
"""

from __future__ import annotations

import argparse

import msgspec

from drake_hand import api
from drake_hand.feedback.sensor import PoseSensor
from drake_hand.physics.engine import Perturbation
from drake_hand.physics.replay import replay
from drake_hand.plans.task import Task

FRICTIONS = (0.8, 0.6, 0.5, 0.45, 0.4, 0.375, 0.35, 0.3, 0.25)
"""Plans rely on 0.55 of what the task states; the table ends where nothing holds any more."""


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", choices=("drake", "mujoco"), default="drake")
    parser.add_argument("--feedback", action="store_true", help="the object seen and corrected")
    parser.add_argument("--stated", type=float, default=0.8, help="friction the task states")
    options = parser.parse_args()
    feedback = PoseSensor() if options.feedback else None
    spin = Task.load("spin")
    stated = msgspec.structs.replace(spin.physics, friction=options.stated)
    found = api.solve(msgspec.structs.replace(spin, physics=stated))
    assert found.plan.certificate is not None
    margin = found.plan.certificate.worst["force_margin"].value
    print(f"planned for {options.stated:g}: {found.regrasps} regrasps, force margin {margin:.2f}\n")
    print("| friction | at the end: mm / tilt deg / turn deg |\n|---|---|")
    for friction in FRICTIONS:
        change = Perturbation(friction=friction / options.stated)
        run, _ = replay(found.plan, change, engine=options.engine, feedback=feedback)
        errors = f"{run.position_error_mm:.2f} / {run.tilt_error_deg:.2f} / {run.rotation_error_deg:.2f}"
        ends = f"dropped after {run.end_s - run.free_s:.1f} s" if run.dropped else errors
        print(f"| {friction:.3g} | {ends} |", flush=True)
        if run.dropped:
            break


if __name__ == "__main__":
    main()
