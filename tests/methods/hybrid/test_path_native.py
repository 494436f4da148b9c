"""The embedding of path relaxations in C: its points satisfy the rows, and shares of modes by Clarabel replace it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.modes import random_problem
from helpers.replacing import substitute
from lin_freq_ocp.methods.hybrid import OPTIMAL, path_library, run_path, solve_relaxation
from lin_freq_ocp.methods.hybrid.search import path_native
from lin_freq_ocp.program.hybrid import PathRelaxation
from lin_freq_ocp.transform.hybrid import piecewise_affine


@pytest.fixture
def library():
    found = path_library()
    if found is None:
        pytest.skip("no C compiler")
    return found


def root_of(problem):
    """Return the relaxations of a problem, the reach of all sequences, and its path program."""
    relaxation = PathRelaxation(problem)
    reach = relaxation.reach.from_start(np.ones((problem.horizon, len(piecewise_affine(problem).modes)), dtype=bool))
    return relaxation, reach, relaxation.path_member(reach).program


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
    _, _, program = root_of(random_problem(3, horizon=6, kinks=2, **fields))
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


COUPLED = lfo.QuadraticCost(Q=[[1.0, 0.95], [0.95, 1.0]], R=0.1, P=np.eye(2))


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3])
@pytest.mark.parametrize("fields", [{}, {"control_spectrum": lfo.stop_band(bins=[1])}, {"cost": COUPLED}])
@pytest.mark.parametrize("seed", [0, 3, 4])
def test_the_proven_bound_of_rough_duals_is_that_of_numpy(library, seed, fields, tolerance):
    """With a coupled cost it may be lower: two sweeps over the coordinates do not find the least Lagrangian."""
    problem = random_problem(seed, horizon=4, kinks=2, **fields)
    relaxation, reach, program = root_of(problem)
    run = run_path(library, program, tolerance, tolerance, np.inf, 0.0)
    duals = relaxation.path_duals(program, run.p / run.tau, run.z / run.tau, run.w / run.tau)
    proven, expected = relaxation.cost(run.proven), relaxation.proven(reach, duals)
    assert proven <= expected + 1e-9 * abs(expected)
    assert "cost" in fields or proven == pytest.approx(expected, rel=1e-9)


def test_a_ray_counts_only_if_its_bound_proves_it(library, monkeypatch):
    relaxation, reach, _ = root_of(random_problem(3, horizon=4, kinks=2))
    expected = solve_relaxation(relaxation, reach).bound

    def wrong_ray(*given):
        run = run_path(*given)
        return replace(run, end=path_native.INFEASIBLE, p=np.ones_like(run.p), bound=1.0)

    substitute(monkeypatch, "methods.hybrid.run_path", wrong_ray)
    answer = solve_relaxation(relaxation, reach)
    assert answer.duals.vertices is None
    assert -np.inf < answer.bound <= expected + 1e-6 * abs(expected)


def test_without_a_compiler_clarabel_solves_the_nodes(no_compiler):
    problem = lfo.library.switched_rotation(horizon=5)
    expected = lfo.solve(problem).cost
    with no_compiler("path.c could not be compiled"):
        result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(expected, rel=1e-6)
