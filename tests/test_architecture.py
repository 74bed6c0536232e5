"""The page about the rows of the package says what is so; the planner says why it is as it is."""

import ast
import sys
from pathlib import Path

import drake_hand

DOCS = Path(__file__).parents[1] / "docs"


def test_page_is_what_the_layers_are(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(DOCS), *sys.path])
    import render_architecture

    written = render_architecture.TARGET.read_text(encoding="utf-8")
    assert written == render_architecture.render(), "run python docs/render_architecture.py"


def test_every_module_of_the_planner_says_why_it_is_as_it_is():
    files = sorted((Path(drake_hand.__file__).parent / "planning").rglob("*.py"))
    assert len(files) > 40
    for file in files:
        head = ast.get_docstring(ast.parse(file.read_text())) or ""
        assert head.partition("\n\n")[2], f"{file.name}: no paragraph under its first line"
