"""Feeds damaged input files and CAN frames to what reads them: every answer must be a value or a `DrakeHandError`.

python benchmarks/fuzz.py --inputs 10000 --seconds 600 [--kinds urdf,frames] [--seed 0] [--keep FOLDER]

Input i of a kind depends on the seed, the kind and i alone. A process of its own reads them, so that one in which Drake
aborts, or that takes more than 20 s of processor time, is told like any other. Exit status: 0 nothing found, 1 a crash,
or a kind none of which was read.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from zlib import crc32

import numpy as np
from fuzz_inputs import Reader

from drake_hand.errors import DrakeHandError

PATIENCE_S = 20.0
"""An input that takes more processor time ends its process: a crash."""
TELLING = 50
"""Of so many inputs of a kind some have to be read, or the kind tests nothing."""
SILENCE_S = 900.0
"""So does one that keeps its process waiting for longer, however busy the machine."""

KINDS = {
    "task": 1,
    "sweep_file": 4,
    "object": 1,
    "plan_file": 1,
    "drives_file": 1,
    "run": 1,
    "mesh": 20,
    "urdf": 4,
    "hand_file": 4,
    "mjcf": 1,
    "frames": 4,
    "scene": 50,
    "certificate": 50,
}
"""Methods of `Reader`, and in which rounds each has its turn: every one, every fourth; the slow ones seldom."""
Input = tuple[str, int]
"""Kind and number."""


@dataclass(frozen=True, kw_only=True)
class Told:
    """What the reading process says of an input: that it begins, or how it ended."""

    kind: str
    i: int
    outcome: str = ""
    """``read``, ``refused``, or the crash; empty at the beginning."""


def read(inputs: list[Input], seed: int, folder: Path, tell: Connection) -> None:
    """Reads inputs in a process of its own, and tells of each before and after."""
    warnings.simplefilter("ignore")
    reader = Reader(folder)
    for kind, i in inputs:
        tell.send(Told(kind=kind, i=i))
        signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)
        method: Callable[[np.random.Generator], None] = getattr(reader, kind)
        try:
            method(np.random.default_rng([seed, crc32(kind.encode()), i]))
            outcome = "read"
        except DrakeHandError:
            outcome = "refused"
        except Exception as e:
            ours = [f for f in traceback.extract_tb(e.__traceback__) if "drake_hand" in Path(f.filename).parts][-1:]
            where = "".join(f" at {Path(f.filename).name}:{f.lineno}" for f in ours)
            outcome = f"{type(e).__name__}{where}: {' '.join(str(e).split())[:100]}"
        tell.send(Told(kind=kind, i=i, outcome=outcome))


@dataclass
class Tally:
    """What came of the inputs so far.

    Args:
        keep: folder for inputs that crash.
    """

    keep: Path | None
    counts: dict[str, Counter[str]] = field(default_factory=lambda: {kind: Counter() for kind in KINDS})
    crashes: set[str] = field(default_factory=set)

    def add(self, told: Told, folder: Path) -> None:
        """Counts an input; a crash of a type and place not seen before is printed, its files are kept."""
        good = told.outcome in ("read", "refused")
        self.counts[told.kind][told.outcome if good else "crashed"] += 1
        place = f"{told.kind}: {told.outcome.partition(': ')[0]}"
        if good or place in self.crashes:
            return
        self.crashes.add(place)
        print(f"  {told.kind} {told.i}: {told.outcome}", flush=True)
        if self.keep:
            self.keep.mkdir(parents=True, exist_ok=True)
            for file in folder.glob("input.*"):
                shutil.copy(file, self.keep / f"{told.kind}-{told.i}-{file.name}")

    def table(self) -> str:
        """A row per kind."""
        columns = ("read", "refused", "crashed")
        lines = ["| kind | inputs | read | refused | crashed |", "|---|---|---|---|---|"]
        for kind, counts in self.counts.items():
            lines.append(f"| {kind} | {counts.total()} | {' | '.join(str(counts[c]) for c in columns)} |")
        total = sum(self.counts.values(), Counter[str]())
        return "\n".join([*lines, f"| all | {total.total()} | {' | '.join(str(total[c]) for c in columns)} |"])


def fuzz(inputs: list[Input], until: float, seed: int, tally: Tally) -> None:
    """Feeds inputs until there are no more, or time is up; begins a new process where one has ended or hangs."""
    spawn, start = multiprocessing.get_context("spawn"), 0
    while start < len(inputs) and time.monotonic() < until:
        with tempfile.TemporaryDirectory() as name:
            hear, tell = spawn.Pipe(duplex=False)
            child = spawn.Process(target=read, args=(inputs[start:], seed, Path(name), tell), daemon=True)
            child.start()
            tell.close()
            told = None
            while start < len(inputs) and time.monotonic() < until:
                try:
                    said = hear.recv() if hear.poll(SILENCE_S) else f"no answer in {SILENCE_S:g} s"
                except EOFError:
                    child.join()
                    said = f"process ended with {child.exitcode}"
                if isinstance(said, str):
                    if told is None:
                        raise SystemExit(f"{said}, before the first input")
                    tally.add(replace(told, outcome=said), Path(name))
                    start += 1
                    break
                told = said
                if told.outcome:
                    tally.add(told, Path(name))
                    start += 1
            child.kill()
            child.join()


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10_000, help="of all kinds together")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--kinds", default=",".join(KINDS), help="comma-separated: " + ", ".join(KINDS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for the inputs that crash")
    arguments = parser.parse_args()
    kinds = arguments.kinds.split(",")
    if unknown := set(kinds) - set(KINDS):
        parser.error(f"no such kind: {', '.join(sorted(unknown))}")
    turns = ((kind, i) for i in itertools.count() for kind in kinds if i % KINDS[kind] == 0)
    tally = Tally(arguments.keep)
    inputs = list(itertools.islice(turns, arguments.inputs))
    fuzz(inputs, time.monotonic() + arguments.seconds, arguments.seed, tally)
    print(tally.table())
    idle = [kind for kind, counts in tally.counts.items() if counts["refused"] > TELLING and not counts["read"]]
    if idle:
        print(f"every input refused, so that nothing behind the loaders was tried: {', '.join(idle)}")
    return 1 if tally.crashes or idle else 0


if __name__ == "__main__":
    sys.exit(main())
