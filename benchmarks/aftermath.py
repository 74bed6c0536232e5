"""What comes after a stop with an object in the hand, many times: off, held, back from here, lost, zero gone.

    python benchmarks/aftermath.py carry.plan.json --seeds 20

tests/epos/aftermath_rows.py says what happens in each row, and what has to hold.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "epos"))
from aftermath_rows import ROWS, violations


def main() -> int:
    """Prints a table; exit status 1 when anything did not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plan", type=Path, help="certified plan of the bundled hand that holds an object at its end")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--only", default="", help="rows whose name contains this")
    arguments = parser.parse_args()
    broken = 0
    print("| event | runs | as it has to be |\n|---|---|---|")
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:  # the clock waits for physics
        for row in (row for row in ROWS if arguments.only in row):
            found = list(pool.map(partial(violations, row, file=arguments.plan), range(arguments.seeds)))
            broken += sum(map(bool, found))
            print(f"| {row} | {len(found)} | {sum(not f for f in found)} |", flush=True)
            for seed, lines in enumerate(found):
                for line in lines:
                    print(f"{row}, seed {seed}: {line}", file=sys.stderr, flush=True)
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
