"""The embedding of path relaxations in C: strict C99, its points satisfy the rows, and Clarabel replaces it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.modes import random_problem
from lin_freq_ocp.methods import native_code
from lin_freq_ocp.methods.hybrid.search import path_native
from lin_freq_ocp.methods.hybrid.search.path_native import OPTIMAL, path_library, run_path
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation


@pytest.fixture
def library():
    found = path_library()
    if found is None:
        pytest.skip("no C compiler")
    return found


def root_program(problem):
    relaxation = PathRelaxation(problem)
    everything = np.ones((problem.horizon, len(piecewise_affine(problem).modes)), dtype=bool)
    return relaxation.path_member(relaxation.reach.from_start(everything)).program


def rows_of(program):
    """Return the rows of the vertices, the rows over all times and G as functions of w (E, W)."""

    def equations(w):
        out = np.zeros(len(program.b))
        at = program.places >= 0
        np.add.at(out, program.places[at], (program.C @ w[..., None])[..., 0][at])
        signals = (program.signals @ w[..., None])[..., 0]
        out[program.vertex_rows :] += np.einsum("qea,ea->q", program.coupled[:, program.t], signals)
        return out

    return equations, lambda w: (program.linear @ w[..., None])[..., 0]


@pytest.mark.parametrize("fields", [{}, {"control_spectrum": lfo.stop_band(bins=[1])}], ids=["plain", "band"])
def test_a_solution_satisfies_all_rows_and_its_bound_is_its_cost(library, fields):
    program = root_program(random_problem(3, horizon=6, kinks=2, **fields))
    run = run_path(library, program, 1e-8, 1e-7, np.inf, 0.0)
    w = run.w / run.tau
    equations, linear = rows_of(program)
    assert run.end == OPTIMAL
    np.testing.assert_allclose(equations(w), program.b, atol=1e-6)
    assert linear(w).max() <= 1e-6
    cost = float((program.cost * w).sum())
    assert run.bound == pytest.approx(cost, rel=1e-6)
    assert run.proven <= cost + 1e-9
    assert run.proven == pytest.approx(cost, rel=1e-5)


def test_the_source_is_strict_c99(tmp_path):
    compiler = native_code.compiler()
    if compiler is None:
        pytest.skip("no C compiler")
    source = Path(path_native.__file__).parent / "path.c"
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wno-unknown-pragmas", "-Werror"]
    command = [compiler, *flags, "-c", str(source), "-o", str(tmp_path / "path.o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("compiler", ["", "/bin/false"], ids=["no compiler", "one that fails"])
def test_without_a_compiler_clarabel_solves_the_nodes(compiler, monkeypatch, tmp_path):
    problem = lfo.library.switched_rotation(horizon=5)
    expected = lfo.solve(problem).cost
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", compiler)
    monkeypatch.setattr(native_code.shutil, "which", lambda name: compiler if name == compiler else None)
    native_code.compiled_library.cache_clear()
    path_library.cache_clear()
    try:
        if compiler:
            with pytest.warns(RuntimeWarning, match="mode search in C could not be compiled"):
                result = lfo.solve(problem)
        else:
            result = lfo.solve(problem)
        assert result.status == "optimal"
        assert result.cost == pytest.approx(expected, rel=1e-6)
    finally:
        native_code.compiled_library.cache_clear()
        path_library.cache_clear()
