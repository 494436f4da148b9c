"""Small tables in HTML, as notebooks show objects: escaped, with nothing loaded from anywhere."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

MOST_TABLE_ROWS = 24  # a table says how many more there are
LABEL = "text-align:left;vertical-align:top;font-weight:normal;opacity:0.7;white-space:nowrap;padding-right:1em"
VALUE = "text-align:left;vertical-align:top;overflow-wrap:anywhere"


def html_table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return a table of terms and values under a title."""
    given = list(rows)
    shown = given[:MOST_TABLE_ROWS]
    if len(given) > len(shown):
        shown.append(("\N{HORIZONTAL ELLIPSIS}", f"{len(given) - len(shown)} more"))
    body = "".join(
        f'<tr><th style="{LABEL}">{escape(term)}</th><td style="{VALUE}">{escape(value)}</td></tr>'
        for term, value in shown
    )
    caption = f'<caption style="text-align:left;font-weight:bold">{escape(title)}</caption>'
    return f"<table>{caption}<tbody>{body}</tbody></table>"
