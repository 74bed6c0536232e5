"""A watch over the machine: how long it stood still while a test that keeps time ran."""

import contextlib
import os
import threading
import time
from pathlib import Path

LOOK_S = 2e-3
LIMIT_S = 10e-3
"""A SYNC period: a pause longer than this stops a run on the bus, as it should, and says nothing of the subject."""
_CHILDREN_S = 10e-3
_PROC = Path("/proc")


class Watch:
    """A thread for each processor that looks at the clock there, and one that looks at the children; a context manager.

    A host may take one processor away and leave the other; a child may be stopped, or wait for a processor, alone.
    """

    longest_s = 0.0

    def __enter__(self):
        self.longest_s, self._end = 0.0, threading.Event()
        jobs = [(self._look, cpu) for cpu in os.sched_getaffinity(0)] + [(self._look_at_children, None)]
        self._threads = [threading.Thread(target=job, args=(cpu,), daemon=True) for job, cpu in jobs]
        for thread in self._threads:
            thread.start()

    def __exit__(self, *exc):
        self._end.set()
        for thread in self._threads:
            thread.join()

    def _note(self, seconds):
        self.longest_s = max(self.longest_s, seconds)

    def _look(self, cpu):
        os.sched_setaffinity(0, {cpu})  # of this thread
        while not self._end.is_set():
            before = time.monotonic()
            time.sleep(LOOK_S)
            self._note(time.monotonic() - before - LOOK_S)

    def _look_at_children(self, _):
        waited, begun = {}, None
        while not self._end.wait(_CHILDREN_S):
            stopped = False
            for task in _tasks_of_children():
                with contextlib.suppress(OSError, ValueError, IndexError):  # it may have ended
                    stopped |= (task / "stat").read_text().rsplit(")", 1)[1].split()[0] == "T"
                    wait_s = int((task / "schedstat").read_text().split()[1]) * 1e-9
                    self._note(wait_s - waited.setdefault(task, wait_s))
                    waited[task] = wait_s
            begun = (begun or time.monotonic()) if stopped else None
            if begun:
                self._note(time.monotonic() - begun + _CHILDREN_S)

    def stood_still(self):
        """Whether something paused for longer than such a test can bear."""
        return self.longest_s > LIMIT_S


def _tasks_of_children():
    """Folders of /proc, one for each thread of each child of this process."""
    with contextlib.suppress(OSError):
        for thread in (_PROC / "self/task").iterdir():
            with contextlib.suppress(OSError):
                for pid in (thread / "children").read_text().split():
                    yield from (_PROC / pid / "task").iterdir()


WATCH = Watch()
