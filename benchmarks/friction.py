"""How little friction a plan gets by with: the bundled spin, planned for 0.8, replayed with less.

Usage::

    python benchmarks/friction.py
    python benchmarks/friction.py --engine mujoco --feedback
"""

from __future__ import annotations

import argparse

from drake_hand import api
from drake_hand.feedback.sensor import PoseSensor
from drake_hand.physics.engine import Perturbation
from drake_hand.physics.replay import replay
from drake_hand.plans.task import Task

SHARES = (1.0, 0.75, 0.625, 0.5625, 0.5, 0.46875, 0.4375)
"""Of the friction the task states; plans rely on 0.55 of it."""


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", choices=("drake", "mujoco"), default="drake")
    parser.add_argument("--feedback", action="store_true", help="the object seen and corrected")
    options = parser.parse_args()
    feedback = PoseSensor() if options.feedback else None
    plan = api.solve(Task.load("spin")).plan
    print("| friction | at the end: mm / tilt deg / turn deg |\n|---|---|")
    for share in SHARES:
        run, _ = replay(plan, Perturbation(friction=share), engine=options.engine, feedback=feedback)
        errors = f"{run.position_error_mm:.2f} / {run.tilt_error_deg:.2f} / {run.rotation_error_deg:.2f}"
        ends = f"dropped after {run.end_s - run.free_s:.1f} s" if run.dropped else errors
        print(f"| {share * plan.task.physics.friction:.2f} | {ends} |", flush=True)


if __name__ == "__main__":
    main()
