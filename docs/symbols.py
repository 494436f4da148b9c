"""Symbols of the glossary: the first of each in the text of a page leads to its meaning."""

from __future__ import annotations

import re
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx

GLOSSARY = Path(__file__).with_name("glossary.md")
BEFORE, AFTER = r"(?<![A-Za-z\\_^{}])", r"(?![A-Za-z_^{])"  # no part of a longer name


def symbols_of(cell: str) -> list[str]:
    """Return the symbols of a cell of the glossary, as TeX, without the sets that they are in.

    Single letters are left out: a page may use them for something else.
    """
    found = (formula.split(r" \in ")[0] for formula in re.findall(r"\$([^$]+)\$", cell))
    return [symbol for symbol in found if len(symbol) > 1]


def listed_symbols() -> dict[str, str]:
    """Return the anchor of each symbol of the glossary."""
    table = GLOSSARY.read_text(encoding="utf-8").partition("## Symbols")[2].partition("\n## ")[0]
    cells = [row.split("|")[1] for row in table.splitlines() if row.startswith("| $")]
    return {symbol: anchor_of(symbol) for cell in cells for symbol in symbols_of(cell)}


def anchor_of(symbol: str) -> str:
    """Return the anchor of a symbol: its letters, in words of their own."""
    return "-".join(["symbol", *re.findall(r"[A-Za-z]+|\*", symbol)]).replace("*", "optimal")


def link_symbols(app: Sphinx, page: nodes.document, name: str) -> None:
    """Make the first of each symbol in the sentences of a page a link, and give the symbols of the glossary anchors."""
    left = listed_symbols()
    if name == "glossary":
        for cell in page.findall(nodes.entry):
            known = [math.astext().split(r" \in ")[0] for math in cell.findall(nodes.math)]
            if cell.parent.index(cell) == 0:
                cell["ids"] += [left.pop(symbol) for symbol in known if symbol in left]
        assert not left, f"glossary.md: no cell has {left}"
        return
    glossary = app.builder.get_relative_uri(name, "glossary")
    for math in page.findall(nodes.math):
        if math.parent is None or isinstance(math.parent, (nodes.title, nodes.reference)):
            continue
        text = math.astext()
        for symbol in sorted(left, key=len, reverse=True):
            place = re.search(BEFORE + re.escape(symbol) + AFTER, text)
            if place is not None and r"\href" not in text:
                link = rf"\href{{{glossary}#{left.pop(symbol)}}}{{{symbol}}}"
                text = text[: place.start()] + link + text[place.end() :]
        if text != math.astext():
            math.children[:] = [nodes.Text(text)]
            math["latex"] = text
