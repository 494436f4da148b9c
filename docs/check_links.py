"""Check the built site: links lead to files, no page loads anything from a network, and formulas are no text."""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}  # what a browser fetches
# Formulas, which a browser sets, and code; and what only the source of a formula has.
SET = re.compile(r'<(span|div) class="math.*?</\1>|<(pre|code|script)\b.*?</\2>', re.DOTALL)
SOURCE = re.compile(r"\$\$|\\(?:eta|hat|langle|le|ge|sum|top)\b")


class Links(HTMLParser):
    """The links of a page: (tag, address)."""

    def __init__(self, text: str):
        super().__init__()
        self.found = list[tuple[str, str]]()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the links and the sources of a page."""
        address = dict(attrs).get("href" if tag == "a" else LOADED.get(tag, ""))
        if address:
            self.found.append((tag, address))


def faults(page: Path, site: Path) -> list[str]:
    """Return the broken links and the formulas left as text of a page, a line each."""
    text = page.read_text(encoding="utf-8")
    wrong = [f"{page.relative_to(site)}: {found}: a formula as text" for found in SOURCE.findall(SET.sub("", text))]
    for tag, address in Links(text).found:
        parts = urlsplit(address)
        where = f"{page.relative_to(site)}: <{tag}> {address}"
        if parts.scheme in ("data", "mailto"):
            continue
        if parts.scheme or parts.netloc:
            wrong += [f"{where}: loaded from a network"] if tag in LOADED else []
        elif parts.path and not (page.parent / unquote(parts.path)).exists():
            wrong.append(f"{where}: no such file")
    return wrong


if __name__ == "__main__":
    root = Path(sys.argv[1])
    pages = sorted(root.rglob("*.html"))
    found = [fault for page in pages for fault in faults(page, root)]
    print("\n".join(found) if found else f"{len(pages)} pages, every local link leads to a file, every formula is set")
    raise SystemExit(bool(found))
