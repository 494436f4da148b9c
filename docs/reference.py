"""The pages of the reference: one for each namespace, with its public names."""

from __future__ import annotations

from pathlib import Path

import lin_freq_ocp as lfo


def write(folder: Path) -> None:
    """Write index.rst and a page for every namespace; unchanged pages are not written."""
    folder.mkdir(exist_ok=True)
    everyday = [name for name in lfo.__all__ if name not in lfo.NAMESPACES]
    pages = {"everyday": ("Names of everyday use", "lin_freq_ocp", everyday)}
    seen = set(everyday)
    for space in lfo.NAMESPACES:
        public = list(lfo.library.PROBLEMS) if space == "library" else getattr(lfo, space).__all__
        names = [name for name in public if name not in seen]  # each name is described once, in its first namespace
        seen.update(names)
        pages[space] = f"lin_freq_ocp.{space}", f"lin_freq_ocp.{space}", names
    for page, (title, module, names) in pages.items():
        write_namespace(folder / f"{page}.rst", title, module, names)
    listing = "\n".join(f"   {page}" for page in pages)
    text = f"Python\n======\n\nEvery example below is run by the tests.\n\n.. toctree::\n   :maxdepth: 1\n\n{listing}\n"
    write_if_changed(folder / "index.rst", text)


def write_namespace(path: Path, title: str, module: str, names: list[str]) -> None:
    """Write the page of a namespace, with a summary of each name."""
    listing = "\n".join(f"   {name}" for name in names)
    body = f".. currentmodule:: {module}\n\n.. autosummary::\n   :toctree: names\n   :nosignatures:\n\n{listing}\n"
    write_if_changed(path, f"{title}\n{'=' * len(title)}\n\n{body}")


def write_if_changed(path: Path, text: str) -> None:
    """Write a page, unless it has this text already: Sphinx reads changed pages again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(Path(__file__).parent / "api")
