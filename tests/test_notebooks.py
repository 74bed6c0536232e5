"""Notebooks run from top to bottom, and are stored without outputs."""

import os
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


QUICK = "03_finger_kinematics"
"""The others take longer; what they call has tests of its own, and that it is there is checked with all other names."""


def _parameter(file: Path):
    return pytest.param(file, id=file.stem, marks=[] if file.stem == QUICK else [pytest.mark.slow])


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda f: f.stem)
def test_a_notebook_is_stored_clean(file):
    code = [c for c in nbformat.read(file, as_version=4).cells if c.cell_type == "code"]
    assert code
    assert all(not c.outputs and c.execution_count is None for c in code), "clear the outputs before committing"


@pytest.mark.parametrize("file", [_parameter(f) for f in NOTEBOOKS])
def test_a_notebook_runs(file, tmp_path, monkeypatch):
    notebook = nbformat.read(file, as_version=4)
    folder = Path(sys.executable).parent  # whose commands the notebook calls
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
