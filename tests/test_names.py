"""A public class, function or constant of a module has a name that means one thing in the whole package."""

import ast
from collections import defaultdict
from pathlib import Path

import drake_hand

PACKAGE = Path(drake_hand.__file__).parent
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def is_command(file: Path, node: Definition) -> bool:
    """Commands are named as a user types them; each shows how in its docstring."""
    return file.parent.name == "cli" and "```console" in (ast.get_docstring(node) or "")


def constants(node: ast.stmt) -> set[str]:
    """Public names in capitals that a statement assigns; type variables are no constants."""
    value = getattr(node, "value", None)
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "TypeVar":
        return set()
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    names = {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}
    return {name for name in names if name.isupper() and not name.startswith("_")}


def several() -> dict[str, set[str]]:
    """Names of classes, functions and constants that several modules define, commands left out."""
    where: dict[str, dict[str, set[Path]]] = {kind: defaultdict(set) for kind in ("class", "function", "constant")}
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.parse(file.read_text()).body:
            for name in constants(node):
                where["constant"][name].add(file)
            if not isinstance(node, Definition) or node.name.startswith("_") or is_command(file, node):
                continue
            where["class" if isinstance(node, ast.ClassDef) else "function"][node.name].add(file)
    return {kind: {name for name, files in names.items() if len(files) > 1} for kind, names in where.items()}


def test_a_name_means_one_thing():
    for kind, names in several().items():
        assert not names, f"a {kind} defined in several modules: {sorted(names)}"
