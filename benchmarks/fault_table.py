"""Every row of the fault table, many times, at random moments of a motion: do the invariants hold, how fast is it?

    python benchmarks/fault_table.py --seeds 20 [--markdown docs/faults.md]
    python benchmarks/fault_table.py --seeds 20 --held spin_fast.plan.json

With ``--held``, the motors move a hand in physics, and the fault happens while it holds the plan's object.
tests/epos/fault_trials.py says how a run goes and what is measured.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from functools import cache, partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "epos"))
from fault_trials import CASES, Held, Outcome, run_case

from drake_hand.plans.holds import hold_windows
from drake_hand.plans.plan import Plan

_BEFORE_END_S = 0.5
"""A fault noticed later than that after it happened would come after the plan."""


@cache
def _held(file: Path | None) -> Held | None:
    """The plan of a file, and when it holds its object."""
    if file is None:
        return None
    plan = Plan.load(file)
    return Held(plan=plan, window=(hold_windows(plan)[0][0], plan.duration - _BEFORE_END_S))


def run(file: Path | None, row: int, seed: int) -> tuple[Outcome, list[str]]:
    """One run of a row, and what stopped those before it that count for nothing: this machine, not the fault."""
    disturbances: list[str] = []
    while True:
        outcome = run_case(CASES[row], seed, held=_held(file))
        if not outcome.disturbed or outcome.violations:
            return outcome, disturbances
        disturbances.append(outcome.disturbed)


def table(seeds: int, say: Callable[[str], None], file: Path | None, only: str) -> tuple[str, int]:
    """Runs the rows that are asked for, with the object of a plan in the hand or without.

    Returns:
        The table as markdown, with a line that counts the runs repeated because this machine, not the fault, stopped
        them; and the number of runs in which an invariant did not hold.
    """
    lines = [
        "| fault | runs | frames: median, worst | stopped: median, worst | SYNCs, worst | target | ramp ms | why |",
        "|---|---|---|---|---|---|---|---|",
    ]
    broken = disturbed = 0
    with ExitStack() as stack:
        each: Callable = map
        if file is not None:  # the clock waits for physics: runs may go side by side
            context = multiprocessing.get_context("spawn")
            each = stack.enter_context(ProcessPoolExecutor(mp_context=context)).map
        for row, case in enumerate(CASES):
            if only not in case.name:
                continue
            outcomes = []
            for seed, (outcome, before) in enumerate(each(partial(run, file, row), range(seeds))):
                for what in before:
                    say(f"{case.name}, seed {seed}: run again, stopped before by: {what}")
                disturbed += len(before)
                outcomes.append(outcome)
                broken += bool(outcome.violations)
                for violation in outcome.violations:
                    say(f"{case.name}, seed {seed}: {violation}")
            frames, stopped = (np.array([getattr(o, k) for o in outcomes]) for k in ("frames", "stopped"))
            told = f"{np.nanmedian(frames):.2f}, {np.nanmax(frames):.2f}" if np.isfinite(frames).any() else "-"
            lines.append(
                f"| {case.name} | {seeds} | {told} | {np.median(stopped):.2f}, {stopped.max():.2f} |"
                f" {max(o.syncs for o in outcomes)} | {'-' if case.target is None else f'{case.target:g}'} |"
                f" {max(o.ramp_ms for o in outcomes):.0f} | {case.why} |"
            )
            say(lines[-1])
    lines.append(f"\n{seeds * (len(lines) - 2)} runs; not counted, since this machine delayed frames: {disturbed}")
    return "\n".join(lines), broken


def main() -> int:
    """Prints the table; exit status 1 when an invariant did not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--held", type=Path, help="certified plan of the bundled hand that holds an object at its end")
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--markdown", type=Path, help="replace the table, or that of --held, in this file")
    arguments = parser.parse_args()
    if arguments.only and arguments.markdown:
        parser.error("--markdown replaces the whole table: not with --only")
    text, broken = table(
        arguments.seeds, lambda line: print(line, file=sys.stderr, flush=True), arguments.held, arguments.only
    )
    print(text)
    print(f"\n{broken} runs broke an invariant")
    if arguments.markdown:
        mark = "<!-- held -->\n" if arguments.held else "<!-- table -->\n"
        before, mark, rest = arguments.markdown.read_text().partition(mark)
        after = rest.partition("<!-- end -->")
        arguments.markdown.write_text(f"{before}{mark}{text}\n<!-- end -->{after[2]}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
