"""The origin of y and the controls that leave the stages; duals of stages as multipliers, and rays that prove."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.linear_kinds import KINDS, PLANT, T, infeasible
from helpers.stage_programs import solved_stages, stage_operator
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.methods.structured import assemble_stages, choose_origin


def test_references_and_fixed_controls_are_the_origin():
    problem = KINDS["coasting"]()
    (origin, found), fixed = choose_origin(problem), np.arange(T) % 3 != 0
    np.testing.assert_array_equal(origin.x, problem.quadratic.x_ref)
    np.testing.assert_array_equal(origin.u[fixed], 0.1)
    np.testing.assert_array_equal(origin.u[~fixed], problem.quadratic.u_ref[~fixed])
    np.testing.assert_array_equal(found.all(axis=1), fixed)
    np.testing.assert_array_equal(found.any(axis=1), fixed)


def test_held_controls_act_on_nothing():
    stages, held = assemble_stages(KINDS["coasting"]()).stages, np.arange(T) % 3 != 0
    assert not stages.B[:-1, :, :2][held].any()
    assert stages.B[:-1, :, :2][~held].any()
    assert not stages.G[:-1, :, 2:4][held].any()
    np.testing.assert_array_equal(stages.H[:-1, 2:4, 2:4][held], np.broadcast_to(np.eye(2), (held.sum(), 2, 2)))
    assert not stages.h[:-1, 2:4][held].any()
    assert not stages.coupling.equations


@pytest.mark.parametrize("kind", ["coasting with a band", "linear constraint"])
def test_controls_of_rows_that_couple_times_are_not_held(kind):
    problem = KINDS[kind]()
    assert not choose_origin(problem)[1].any()


def test_fixed_controls_of_a_band_are_equations():
    equations = assemble_stages(KINDS["coasting with a band"]()).stages.coupling.equations
    assert [part.rows.count for part in equations] == [2, 6]  # of the bin, and at the times of two in three


def pulled_back(problem, multipliers):
    """Return the gradients in x and u of all rows, from the definition of the multipliers."""
    linear, shapes = problem.linear, ((T + 1, 2), (T, 2))
    of_x, of_u = multipliers.mu.copy(), multipliers.nu.copy()
    of_x[1:] += multipliers.eta
    A, B = (np.broadcast_to(M, (T, 2, 2)) for M in (linear.A, linear.B))
    of_x[:-1] -= np.einsum("tij,ti->tj", A, multipliers.eta)
    of_u -= np.einsum("tij,ti->tj", B, multipliers.eta)
    for signal, rho in ((of_x, multipliers.rho_x), (of_u, multipliers.rho_u)):
        N = len(signal)
        waves = np.exp(-2j * np.pi * np.outer(np.arange(N), np.arange(len(rho))) / N)
        signal += (waves.real @ rho.real) + (waves.imag @ rho.imag)
    for term in problem.terms:
        parts = term.map.pull_back(multipliers.stage[term.name], shapes)
        of_x, of_u = of_x + parts[0], of_u + parts[1]
    return of_x, of_u


@pytest.mark.parametrize("kind", KINDS)
def test_multipliers_make_the_gradient_of_their_duals(kind):
    problem, rng = KINDS[kind](), np.random.default_rng(2)
    assembly = assemble_stages(problem)
    matrices, _ = stage_operator(assembly.stages)
    z = [rng.standard_normal(len(M)) for M in matrices]
    stages = assembly.stages
    z[1] *= stages.fixed
    shapes = [
        stages.d.shape,
        (-1,),
        stages.g.shape,
        (-1,),
        (-1, 1),
        *[(len(p.radius), -1) for p in stages.coupling.balls],
    ]
    z[2] = np.where(stages.present, z[2].reshape(stages.g.shape), 0.0)
    adjoint = sum(M.T @ part.ravel() for M, part in zip(matrices, z, strict=True)).reshape(stages.h.shape)
    units = assembly.units
    multipliers = assembly.multipliers([p.reshape(s) for p, s in zip(z, shapes, strict=True)], 0.0)
    of_x, of_u = pulled_back(problem, multipliers)
    gradient = adjoint / (units.columns * units.cost)
    np.testing.assert_allclose(gradient[:, :2], of_x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(gradient[:-1, 2:4], of_u, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "kind", ["boxes", "cones", "bands", "masks", "rows", "fixed controls", "rows of fixed controls"]
)
def test_rays_prove_infeasibility(kind):
    problem = infeasible(kind)
    assembly = assemble_stages(problem)
    status, _, z = solved_stages(assembly.stages)
    assert status == "PrimalInfeasible"
    assert prove_infeasible(problem, assembly.multipliers(z, 0.0)) is not None


def test_a_direction_of_descent():
    cost = lfo.QuadraticCost(r=[-1.0, 0.0])
    problem = lfo.OptimalControlProblem(PLANT, T, cost, control_set=lfo.Box([-1, -1], [np.inf, 1]))
    assembly = assemble_stages(problem)
    status, y, _ = solved_stages(assembly.stages)
    assert status == "DualInfeasible"
    change = assembly.direction(y)
    np.testing.assert_allclose(change.x[1:], change.x[:-1] @ PLANT.A.T + change.u @ PLANT.B.T, atol=1e-6)
    assert change.u[:, 0].sum() > 0
    assert change.u[:, 0].min() > -1e-6
