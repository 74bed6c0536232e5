"""General tasks: any finger set, the object's pose free in its corridor, `start: auto`.

python benchmarks/general.py                     every task once
python benchmarks/general.py --only cube --seeds 5
python benchmarks/general.py --file soup=TomatoSoupCan/model.urdf --only soup
"""

from __future__ import annotations

import argparse
from typing import Literal

from drake_hand import api
from drake_hand.errors import NoPlanFound
from drake_hand.plans.task import Grasp, Options, Physics, Rotate, Step, Task, Translate

UP, DOWN, THUMB = (-9.81, 0.0, 0.0), (9.81, 0.0, 0.0), (0.0, -9.81, 0.0)
HANGING = (0.0, 0.0, -9.81)
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def task(
    object_: str,
    *steps: Step,
    hand: str = "kanguera",
    gravity: tuple[float, float, float] = UP,
    limit: float = 90.0,
    fingers: list[str] | None = None,
    hold: Literal["equilibrium", "kinematic"] = "equilibrium",
) -> Task:
    """A grasp, and what follows it."""
    return Task(
        hand=hand,
        object=object_,
        start="auto",
        motion=[Step(grasp=Grasp(fingers=fingers)), *steps],
        physics=Physics(gravity=gravity),
        options=Options(time_limit_s=limit, hold=hold),
    )


def turn(axis: tuple[float, float, float], angle: float, frame: Literal["wrist", "object"] = "wrist") -> Step:
    """About the object's own origin."""
    return Step(rotate=Rotate(axis=axis, angle_deg=angle, frame=frame))


TASKS = {
    "cube 50 mm, 360 deg about x": task("cube", turn(X, 360.0)),
    "cube 50 mm, 360 deg about y": task("cube", turn(Y, 360.0)),
    "cube 50 mm, 360 deg about x, thumb up": task("cube", turn(X, 360.0), gravity=THUMB),
    "cube 50 mm, 90 deg about x, palm down": task("cube", turn(X, 90.0), gravity=DOWN),
    "sphere, 360 deg about x": task("sphere", turn(X, 360.0)),
    "sphere, 360 deg about y": task("sphere", turn(Y, 360.0)),
    "sphere, 360 deg about z": task("sphere", turn(Z, 360.0)),
    "cylinder r 25, 360 deg about its axis": task("cylinder", turn(Z, 360.0, "object")),
    "pencil, 60 mm along z": task("pencil_r8", Step(translate=Translate(by_mm=(0.0, 0.0, 60.0)))),
    "pencil, 360 deg end over end, kinematic": task("pencil", turn(Y, 360.0), hold="kinematic"),
    "two grasps in a row": task(
        "pencil_r8",
        Step(grasp=Grasp(fingers=["thumb", "ring", "little"])),
        fingers=["thumb", "index", "middle"],
    ),
}


def of_files(files: dict[str, str]) -> dict[str, Task]:
    """The tasks for which the file is given of an object, and of a hand where it is not the Kanguera."""
    every = {
        "six-sided pencil, 360 deg about its axis": ("hex", "kanguera", UP, turn(Z, 360.0, "object"), 60.0),
        "soup can, 360 deg about x": ("soup", "kanguera", UP, turn(X, 360.0), 120.0),
        "banana, 90 deg about x": ("banana", "kanguera", UP, turn(X, 90.0), 120.0),
        "hammer, 90 deg about x": ("hammer", "kanguera", UP, turn(X, 90.0), 120.0),
        "Allegro, cube 60 mm, 360 deg about x": ("cube_60", "allegro", UP, turn(X, 360.0), 120.0),
        "TriFinger Pro, its cube, 90 deg about z": ("cube_65", "trifinger", HANGING, turn(Z, 90.0), 120.0),
    }
    hands = {"kanguera": "kanguera"} | files
    return {
        name: task(files[object_], step, hand=hands[hand], gravity=gravity, limit=limit)
        for name, (object_, hand, gravity, step, limit) in every.items()
        if object_ in files and hand in hands
    }


def main() -> None:
    """Plans and certifies each and prints a row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="tasks with this in their name")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument(
        "--file",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="hex (a six-sided pencil along z), soup, banana, hammer, cube_60, cube_65; hands: allegro, trifinger",
    )
    args = parser.parse_args()
    print("| task | seed | plan time s | regrasps | duration s | modes visited | result |")
    print("|---|---|---|---|---|---|---|")
    for name, asked in (TASKS | of_files(dict(x.split("=", 1) for x in args.file))).items():
        for seed in range(args.seeds) if args.only in name else ():
            try:
                result = api.solve(asked, seed=seed)
            except NoPlanFound as e:
                print(f"| {name} | {seed} | | | | | {e.status}: {e.reason} |", flush=True)
                continue
            modes = len(set(result.plan.modes))
            row = f"{result.plan_s:.1f} | {result.regrasps} | {result.plan.duration:.0f} | {modes}"
            print(f"| {name} | {seed} | {row} | certified |", flush=True)


if __name__ == "__main__":
    main()
