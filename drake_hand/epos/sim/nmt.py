"""NMT slave of a simulated drive: states, boot-up, heartbeat producer and consumer (CiA 301)."""

from __future__ import annotations

from collections.abc import Callable

from drake_hand.epos import objects as o
from drake_hand.epos.pdo import HEARTBEAT_BASE
from drake_hand.epos.sim.dictionary import Dictionary

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
START, STOP, ENTER_PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
HEARTBEAT_LOST = 0x8130


class Nmt:
    """Network state and heartbeats.

    Args:
        node: node id.
        dictionary: the drive's.
        send: puts a frame on the bus (COB-ID, data).
        fail: reports an error code to the drive.
    """

    def __init__(
        self,
        node: int,
        dictionary: Dictionary,
        send: Callable[[int, bytes], None],
        fail: Callable[[int], None],
    ) -> None:
        self._node, self._dictionary, self._send, self._fail = node, dictionary, send, fail
        self.state = BOOT_UP
        self._produced = float("-inf")
        self._heard: float | None = None
        dictionary.hook(o.CONSUMER_HEARTBEAT, write=self._forget)

    def boot(self, t: float) -> None:
        """Sends the boot-up frame and goes to pre-operational."""
        self._send(HEARTBEAT_BASE + self._node, bytes([BOOT_UP]))
        self.state, self._produced, self._heard = PRE_OPERATIONAL, t, None

    def _forget(self, _: int) -> None:
        self._heard = None

    def heard(self, node: int, t: float) -> None:
        """Takes somebody's heartbeat; supervision starts with the first of the node watched."""
        if self._dictionary[o.CONSUMER_HEARTBEAT] >> 16 & 0x7F == node:
            self._heard = t

    def housekeep(self, t: float) -> None:
        """Sends the heartbeat when due; notices the loss of the one watched."""
        period = self._dictionary[o.PRODUCER_HEARTBEAT] * 1e-3
        if period and t - self._produced >= period:
            # kept on its grid, unless far behind: no bursts
            self._produced = self._produced + period if t - self._produced < 2 * period else t
            self._send(HEARTBEAT_BASE + self._node, bytes([self.state]))
        limit = (self._dictionary[o.CONSUMER_HEARTBEAT] & 0xFFFF) * 1e-3
        if limit and self._heard is not None and t - self._heard > limit:
            self._heard = None
            self._fail(HEARTBEAT_LOST)
