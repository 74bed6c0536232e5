"""Prints how long it takes to find grasps, beside the same where every set of contacts drawn is asked by a program.

python benchmarks/grasps.py                      of a cube and a cylinder
python benchmarks/grasps.py --file hammer=Hammer/model.urdf
"""

import argparse
from statistics import median
from time import perf_counter

import numpy as np
from general import TASKS, of_files

from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.planning import grasp
from drake_hand.planning.bearing import ROUNDING_N, shortfalls
from drake_hand.planning.object_path import pose
from drake_hand.planning.problem import Problem
from drake_hand.planning.start import variants
from drake_hand.planning.state import Node, by_finger
from drake_hand.plans.task import Task

BUNDLED = (
    "cube 50 mm, 360 deg about x",
    "cube 50 mm, 90 deg about x, palm down",
    "cylinder r 25, 360 deg about its axis",
)


def found(problem: Problem, task: Task) -> list[Node]:
    """Grasps from a start."""
    assert not isinstance(task.start, str), "auto is replaced before"
    moves = problem.moves(task, problem.path(pose(task.start), task.motion[1:]), frozenset(range(5)))
    try:
        return grasp.roots(moves, by_finger(problem.hand, problem.hand.q_home), every=False, most=False)
    except NoPlanFound:
        return []


def main() -> None:
    """One line for each task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=30)
    parser.add_argument("--file", action="append", default=[], metavar="NAME=PATH", help="as for general.py")
    args = parser.parse_args()
    tasks = {name: TASKS[name] for name in BUNDLED} | of_files(dict(x.split("=", 1) for x in args.file))
    for name, task in tasks.items():
        problem = Problem.of(task, Hand.load(task.hand), lambda _: None)
        starts = variants(task, problem.clearance, problem.world, np.random.default_rng(0))[: args.starts]
        out: list[np.ndarray] = []

        def counted(*asked, out: list[np.ndarray] = out) -> np.ndarray:
            out.append(shortfalls(*asked))
            return out[-1]

        ways = {"ours": counted, "all": lambda *asked: np.zeros(len(asked[-1]))}
        times: dict[str, list[float]] = {way: [] for way in ways}
        grasps: dict[str, list[list[Node]]] = {way: [] for way in ways}
        for start in starts:
            for way, of_sets in ways.items():
                grasp.shortfalls = of_sets
                began = perf_counter()
                grasps[way].append(found(problem, start))
                times[way].append(perf_counter() - began)
        left_out = np.mean(np.concatenate(out) > ROUNDING_N)
        same = all(
            len(a) == len(b) and all(np.array_equal(x.q, y.q) for x, y in zip(a, b, strict=True))
            for a, b in zip(*grasps.values(), strict=True)
        )
        ours, theirs = (1e3 * median(times[way]) for way in ways)
        print(
            f"{name}: {left_out:.0%} of the sets left out; {ours:.0f} ms a start, {theirs:.0f} ms with all asked, "
            f"ratio {theirs / ours:.1f}; from {sum(map(bool, grasps['ours']))} of {len(starts)} starts, "
            f"{'the same grasps' if same else 'OTHER GRASPS'}",
            flush=True,
        )


if __name__ == "__main__":
    main()
