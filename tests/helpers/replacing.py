"""Replacements of what a room of the package names, wherever the package uses it, for one test."""

from __future__ import annotations

import re
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import lin_freq_ocp as lfo

PACKAGE = Path(lfo.__file__).parent
APART = {"__main__", "lfo_check"}  # programs of their own


def substitute(patch: pytest.MonkeyPatch, name: str, new: object) -> None:
    """Replace a function or a constant, such as ``solving.solve_judged``, in every module of the package that has it.

    Only what a room lists in ``__all__`` can be replaced; no test has to know where it is defined and who imports it.
    """
    path, _, name = f"lin_freq_ocp.{name}".rpartition(".")
    room = import_module(path)
    assert name in room.__all__, f"{path} does not list {name}"
    old = getattr(room, name)
    for module in modules_with(name):
        if vars(module).get(name) is old:
            patch.setattr(module, name, new)


def modules_with(name: str) -> list[ModuleType]:
    """Import and return the modules whose text has a name: one that is imported during the test would keep the new."""
    return [import_module(module) for module, text in texts().items() if re.search(rf"\b{name}\b", text)]


@cache
def texts() -> dict[str, str]:
    """Return the text of every module by its dotted name."""
    paths = [path for path in sorted(PACKAGE.rglob("*.py")) if path.stem not in APART]
    return {dotted(path): path.read_text(encoding="utf-8") for path in paths}


def dotted(path: Path) -> str:
    """Return the dotted name of a module."""
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
