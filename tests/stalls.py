"""A watch over the machine: how long it stood still while a test that keeps time ran."""

import threading
import time

LOOK_S = 2e-3
LIMIT_S = 10e-3
"""A SYNC period: a pause longer than this stops a run on the bus, as it should, and says nothing of the subject."""


class Watch:
    """A thread that looks at the clock; a context manager."""

    longest_s = 0.0

    def __enter__(self):
        self.longest_s, self._end = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __exit__(self, *exc):
        self._end.set()
        self._thread.join()

    def _run(self):
        while not self._end.is_set():
            before = time.monotonic()
            time.sleep(LOOK_S)
            self.longest_s = max(self.longest_s, time.monotonic() - before - LOOK_S)

    def stood_still(self):
        """Whether the machine paused for longer than such a test can bear."""
        return self.longest_s > LIMIT_S


WATCH = Watch()
