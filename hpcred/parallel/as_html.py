"""Show what an object says of itself as HTML in notebooks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape


def as_html(title: str, facts: Mapping[str, object], rows: Sequence[Mapping[str, object]] = (), notes=()) -> str:
    """Return a title, `facts` as a table with a line each, `rows` as a table with a head, and sentences below."""
    left = "style='text-align:left'"
    pairs = [(_cell(key), _cell(value)) for key, value in facts.items()]
    lines = "".join(f"<tr><th {left}>{key}</th><td {left}>{value}</td></tr>" for key, value in pairs)
    blocks = [f"<strong>{escape(title)}</strong>", f"<table>{lines}</table>" if facts else ""]
    if rows:
        head = "".join(f"<th>{_cell(key)}</th>" for key in rows[0])
        body = "".join("<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row.values()) + "</tr>" for row in rows)
        blocks.append(f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>")
    blocks += [f"<p>{escape(note)}</p>" for note in notes]
    return "<div>" + "".join(blocks) + "</div>"


def _cell(value) -> str:
    return escape(f"{value:.6g}" if isinstance(value, float) else str(value))
