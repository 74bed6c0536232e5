"""A public class or function of a module has a name that means one thing in the whole package."""

import ast
from collections import defaultdict
from pathlib import Path

import drake_hand

PACKAGE = Path(drake_hand.__file__).parent
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
TYPES = {
    "Axis": "a joint's axis in a finger's chain; the motor of a simulated drive",
    "Contact": "a contact of a plan's part; one that the planner tries",
    "Corridor": "of a task file; rows of the planner's",
    "Cyclic": "a drive's mode as its master plays it, and as it is simulated",
    "Event": "a switch of a finger; what happens to a simulated drive",
    "Fault": "of a run; one that is put into a simulated drive",
    "Hold": "a contact the planner can take; a simulated drive at rest",
    "Physics": "of a task file; of a simulation",
    "Pose": "of a task file; a hand's, in the mirror",
    "Progress": "of the search; of a run on drives",
    "Push": "a step of a task; a push of the object in a run",
    "Record": "a run in physics as it happened; an entry of a PVT queue",
    "Run": "of the planner; in physics; on drives",
    "Schedule": "of positions, for drives; of faults, for simulated ones",
    "Setup": "of the child process with simulated drives; of the one with physics",
    "State": "of the automaton, of a drive, of the search",
    "Switch": "of the automaton; as the search makes it",
    "World": "as the kernels see a scene; physics that drives are simulated in",
}
FUNCTIONS = {
    "build": "MuJoCo's model; the path of an object",
    "check": "the program's answer; what a run on drives refuses; a plan of faults",
    "child": "processes of two commands",
    "error_history": "how a drive's is read; what a simulated drive has",
    "explain": "a file's error; a rehearsal's",
    "lift": "kernels and their front",
    "listen": "to a bus; to a child process",
    "load": "a file; the planner's load on the hand",
    "poses": "of a trajectory; to start from",
    "propose": "a hand file; grasps",
    "release": "drives; the object",
    "replay": "a plan in physics; a log on the mirror",
    "reset_faults": "of drives, and its command's part",
    "resolve": "a name of a file; a fault's time",
    "straight": "kernels and their front",
    "switches": "of the automaton; of a plan's excerpts",
}
"""What these names mean today. Each is to be told apart; nothing may be added."""


def is_command(file: Path, node: Definition) -> bool:
    """Commands are named as a user types them; each shows how in its docstring."""
    return file.parent.name == "cli" and "```console" in (ast.get_docstring(node) or "")


def several() -> dict[str, set[str]]:
    """Names of classes and of functions that stand in several modules, commands left out."""
    where: dict[str, dict[str, set[Path]]] = {"class": defaultdict(set), "function": defaultdict(set)}
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.parse(file.read_text()).body:
            if not isinstance(node, Definition) or node.name.startswith("_") or is_command(file, node):
                continue
            where["class" if isinstance(node, ast.ClassDef) else "function"][node.name].add(file)
    return {kind: {name for name, files in names.items() if len(files) > 1} for kind, names in where.items()}


def test_a_name_means_one_thing():
    for kind, names in several().items():
        known = set(TYPES if kind == "class" else FUNCTIONS)
        assert not names - known, f"defined in several modules: {sorted(names - known)}"
        assert not known - names, f"told apart by now, so strike it off: {sorted(known - names)}"
