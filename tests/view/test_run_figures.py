"""Figures of a run show what was recorded."""

import matplotlib.image
import numpy as np
import pytest

from drake_hand.epos.record import Fault, RunHeader, RunRecord
from drake_hand.view import run_figures


@pytest.fixture
def record() -> RunRecord:
    k, joints = 50, ["a", "b", "c", "d"]
    t = np.arange(k) * 0.01
    commanded = np.sin(t)[:, None] * np.arange(1, 5)
    fault = Fault(kind="emcy", text="joint b: following error", time_s=0.4, sync=40, joint="b")
    header = RunHeader(
        version="0", started="", plan_hash="", hand="h", joints=joints, nodes=[1, 2, 3, 4], types=["epos4"] * 4,
        sync_ms=10, bus="virtual", realtime=False, ok=False, faults=[fault], not_disabled=[],
    )  # fmt: skip
    return RunRecord(
        header=header,
        t=t,
        late_ms=np.zeros(k),
        step=np.arange(k),
        plan_time=np.arange(k) * 0.01,
        playing=np.arange(k) <= 40,
        commanded=commanded,
        measured=commanded - np.radians(0.5),
        status=np.zeros((k, 4), dtype=np.uint16),
        current_ma=np.zeros((k, 4), np.float32),
        queued=np.zeros((k, 4), dtype=np.int16),
    )


def test_files(record, tmp_path):
    files = run_figures.draw_run(record, tmp_path / "run")
    assert [f.stem for f in files] == ["tracking", "errors"]
    for f in files:
        assert matplotlib.image.imread(f).std() > 0.02


def test_error_and_fault_are_drawn(record):
    error = run_figures.draw_errors(record).axes[0]
    assert [tick.get_text() for tick in error.get_yticklabels()] == ["a", "b", "c", "d"]
    (shown,) = error.collections
    np.testing.assert_allclose(np.asarray(shown.get_array()), 0.5)
    assert "following error" in error.get_title(loc="left")
    assert any(np.allclose(line.get_xdata(), 0.4) for line in error.get_lines())
