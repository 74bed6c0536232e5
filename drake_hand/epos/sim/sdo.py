"""SDO server of a simulated drive: expedited and segmented transfers, no blocks (CiA 301)."""

from __future__ import annotations

import struct

from canopen.sdo import SdoAbortedError

from drake_hand.epos.sim.dictionary import Dictionary

_HEADER = struct.Struct("<BHB")
_TOGGLE_ERROR, _BAD_COMMAND = 0x05030000, 0x05040001
_TOGGLE_BIT = 0x10


class SdoServer:
    """Answers one request frame with one response frame."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        self._key = (0, 0)
        self._buffer = bytearray()
        self._toggle = 0
        self._transfer = ""

    def answer(self, request: bytes) -> bytes | None:
        """The response of 8 bytes to a request of 8 bytes; None to an abort."""
        command = request[0] >> 5
        try:
            if command == 4:
                self._transfer = ""
                return None
            if command == 2:
                return self._upload(request)
            if command == 1:
                return self._download(request)
            if command == 3 and self._transfer == "up":
                return self._upload_segment(request)
            if command == 0 and self._transfer == "down":
                return self._download_segment(request)
            if command in (5, 6):
                self._key = _HEADER.unpack_from(request)[1:]
            raise SdoAbortedError(_BAD_COMMAND)
        except SdoAbortedError as e:
            self._transfer = ""
            return _HEADER.pack(0x80, *self._key) + struct.pack("<I", e.code)

    def _upload(self, request: bytes) -> bytes:
        self._key = _HEADER.unpack_from(request)[1:]
        data = self._dictionary.upload(*self._key)
        if len(data) <= 4:
            self._transfer = ""
            return _HEADER.pack(0x43 | (4 - len(data)) << 2, *self._key) + data.ljust(4, b"\0")
        self._buffer, self._toggle, self._transfer = bytearray(data), 0, "up"
        return _HEADER.pack(0x41, *self._key) + struct.pack("<I", len(data))

    def _upload_segment(self, request: bytes) -> bytes:
        self._check_toggle(request)
        part = bytes(self._buffer[:7])
        del self._buffer[:7]
        head = self._toggle | (7 - len(part)) << 1 | (not self._buffer)
        self._toggle ^= _TOGGLE_BIT
        if not self._buffer:
            self._transfer = ""
        return bytes([head]) + part.ljust(7, b"\0")

    def _download(self, request: bytes) -> bytes:
        self._key = _HEADER.unpack_from(request)[1:]
        expedited, sized = request[0] & 2, request[0] & 1
        if expedited:
            size = 4 - (request[0] >> 2 & 3) if sized else self._dictionary.entry(*self._key).obj.size
            self._dictionary.download(*self._key, request[4 : 4 + size])
            self._transfer = ""
        else:
            self._dictionary.entry(*self._key)
            self._buffer, self._toggle, self._transfer = bytearray(), 0, "down"
        return _HEADER.pack(0x60, *self._key) + bytes(4)

    def _download_segment(self, request: bytes) -> bytes:
        self._check_toggle(request)
        self._buffer += request[1 : 8 - (request[0] >> 1 & 7)]
        if request[0] & 1:
            self._dictionary.download(*self._key, bytes(self._buffer))
            self._transfer = ""
        response = bytes([0x20 | self._toggle]) + bytes(7)
        self._toggle ^= _TOGGLE_BIT
        return response

    def _check_toggle(self, request: bytes) -> None:
        if request[0] & _TOGGLE_BIT != self._toggle:
            raise SdoAbortedError(_TOGGLE_ERROR)
