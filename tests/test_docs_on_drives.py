"""The commands that README and documentation show for the real hand, typed at a terminal, on simulated drives."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from drake_hand import api
from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.process import spawn_simulated_drives
from drake_hand.plans.plan import Plan
from tests.test_docs import shown

LIMIT_S = 400.0
"""For a command; the longest plays a plan of half a minute at a fifth of its speed."""
FILE = "my.drives.yaml"
ON_DRIVES = [c for c in shown() if FILE in c and not c.endswith("--simulate") and "--dry-run" not in c]
RECORDED = {"my.run.npz": "--log my.run.npz", "today.run.npz": "--log today.run.npz"}
"""Records that `plot` is shown with, and what makes them."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory) -> Path:
    """A folder with plans and a drives file."""
    folder = tmp_path_factory.mktemp("desk")
    for name, task in (("my", "carry"), ("spin", "spin")):
        api.solve(task).plan.save(folder / f"{name}.plan.json")
    return folder


def typed(command: str, folder: Path) -> tuple[int, str]:
    """Status and output of a command at a terminal; somebody presses Enter again and again, or Ctrl-C in the end."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(folder)
        run = "import sys; from drake_hand.cli import main; main()"
        os.execv(sys.executable, [sys.executable, "-c", run, *command.split()[1:]])
    said, until, interrupted = b"", time.monotonic() + LIMIT_S, False
    try:
        while time.monotonic() < until:
            if "mirror" in command and b"http" in said and not interrupted:
                time.sleep(1.0)
                os.kill(pid, signal.SIGINT)
                interrupted = True
            elif select.select([terminal], [], [], 0.5)[0]:
                said += os.read(terminal, 65536)
            else:
                os.write(terminal, b"\n")
        os.kill(pid, signal.SIGKILL)
    except OSError:  # it has ended
        pass
    _, status = os.waitpid(pid, 0)
    return os.waitstatus_to_exitcode(status), said.decode(errors="replace")


@pytest.mark.slow
@pytest.mark.clocked
@pytest.mark.parametrize("command", ON_DRIVES)
def test_a_command_shown_runs_on_drives(command, desk):
    plan = next((Plan.load(desk / word) for word in command.split() if word.endswith(".plan.json")), None)
    content = yaml.safe_load(Drives.load().file.read_text())
    del content["defaults"]["torque_constant_nm_a"]  # there is no object to press
    (desk / FILE).write_text(yaml.safe_dump(content))
    drives = Drives.load(str(desk / FILE))
    away = plan is None or "goto" in command or "--from-here" in command
    q = np.zeros(len(drives.joints)) if away else plan.at(np.zeros(1)).q[0, drives.columns(plan.joints)]
    with spawn_simulated_drives(drives, q=q, zeroed="drives zero" not in command) as spawned:
        content["bus"] |= {"interface": spawned.interface, "channel": spawned.channel}
        (desk / FILE).write_text(yaml.safe_dump(content))
        status, said = typed(command, desk)
    assert status == 0, said[-1500:]  # a mirror is ended by Ctrl-C
    for record, made in RECORDED.items():
        if made in command:
            words = [sys.executable, "-c", "from drake_hand.cli import main; main()", "plot", record, "-o", "figures"]
            assert subprocess.run(words, cwd=desk).returncode == 0


def test_all_that_is_shown_for_drives_is_run_here_or_in_the_morning():
    """The other commands of the page are those of the morning (`epos/test_morning.py`), or need no bus."""
    assert len(ON_DRIVES) > 12
    rest = [c for c in shown() if re.match("drake-hand (execute|drives|mirror)", c) and c not in ON_DRIVES]
    assert all(re.search("carry|--simulate|--dry-run|drives (zero|home|off|status)", c) for c in rest)
