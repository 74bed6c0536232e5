"""Typed, strict reading of YAML and JSON, bundled files, and atomic writing."""

from __future__ import annotations

import hashlib
import math
import secrets
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from drake_hand.errors import InputError, MissingFile, nearest
from drake_hand.files import yaml_text
from drake_hand.files.explain import explain
from drake_hand.files.kinds import refuse_other, refuse_record, refuse_xml

T = TypeVar("T")

_CHECKOUT = Path(__file__).resolve().parents[2] / "urdf"


def data_dir() -> Path:
    """The folder of bundled hands, objects, tasks and drives: in the wheel, or ``urdf/`` in a checkout."""
    packaged = Path(str(resources.files("drake_hand"))) / "data"
    return packaged if packaged.is_dir() else _CHECKOUT


def bundled(kind: str, suffix: str) -> dict[str, Path]:
    """Bundled files by name: ``bundled("tasks", ".task.yaml")["spin"]``."""
    folder = data_dir() / kind
    return {p.name[: -len(suffix)]: p for p in sorted(folder.rglob(f"*{suffix}"))}


def resolve(ref: str | Path, kind: str, suffix: str, *, beside: Path | None = None) -> Path:
    """Finds a bundled name or a path.

    Args:
        ref: bundled name (``kanguera``) or a path.
        kind: folder of bundled data (``hands``, ``objects``, ``tasks``, ``drives``).
        suffix: of bundled files of that kind.
        beside: a file whose folder relative paths are tried against first.

    Raises:
        MissingFile: neither exists; lists the bundled names.
    """
    names = bundled(kind, suffix)
    if str(ref) in names:
        return names[str(ref)]
    for base in ([beside.parent] if beside else []) + [Path.cwd()]:
        path = (base / ref).expanduser()
        if path.is_file():
            return path.resolve()
    raise MissingFile(f"no such {kind[:-1]}: '{ref}'", found=str(ref), expected=f"a path, or {nearest(ref, names)}")


def sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_bytes(path: Path) -> bytes:
    """Reads a file.

    Raises:
        MissingFile: there is none.
        InputError: unreadable.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise MissingFile("no such file", file=path, expected="a file") from None
    except OSError as e:
        raise InputError("cannot read file", file=path, found=e.strerror or str(e), expected="a readable file") from e


def read_text(path: Path) -> str:
    """Reads a text file.

    Raises:
        MissingFile: there is none.
        InputError: unreadable, not UTF-8, or the record of a run.
    """
    data = read_bytes(path)
    refuse_record(data, path)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as e:
        raise InputError("cannot read file", file=path, found=str(e), expected="a UTF-8 text file") from e


def load(path: Path, type_: type[T]) -> T:
    """Reads a YAML or JSON file into a msgspec type.

    Raises:
        InputError: with file, line (of YAML), key, found and expected; also for non-finite numbers, doubled keys, and
            a file of another kind.
    """
    text = read_text(path)
    refuse_xml(text, path)
    if not text.strip():
        raise InputError("file is empty", file=path, expected="YAML or JSON")
    if path.suffix == ".json":
        try:
            return convert(msgspec.json.decode(text), type_, file=path)
        except (msgspec.DecodeError, RecursionError) as e:
            raise InputError("not valid JSON", file=path, found=str(e), expected="well-formed JSON") from e
    try:
        return convert(yaml_text.parse_yaml(text), type_, file=path)
    except InputError as e:
        raise with_line(e, path, text) from e


def with_line(e: InputError, path: Path, text: str | None = None) -> InputError:
    """An error of a file, with the line its key is on; in JSON, which may be all on one line, without.

    Args:
        e: the error.
        path: the file.
        text: what is in it, if it has been read.
    """
    line = e.line
    if line is None and e.key and path.suffix != ".json":
        line = yaml_text.line_of(read_text(path) if text is None else text, e.key)
    return InputError(e.message, file=path, key=e.key, found=e.found, expected=e.expected, line=line)


def convert(raw: Any, type_: type[T], *, file: Path | str | None = None) -> T:
    """Converts plain data into a msgspec type, as :func:`load` does after parsing."""
    refuse_other(raw, type_, file)
    _refuse_non_finite(raw, "", file)
    try:
        return msgspec.convert(raw, type_)
    except msgspec.ValidationError as e:
        raise explain(e, raw, type_).within(file) from e


def _refuse_non_finite(raw: Any, key: str, file: Path | str | None) -> None:
    if isinstance(raw, float) and not math.isfinite(raw):
        raise InputError("number is not finite", file=file, key=key, found=raw, expected="a finite number")
    if isinstance(raw, dict):
        for k, v in raw.items():
            _refuse_non_finite(v, f"{key}.{k}" if key else str(k), file)
    elif isinstance(raw, list):
        for i, v in enumerate(raw):
            _refuse_non_finite(v, f"{key}[{i}]", file)


def require_folder(path: Path) -> None:
    """Refuses, before there is anything to write, a file that has no folder to be in, or is one itself.

    Raises:
        InputError: it is a folder.
        MissingFile: its folder is missing, which is more often a typing error than a wish.
    """
    if path.is_dir():
        raise InputError("this is a folder", file=path, found="a folder", expected="the name of a file")
    _require_parent(path)


def require_place(folder: Path) -> None:
    """Refuses, before there is anything to write, a folder that is a file, or would have to be made in one not there.

    Raises:
        InputError: it is a file.
        MissingFile: the folder it is to be in is missing.
    """
    if folder.is_dir():
        return
    if folder.exists():
        raise InputError("this is a file", file=folder, found="a file", expected="the name of a folder")
    _require_parent(folder)


def make_folder(folder: Path) -> None:
    """Makes a folder for output, unless it is there.

    Raises:
        InputError: as :func:`require_place`.
        OSError: it cannot be made.
    """
    require_place(folder)
    folder.mkdir(exist_ok=True)


def _require_parent(path: Path) -> None:
    if not path.parent.is_dir():
        raise MissingFile("no such folder", file=path, found=str(path.parent), expected="a folder that exists")


def write_atomic(path: Path, data: bytes | str) -> None:
    """Writes a file whole or not at all (temporary file beside it, then rename).

    A link stays one: the file it leads to is written. What is no file, such as ``/dev/null``, is written to as it is.

    Raises:
        InputError: as :func:`require_folder`.
        OSError: it cannot be written.
    """
    require_folder(path)
    payload = data.encode() if isinstance(data, str) else data
    if path.exists() and not path.is_file():
        path.write_bytes(payload)
        return
    path = path.resolve()
    beside = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        with beside.open("xb") as f:  # opened like any file: the process's umask decides who may read it
            f.write(payload)
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
