"""Duals of stages as multipliers: the same gradients, in the problem's own units; rays that prove."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.linear_kinds import KINDS, PLANT, T, infeasible
from helpers.stage_programs import solved_stages, stage_operator
from lin_freq_ocp.certificate.conflict import prove_infeasible
from lin_freq_ocp.methods.structured.assembly import stages_of


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
    assembly = stages_of(problem)
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
    units = assembly.recovery.units
    multipliers = assembly.recovery.multipliers([p.reshape(s) for p, s in zip(z, shapes, strict=True)], 0.0)
    of_x, of_u = pulled_back(problem, multipliers)
    gradient = adjoint / (units.columns * units.cost)
    np.testing.assert_allclose(gradient[:, :2], of_x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(gradient[:-1, 2:4], of_u, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "kind", ["boxes", "cones", "bands", "masks", "rows", "fixed controls", "rows of fixed controls"]
)
def test_rays_prove_infeasibility(kind):
    problem = infeasible(kind)
    assembly = stages_of(problem)
    status, _, z = solved_stages(assembly.stages)
    assert status == "PrimalInfeasible"
    assert prove_infeasible(problem, assembly.recovery.multipliers(z, 0.0)) is not None


def test_a_direction_of_descent():
    cost = lfo.QuadraticCost(r=[-1.0, 0.0])
    problem = lfo.OptimalControlProblem(PLANT, T, cost, control_set=lfo.Box([-1, -1], [np.inf, 1]))
    assembly = stages_of(problem)
    status, y, _ = solved_stages(assembly.stages)
    assert status == "DualInfeasible"
    change = assembly.recovery.direction(y)
    np.testing.assert_allclose(change.x[1:], change.x[:-1] @ PLANT.A.T + change.u @ PLANT.B.T, atol=1e-6)
    assert change.u[:, 0].sum() > 0
    assert change.u[:, 0].min() > -1e-6
