"""The documentation builds without warnings, names every key, and shows commands that exist."""

import enum
import inspect
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

import drake_hand
from drake_hand.cli.app import build_app
from drake_hand.epos.drives import Drives
from drake_hand.plans.task import Options, Physics, Rotate

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    pytest.importorskip("mkdocs", reason="needs mkdocs: pip install drake_hand[docs]")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-f", "mkdocs.yml", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def test_reference_names_every_key_and_its_meaning(site):
    page = (site / "reference" / "task" / "index.html").read_text()
    for kind in (Options, Physics, Rotate):
        for field in msgspec.structs.fields(kind):
            assert f"<code>{field.name}</code>" in page
    assert "lets the planner choose how the palm is turned" in page
    assert "home_deg" in (site / "reference" / "hand" / "index.html").read_text()


@pytest.mark.parametrize("name", ["task", "hand", "drives", "plan"])
def test_no_key_is_without_a_meaning_and_types_are_words(site, name):
    page = (site / "reference" / name / "index.html").read_text()
    assert page.count("<td>") > 20
    assert "<td></td>" not in page
    assert "typing." not in page


def test_schemas_are_there_for_editors(site):
    schema = msgspec.json.decode((site / "reference" / "task.schema.json").read_bytes())
    assert set(schema["$defs"]["Options"]["properties"]) == {f.name for f in msgspec.structs.fields(Options)}


def test_the_library_is_told_with_members_and_arguments(site):
    page = (site / "reference" / "python" / "index.html").read_text()
    for name in drake_hand.__all__:
        thing = getattr(drake_hand, name)
        path = thing.__name__ if inspect.ismodule(thing) else f"{thing.__module__}.{name}"
        assert f'id="{path}"' in page
        told = [m for m, what in vars(thing).items() if not m.startswith("_") and inspect.getdoc(what)]
        for member in told if inspect.isclass(thing) and not issubclass(thing, enum.Enum) else []:
            if inspect.isfunction(vars(thing)[member]) or isinstance(vars(thing)[member], (property, classmethod)):
                assert f'id="{path}.{member}"' in page, (name, member)
    assert "drake_hand.api.solve" in page
    assert "called with how far planning has come" in page


def test_commands_are_told_with_their_options_as_typed(site):
    page = (site / "reference" / "commands" / "index.html").read_text()
    for typed in ("TASK", "--output -o", "--time-limit", "--all", "--host"):
        assert f"<li><code>{typed}</code>: " in page
    for below in ("hand check", "hand init", "drives zero", "drives off"):
        assert f"drake-hand {below}<" in page


def test_pages_ask_no_network_for_fonts(site):
    assert "fonts.googleapis" not in (site / "index.html").read_text()


THEORY = (ROOT / "docs" / "theory.md").read_text()


def test_what_the_theory_names_is_there():
    names = re.findall(r"`((?:\w+\.)+\w+)`", THEORY)
    assert "contact.kinematics.SubmodelKinematics.velocities" in names
    for name in names:
        assert pkgutil.resolve_name(f"drake_hand.{name}") is not None


@pytest.mark.parametrize(("word", "last"), [("Eq", 4), ("Fig", 16)])
def test_the_theory_has_every_equation_and_figure(word, last):
    """Of the paper; its first two figures are photographs."""
    found = set()
    for said in re.findall(rf"{word}s?\. ((?:\(?\d+\)?(?: to | and |, )?)+)", THEORY):
        numbers = re.sub(r"(\d+) to (\d+)", lambda m: " ".join(map(str, range(int(m[1]), int(m[2]) + 1))), said)
        found |= set(map(int, re.findall(r"\d+", numbers)))
    assert found >= set(range(3 if word == "Fig" else 1, last + 1))


