"""Typed, strict reading of YAML and JSON, bundled files, and writing that leaves nothing half-written."""

from __future__ import annotations

import errno
import hashlib
import math
import os
import re
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from drake_hand.errors import InputError, nearest

T = TypeVar("T")

_CHECKOUT = Path(__file__).resolve().parent.parent / "urdf"


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
        InputError: neither exists; lists the bundled names.
    """
    names = bundled(kind, suffix)
    if str(ref) in names:
        return names[str(ref)]
    for base in ([beside.parent] if beside else []) + [Path.cwd()]:
        path = (base / ref).expanduser()
        if path.is_file():
            return path.resolve()
    raise InputError(f"no such {kind[:-1]}: '{ref}'", found=str(ref), expected=f"a path, or {nearest(str(ref), names)}")


def sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_text(path: Path) -> str:
    """Reads a text file.

    Raises:
        InputError: missing, unreadable or not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as e:
        raise InputError("cannot read file", file=path, found=str(e), expected="a readable UTF-8 text file") from e


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML 1.1 safe loader that refuses a key given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key '{key}' given twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def load(path: Path, type_: type[T]) -> T:
    """Reads a YAML or JSON file into a msgspec type.

    Raises:
        InputError: with file, key, found and expected; also for non-finite numbers and doubled keys.
    """
    text = read_text(path)
    try:
        raw = msgspec.json.decode(text) if path.suffix == ".json" else yaml.load(text, _UniqueKeyLoader)
    except (msgspec.DecodeError, yaml.YAMLError, RecursionError) as e:
        kind = "JSON" if path.suffix == ".json" else "YAML"
        found = " ".join(str(e).split())
        raise InputError(f"not valid {kind}", file=path, found=found, expected=f"well-formed {kind}") from e
    return convert(raw, type_, file=path)


def convert(raw: Any, type_: type[T], *, file: Path | str | None = None) -> T:
    """Converts plain data into a msgspec type, as :func:`load` does after parsing."""
    _refuse_non_finite(raw, "", file)
    try:
        return msgspec.convert(raw, type_)
    except msgspec.ValidationError as e:
        raise _explain(e, raw, type_, file) from e


def _refuse_non_finite(raw: Any, key: str, file: Path | str | None) -> None:
    if isinstance(raw, float) and not math.isfinite(raw):
        raise InputError("number is not finite", file=file, key=key, found=raw, expected="a finite number")
    if isinstance(raw, dict):
        for k, v in raw.items():
            _refuse_non_finite(v, f"{key}.{k}" if key else str(k), file)
    elif isinstance(raw, list):
        for i, v in enumerate(raw):
            _refuse_non_finite(v, f"{key}[{i}]", file)


def _explain(e: msgspec.ValidationError, raw: Any, type_: Any, file: Path | str | None) -> InputError:
    """Turns msgspec's message (``... - at `$.a.b```) into key, found and expected."""
    text, _, where = str(e).partition(" - at ")
    key = where.strip("`").removeprefix("$").removeprefix(".")
    found: Any = raw
    for step in re.findall(r"[^.\[\]]+", key):
        if isinstance(found, dict):
            found = found.get(step, found)
        elif isinstance(found, list) and step.isdigit():
            found = found[int(step)]
    unknown = re.search(r"unknown field `(.*)`", text)
    if unknown:
        name = unknown.group(1)
        return InputError(
            f"unknown key '{name}'",
            file=file,
            key=f"{key}.{name}" if key else name,
            found=name,
            expected=nearest(name, sorted(_known_fields(type_))),
        )
    missing = re.search(r"missing required field `(.*)`", text)
    if missing:
        return InputError(
            f"missing key '{missing.group(1)}'",
            file=file,
            key=key or "(top level)",
            expected=missing.group(1),
        )
    return InputError("wrong value", file=file, key=key or "(top level)", found=_short(found), expected=text)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 120 else text[:117] + "..."


def _known_fields(type_: Any) -> set[str]:
    """All field names of a struct type and the types inside it: nearest-name hints need no path."""
    names: set[str] = set()
    todo, seen = [type_], set()
    while todo:
        t = todo.pop()
        todo += getattr(t, "__args__", ())
        if isinstance(t, type) and issubclass(t, msgspec.Struct) and t not in seen:
            seen.add(t)
            for field in msgspec.structs.fields(t):
                names.add(field.encode_name)
                todo.append(field.type)
    return names


def write_atomic(path: Path, data: bytes | str) -> None:
    """Writes a file whole or not at all (temporary file beside it, then rename)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    payload = data.encode() if isinstance(data, str) else data
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as f:
            f.write(payload)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
