"""A long motion on simulated drives in another process: does memory grow, does a queue run dry, is the SYNC kept?

python benchmarks/soak.py --minutes 30 [--types mix]
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "epos"))
from fault_trials import drives_of
from swing import swing

from drake_hand.epos.bus import BusSpec
from drake_hand.epos.drives import DRIVES_SUFFIX, Drives
from drake_hand.epos.executor import DriveRun, RunProgress, execute
from drake_hand.epos.record import NO_QUEUE
from drake_hand.epos.sim.process import spawn_simulated_drives

SWING_S = 2.0
SAMPLE_S = 5.0
MAY_GROW_MB = 2.0
WARM_S = 30.0
"""After which memory must not grow any more."""
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 2**20


def written(types: str, sync_ms: int, folder: Path) -> Drives:
    """The bundled drives with other types and period, in a file, which the child process reads too."""
    file = folder / f"soak{DRIVES_SUFFIX}"
    wanted = drives_of(types)
    raw = yaml.safe_load(Drives.load().file.read_text())
    for d in wanted.drives:
        raw["joints"][d.joint]["type"] = d.type
    raw["bus"]["sync_ms"] = sync_ms
    file.write_text(yaml.safe_dump(raw))
    return Drives.load(file)


def resident_mb(pid: int) -> float:
    """Resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE_MB


def soak(minutes: float, types: str, sync_ms: int) -> tuple[DriveRun, np.ndarray]:
    """One run of so many minutes.

    Returns:
        The run; and (k, 3) time since the motion began [s], resident memory of master and drives [MB].
    """
    samples: list[tuple[float, float, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        drives = written(types, sync_ms, Path(folder))
        plan = swing(drives.joints, 60 * minutes, swings=round(60 * minutes / SWING_S))
        with spawn_simulated_drives(drives) as spawned, BusSpec().open(spawned.interface, spawned.channel) as bus:

            def note(progress: RunProgress) -> None:
                if progress.time_s >= SAMPLE_S * len(samples) and progress.stage == "playing":
                    samples.append((progress.time_s, resident_mb(os.getpid()), resident_mb(spawned.process.pid)))
                    if len(samples) % 12 == 0:
                        print(f"{progress.time_s:7.0f} s, tracking {progress.tracking_deg:.2f} deg", file=sys.stderr)

            run = execute(plan, drives, bus, progress=note)
    return run, np.array(samples)


def main() -> int:
    """Prints the figures; exit status 1 when the run did not end well or memory grew."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--types", default="epos2")
    parser.add_argument("--sync-ms", type=int, default=10)
    arguments = parser.parse_args()
    begun = time.monotonic()
    run, memory = soak(arguments.minutes, arguments.types, arguments.sync_ms)
    took = time.monotonic() - begun
    for line in figures(run, memory):
        print(line)
    print(f"{took:.0f} s in all")
    warm = memory[memory[:, 0] >= min(WARM_S, memory[-1, 0] / 2)]
    return 0 if run.ok and (warm[-1, 1:] - warm[0, 1:] < MAY_GROW_MB).all() else 1


def figures(run: DriveRun, memory: np.ndarray) -> Iterator[str]:
    """What the run says of itself."""
    answer, record = run.answer(), run.record
    late, tracking = answer["sync_late_ms"], answer["tracking"].values()
    yield f"ok {answer['ok']}, disabled {answer['disabled']}, faults {[f['text'] for f in answer['faults']]}"
    skipped = int((np.diff(record.step[record.playing]) - 1).sum())
    yield f"{len(record.t)} SYNCs, {skipped} skipped; start skew {answer['start_skew_syncs']}"
    yield f"SYNC late ms: p50 {late['p50']:.3f}, p99 {late['p99']:.3f}, max {late['max']:.3f}"
    lags, rest = [t["lag_ms"] for t in tracking], max(t["unexplained_deg"] for t in tracking)
    explained = f"a lag of {min(lags):.1f} to {max(lags):.1f} ms explains all but {rest:.3f} deg"
    yield f"tracking error at most {answer['max_tracking_error_deg']:.3f} deg; {explained}"
    measured = record.measured[record.playing]
    yield f"answers missed: {int(np.isnan(measured).sum())} of {measured.size}"
    queued = record.queued[record.playing & (record.plan_time < record.plan_time[record.playing][-1] - 0.5)]
    if (queued != NO_QUEUE).any():
        yield f"PVT records queued: {queued[queued != NO_QUEUE].min()} to {queued.max()}, 20 ms each"
    for column, name in ((1, "master"), (2, "drives")):
        at = [np.interp(t, memory[:, 0], memory[:, column]) for t in (WARM_S, memory[-1, 0])]
        yield f"memory of the {name}: {at[0]:.1f} MB after {WARM_S:.0f} s, {at[1]:.1f} MB at the end"


if __name__ == "__main__":
    sys.exit(main())
