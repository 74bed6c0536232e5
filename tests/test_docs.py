"""The documentation builds without warnings, names every key, and shows commands that exist."""

import re
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from drake_hand.cli import COMMANDS
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


def test_schemas_are_there_for_editors(site):
    schema = msgspec.json.decode((site / "reference" / "task.schema.json").read_bytes())
    assert set(schema["$defs"]["Options"]["properties"]) == {f.name for f in msgspec.structs.fields(Options)}


def test_pages_ask_no_network_for_fonts(site):
    assert "fonts.googleapis" not in (site / "index.html").read_text()


def test_commands_shown_exist():
    told = [line for file in (ROOT / "docs").glob("*.md") for line in file.read_text().splitlines()]
    names = {m[1] for line in told for m in re.finditer(r"\$ drake-hand (\w+)", line)}
    assert names
    assert names <= set(COMMANDS)
