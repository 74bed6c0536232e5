"""PDO engine of a simulated drive: mapping, SYNC-latched and event-driven PDOs, inhibit and time-out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from canopen.sdo import SdoAbortedError

from drake_hand.epos.objects import Obj
from drake_hand.epos.pdo import ON_EVENT, ON_SYNC, PDO_DISABLED
from drake_hand.epos.sim.dictionary import OUT_OF_RANGE, WRONG_STATE, Dictionary, Entry

NOT_MAPPABLE, TOO_LONG = 0x06040041, 0x06040042
LENGTH_ERROR, RPDO_TIMEOUT = 0x8210, 0x8250
_NEVER = float("-inf")


@dataclass(slots=True)
class _Pdo:
    """A PDO in use."""

    cob: int
    on_sync: bool
    entries: list[Entry]
    inhibit_s: float
    timeout_s: float
    last_data: bytes = b""
    last_time: float = _NEVER
    latched: bytes | None = None
    size: int = field(init=False)

    def __post_init__(self) -> None:
        self.size = sum(e.obj.size for e in self.entries)


class PdoEngine:
    """RPDOs into the dictionary, TPDOs out of it.

    Args:
        dictionary: the drive's.
        send: puts a frame on the bus (COB-ID, data).
        fail: reports an error code to the drive.
    """

    def __init__(self, dictionary: Dictionary, send: Callable[[int, bytes], None], fail: Callable[[int], None]) -> None:
        self._dictionary, self._send, self._fail = dictionary, send, fail
        self.changed = True
        """Whether the configuration was written since :meth:`configure`."""
        self._rx: dict[int, _Pdo] = {}
        self._tx: list[_Pdo] = []
        for base in (0x1400, 0x1800):
            for k in range(4):
                dictionary.hook(Obj(base + k, 1, "u32"), write=self._write_any)
                dictionary.hook(Obj(base + k, 2, "u8"), write=self._write_transmission)
                dictionary.hook(Obj(base + k, 3, "u16"), write=self._write_any)
                if Obj(base + k, 5, "u16") in dictionary:
                    dictionary.hook(Obj(base + k, 5, "u16"), write=self._write_any)
                self._hook_mapping(base + 0x200 + k)

    def _hook_mapping(self, index: int) -> None:
        count = Obj(index, 0, "u8")
        slots = [Obj(index, n, "u32") for n in range(1, 13) if Obj(index, n, "u32") in self._dictionary]

        def write_count(value: int) -> None:
            size = sum(self._mapped(self._dictionary[s]).obj.size for s in slots[:value])
            if size > 8:
                raise SdoAbortedError(TOO_LONG)
            self.changed = True

        def write_slot(value: int) -> None:
            if self._dictionary[count]:
                raise SdoAbortedError(WRONG_STATE)
            self._mapped(value)

        self._dictionary.hook(count, write=write_count)
        for slot in slots:
            self._dictionary.hook(slot, write=write_slot)

    def _mapped(self, mapping: int) -> Entry:
        try:
            entry = self._dictionary.entry(mapping >> 16, mapping >> 8 & 0xFF)
        except SdoAbortedError as e:
            raise SdoAbortedError(NOT_MAPPABLE) from e
        if entry.obj.mapping != mapping or entry.obj.index < 0x2000:
            raise SdoAbortedError(NOT_MAPPABLE)
        return entry

    def _write_any(self, _: int) -> None:
        self.changed = True

    def _write_transmission(self, value: int) -> None:
        if value not in (ON_SYNC, ON_EVENT):
            raise SdoAbortedError(OUT_OF_RANGE)
        self.changed = True

    def configure(self) -> None:
        """Reads the configuration from the dictionary again."""
        self._rx = {p.cob: p for p in self._read(0x1400)}
        self._tx = self._read(0x1800)
        self.changed = False

    def _read(self, base: int) -> list[_Pdo]:
        found = []
        for k in range(4):
            cob = self._dictionary[Obj(base + k, 1, "u32")]
            count = self._dictionary[Obj(base + 0x200 + k, 0, "u8")]
            if cob & PDO_DISABLED or not count:
                continue
            timer = Obj(base + k, 5, "u16")
            found.append(
                _Pdo(
                    cob=cob & 0x7FF,
                    on_sync=self._dictionary[Obj(base + k, 2, "u8")] == ON_SYNC,
                    entries=[self._mapped(self._dictionary[Obj(base + 0x200 + k, n + 1, "u32")]) for n in range(count)],
                    inhibit_s=self._dictionary[Obj(base + k, 3, "u16")] * 1e-4,
                    timeout_s=self._dictionary[timer] * 1e-3 if timer in self._dictionary else 0.0,
                )
            )
        return found

    @property
    def cob_ids(self) -> list[int]:
        """COB-IDs of the RPDOs."""
        return list(self._rx)

    def receive(self, cob: int, data: bytes, t: float) -> None:
        """Takes an RPDO: at once, or into the latch until the next SYNC."""
        pdo = self._rx.get(cob)
        if pdo is None:
            return
        pdo.last_time = t
        if pdo.on_sync:
            pdo.latched = data
        else:
            self._apply(pdo, data)

    def sample(self) -> None:
        """SYNC, first half: sends the synchronous TPDOs."""
        for pdo in self._tx:
            if pdo.on_sync:
                self._send(pdo.cob, self._pack(pdo))

    def actuate(self) -> None:
        """SYNC, second half: applies what was latched."""
        for pdo in self._rx.values():
            if pdo.latched is not None:
                data, pdo.latched = pdo.latched, None
                self._apply(pdo, data)

    def housekeep(self, t: float) -> None:
        """Sends event-driven TPDOs whose data changed; notices RPDOs that stay away."""
        for pdo in self._tx:
            if not pdo.on_sync and t - pdo.last_time >= pdo.inhibit_s:
                data = self._pack(pdo)
                if data != pdo.last_data:
                    pdo.last_data, pdo.last_time = data, t
                    self._send(pdo.cob, data)
        for pdo in self._rx.values():
            if pdo.timeout_s and pdo.last_time + pdo.timeout_s < t and pdo.last_time != _NEVER:
                pdo.last_time = _NEVER
                self._fail(RPDO_TIMEOUT)

    def _pack(self, pdo: _Pdo) -> bytes:
        return b"".join(
            [e.obj.pack(e.on_read() if e.on_read else e.value) for e in pdo.entries],
        )

    def _apply(self, pdo: _Pdo, data: bytes) -> None:
        if len(data) < pdo.size:
            self._fail(LENGTH_ERROR)
            return
        at = 0
        for entry in pdo.entries:
            value = entry.obj.unpack(data[at : at + entry.obj.size])
            at += entry.obj.size
            try:
                self._dictionary.write(entry, value)
            except SdoAbortedError:
                continue  # a PDO has nobody to tell
