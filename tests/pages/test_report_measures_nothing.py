"""The report shows what others measured: it imports nothing that judges or measures, only what draws a spectrum."""

from __future__ import annotations

import ast
from pathlib import Path

import lin_freq_ocp

PACKAGE = Path(lin_freq_ocp.__file__).parent / "report"
FOR_DRAWING = {"ZERO_PADDING", "padded_spectrum", "stopped_runs"}
JUDGING = ("lin_freq_ocp.analysis", "lin_freq_ocp.certificate", "lin_freq_ocp.solving", "lin_freq_ocp.methods")


def test_only_records_and_spectra_are_imported():
    trees = [ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")]
    imports = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    names = {one.name for node in imports if (node.module or "").startswith(JUDGING) for one in node.names}
    assert {name for name in names if not name[0].isupper()} <= FOR_DRAWING
    calls = {node.attr for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    assert not calls & {"violation", "gains", "successors"}