def shown() -> list[str]:
    """Every `$ command` of README and documentation, without what is said about it."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    lines = [line for page in pages for line in page.read_text().splitlines() if line.startswith("$ ")]
    return sorted({re.sub(r"\s+#.*|\s\|.*", "", line.removeprefix("$ ")) for line in lines})


OURS = [command.removeprefix("drake-hand ") for command in shown() if command.startswith("drake-hand")]


@pytest.mark.parametrize("command", OURS)
def test_commands_shown_are_understood(command):
    tokens = shlex.split(command)
    if tokens[0] in ("drives", "execute") and "--drives" not in tokens:
        tokens += ["--drives", "my.drives.yaml"]  # as the page says of its list
    _, _, left, *_ = build_app(tokens).parse_known_args(tokens)
    assert not left


ELSEWHERE = {
    "execute carry": "epos/morning_commands.py",
    "execute": "test_docs_on_drives.py",
    **{f"drives {word}": "test_docs_on_drives.py" for word in ("scan", "status", "off", "home", "goto", "zero")},
    "mirror": "test_docs_on_drives.py",
    "sweep": "sweep/test_sweep.py",
    "plot my.run.npz": "test_docs_on_drives.py",
    "plot today.run.npz": "test_docs_on_drives.py",
}
"""Commands shown that need drives or a file of their own: by which tests they are run."""
ELSEWHERE_ONLY = {
    "sudo ip": "needs a CAN interface",
    "make": "builds an environment: what continuous integration does",
    "pip": "asks a package index",
    "python benchmarks": "takes minutes to hours",
    **{f"drake-hand {command}": f"run by tests/{file}" for command, file in ELSEWHERE.items()},
}
"""Beginnings of commands that are not run here, and why."""
MADE_BY = {
    "my.plan.json": "plan my.task.yaml -o my.plan.json",
    "my.hand.yaml": "hand init my_hand.urdf -o my.hand.yaml",
    **{f"{name}.plan.json": f"plan {name} -o {name}.plan.json" for name in ("spin", "carry")},
}
"""Files that commands shown take for granted, and the command shown that makes each."""


def test_commands_run_elsewhere_are_named_there():
    for command, file in ELSEWHERE.items():
        if file != "test_docs_on_drives.py":  # which takes them from the pages
            assert command.split()[0] in (ROOT / "tests" / file).read_text(), command


@pytest.fixture(scope="module")
def desk(tmp_path_factory) -> Path:
    """A folder with what a reader has before the first command."""
    folder = tmp_path_factory.mktemp("desk")
    task = re.search(r"```yaml\n(hand:.*?)```", (ROOT / "docs" / "write_a_task.md").read_text(), re.DOTALL).group(1)
    (folder / "my.task.yaml").write_text(task)
    cube = (ROOT / "docs" / "gallery" / "cube.task.yaml").read_text()
    (folder / "cube.task.yaml").write_text(cube.replace("time_limit_s: 60", "time_limit_s: 600"))  # on a busy machine
    shutil.copy(Drives.load().file, folder / "my.drives.yaml")
    shutil.copytree(ROOT / "urdf" / "hands" / "trio", folder, dirs_exist_ok=True)
    (folder / "trio.urdf").rename(folder / "my_hand.urdf")
    (folder / "trio.hand.yaml").unlink()
    return folder


def done(command: str, folder: Path) -> None:
    """Runs a command as typed there."""
    code = "from drake_hand.cli import main; main()"
    ran = subprocess.run(
        [sys.executable, "-c", code, *shlex.split(command)], cwd=folder, capture_output=True, text=True
    )
    assert ran.returncode == 0, (command, ran.stderr[-1000:])


@pytest.mark.slow
@pytest.mark.parametrize("command", shown())
def test_a_command_shown_runs(command, desk):
    """Seconds of planning or physics each, some a minute or two."""
    alone = "--dry-run" in command or command.endswith("--simulate")
    reason = next((why for start, why in ELSEWHERE_ONLY.items() if command.startswith(start)), None)
    if reason and not alone:
        pytest.skip(reason)
    tokens = command.split()[1:]
    for name, making in MADE_BY.items():
        if name in tokens and not (desk / name).exists() and " ".join(tokens) != making:
            done(making, desk)
    for name in {name for name, making in MADE_BY.items() if " ".join(tokens) == making}:
        (desk / name).unlink(missing_ok=True)  # one that is there is not overwritten
    shows = "show" in tokens[:2]  # would serve the page until interrupted
    done(" ".join(tokens) + (" --html page.html" if shows else ""), desk)
