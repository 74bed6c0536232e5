"""Object dictionary of a simulated drive: entries, access rules, stored values; our own selection of objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from canopen.sdo import SdoAbortedError

from drake_hand.epos import objects as o
from drake_hand.epos.drives import Drive
from drake_hand.epos.objects import Obj
from drake_hand.epos.pdo import EMCY_BASE, LAYOUT, PDO_DISABLED, SYNC_COB

WRITE_ONLY, READ_ONLY, NO_OBJECT = 0x06010001, 0x06010002, 0x06020000
WRONG_LENGTH, NO_SUBINDEX, OUT_OF_RANGE = 0x06070010, 0x06090011, 0x06090030
NOT_STORED, WRONG_STATE = 0x08000020, 0x08000022

_S32 = (-(2**31), 2**31 - 1)


@dataclass(slots=True)
class Entry:
    """One object: its value now, its default, who may touch it, what happens when they do."""

    obj: Obj
    value: int
    default: int
    access: str
    limits: tuple[int, int] | None
    stored: bool
    on_read: Callable[[], int] | None = None
    on_write: Callable[[int], None] | None = None


class Dictionary:
    """Values by (index, subindex); SDO and PDO come through the same entries.

    Args:
        drive: whose objects.
        serial: its 64-bit serial number.
    """

    def __init__(self, drive: Drive, serial: int) -> None:
        self._entries: dict[tuple[int, int], Entry] = {}
        _communication(self, drive, serial)
        _device(self, drive)
        self.saved: dict[str, int] = {}
        """Non-volatile values, by ``index:subindex``."""

    def add(
        self,
        obj: Obj,
        default: int = 0,
        *,
        access: str = "rw",
        limits: tuple[int, int] | None = None,
        stored: bool | None = None,
    ) -> None:
        """Adds an object; a record's subindex 0 comes by itself."""
        self._entries[obj.index, obj.sub] = Entry(
            obj, default, default, access, limits, access == "rw" if stored is None else stored
        )
        if obj.sub:
            count = self._entries.get((obj.index, 0))
            if count is None:
                self.add(Obj(obj.index, 0, "u8"), obj.sub, access="ro")
            elif count.access == "ro":
                count.value = count.default = max(count.value, obj.sub)

    def __contains__(self, obj: Obj) -> bool:
        return (obj.index, obj.sub) in self._entries

    def __getitem__(self, obj: Obj) -> int:
        """Value of an object, whoever may read it."""
        entry = self._entries[obj.index, obj.sub]
        return entry.on_read() if entry.on_read else entry.value

    def __setitem__(self, obj: Obj, value: int) -> None:
        """Sets a value from inside the drive: no hooks, no access check."""
        self._entries[obj.index, obj.sub].value = value

    def hook(
        self, obj: Obj, *, read: Callable[[], int] | None = None, write: Callable[[int], None] | None = None
    ) -> None:
        """Lets the drive answer reads and take writes; a write hook may raise `SdoAbortedError`."""
        entry = self._entries[obj.index, obj.sub]
        entry.on_read, entry.on_write = read or entry.on_read, write or entry.on_write

    def be(self, vendor: int, product: int) -> None:
        """Takes on an identity that survives resets."""
        for obj, value in ((o.VENDOR, vendor), (o.PRODUCT, product)):
            entry = self._entries[obj.index, obj.sub]
            entry.value = entry.default = value

    @property
    def objects(self) -> list[Obj]:
        """All of its objects."""
        return [e.obj for e in self._entries.values()]

    def entry(self, index: int, sub: int) -> Entry:
        """The entry.

        Raises:
            SdoAbortedError: no such object or subindex.
        """
        found = self._entries.get((index, sub))
        if found is None:
            raise SdoAbortedError(NO_SUBINDEX if (index, 0) in self._entries else NO_OBJECT)
        return found

    def upload(self, index: int, sub: int) -> bytes:
        """Bytes an SDO read gets; raises `SdoAbortedError` as a drive does."""
        entry = self.entry(index, sub)
        if entry.access == "wo":
            raise SdoAbortedError(WRITE_ONLY)
        return entry.obj.pack(self[entry.obj])

    def download(self, index: int, sub: int, data: bytes) -> None:
        """Takes an SDO write; raises `SdoAbortedError` as a drive does."""
        entry = self.entry(index, sub)
        if entry.access == "ro":
            raise SdoAbortedError(READ_ONLY)
        if len(data) != entry.obj.size:
            raise SdoAbortedError(WRONG_LENGTH)
        self.write(entry, entry.obj.unpack(bytes(data)))

    def write(self, entry: Entry, value: int) -> None:
        """Takes a write by SDO or PDO: limits, then the hook, then the value."""
        if entry.limits and not entry.limits[0] <= value <= entry.limits[1]:
            raise SdoAbortedError(OUT_OF_RANGE)
        if entry.on_write:
            entry.on_write(value)
        entry.value = value

    def save(self) -> None:
        """Keeps all storable values over a reset."""
        self.saved = {f"{i:04X}:{s:02X}": e.value for (i, s), e in self._entries.items() if e.stored}

    def restore_defaults(self) -> None:
        """Forgets what was saved: from the next reset on the defaults hold."""
        self.saved = {}

    def reset(self, *, communication_only: bool = False) -> None:
        """Sets every value to what was saved, or to its default, without hooks."""
        for (i, s), entry in self._entries.items():
            if not communication_only or 0x1000 <= i < 0x2000:
                entry.value = self.saved.get(f"{i:04X}:{s:02X}", entry.default) if entry.stored else entry.default


