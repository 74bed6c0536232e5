"""Many runs at once: Ctrl-C, and what is said meanwhile."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.feedback.test_correction import certified
from tests.verify.held import held_plan


def children(pid):
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(pids):
    """Those that run; one that has ended and was not yet asked for its status does not."""
    states = {p: Path(f"/proc/{p}/stat") for p in pids}
    return [p for p, stat in states.items() if stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at processes in /proc")
@pytest.mark.parametrize("signals", [1, 3])
def test_ctrl_c_ends_everything_and_tells_what_was_finished(tmp_path, signals):
    file = tmp_path / "held.plan.json"
    certified(held_plan(end=3.0)).save(file)
    command = "from drake_hand.cli import main; main()"
    arguments = ["simulate", str(file), "--runs", "500", "--json"]
    program = subprocess.Popen(
        [sys.executable, "-c", command, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    deadline = time.monotonic() + 120
    while len(workers := children(program.pid)) < 2 and time.monotonic() < deadline:  # workers, and who keeps count
        time.sleep(0.05)
    assert len(workers) >= 2
    time.sleep(5)
    began = time.monotonic()
    for _ in range(signals):
        os.killpg(program.pid, signal.SIGINT)  # as a terminal does it: to all of them
        time.sleep(0.02)
    out, err = program.communicate(timeout=60)
    took = time.monotonic() - began
    assert program.returncode == 130
    assert err.startswith("drake-hand: interrupted: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    answer = json.loads(out)
    assert answer["interrupted"].endswith("of 500 runs finished")
    time.sleep(0.2)
    assert not alive(workers)
    assert took < 1.0 or os.getloadavg()[0] > 2 * (os.cpu_count() or 1), f"took {took:.1f} s"
