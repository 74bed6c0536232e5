"""Writes architecture.md: the rows of the package, what each is for, and which rows it really imports from.

python docs/render_architecture.py
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))
from test_layers import EPOS_MAY_USE, FILES, HEAVY, PACKAGE, ROWS, imports  # noqa: E402

TARGET = HERE / "architecture.md"
PAGE = """# Architecture

Written by `python docs/render_architecture.py` from what `tests/test_layers.py` checks, not by hand.

The package is a stack of rows. A row imports only from rows above it in this table, never from one below.
`epos` imports only from {epos_uses}. `epos`, `cli`, and the types of tasks and plans load without {heavy}.

| row | what it is for | imports from |
|---|---|---|
{table}

An arrow means *imports from*. Where one row reaches another through a third, the direct arrow is left out.

```mermaid
flowchart BT
{arrows}
```
"""


def row_of(file: Path) -> str:
    """The row a module belongs to."""
    return file.relative_to(PACKAGE).with_suffix("").parts[0]


def purpose(row: str) -> str:
    """The first line of its docstring."""
    folder = PACKAGE / row
    file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    return (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").partition("\n")[0]


def used() -> dict[str, set[str]]:
    """By row: the rows it imports from, itself apart."""
    found: dict[str, set[str]] = {row: set() for row in ROWS}
    for file in FILES:
        row = row_of(file)
        found[row] |= {name.split(".")[0] for _, name in imports(file)} & set(ROWS) - {row}
    return found


def render() -> str:
    """The page."""
    rows = used()
    below: dict[str, set[str]] = {}
    for row in ROWS:
        below[row] = rows[row].union(*(below[r] for r in rows[row]))
    arrows = [
        f"  {row} --> {other}"
        for row in ROWS
        for other in ROWS
        if other in rows[row] and not any(other in below[r] for r in rows[row])
    ]
    table = [f"| `{row}` | {purpose(row)} | {', '.join(r for r in ROWS if r in rows[row]) or '-'} |" for row in ROWS]
    epos_uses = ", ".join(f"`{row}`" for row in ROWS if row in EPOS_MAY_USE - {"epos"})
    heavy = ", ".join(sorted(HEAVY))
    return PAGE.format(epos_uses=epos_uses, heavy=heavy, table="\n".join(table), arrows="\n".join(arrows))


if __name__ == "__main__":
    TARGET.write_text(render(), encoding="utf-8")
