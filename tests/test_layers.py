"""The house has one way through it: rows import only from rows above, and what must stay light stays light."""

import ast
import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import drake_hand

PACKAGE = Path(drake_hand.__file__).parent
_PLANNER = ["errors", "files", "compiled", "model", "plans", "contact", "feedback", "modes", "planning", "motion"]
ROWS = [*_PLANNER, "verify", "physics", "epos", "view", "api", "sweep", "cli"]
EPOS_MAY_USE = {"errors", "files", "plans", "feedback", "epos"}
HEAVY = {"pydrake", "trimesh", "matplotlib", "yourdfpy"}

FILES = sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")
MODULES = sorted(m.name for m in pkgutil.walk_packages([str(PACKAGE)], "drake_hand."))


def imports(file: Path) -> list[tuple[int, str]]:
    """Line and name, below ``drake_hand``, of every import in a file, wherever it stands."""
    found = []
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found += [(node.lineno, a.name) for a in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}:{node.lineno}: relative import"
            whole = [f"{node.module}.{a.name}" for a in node.names]
            found += [(node.lineno, n if n in MODULES else str(node.module)) for n in whole]
    return [(line, n.removeprefix("drake_hand.")) for line, n in found if n.startswith("drake_hand.")]


@pytest.mark.parametrize("file", FILES, ids=lambda f: str(f.relative_to(PACKAGE)))
def test_imports_point_up_the_rows(file: Path) -> None:
    row = file.relative_to(PACKAGE).with_suffix("").parts[0]
    assert row in ROWS, f"new top-level name '{row}': give it a row"
    for line, name in imports(file):
        imported = name.split(".")[0]
        assert ROWS.index(imported) <= ROWS.index(row), f"{file}:{line}: {row} must not import {name}"
        if row == "epos":
            allowed = any(name == a or name.startswith(f"{a}.") for a in EPOS_MAY_USE)
            assert allowed, f"{file}:{line}: epos must not import {name}"


def heavy_after(*steps: str) -> list[str]:
    """Which of some statements, run in turn in a fresh interpreter, first load a heavy package."""
    code = "import sys\nseen = set()\n" + "\n".join(
        f"{step}\nnew = {HEAVY} & set(sys.modules) - seen; seen |= new\nif new: print('heavy:', {step!r}, *new)"
        for step in steps
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    return [line for line in out.splitlines() if line.startswith("heavy:")]


def test_help_and_plain_types_stay_light() -> None:
    help_ = "from drake_hand.cli import run; assert run(['--help']) == 0"
    assert not heavy_after("import drake_hand; drake_hand.Task; drake_hand.Plan", "import drake_hand.cli", help_)


def test_epos_and_command_modules_stay_light() -> None:
    light = [m for m in MODULES if m.startswith(("drake_hand.epos", "drake_hand.cli"))]
    assert not heavy_after(*(f"import {m}" for m in light))


@pytest.mark.parametrize("name", MODULES)
def test_every_public_name_resolves(name: str) -> None:
    if name.startswith("drake_hand.physics.mujoco"):
        pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    module = importlib.import_module(name)
    for public in getattr(module, "__all__", ()):
        getattr(module, public)


def test_top_level_names_resolve() -> None:
    for name in drake_hand.__all__:
        getattr(drake_hand, name)
    assert dir(drake_hand) == sorted([*drake_hand.__all__, "__version__"])
    with pytest.raises(AttributeError, match="no attribute 'Nope'"):
        drake_hand.Nope  # noqa: B018


def test_tests_import_nothing_from_benchmarks() -> None:
    """Benchmarks may lean on tests, whose helpers are checked whenever they run; never the other way round."""
    checkout = Path(__file__).parents[1]
    benchmarks = {file.stem for file in (checkout / "benchmarks").glob("*.py")}
    assert benchmarks
    for file in sorted((checkout / "tests").rglob("*.py")):
        beside = {f.stem for f in file.parent.glob("*.py")}
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            found = benchmarks & {name.split(".")[0] for name in names} - beside
            assert not found, f"{file.relative_to(checkout)}: imports {sorted(found)} from benchmarks"
