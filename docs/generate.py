"""A hook of mkdocs: the reference of every key, of commands and of the library, made from types and docstrings."""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
from importlib import import_module
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
from cyclopts import App
from mkdocs.structure.files import File

import drake_hand
from drake_hand.cli.app import COMMANDS
from drake_hand.epos.drives import DrivesFile
from drake_hand.model.hand_file import HandSpec
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Task

TYPES = {"task": Task, "hand": HandSpec, "drives": DrivesFile, "plan": Plan}


def on_files(files, config):
    """Adds the generated pages and schemas to the site."""
    pages = {f"reference/{name}.md": keys_page(name, kind) for name, kind in TYPES.items()}
    pages |= {f"reference/{name}.schema.json": schema(kind) for name, kind in TYPES.items()}
    pages["reference/commands.md"] = commands_page()
    pages["reference/python.md"] = python_page()
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def schema(kind: type) -> str:
    """JSON schema of a file, for editors."""
    return json.dumps(msgspec.json.schema(kind), indent=1)


def keys_page(name: str, kind: type) -> str:
    """Every key of a file, a table per type."""
    parts = [
        f"# Keys of a {name} file\n\n{first_line(kind)}\n",
        f"For editors that complete YAML or JSON: [{name}.schema.json]({name}.schema.json).\n",
    ]
    for struct in structs(kind):
        rows = [f"## {struct.__name__}\n\n{inspect.getdoc(struct) or ''}\n"]
        if struct.__struct_fields__:
            rows += ["| key | type | default | meaning |", "|---|---|---|---|"]
        told = attribute_docs(struct)
        for field in msgspec.structs.fields(struct):
            default = "required" if field.required else plain(field)
            meaning = " ".join(told.get(field.name, "").split()).replace("|", "\\|")
            rows.append(f"| `{field.encode_name}` | {type_words(field.type)} | {default} | {meaning} |")
        parts.append("\n".join(rows) + "\n")
    return "\n".join(parts)


def structs(kind: type) -> list[type]:
    """A struct and all it is made of, in the order they are met."""
    found: list[type] = []

    def visit(t: Any) -> None:
        if isinstance(t, type) and issubclass(t, msgspec.Struct) and t not in found:
            found.append(t)
            for hint in get_type_hints(t).values():
                visit(hint)
        for inner in get_args(t):
            visit(inner)

    visit(kind)
    return found


def type_words(kind: Any) -> str:
    """A type in words, structs as links to their tables."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        meta, signs = inner[1], {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
        bounds = [(sign, getattr(meta, key)) for key, sign in signs.items()]
        said = [f"{sign} {bound:g}" for sign, bound in bounds if bound is not None and abs(bound) < 1e6]  # no slips
        return f"{type_words(inner[0])} {', '.join(said)}".strip()
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in inner)
    if origin in (Union, UnionType):
        return " or ".join(type_words(kind) for kind in inner if kind is not msgspec.UnsetType)
    if origin is tuple and len(set(inner)) == 1:
        return f"[{', '.join(len(inner) * [type_words(inner[0])])}]"
    if origin is tuple:
        return f"[{', '.join(map(type_words, (t for t in inner if t is not Ellipsis)))}, ...]"
    if origin is list:
        return f"list of {type_words(inner[0])}"
    if origin is dict:
        return f"{type_words(inner[1])} by name"
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return f"[{kind.__name__}](#{kind.__name__.lower()})"
    return {float: "number", int: "whole number", str: "text", bool: "`true` or `false`", type(None): "`null`"}.get(
        kind, f"`{getattr(kind, '__name__', kind)}`"
    )


def attribute_docs(struct: type) -> dict[str, str]:
    """Docstrings under the fields of a class, read from its source."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(struct))).body
    told = {}
    for field, after in zip(tree.body, tree.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            told[field.target.id] = str(after.value.value)
    return told


def plain(field: Any) -> str:
    """A default as it would be written in a file."""
    value = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    if value is msgspec.UNSET:
        return "left out"
    if isinstance(value, msgspec.Struct) and value == type(value)():
        return "`{}`"  # each of its keys has its own default
    return f"`{json.dumps(msgspec.to_builtins(value))}`"


def first_line(thing: Any) -> str:
    """The first line of a docstring."""
    return (inspect.getdoc(thing) or "").partition("\n")[0]


def commands_page() -> str:
    """What every command does, from its docstring."""
    parts = [
        "# Commands\n\nEvery command has `--help`; exit status 0 done, 1 the answer is no, 2 the input is wrong.\n"
    ]
    for name, (target, summary) in COMMANDS.items():
        module, _, attribute = target.partition(":")
        command = getattr(import_module(module), attribute)
        told = command_words(command) if inspect.isfunction(command) else summary
        parts.append(f"## drake-hand {name}\n\n{told}\n")
        if isinstance(command, App):
            for word in sorted(w for w in command if not w.startswith("-")):
                below = command_words(command[word].default_command)
                parts.append(f"### drake-hand {name} {word}\n\n{below}\n")
    return "\n".join(parts)


def command_words(command: Any) -> str:
    """The docstring of a command, its arguments as a list and as they are typed."""
    told, _, arguments = (inspect.getdoc(command) or "").partition("\nArgs:\n")
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        named = [n for meta in get_args(hints[name])[1:] for n in getattr(meta, "name", None) or ()]
        typed = " ".join(named) or f"--{name.replace('_', '-')}"
        if parameter.kind is parameter.POSITIONAL_ONLY:
            typed = name.upper()
        arguments = re.sub(rf"^    {name}:", f"- `{typed}`:", arguments, flags=re.MULTILINE)
    return f"{told}\n{arguments}"


def python_page() -> str:
    """Every public name of the library, with its members, from docstrings and annotations."""
    parts = ["# Python\n\nAll of these are importable from `drake_hand`.\n"]
    for name in drake_hand.__all__:
        thing = getattr(drake_hand, name)
        path = thing.__name__ if inspect.ismodule(thing) else f"{thing.__module__}.{name}"
        parts.append(f"::: {path}\n")
    return "\n".join(parts)
