"""How planning grows with what is asked: angle, fingers, contact grid, faces of the object; time and memory.

    python benchmarks/scaling.py
    python benchmarks/scaling.py --runs 5 --only faces

Every row is a process of its own, so that memory is its own; its first plan, of imports and compiled code, is not
counted. Ratios are to the first row of the same kind.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import msgspec
import numpy as np
import trimesh

from drake_hand import api
from drake_hand.cli.bench import spin_by
from drake_hand.planning import reach, world
from drake_hand.plans.task import Grasp, Options, Physics, Step, Task, Translate

UP = (-9.81, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measurement."""

    kind: str
    label: str
    task: Task
    grid: float = 1.0
    """Points of the contact grid, over the usual number."""


def rows(folder: Path) -> list[Row]:
    """All measurements."""
    spin = Task.load("spin")
    kinematic = msgspec.structs.replace(spin, options=msgspec.structs.replace(spin.options, hold="kinematic"))
    named = ["thumb", "index", "middle", "ring", "little"]
    out = [Row(kind="angle", label=f"{a:g} deg", task=spin_by(spin, a)) for a in (360.0, 720.0, 1440.0, 3600.0)]
    out += [Row(kind="fingers", label=str(n), task=spin_by(kinematic, 360.0, fingers=named[:n])) for n in (3, 4, 5)]
    moved = Step(translate=Translate(by_mm=(0.0, 0.0, 10.0)))
    out += [
        Row(kind="grid", label=f"{n} x {name}", grid=n, task=task)
        for name, task in (("spin", spin_by(spin, 360.0)), ("cube by 10 mm", held("cube", moved)))
        for n in (1, 2, 4)
    ]
    for n in (1_000, 10_000, 100_000):
        out.append(Row(kind="faces", label=f"{n:,}", task=held(str(barrel(folder / f"{n}.obj", n)), moved)))
    return out


def held(object_: str, step: Step) -> Task:
    """A grasp from wherever the planner likes, and one step."""
    return Task(
        hand="kanguera",
        object=object_,
        start="auto",
        motion=[Step(grasp=Grasp()), step],
        physics=Physics(gravity=UP, object_mass_kg=0.05),
        options=Options(time_limit_s=60.0),
    )


def barrel(file: Path, faces: int) -> Path:
    """A barrel 50 mm thick and 100 mm long, of so many faces."""
    around = round(np.sqrt(faces / 2))
    z = np.linspace(-0.05, 0.05, around)
    profile = np.column_stack([0.025 * np.sqrt(1 - (z / 0.1) ** 2), z])
    ends = np.array([[0.0, -0.05]]), np.array([[0.0, 0.05]])
    trimesh.creation.revolve(np.concatenate([ends[0], profile, ends[1]]), sections=around).export(file)
    return file


def measure(row: Row, runs: int) -> tuple[list[float], list[float], float]:
    """Seconds of planning and of loading the models, certificates apart, and the most memory in MB."""
    wide = float(np.sqrt(row.grid))
    world.POINT_SPACING_M, world.MOST_POINTS = world.POINT_SPACING_M / wide, round(world.MOST_POINTS * row.grid)
    reach.SPAN_SPACING_M, reach.MOST_SPANS = reach.SPAN_SPACING_M / wide, round(reach.MOST_SPANS * row.grid)
    api.solve(spin_by(Task.load("spin"), 10.0))
    whole, models = [], []
    for _ in range(runs):
        began = time.perf_counter()
        found = api.solve(row.task)
        whole.append(time.perf_counter() - began - found.stages_s["certificate"])
        models.append(found.stages_s["model"])
    return whole, models, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", default="", help="rows of this kind")
    words = parser.parse_args()
    print("| what | | plan s | ratio | of it models s | memory MB |")
    print("|---|---|---|---|---|---|")
    first: dict[str, float] = {}
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool,
    ):
        for row in rows(Path(folder)):
            if words.only not in row.kind:
                continue
            whole, models, memory = pool.submit(measure, row, words.runs).result()
            kind = f"{row.kind} {row.label.partition(' x ')[2]}"
            ratio = median(whole) / first.setdefault(kind, median(whole))
            figures = f"{median(whole):.2f} | {ratio:.2f} | {median(models):.2f} | {memory:.0f}"
            print(f"| {row.kind} | {row.label} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
