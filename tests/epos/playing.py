"""What tests of whole runs share: drives with time to spare, a bus one may listen to, errors explained."""

import pytest
from fault_trials import drives_of

from drake_hand.epos.drives import Drives
from drake_hand.epos.sim.motor import LAG_S

COUNT_DEG = 180 / 1088


def drives_20ms(types: str) -> Drives:
    """A period that leaves a busy machine some room."""
    return drives_of(types, sync_ms=20)


def explained(answer: dict, types: list[str], period: float) -> None:
    """The tracking error is the servo's lag at the speed commanded, and what the encoder's steps add."""
    for joint, kind in zip(answer["tracking"].values(), types, strict=True):
        lag = LAG_S - period * 0.5 * (kind == "epos1")  # position mode is ahead by half a step on average
        assert joint["lag_ms"] == pytest.approx(lag * 1e3, abs=4.0)
        assert joint["unexplained_deg"] < 2.5 * COUNT_DEG + (1.5 if kind == "epos1" else 0)


class Listening:
    """A bus that notes what is sent."""

    def __init__(self, bus):
        self._bus, self.channel_info, self.sent = bus, bus.channel_info, []

    def send(self, message, timeout=None):
        self.sent.append(message.arbitration_id)
        self._bus.send(message, timeout)

    def recv(self, timeout=None):
        return self._bus.recv(timeout)
