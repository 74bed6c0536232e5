"""A small table in HTML, for what shows itself in a notebook cell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], *, note: str = "") -> str:
    """A titled table; cells are escaped, numbers have three digits."""

    def text(cell: object) -> str:
        return escape(f"{cell:.3g}" if isinstance(cell, float) else str(cell))

    head = "".join(f"<th style='text-align: left'>{escape(c)}</th>" for c in columns)
    body = "".join(
        "<tr>" + "".join(f"<td style='text-align: left'>{text(c)}</td>" for c in row) + "</tr>" for row in rows
    )
    small = f"<div>{escape(note)}</div>" if note else ""
    return f"<div><b>{escape(title)}</b></div>{small}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
