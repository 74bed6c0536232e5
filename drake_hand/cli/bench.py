"""`drake-hand bench`: speed on this machine, compared in one run with what a user would otherwise write."""

from __future__ import annotations

import importlib.metadata
import platform
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import msgspec
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.cli.output import print_json, print_table
from drake_hand.errors import NoPlanFound
from drake_hand.plans.task import Grasp, Options, Pose, Rotate, Step, Task

Samples = dict[str, list[float]]
CUBE_MM = (62.0, -3.0, 120.0)
"""Where fingertips meet around a cube."""

UNITS = {
    "ik_per_s": "contacts solved per second, batched",
    "ik_vs_drake": "times the rate of one Drake IK program per contact",
    "ik_vs_pinocchio": "times the rate of a Pinocchio loop per contact",
    "equilibrium_per_s": "contact sets tested for balance per second",
    "stroke_us": "us for each pose of a cube's strokes: contacts rolled on, clearances, balance every third",
    "spin90_s": "s to plan a quarter turn of the pencil",
    "spin360_s": "s to plan a full turn",
    "plan_over_check": "planning time over checking time, full turn",
    "five_over_three": "planning time with five fingers over three, full turn, kinematic",
    "turns10_over_1": "planning time of ten turns over one",
    "proved10_over_1": "the same, certificate included",
    "trio90_s": "cpu s to turn a pencil by 90 deg with three fingers, kinematic; start and grasp are found",
    "hpp90_s": "cpu s that HPP takes for it, start and grasp given",
    "trio180_s": "the same for 180 deg",
    "hpp180_s": "HPP",
    "trio360_s": "the same for 360 deg",
    "hpp360_s": "HPP",
    "hpp_found": "share of these turns that HPP found within 60 s of cpu time",
    "certificate_per_s": "samples of a full turn certified per second",
    "certificate_vs_all_pairs": "times the rate of a certificate that asks Drake about every pair at every sample",
    "realtime_factor": "physics replay, times real time",
}


def bench(
    *,
    runs: Annotated[int, Parameter(validator=Number(gte=1))] = 3,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    hpp: Path | None = None,
    json: bool = False,
) -> None:
    """Measure speed on this machine: inverse kinematics, equilibrium, planning, physics.

    A measurement that is impossible here (a package is not installed, a plan is not found) is left out and named.

    ```console
    $ drake-hand bench
    $ drake-hand bench --runs 5 --json
    $ python -m venv hpp && hpp/bin/pip install hpp-python && drake-hand bench --hpp hpp/bin/python
    ```

    Args:
        runs: number of runs of every measurement; median, minimum and maximum are reported.
        seed: of random contacts and of the planner.
        hpp: interpreter of an environment with the package hpp-python, to be measured too.
        json: print one JSON object on stdout.
    """
    found: Samples = {}
    missing: dict[str, str] = {}
    measures: dict[str, Callable[[int, int], Iterable[tuple[str, list[float]]]]] = {
        "ik": _ik,
        "equilibrium": _equilibrium,
        "strokes": _strokes,
        "planning": _planning,
        "fingers": _fingers,
        "hpp": partial(_hpp, hpp),
        "certificate": _certificate,
        "physics": _physics,
    }
    for name, measure in measures.items():
        print(f"measuring {name} ...", file=sys.stderr)
        try:
            for key, values in measure(runs, seed):
                found.setdefault(key, []).extend(values)
        except NoPlanFound as e:
            missing[name] = str(e)
    figures = {key: summarise(found[key]) for key in UNITS if key in found}
    if json:
        print_json(figures | {"machine": _machine(), "versions": _versions(), "missing": missing})
        return
    print_table(
        "Benchmark",
        ["", "median>", "min>", "max>", "n>", ""],
        [(key, f["median"], f["min"], f["max"], f["n"], UNITS[key]) for key, f in figures.items()],
    )
    for what in (_machine(), _versions()):
        print(", ".join(f"{k} {v}" for k, v in what.items()))
    for name, reason in missing.items():
        print(f"{name} not measured: {reason}")


def summarise(values: list[float]) -> dict[str, float]:
    """Median, least, largest and number of some values."""
    return {"median": median(values), "min": min(values), "max": max(values), "n": len(values)}


def _ik(runs: int, seed: int) -> Iterator[tuple[str, list[float]]]:
    from drake_hand.cli.bench_ik import ik_samples
    from drake_hand.model.hand import Hand

    yield from ik_samples(Hand.load("kanguera"), repeats=runs, seed=seed).items()


def _equilibrium(runs: int, seed: int) -> Iterator[tuple[str, list[float]]]:
    import numpy as np

    from drake_hand.contact.contact_sets import ContactSets
    from drake_hand.contact.equilibrium import Capacity, margins

    N, k = 20_000, 5
    rng = np.random.default_rng(seed)

    def once() -> float:
        angle, along = rng.uniform(0, 2 * np.pi, (N, k)), rng.uniform(-0.03, 0.03, (N, k))
        n_W = np.stack([np.cos(angle), np.sin(angle), np.zeros((N, k))], axis=-1)
        p_WP = 0.008 * n_W
        p_WP[..., 2] = along
        sets = ContactSets.of_points(p_WP, n_W, np.zeros(3))
        start = perf_counter()
        margins(sets, Capacity(friction=0.8, f_max=1.0), np.array([-0.1, 0, 0]))
        return N / (perf_counter() - start)

    once()  # compiles
    yield "equilibrium_per_s", [once() for _ in range(runs)]