def _communication(d: Dictionary, drive: Drive, serial: int) -> None:
    d.add(o.DEVICE_TYPE, 0x00020192, access="ro")
    d.add(o.ERROR_REGISTER, access="ro")
    d.add(o.ERROR_HISTORY_COUNT, limits=(0, 0), stored=False)
    for n in range(1, o.ERROR_HISTORY_DEPTH + 1):
        d.add(o.error_history(n), access="ro")
    d.add(o.SYNC_COB_ID, SYNC_COB)
    d.add(o.EMCY_COB_ID, EMCY_BASE + drive.node)
    d.add(o.STORE_ALL, 1, stored=False)
    d.add(o.RESTORE_ALL, 1, stored=False)
    d.add(o.CONSUMER_HEARTBEAT)
    d.add(o.PRODUCER_HEARTBEAT)
    d.add(o.VENDOR, drive.identity.vendor, access="ro")
    d.add(o.PRODUCT, drive.identity.product or 0, access="ro")
    d.add(o.REVISION, 0x21220000, access="ro")
    d.add(o.SERIAL, serial & 0xFFFFFFFF, access="ro")
    d.add(o.SERIAL64[drive.type], serial, access="ro")
    by_default = (LAYOUT[drive.type].command, LAYOUT[drive.type].status)
    width = 12 if drive.type == "epos4" else 8
    for direction, communication, mapping, base in (
        ("rx", 0x1400, 0x1600, 0x200),
        ("tx", 0x1800, 0x1A00, 0x180),
    ):
        for k in range(4):
            pdo = next((p for p in by_default if (p.direction, p.number) == (direction, k + 1)), None)
            entries = pdo.entries if pdo else ()
            cob = base + 0x100 * k + drive.node
            d.add(Obj(communication + k, 1, "u32"), cob if pdo else cob | PDO_DISABLED)
            d.add(Obj(communication + k, 2, "u8"), pdo.transmission if pdo else 255)
            d.add(Obj(communication + k, 3, "u16"))
            if direction == "rx" and drive.type == "epos4":
                d.add(Obj(communication + k, 5, "u16"))
            d.add(Obj(mapping + k, 0, "u8"), len(entries), limits=(0, width))
            for n in range(width):
                d.add(Obj(mapping + k, n + 1, "u32"), entries[n].mapping if n < len(entries) else 0)


