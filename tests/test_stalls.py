"""What makes a test that keeps time run again: a pause of this process or of a child; nothing else does."""

import os
import signal
import subprocess
import sys
import time

import pytest
from stalls import LIMIT_S, Watch

pytestmark = pytest.mark.clocked


def stop(pid: int, seconds: float) -> None:
    os.kill(pid, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(pid, signal.SIGCONT)


def test_a_child_that_stands_still_is_seen():
    watch = Watch()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        with watch:
            stop(child.pid, 0.1)
        child.communicate(b"\n")
    assert watch.longest_s > 0.09


def test_this_process_standing_still_is_seen():
    watch = Watch()
    code = "import os, signal, sys, time; p = int(sys.argv[1]); os.kill(p, signal.SIGSTOP); time.sleep(0.1)"
    with watch:
        subprocess.run([sys.executable, "-c", code + "; os.kill(p, signal.SIGCONT)", str(os.getpid())], check=True)
    assert watch.longest_s > 0.09


def test_a_wait_is_no_pause():
    for _ in range(20):  # unless the machine is busy each time
        watch = Watch()
        with watch:
            time.sleep(0.1)
        if watch.longest_s < LIMIT_S:
            return
    pytest.fail(f"stood still for {watch.longest_s:.3f} s, 20 times")
