"""What msgspec found wrong, in the words of the person who wrote the file."""

from __future__ import annotations

import re
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import msgspec

from drake_hand.errors import InputError, nearest

_WORDS = {
    "array": "a list",
    "object": "a mapping",
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "null": "nothing",
}


def explain(e: msgspec.ValidationError, raw: Any, type_: Any) -> InputError:
    """Turns msgspec's message (``... - at `$.a.b```) into key, found and expected."""
    text, _, where = str(e).partition(" - at ")
    key, found, inner = _located(where.removeprefix("`key` in "), raw, type_)
    names = [f.encode_name for struct in _structs(inner) for f in msgspec.structs.fields(struct)]
    if unknown := re.search(r"unknown field `(.*)`", text):
        name = unknown.group(1)
        return InputError(
            f"unknown key '{name}'", key=f"{key}.{name}" if key else name, found=name, expected=nearest(name, names)
        )
    key = key or "(top level)"
    if missing := re.search(r"missing required field `(.*)`", text):
        return InputError(f"missing key '{missing.group(1)}'", key=key, expected=missing.group(1))
    if where.startswith("`key` in "):
        odd = next(k for k in found if not isinstance(k, str))
        return InputError("a key is not text", key=key, found=_short(odd), expected="text, in quotes if need be")
    if choices := [str(word) for word in _choices(inner)]:
        expected = nearest(found, choices)
        expected += f"; or a mapping with {', '.join(names)}" if names else ""
        expected += "; or a list" if any(get_origin(t) in (list, tuple) for t in _options(inner)) else ""
        return InputError("wrong value", key=key, found=_short(found), expected=expected)
    return InputError("wrong value", key=key, found=_short(found), expected=_in_words(text))


def _located(where: str, raw: Any, type_: Any) -> tuple[str, Any, Any]:
    """Key, value and type of what msgspec calls ``$.motion[0].start`` or, in a mapping, ``$.joints[...]``."""
    key, found, inner = "", raw, type_
    for index, name in re.findall(r"\[([^\]]*)\]|([^.$`\[\]]+)", where):
        if isinstance(found, list | tuple):
            key, step = f"{key}[{index}]", index
            found = found[int(index)]
        else:
            step = _culprit(found, inner) if index else name
            key = f"{key}.{step}" if key else step
            found = found[step]
        inner = _inside(inner, step)
    return key, found, inner


def _in_words(text: str) -> str:
    """``Expected `array` of length 3, got 2``: "a list of 3"; what was got is reported as found."""
    match = re.fullmatch(r"Expected `([^`]*)`(.*?)(?:, got .*)?", text)
    if match is None:
        return text
    kinds, more = match.groups()
    more = more.replace(" of length >= ", " of at least ").replace(" of length <= ", " of at most ")
    more = re.sub(r"(\d)\.0$", r"\1", more.replace(" of length ", " of "))
    return " or ".join(_WORDS.get(kind, kind) for kind in kinds.split(" | ")) + more


def _options(type_: Any) -> Iterator[Any]:
    """The types a value may have: unions and annotations taken apart."""
    origin = get_origin(type_)
    if origin is Annotated:
        yield from _options(get_args(type_)[0])
    elif origin in (Union, types.UnionType):
        for option in get_args(type_):
            yield from _options(option)
    else:
        yield type_


def _structs(type_: Any) -> list[Any]:
    return [t for t in _options(type_) if isinstance(t, type) and issubclass(t, msgspec.Struct)]


def _choices(type_: Any) -> list[object]:
    return [word for t in _options(type_) if get_origin(t) is Literal for word in get_args(t)]


def _inside(type_: Any, step: str) -> Any:
    """Type of what is at a key or index of a value of some type."""
    for option in _options(type_):
        origin, arguments = get_origin(option), get_args(option)
        if origin is dict:
            return arguments[1]
        if origin is list:
            return arguments[0]
        if origin is tuple:
            return arguments[min(int(step), len(arguments) - 1)]
    fields = {f.encode_name: f.type for struct in _structs(type_) for f in msgspec.structs.fields(struct)}
    return fields.get(step, Any)


def _culprit(found: Any, type_: Any) -> str:
    """The key of a mapping whose value is wrong; msgspec does not name it."""
    for key, value in found.items():
        try:
            msgspec.convert(value, _inside(type_, key))
        except msgspec.ValidationError:
            return key
    raise AssertionError("one of the values was refused")


def _short(value: object) -> str:
    try:
        text = msgspec.json.encode(value).decode()
    except TypeError:
        text = repr(value)
    return text if len(text) <= 120 else text[:117] + "..."
