"""The bundled tasks one after the other: the table in the README.

python benchmarks/tasks.py
"""

from __future__ import annotations

import argparse

import msgspec

from drake_hand import api
from drake_hand.errors import NoPlanFound
from drake_hand.plans.task import Task

TASKS = [
    ("spin_fast", None),
    ("spin", None),
    ("spin", -360.0),
    ("spin", 720.0),
    ("spin", 3600.0),
    ("paper", None),
    ("carry", None),
]
TASKS += [("carry_far", None), ("twirl", None), ("table_pencil", None), ("table_cube", None)]


def turned(task: Task, angle_deg: float | None) -> Task:
    """The same task with another angle."""
    if angle_deg is None:
        return task
    motion = [
        msgspec.structs.replace(s, rotate=msgspec.structs.replace(s.rotate, angle_deg=angle_deg)) if s.rotate else s
        for s in task.motion
    ]
    return msgspec.structs.replace(task, motion=motion)


def main() -> None:
    """Plans and certifies each and prints a row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    print(
        "| task | plan time s | regrasps | duration s | contact mm | slip mm | nearest other pair mm | force margin |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name, angle in TASKS:
        label = name if angle is None else f"{name}, {angle:g} deg"
        try:
            result = api.solve(turned(Task.load(name), angle))
        except NoPlanFound as e:
            print(f"| {label} | none: {e.reason} | | | | | | |", flush=True)
            continue
        assert result.plan.certificate is not None, "solve certifies"
        worst = {k: w.value for k, w in result.plan.certificate.worst.items()}
        force = worst["force_margin"]
        print(
            f"| {label} | {result.plan_s:.1f} | {result.regrasps} | {result.plan.duration:.0f} "
            f"| {worst['contact_mm']:.4f} | {worst['slip_mm']:.4f} | {-(worst['penetration_mm'] or 0.0):.1f} "
            f"| {'none planned' if force is None else f'{force:.2f}'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