def _device(d: Dictionary, drive: Drive) -> None:
    d.add(o.CONTROLWORD, stored=False)
    d.add(o.STATUSWORD, access="ro")
    d.add(o.ABORT_OPTION, 3, limits=(0, 3))
    if drive.type == "epos4":
        d.add(o.QUICK_STOP_OPTION, 6, limits=(0, 6))
    d.add(o.SHUTDOWN_OPTION, 0, limits=(0, 1))
    d.add(o.DISABLE_OPTION, 1, limits=(0, 1))
    d.add(o.FAULT_OPTION, 2, limits=(0, 2))
    d.add(o.MODE, o.MODE_PROFILE)
    modes = [m for m in (o.MODE_PROFILE, o.MODE_HOMING, o.STREAM_MODE[drive.type]) if m > 0]
    d.add(o.SUPPORTED_MODES, sum(1 << m - 1 for m in modes), access="ro")
    d.add(o.MODE_DISPLAY, o.MODE_PROFILE, access="ro")
    d.add(o.POSITION_DEMAND, access="ro")
    d.add(o.POSITION_ACTUAL, access="ro")
    d.add(o.VELOCITY_ACTUAL, access="ro")
    d.add(o.FOLLOWING_WINDOW, 2000)
    d.add(o.FOLLOWING_ERROR[drive.type], access="ro")
    d.add(o.CURRENT_ACTUAL[drive.type], access="ro")
    d.add(o.TARGET_POSITION, stored=False)
    d.add(o.HOME_OFFSET)
    d.add(o.HOME_POSITION[drive.type])
    d.add(o.HOMING_METHOD, 7)
    d.add(o.HOMING_SPEED, 100)
    d.add(o.HOMING_SPEED_ZERO, 10)
    d.add(o.HOMING_ACCELERATION, 1000, limits=(1, 2**32 - 1))
    d.add(o.HOMING_CURRENT[drive.type], 500)
    d.add(o.SOFT_LIMIT_MIN, 0 if drive.type == "epos4" else _S32[0])
    d.add(o.SOFT_LIMIT_MAX, 0 if drive.type == "epos4" else _S32[1])
    d.add(o.MAX_PROFILE_VELOCITY, 25000)
    d.add(o.PROFILE_VELOCITY, 1000)
    for deceleration in (o.PROFILE_ACCELERATION, o.PROFILE_DECELERATION, o.QUICK_STOP_DECELERATION):
        d.add(deceleration, 10000, limits=(1, 2**32 - 1))
    d.add(o.MAX_ACCELERATION, 2**32 - 1)
    if drive.type == "epos4":
        d.add(o.IP_PERIOD_VALUE, 1, limits=(1, 255))
        d.add(o.IP_PERIOD_INDEX, -3, limits=(-3, -3))
    if drive.has_queue:
        d.add(o.IP_SUBMODE, -1, limits=(-1, -1))
        d.add(o.IP_PERIOD_VALUE, 1, limits=(1, 1))
        d.add(o.IP_PERIOD_INDEX, -3, limits=(-3, -3))
        d.add(o.IP_BUFFER_SIZE, o.IP_DEPTH, access="ro")
        d.add(o.IP_BUFFER_FREE, o.IP_DEPTH, access="ro")
        d.add(o.IP_BUFFER_ORGANISATION, 0, limits=(0, 0))
        d.add(o.IP_BUFFER_USED, access="ro")
        d.add(o.IP_BUFFER_CLEAR, 0, access="wo", limits=(0, 1))
        d.add(o.IP_RECORD, access="wo")
        d.add(o.IP_STATUS, access="ro")
        d.add(o.IP_UNDERFLOW_WARNING, 4, limits=(0, o.IP_DEPTH))
        d.add(o.IP_OVERFLOW_WARNING, 60, limits=(0, o.IP_DEPTH))
    if drive.type == "epos1":
        d.add(o.POSITION_MODE_SETTING, stored=False)


def fits(obj: Obj, value: int) -> int:
    """Clips a value into an object's type, as a drive's own counters saturate."""
    bits = 8 * obj.size
    low, high = (0, 2**bits - 1) if obj.type[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return min(max(value, low), high)
