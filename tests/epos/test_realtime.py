"""What keeps a bus in time."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drake_hand.epos import realtime

LATENCY = Path("/dev/cpu_dma_latency")


@pytest.mark.skipif(not os.access(LATENCY, os.W_OK), reason="needs the right to keep processors awake")
def test_processors_stay_awake() -> None:
    with realtime.awake_processors():
        assert int.from_bytes(LATENCY.read_bytes()[:4], "little") == 0


def test_no_right_to_keep_processors_awake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(realtime, "_LATENCY_FILE", tmp_path / "none" / "such")
    with realtime.awake_processors():
        pass
