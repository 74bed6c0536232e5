"""Nothing public in drake_hand is there for tests alone: the package or a notebook uses each."""

import ast
import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import drake_hand

PACKAGE = Path(drake_hand.__file__).parent
TREES = {file.relative_to(PACKAGE): ast.parse(file.read_text()) for file in sorted(PACKAGE.rglob("*.py"))}
NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def definitions(tree: ast.Module) -> Iterator[tuple[str, Definition]]:
    """Public functions, classes and methods as (name below the module, node)."""
    for node in tree.body:
        if isinstance(node, Definition) and not node.name.startswith("_"):
            yield node.name, node
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for inner in node.body:
                if isinstance(inner, Definition) and not inner.name.startswith("_"):
                    yield f"{node.name}.{inner.name}", inner


def is_entry(tree: ast.Module, node: Definition, name: str) -> bool:
    """Called by a library: commands by their decorator, methods that override those of a base class outside."""
    registered = [ast.unparse(d) for d in node.decorator_list]
    if any(d.split("(")[0].endswith((".command", ".default", "njit", ".setter")) for d in registered):
        return True
    owner = next((c for c in tree.body if isinstance(c, ast.ClassDef) and c.name == name.split(".")[0]), None)
    return "." in name and owner is not None and bool(OUTSIDE & {ast.unparse(b) for b in owner.bases})


OUTSIDE = {"threading.Thread", "can.Listener", "logging.Handler", "canopen.LocalNode", "canopen.RemoteNode"}


class Module:
    """What a module mentions, read once."""

    def __init__(self, file: Path, tree: ast.Module) -> None:
        parts = file.with_suffix("").parts
        self.tree = tree
        self.name = ".".join(("drake_hand", *(parts[:-1] if parts[-1] == "__init__" else parts)))
        nodes = list(ast.walk(tree))
        self.names, self.attributes = mentions(nodes)
        texts = [n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)]
        self.texts = {text.split(":")[-1].split(".")[-1] for text in texts if len(text) < 80}
        self.texts |= {
            name for text in texts for name in re.findall(r"^from drake_hand\S* import (\w+); \1\(\)$", text)
        }
        """Names by which others find what they call: ``module:name``, lazy imports, code of a child process."""
        self.imported: dict[str, str] = {}
        """``module.name`` (of a module, too) and what it is called here."""
        for node in nodes:
            if isinstance(node, ast.ImportFrom):
                self.imported |= {f"{node.module}.{a.name}": a.asname or a.name for a in node.names}
            elif isinstance(node, ast.Import):
                self.imported |= {a.name: a.asname or a.name for a in node.names}

    def uses(self, module: str, name: str) -> bool:
        """Whether it uses a function or class of another module."""
        local = self.imported.get(f"{module}.{name}")
        return (local is not None and self.names[local] > 0) or (module in self.imported and self.attributes[name] > 0)


def mentions(nodes: list[ast.AST]) -> tuple[Counter[str], Counter[str]]:
    """How often names are read or called, as plain names and behind a dot."""
    names = Counter(node.id for node in nodes if isinstance(node, ast.Name))
    return names, Counter(node.attr for node in nodes if isinstance(node, ast.Attribute))


def notebook(file: Path) -> Module:
    """What the code of a notebook mentions; what IPython alone understands is left out."""
    cells = [c["source"] for c in json.loads(file.read_text())["cells"] if c["cell_type"] == "code"]
    lines = [line for cell in cells for line in "".join(cell).splitlines() if not line.startswith(("%", "!"))]
    return Module(Path(file.name), ast.parse("\n".join(lines)))


def unused() -> set[str]:
    """``module.name`` of what nothing mentions but its own definition and others that are unused.

    Methods are told by their name alone: one that shares it with a method in use is not found.
    """
    modules = [Module(file, tree) for file, tree in TREES.items()]
    users = [*modules, *map(notebook, NOTEBOOKS)]
    open_ = [(m, name, node) for m in modules for name, node in definitions(m.tree)]
    found: set[str] = set()
    while True:
        behind_dots = sum((m.attributes for m in users), Counter())
        texts = set().union(*(m.texts for m in modules))
        new = []
        for m, name, node in open_:
            last = name.split(".")[-1]
            if last in texts or is_entry(m.tree, node, name):
                continue
            own_names, own_attributes = mentions(list(ast.walk(node)))
            if "." in name:
                used = behind_dots[last] > own_attributes[last]
            else:
                used = m.names[last] > own_names[last] or any(o.uses(m.name, last) for o in users if o is not m)
            if not used:
                new.append((m, name, node))
        if not new:
            return found
        for m, name, node in new:
            open_.remove((m, name, node))
            found.add(f"{m.name}.{name}")
            names, attributes = mentions(list(ast.walk(node)))
            m.names.subtract(names)
            m.attributes.subtract(attributes)


def test_no_public_name_is_for_tests_alone():
    assert not unused()
