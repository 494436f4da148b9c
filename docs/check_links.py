"""Check the built site: every local link leads to a file, and no page loads anything from a network."""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}  # fetched by a browser


class Links(HTMLParser):
    """The links of a page: (tag, address)."""

    def __init__(self, text: str):
        super().__init__()
        self.addresses = list[tuple[str, str]]()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the address of each tag that links or loads."""
        address = dict(attrs).get("href" if tag == "a" else LOADED.get(tag, ""))
        if address:
            self.addresses.append((tag, address))


def link_faults(page: Path, site: Path) -> list[str]:
    """Return the faulty links of a page, one line each."""
    lines = list[str]()
    for tag, address in Links(page.read_text(encoding="utf-8")).addresses:
        parts = urlsplit(address)
        place = f"{page.relative_to(site)}: <{tag}> {address}"
        if parts.scheme in ("data", "mailto"):
            continue
        if parts.scheme or parts.netloc:
            lines += [f"{place}: loaded from a network"] if tag in LOADED else []
        elif parts.path and not (page.parent / unquote(parts.path)).exists():
            lines.append(f"{place}: no such file")
    return lines


if __name__ == "__main__":
    root = Path(sys.argv[1])
    pages = sorted(root.rglob("*.html"))
    faults = [fault for page in pages for fault in link_faults(page, root)]
    print("\n".join(faults) if faults else f"{len(pages)} pages, every local link leads to a file")
    raise SystemExit(bool(faults))
