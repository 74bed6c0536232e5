"""The page about the rows of the package says what is so."""

import sys
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def test_page_is_what_the_layers_are(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(DOCS), *sys.path])
    import render_architecture

    written = render_architecture.TARGET.read_text(encoding="utf-8")
    assert written == render_architecture.render(), "run python docs/render_architecture.py"
