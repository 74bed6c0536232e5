"""Reading the timelines that simulated drives write."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from drake_hand.epos.sim.timeline import Header, Row, TimelineEvent


def read_timeline(file: Path) -> tuple[Header, list[Row], list[TimelineEvent]]:
    """An unfinished last line is left out."""
    lines = file.read_bytes().split(b"\n")[:-1]
    header = msgspec.json.decode(lines[0], type=Header)
    rows = [msgspec.json.decode(x, type=Row) for x in lines[1:] if b'"status"' in x]
    events = [msgspec.json.decode(x, type=TimelineEvent) for x in lines[1:] if b'"status"' not in x]
    return header, rows, events


def rows_as_arrays(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times (k,), status words (k, n), positions (k, n) and demands (k, n) [counts] of k rows."""
    return (
        np.array([r.t for r in rows]),
        np.array([r.status for r in rows]),
        np.array([r.position for r in rows]),
        np.array([r.demand for r in rows]),
    )
