"""Pages show what others measured: they import nothing that judges or measures, only what draws a spectrum."""

from __future__ import annotations

import ast
from pathlib import Path

import lin_freq_ocp

PAGES = Path(lin_freq_ocp.__file__).parent / "pages"
FOR_DRAWING = {"ZERO_PADDING", "padded_spectrum", "stopped_runs"}
FACTS = {"facts_where_modes_meet", "tree_of"}  # of a certificate and an outcome
JUDGING = tuple(
    f"lin_freq_ocp.{floor}" for floor in ("problem.measures", "transform.sizes", "certificate", "solving", "methods")
)


def test_only_records_and_spectra_are_imported():
    trees = [ast.parse(path.read_text()) for folder in ("report", "figures") for path in (PAGES / folder).glob("*.py")]
    assert len(trees) > 2
    imports = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    names = {one.name for node in imports if (node.module or "").startswith(JUDGING) for one in node.names}
    assert {name for name in names if not name[0].isupper()} <= FOR_DRAWING | FACTS
    calls = {node.attr for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    assert not calls & {"violation", "gains", "successors"}