def _strokes(runs: int, seed: int) -> Iterator[tuple[str, list[float]]]:
    from drake_hand.model.hand import Hand
    from drake_hand.planning import grasp
    from drake_hand.planning.object_path import build, pose
    from drake_hand.planning.problem import Problem
    from drake_hand.planning.state import Stroke, by_finger
    from drake_hand.planning.strokes import draw_strokes

    start, turn = Pose(xyz_mm=CUBE_MM), Step(rotate=Rotate(axis=(1.0, 0.0, 0.0), angle_deg=360.0))
    task = Task(
        hand="kanguera", object="cube", start=start, motion=[Step(grasp=Grasp()), turn], options=Options(seed=seed)
    )
    problem = Problem.of(task, Hand.load(task.hand), lambda _: None)
    moves = problem.moves(task, build(pose(start), [turn]), frozenset(range(len(problem.hand.fingers))))
    states = grasp.roots(moves, by_finger(problem.hand, problem.hand.q_home), every=False, most=False)

    def once() -> float:
        began = perf_counter()
        drawn = [x.move for root in states for x in draw_strokes(moves, root)]
        took = perf_counter() - began
        return 1e6 * took / sum(len(move.q) - 1 for move in drawn if isinstance(move, Stroke))

    once()  # loads compiled code
    yield "stroke_us", [once() for _ in range(runs)]


def _planning(runs: int, seed: int) -> Iterator[tuple[str, list[float]]]:
    from drake_hand import api

    spin = Task.load("spin")

    def plan_s(task: Task) -> float:
        return api.solve(task, seed=seed).plan_s

    plan_s(spin_by(spin, 10.0))  # imports and compiled code are not planning time
    yield "spin90_s", [plan_s(spin_by(spin, 90.0)) for _ in range(runs)]
    full = [api.solve(spin_by(spin, 360.0), seed=seed) for _ in range(runs)]
    yield "spin360_s", [r.plan_s for r in full]
    yield "plan_over_check", [r.plan_s / r.stages_s["certificate"] for r in full]
    one = median(r.plan_s for r in full)
    ten = api.solve(spin_by(spin, 3600.0), seed=seed)
    yield "turns10_over_1", [ten.plan_s / one]
    proved = median(r.plan_s + r.stages_s["certificate"] for r in full)
    yield "proved10_over_1", [(ten.plan_s + ten.stages_s["certificate"]) / proved]


def _hpp(python: Path | None, runs: int, seed: int) -> Iterator[tuple[str, list[float]]]:
    from drake_hand.cli.bench_hpp import hpp_samples

    if python is None:
        raise NoPlanFound("--hpp names no interpreter of an environment with the package hpp-python")
    yield from hpp_samples(python, repeats=runs)


def _fingers(runs: int, seed: int) -> Iterator[tuple[str, list[float]]]:
    from drake_hand import api

    spin = Task.load("spin")
    kinematic = msgspec.structs.replace(spin.options, hold="kinematic")  # three fingers do not hold it everywhere

    def plan_s(*names: str) -> float:
        task = spin_by(spin, 360.0, fingers=list(names))
        return api.solve(msgspec.structs.replace(task, options=kinematic), seed=seed).plan_s

    three = ("thumb", "index", "middle")
    yield "five_over_three", [plan_s(*three, "ring", "little") / plan_s(*three) for _ in range(runs)]


def _certificate(runs: int, seed: int) -> Iterator[tuple[str, list[float]]]:
    from drake_hand import api
    from drake_hand.verify.all_pairs import certificate_samples

    plan = api.plan(spin_by(Task.load("spin"), 360.0), seed=seed)
    yield from certificate_samples(plan, repeats=runs).items()


def _physics(runs: int, seed: int) -> Iterator[tuple[str, list[float]]]:
    from drake_hand import api
    from drake_hand.physics.runs import simulate

    plan = api.plan(spin_by(Task.load("spin"), 90.0), seed=seed)
    yield "realtime_factor", [simulate(plan, perturb=False).realtime_factor for _ in range(runs)]


def spin_by(task: Task, angle_deg: float, *, fingers: list[str] | None = None) -> Task:
    """A spin task with another angle, and perhaps other fingers."""

    def change(step: Step) -> Step:
        if step.rotate:
            return Step(rotate=msgspec.structs.replace(step.rotate, angle_deg=angle_deg))
        if step.grasp and fingers:
            return Step(grasp=Grasp(fingers=fingers, kind=step.grasp.kind))
        return step

    return msgspec.structs.replace(task, motion=[change(s) for s in task.motion])


def _machine() -> dict[str, Any]:
    from drake_hand.physics.runs import cores

    return {"cpu": _cpu(), "cores": cores(), "system": f"{platform.system()} {platform.machine()}"}


def _cpu() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as f:
            return next(line.partition(":")[2].strip() for line in f if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "unknown"


def _versions() -> dict[str, str]:
    names = ("drake_hand", "drake", "numpy", "numba")
    return {"python": platform.python_version(), **{n: importlib.metadata.version(n) for n in names}}
