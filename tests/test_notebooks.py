"""Notebooks run from top to bottom, and are stored without outputs."""

import os
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


SLOW = {"01_quick_start", "05_forces_and_physics", "06_your_own_hand", "07_drives"}
"""They plan in equilibrium, simulate, or keep time."""


def _parameter(file: Path):
    return pytest.param(file, id=file.stem, marks=[pytest.mark.slow] if file.stem in SLOW else [])


@pytest.mark.parametrize("file", [_parameter(f) for f in NOTEBOOKS])
def test_notebook_runs_and_is_stored_clean(file, tmp_path, monkeypatch):
    notebook = nbformat.read(file, as_version=4)
    folder = Path(sys.executable).parent  # whose commands the notebook calls
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    code = [c for c in notebook.cells if c.cell_type == "code"]
    assert code
    assert all(not c.outputs and c.execution_count is None for c in code), "clear the outputs before committing"
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
