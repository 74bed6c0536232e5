"""Recognises a file of another kind than the one asked for, and says what it is good for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from drake_hand.errors import InputError

_KINDS = {
    "a task": ({"object", "motion"}, "plan it first: drake-hand plan {}"),
    "a plan": ({"parts", "urdf_sha256"}, "watch it with: drake-hand show {}"),
    "a hand file": ({"urdf", "palm"}, "examine it with: drake-hand hand check {}"),
    "a drives file": ({"joints", "bus"}, "see who is on the bus with: drake-hand drives scan --drives {}"),
    "a sweep file": ({"tasks"}, "run it with: drake-hand sweep {}"),
    "a faults file": ({"faults"}, "it goes with: drake-hand drives simulate --faults {}"),
}
"""Keys that only this kind has all of, and what to do with it."""


def refuse_other(raw: Any, type_: Any, file: Path | str | None) -> None:
    """Refuses data of another kind than `type_`, if they are of a known one.

    Raises:
        InputError: says which kind it is, and what to do with it.
    """
    if not (isinstance(raw, dict) and isinstance(type_, type) and issubclass(type_, msgspec.Struct)):
        return
    known = {f.encode_name for f in msgspec.structs.fields(type_)}
    wanted = next((kind for kind, (keys, _) in _KINDS.items() if keys <= known), None)
    for kind, (keys, advice) in _KINDS.items():
        if wanted and kind != wanted and keys <= raw.keys():
            raise InputError(f"this is {kind}; {advice.format(file)}", file=file, found=kind, expected=wanted)


def refuse_record(data: bytes, file: Path) -> None:
    """Refuses a record of a run where YAML or JSON is wanted.

    Raises:
        InputError: it is one.
    """
    if file.suffix == ".npz" and data.startswith(b"PK"):
        advice = f"draw it with: drake-hand plot {file} -o figures"
        raise InputError(f"this is the record of a run; {advice}", file=file, found="arrays", expected="YAML or JSON")


def refuse_xml(text: str, file: Path) -> None:
    """Refuses a model where YAML or JSON is wanted.

    Raises:
        InputError: it is XML.
    """
    if text.lstrip("\ufeff \r\n\t").startswith("<"):
        advice = f"if it is a hand's, draft its hand file with: drake-hand hand init {file}"
        raise InputError(f"this is a model (XML); {advice}", file=file, found="XML", expected="YAML or JSON")
