"""Demonstrations to train on, out of a sweep: plans and replays, a row per time step, as Parquet."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drake_hand.files import make_folder
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory, quaternions
from drake_hand.sweep.store import Store

if TYPE_CHECKING:
    import pyarrow

ROW_S = 0.02
"""Between time steps."""


def write_dataset(store: Store, ids: list[str], folder: Path) -> list[Path]:
    """Writes a file of demonstrations per hand, the certified plans of these cases and their replays.

    All plans of a file are for one hand: the lists in its columns have one length, and its metadata names joints and
    fingers.

    Returns:
        The files.
    """
    import pyarrow.parquet as pq

    make_folder(folder)
    writers: dict[str, pq.ParquetWriter] = {}
    files: dict[str, Path] = {}
    try:
        for id_ in ids:
            row = store.rows.get(id_)
            if row is None or row.status != "certified":
                continue
            plan = Plan.load(store.plan_file(id_))
            for episode in _episodes(plan, id_, store.run_files(id_)):
                if plan.hand not in writers:
                    files[plan.hand] = folder / f"{plan.hand}.parquet"
                    writers[plan.hand] = pq.ParquetWriter(files[plan.hand].with_suffix(".part"), episode.schema)
                writers[plan.hand].write_table(episode)
        for hand, writer in writers.items():
            writer.close()
            os.replace(files[hand].with_suffix(".part"), files[hand])
    finally:
        for file in files.values():
            file.with_suffix(".part").unlink(missing_ok=True)
    return list(files.values())


def _episodes(plan: Plan, id_: str, runs: list[Path]) -> Iterator[pyarrow.Table]:
    trajectory = Trajectory(plan)
    t = np.arange(0.0, plan.duration + 1e-9, ROW_S)
    s = trajectory.at(t)
    yield _table(plan, trajectory, f"{id_}", "plan", t, s.q, s.X_WO, s.f_W)
    for i, file in enumerate(runs):
        with np.load(file) as run:
            rows = np.searchsorted(run["t"], np.arange(0.0, run["t"][-1] + 1e-9, ROW_S) - 1e-9)
            yield _table(
                plan, trajectory, f"{id_}.{i}", "replay", *(run[key][rows] for key in ("t", "q", "X_WO", "f_W"))
            )


def _table(
    plan: Plan,
    trajectory: Trajectory,
    episode: str,
    source: str,
    t: np.ndarray,
    q: np.ndarray,
    X_WO: np.ndarray,
    f_W: np.ndarray,
) -> pyarrow.Table:
    import pyarrow as pa

    told = trajectory.at(t)
    modes = [plan.parts[i].mode for i in told.part]

    def lists(values: np.ndarray) -> pa.Array:
        flat = np.ascontiguousarray(values.reshape(len(t), -1), dtype=np.float32)
        return pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), flat.shape[1])

    columns = {
        "episode": pa.array([episode] * len(t)),
        "source": pa.array([source] * len(t)),
        "object": pa.array([plan.task.object] * len(t)),
        "t": pa.array(t),
        "mode": pa.array(modes),
        "action": lists(told.q_command),
        "q": lists(q),
        "object_pose": lists(np.hstack([quaternions(X_WO[:, :3, :3]), X_WO[:, :3, 3]])),
        "f_W": lists(f_W),
    }
    names = {"joints": " ".join(plan.joints), "fingers": " ".join(plan.fingers), "step_s": str(ROW_S)}
    return pa.table(columns).replace_schema_metadata(names)
