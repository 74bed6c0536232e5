"""A full turn of pencils of three radii, palm four ways round: which work, with how many regrasps, and how they fare.

Start poses are the planner's own (``start: auto``). Prints a Markdown table.

    python benchmarks/spins.py --runs 1
"""

from __future__ import annotations

import argparse
import time

from drake_hand import api
from drake_hand.errors import NoPlanFound
from drake_hand.planning.task import Grasp, Options, Physics, Rotate, Step, Task
from drake_hand.verify.replay import simulate

PALMS = {
    "up": (-9.81, 0.0, 0.0),
    "sideways, thumb up": (0.0, -9.81, 0.0),
    "down": (9.81, 0.0, 0.0),
    "forward, fingers up": (0.0, 0.0, -9.81),
}
PENCILS = {4: "pencil", 8: "pencil_r8", 12: "pencil_r12"}


def spin(pencil: str, gravity: tuple[float, float, float], angle_deg: float, time_limit_s: float) -> Task:
    """The task: once around its own axis, from wherever the planner likes."""
    return Task(
        hand="kanguera",
        object=pencil,
        start="auto",
        motion=[
            Step(grasp=Grasp()),
            Step(rotate=Rotate(axis=(0.0, 0.0, 1.0), frame="object", angle_deg=angle_deg)),
        ],
        physics=Physics(gravity=gravity),
        options=Options(time_limit_s=time_limit_s),
    )


def main() -> None:
    """Plans, certifies and replays every case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1, help="replays of each plan; 0 leaves physics out")
    parser.add_argument("--angle-deg", type=float, default=360.0)
    parser.add_argument("--time-limit", type=float, default=60.0, help="of planning, s")
    options = parser.parse_args()
    print("| radius mm | palm | plan | start mm; deg | regrasps | duration s | replay mm / tilt deg / turn deg |")
    print("|---|---|---|---|---|---|---|")
    for radius, pencil in PENCILS.items():
        for palm, gravity in PALMS.items():
            started = time.monotonic()
            try:
                result = api.solve(spin(pencil, gravity, options.angle_deg, options.time_limit))
            except NoPlanFound as e:
                print(f"| {radius} | {palm} | none: {e.reason} | | | | |", flush=True)
                continue
            plan = result.plan
            verdict = "certified" if plan.certified else "not certified"
            fate = ""
            if plan.certified and options.runs:
                replay = simulate(plan, runs=options.runs)
                worst = max(replay.runs, key=lambda r: (r.dropped, abs(r.rotation_error_deg)))
                fate = (
                    "dropped"
                    if worst.dropped
                    else f"{worst.position_error_mm:.2f} / {worst.tilt_error_deg:.2f} / {worst.rotation_error_deg:.2f}"
                )
            start = plan.task.start
            where = f"{start.xyz_mm}; {start.rpy_deg}" if not isinstance(start, str) else start
            took = time.monotonic() - started
            print(
                f"| {radius} | {palm} | {verdict} in {took:.0f} s | {where} | {result.regrasps} "
                f"| {plan.duration:.0f} | {fate} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
