"""The built wheel, in an empty environment and away from the checkout, plans a bundled task."""

import json
import re
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def bin_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scripts of a venv that holds the wheel and sees the dependencies of this one, but not the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(CHECKOUT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "venv", with_pip=False)
    python = folder / "venv" / "bin" / "python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder / "venv")}))
    # A path named in a .pth file gives modules, but its own .pth files (the editable install) are not followed.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    return python.parent


def run(bin_dir: Path, cwd: Path, *command: str) -> str:
    job = subprocess.run([str(bin_dir / command[0]), *command[1:]], cwd=cwd, capture_output=True, text=True)
    assert job.returncode == 0, job.stderr
    assert "compiling" not in job.stderr
    return job.stdout


def test_wheel_is_what_runs_and_brings_its_data(bin_dir, tmp_path):
    code = (
        "import drake_hand.files as f; print(f.__file__); print(f.data_dir()); print(*f.bundled('hands', '.hand.yaml'))"
    )
    file, data, hands = run(bin_dir, tmp_path, "python", "-c", code).splitlines()
    assert file.startswith(str(bin_dir.parent))
    assert data.startswith(str(bin_dir.parent))
    assert {"kanguera", "quartet", "trio"} <= set(hands.split())


def test_wheel_plans_checks_and_shows_a_bundled_task_and_compiles_nothing(bin_dir, tmp_path):
    answer = run(bin_dir, tmp_path, "drake-hand", "plan", "carry", "-o", "carry.plan.json", "--json")
    assert json.loads(answer)["status"] == "certified"
    assert json.loads(run(bin_dir, tmp_path, "drake-hand", "check", "carry.plan.json", "--json"))["certified"]
    run(bin_dir, tmp_path, "drake-hand", "show", "carry.plan.json", "--html", "carry.html")
    assert "dh-data" in (tmp_path / "carry.html").read_text()


def test_links_of_its_page_lead_somewhere(bin_dir):
    """PyPI shows the README away from the repository, where relative links and pictures lead nowhere."""
    (metadata,) = bin_dir.parent.glob("lib/python*/site-packages/drake_hand-*.dist-info/METADATA")
    text = metadata.read_text()
    assert "Description-Content-Type: text/markdown" in text
    page = text.partition("\n\n")[2]
    assert "docs/physics.md" in (CHECKOUT / "README.md").read_text()
    assert "hardware.md has the full procedure" in page
    assert [link for link in re.findall(r"\]\(([^)]*)\)", page) if not link.startswith(("https:", "#"))] == []


def test_its_metadata_says_who_what_and_where(bin_dir):
    (metadata,) = bin_dir.parent.glob("lib/python*/site-packages/drake_hand-*.dist-info/METADATA")
    head = metadata.read_text().partition("\n\n")[0]
    known = {line.partition(": ")[0] for line in head.splitlines()}
    assert {"Author", "Keywords", "Classifier", "Project-URL", "License-Expression", "Requires-Python"} <= known
    extras = {line.partition(": ")[2] for line in head.splitlines() if line.startswith("Provides-Extra")}
    assert {"notebook", "mujoco", "sweep", "docs"} <= extras
