"""Check the built site: every local link leads to a file, and no page loads anything from a network."""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}  # what a browser fetches


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
    """Return the broken links of a page, a line each."""
    wrong = list[str]()
    for tag, address in Links(page.read_text(encoding="utf-8")).found:
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
    print("\n".join(found) if found else f"{len(pages)} pages, every local link leads to a file")
    raise SystemExit(bool(found))
