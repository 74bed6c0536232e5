"""The folder of a sweep: a journal that survives any kill, plan files, and the results as a table.

A case is done when its line is in the journal; its files are there before that. A line that a kill cut short does not
count, and its case is done again.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from drake_hand.errors import InputError
from drake_hand.files import make_folder, write_atomic
from drake_hand.sweep.work import CaseRow, Done

if TYPE_CHECKING:
    import pyarrow

RESULTS = "results.parquet"


class Store:
    """A sweep's folder, open for one process at a time; ask :meth:`open`."""

    def __init__(self, folder: Path, journal: int) -> None:
        self.folder, self._journal = folder, journal
        self.rows: dict[str, CaseRow] = {row.id: row for row in _read(folder / "journal.jsonl")}

    @classmethod
    @contextmanager
    def open(cls, folder: Path) -> Iterator[Store]:
        """Opens or makes the folder.

        Raises:
            InputError: another sweep is writing there, or it is in no folder.
        """
        for made in (folder, folder / "plans"):
            make_folder(made)
        journal = os.open(folder / "journal.jsonl", os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            try:
                fcntl.flock(journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as e:
                raise InputError("another sweep is writing here", file=folder, expected="one at a time") from e
            size = os.fstat(journal).st_size
            if size and os.pread(journal, 1, size - 1) != b"\n":
                os.write(journal, b"\n")  # ends the line that a kill cut short
            yield cls(folder, journal)
        finally:
            os.close(journal)

    def plan_file(self, id_: str) -> Path:
        """Where a case's plan is."""
        return self.folder / "plans" / f"{id_}.plan.json"

    def run_files(self, id_: str) -> list[Path]:
        """Where its replays are."""
        return sorted((self.folder / "replays").glob(f"{id_}.*.npz"))

    def add(self, done: Done) -> None:
        """Writes a case's files, then its line, and has the disk take it."""
        if done.plan is not None:
            write_atomic(self.plan_file(done.row.id), done.plan)
        for i, run in enumerate(done.runs):
            write_atomic(self.folder / "replays" / f"{done.row.id}.{i}.npz", run)
        os.write(self._journal, msgspec.json.encode(done.row) + b"\n")
        os.fsync(self._journal)
        self.rows[done.row.id] = done.row

    def write_table(self, ids: list[str]) -> Path:
        """Writes the results of these cases, in this order, as Parquet."""
        import pyarrow.parquet

        file = self.folder / RESULTS
        part = file.with_suffix(".part")
        pyarrow.parquet.write_table(table([self.rows[i] for i in ids if i in self.rows]), part)
        os.replace(part, file)
        return file


def table(rows: list[CaseRow]) -> pyarrow.Table:
    """The results as a table; what was varied has columns ``vary.KEY``."""
    import pyarrow as pa

    kinds = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    columns, types = {}, {}
    for field in msgspec.structs.fields(CaseRow):
        if field.name == "varied":
            continue
        kind = next(k for k in (str, int, float) if field.type in (k, k | None))
        columns[field.name] = [getattr(row, field.name) for row in rows]
        types[field.name] = kinds[kind]
    for key in dict.fromkeys(k for row in rows for k in row.varied):
        values = [row.varied.get(key) for row in rows]
        plain = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
        columns[f"vary.{key}"] = values if plain else [v if isinstance(v, str) else _text(v) for v in values]
        types[f"vary.{key}"] = pa.float64() if plain else pa.string()
    return pa.table(columns, schema=pa.schema(list(types.items())))


def _text(value: object) -> str:
    return msgspec.json.encode(value).decode()


def _read(file: Path) -> Iterator[CaseRow]:
    for line in file.read_bytes().split(b"\n"):
        try:
            yield msgspec.json.decode(line, type=CaseRow)
        except msgspec.DecodeError:  # empty, or cut short
            continue
