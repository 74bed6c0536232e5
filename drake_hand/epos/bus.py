"""`BusSpec`: the CAN bus of a drives file, its clocks, and how python-can opens it."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path
from typing import Annotated, Any

import can
import msgspec
from can.interfaces.udp_multicast import UdpMulticastBus
from msgspec import Meta

from drake_hand.epos.clock import SharedClock
from drake_hand.errors import InputError

UDP_GROUP, UDP_PORT = "239.74.163.2", 43113
"""Where python-can's udp_multicast meets by default."""
IN_STEP = "in_step"
_SAME_CLOCK_S = 5.0
_UDP_BUFFER = 4 << 20
_CHANNELS = {"udp_multicast": UDP_GROUP, "virtual": "drake-hand"}

_Milliseconds = Annotated[int, Meta(ge=1, le=65535)]


class BusSpec(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The CAN bus and its clocks."""

    interface: str = "socketcan"
    """Any python-can interface: socketcan, slcan, pcan, virtual, udp_multicast, ..."""
    channel: str = "can0"
    """Of that interface."""
    bitrate: Annotated[int, Meta(gt=0)] = 1_000_000
    """Bit/s."""
    sync_ms: Annotated[int, Meta(ge=1, le=100)] = 10
    """Time between SYNCs, each with a command for every drive."""
    heartbeat_ms: _Milliseconds = 100
    """Producer time, of the master and of each drive."""
    heartbeat_consumer_ms: _Milliseconds = 250
    """A heartbeat not heard for so long is lost, in both directions."""

    def arguments(self, interface: str | None = None, channel: str | None = None) -> dict[str, Any]:
        """Arguments of `can.Bus` for this bus, or for another interface or channel.

        The channel of ``udp_multicast`` may name a port, ``239.74.163.2:43113`` (the default); its frames never leave
        this machine.

        Raises:
            InputError: no port, or another interface without a channel.
        """
        name = interface or self.interface
        place = channel or (self.channel if name == self.interface else _CHANNELS.get(name))
        if place is None:
            raise InputError(f"interface '{name}' needs a channel", key="channel", expected="--channel C")
        if name in ("virtual", IN_STEP):
            return {"interface": name, "channel": place}
        if name != "udp_multicast":
            return {"interface": name, "channel": place, "bitrate": self.bitrate}
        group, _, port = place.partition(":") if "." in place else (place, "", "")
        if port and not (port.isdecimal() and 0 < int(port) < 65536):
            raise InputError("not a port", key="channel", found=place, expected="239.74.163.2:43113")
        return {"interface": name, "channel": group, "port": int(port or UDP_PORT), "hop_limit": 0}

    def open(self, interface: str | None = None, channel: str | None = None) -> can.BusABC:
        """Opens it; the caller shuts it down. Arguments and errors as :meth:`arguments`, and what `can.Bus` raises.

        The interface ``in_step`` is that of drives in physics: its channel is the file of the clock they go by.
        """
        if interface == IN_STEP:
            clock = SharedClock(Path(self.arguments(interface, channel)["channel"]))
            bus = self.open("udp_multicast", clock.channel)
            bus.clock = clock  # type: ignore[attr-defined]
            return bus
        bus = can.Bus(**self.arguments(interface, channel))
        if isinstance(bus, UdpMulticastBus):
            # the usual buffer holds 256 frames, which a busy machine leaves unread in 0.1 s
            with socket.socket(fileno=os.dup(bus.fileno())) as shared:
                shared.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _UDP_BUFFER)
        return bus


def when(message: can.Message) -> float:
    """Time of a frame, s since the epoch: its stamp, or now where an interface stamps with a clock of its own."""
    now = time.time()
    return message.timestamp if abs(message.timestamp - now) < _SAME_CLOCK_S else now
