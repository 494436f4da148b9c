"""Names of a problem reach C, HTML, TOML, JSON, CSV and a terminal as text: no character of them acts there.

A sample of ``scripts/verify.py --part names``.
"""

from __future__ import annotations

import pytest

from helpers.checks import names
from helpers.seeds import expensive
from lin_freq_ocp.methods import compiler

CHEAP = "TOML", "JSON", "CSV"  # with 200 names
PROBLEMS = [names.hostile_problem(seed) for seed in range(25)]


@expensive
@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_generated_code_compiles_and_shows_them(tmp_path):
    comments = [names.c_comment(problem, tmp_path / str(i)) for i, problem in enumerate(PROBLEMS[::5])]
    assert names.compiles(comments, tmp_path)


@pytest.mark.parametrize("writer", [name for name in names.WRITERS if name not in ("C", "proof")])
def test_every_writer_keeps_them(writer, tmp_path):
    some = PROBLEMS if writer in CHEAP else [*PROBLEMS[::5], names.hostile_problem(276)]  # ":smile:" was a picture
    assert all(names.WRITERS[writer](problem, tmp_path) for problem in some)
