"""The structure of the package in figures, each beside its limit; exit status 1 if one is beyond it. Part of .ci/run.

    python scripts/structure.py

Circles of files count every import, within functions and for type checkers too. Lines of functions are counted without
their docstrings. isinstance on kinds of dynamics and of terms is what their protocols replace.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import grimp
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

import lin_freq_ocp as lfo

PACKAGE = Path(lfo.__file__).parent

TERMS = ("terms", "sets", "costs", "spectrum")
"""Folders of problem/ whose classes are terms of a problem."""

LIMITS = {
    "lines": 62_000,
    "files in a folder": 12,
    "lines of a file": 400,
    "lines of a function": 50,
    "files in circles": 0,
    "isinstance on dynamics": 3,
    "isinstance on terms": 6,
    "Any": 27,
    "names in __all__": 53,
}


def functions(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield the names of functions and their lines without docstrings."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            docstring = node.body[0] if ast.get_docstring(node) else None
            described = 0 if docstring is None else (docstring.end_lineno or 0) - docstring.lineno + 1
            yield node.name, (node.end_lineno or 0) - node.lineno + 1 - described


def kinds(trees: dict[Path, ast.Module], folder: str) -> set[str]:
    """Return the names of the concrete classes in a folder of problem/: those of another class of the package."""
    inside = PACKAGE / "problem" / folder
    found = (node for path, tree in trees.items() if path.parent == inside for node in ast.walk(tree))
    return {node.name for node in found if isinstance(node, ast.ClassDef) and node.bases and not abstract(node)}


def abstract(node: ast.ClassDef) -> bool:
    """Whether a class is an interface."""
    return any(isinstance(base, ast.Name) and base.id in ("ABC", "Protocol", "Enum", "StrEnum") for base in node.bases)


def tests_of(trees: dict[Path, ast.Module], names: set[str]) -> int:
    """Return how many calls of isinstance name one of these classes."""
    calls = (node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.Call))
    return sum(
        isinstance(call.func, ast.Name)
        and call.func.id == "isinstance"
        and any(isinstance(part, ast.Name) and part.id in names for part in ast.walk(call.args[1]))
        for call in calls
    )


def uses_of_any(tree: ast.Module) -> int:
    """Return how often a module says that a type is anything."""
    return sum(isinstance(node, ast.Name) and node.id == "Any" for node in ast.walk(tree))


def files_in_circles() -> list[str]:
    """Return the modules that import themselves by way of others."""
    graph = grimp.build_graph("lin_freq_ocp", cache_dir=None)
    modules = sorted(graph.modules)
    number = {name: i for i, name in enumerate(modules)}
    pairs = [(number[a], number[b]) for a in modules for b in graph.find_modules_directly_imported_by(a)]
    rows, columns = np.array(pairs).T
    edges = csr_array((np.ones(len(pairs)), (rows, columns)), shape=(len(modules), len(modules)))
    _, group = connected_components(edges, connection="strong")
    sizes = np.bincount(group)
    return [name for name, i in number.items() if sizes[group[i]] > 1]


def measures() -> dict[str, tuple[int, str]]:
    """Return every figure, and where it is met."""
    paths = sorted(PACKAGE.rglob("*.py"))
    texts = {path: path.read_text() for path in paths}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    lines = {str(path.relative_to(PACKAGE)): len(text.splitlines()) for path, text in texts.items()}
    sizes = [(size, f"{path.name}: {name}") for path, tree in trees.items() for name, size in functions(tree)]
    folders = Counter(str(path.parent.relative_to(PACKAGE)) for path in paths if path.name != "__init__.py")
    largest, fullest = max(lines, key=lambda name: lines[name]), max(folders, key=lambda name: folders[name])
    circles = files_in_circles()
    return {
        "lines": (sum(lines.values()), ""),
        "files in a folder": (folders[fullest], fullest),
        "lines of a file": (lines[largest], largest),
        "lines of a function": max(sizes),
        "files in circles": (len(circles), ", ".join(circles[:3])),
        "isinstance on dynamics": (tests_of(trees, kinds(trees, "dynamics")), ""),
        "isinstance on terms": (tests_of(trees, set().union(*(kinds(trees, folder) for folder in TERMS))), ""),
        "Any": (sum(uses_of_any(tree) for tree in trees.values()), ""),
        "names in __all__": (len(lfo.__all__), ""),
    }


def main() -> None:
    """Print the figures, and exit with 1 if one is beyond its limit."""
    table, beyond = Table("figure", "is", "limit", "where", title="structure of the package"), False
    for name, (value, where) in measures().items():
        beyond |= value > LIMITS[name]
        table.add_row(name, f"{value}", f"{LIMITS[name]}", where, style="red" if value > LIMITS[name] else None)
    Console().print(table)
    sys.exit(int(beyond))


if __name__ == "__main__":
    main()
