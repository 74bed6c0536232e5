"""A public class, function or constant of a module has a name that means one thing in the whole package."""

import ast
import re
from collections import defaultdict
from pathlib import Path

import drake_hand

PACKAGE = Path(drake_hand.__file__).parent
UNIT = re.compile(
    "_(M|MM|IN|DEG|RAD|S|MS|S2|S3|N|NM|KG|HZ|PA|M2|M3|A|TICKS|SYNCS)$"
    "|(SHARES?|RATIOS?|RADII|COS|FACTORS?|CHANCE|FRICTION|SCORE|COST|WEIGHT|PENALTY|GAIN|OPACITY|IMPEDANCE|IMPRATIO)$"
    "|(TOLERANCE|MARGIN|PIVOT|SCALE|CONDITION|NUMBER|COLOR|TONES|DIRECTION|CHANGE|ERROR|GRAVITY|THRESHOLDS|LIMIT|INERTIA)$"
)
"""With what the name of a number that is no count ends: its unit, or what says that it has none or several."""
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


def measures() -> set[str]:
    """Names in capitals of numbers that are no counts, public or not."""
    found = set()
    for file in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(file.read_text())
        for node in [n for body in (tree, *(c for c in tree.body if isinstance(c, ast.ClassDef))) for n in body.body]:
            if not isinstance(node, ast.Assign):
                continue
            (target,), value = node.targets, node.value
            both = isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)
            for name, part in zip(target.elts, value.elts, strict=True) if both else [(target, value)]:
                if isinstance(name, ast.Name) and name.id.isupper() and is_measure(part):
                    found.add(name.id)
    return found


def is_measure(value: ast.expr) -> bool:
    """Whether an expression is a float, or some of them, or an angle."""
    called = {ast.unparse(n.func) for n in ast.walk(value) if isinstance(n, ast.Call)}
    if not called <= {"np.radians", "math.radians", "np.cos", "np.array"} or isinstance(value, ast.Dict):
        return False
    return bool(called & {"np.radians", "math.radians"}) or any(
        isinstance(n, ast.Constant) and isinstance(n.value, float) for n in ast.walk(value)
    )


def test_the_name_of_a_number_says_its_unit():
    assert len(measures()) > 100
    assert not {name for name in measures() if not UNIT.search(name)}
