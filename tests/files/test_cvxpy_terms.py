"""Every feature beyond boxes, bands and quadratic costs as CVXPY sees it: the same optimum, the same multipliers."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.random.mixed import problem_of, random_model
from helpers.seeds import seeds
from lin_freq_ocp.problem import HalfSpaces, SpectrumMap, StandardCone, Term


def labelled(program: cp.Problem) -> dict[str, cp.Constraint]:
    return {constraint.label: constraint for constraint in program.constraints}


def stage_multipliers(program: cp.Problem, term: Term) -> np.ndarray:
    """Return the multipliers of a hard term from the duals, by the signs that to_cvxpy documents."""
    constraints, multipliers = labelled(program), np.zeros(term.shape)
    if isinstance(term.penalty, HalfSpaces):
        multipliers[np.isfinite(np.broadcast_to(term.penalty.limit, term.shape))] = constraints[term.name].dual_value
        return multipliers
    if isinstance(term.penalty, StandardCone):
        size, direction = constraints[term.name].dual_value
        return -np.column_stack([size, direction])
    radius = np.broadcast_to(term.penalty.radius, term.shape[:1])
    equation = np.repeat(radius[:, None] == 0, term.shape[1], axis=1)
    if isinstance(term.map, SpectrumMap) and not term.map.joint:
        equation[term.map.real, 1] = False
    if (np.isfinite(radius) & (radius > 0)).any():
        multipliers[np.isfinite(radius) & (radius > 0)] = -constraints[term.name].dual_value[1]
    if equation.any():
        label = f"{term.name} zero" if f"{term.name} zero" in constraints else term.name
        multipliers[equation] = constraints[label].dual_value
    return multipliers


def two_carts(horizon: int = 24, **further) -> lfo.OptimalControlProblem:
    """Return a spring between two carts that is pulled away from rest; ``further`` features may be added."""
    A = np.array([[1, 0.2, 0, 0], [-0.1, 0.98, 0.1, 0], [0, 0, 1, 0.2], [0.1, 0, -0.1, 0.98]])
    dynamics = lfo.LinearDynamics(
        A, [[0, 0], [0.2, 0], [0, 0], [0, 0.3]], sampling_time=0.2, control_names=["left", "right"]
    )
    fields = {
        "cost": lfo.QuadraticCost(Q=0.1, R=0.2),
        "initial_state": [1.0, 0.0, -1.0, 0.5],
        "terminal_state": [0.0, 0.0, 0.0, 0.0],
    }
    return lfo.OptimalControlProblem(dynamics, horizon, **(fields | further))


C, D = np.array([[1.0, 0, -1, 0], [0, 1, 0, 1]]), np.array([[0.5, 0], [0, -0.5]])
SWING = np.cos(np.arange(24))[:, None, None] * np.array([[1.0, 0.2], [0.0, 1.0]])
SPEEDS = np.array([[0, 1.0, 0, 0], [0, 0, 0, 1.0]])
QUADRATIC = lfo.QuadraticCost(R=0.2)
FEATURES = {
    "stage rows": {"stage_rows": lfo.StageRows(C, D, [1.5, np.inf], name="gap")},
    "stage rows per time": {"stage_rows": lfo.StageRows(C, None, np.linspace(2.1, -0.1, 48).reshape(24, 2))},
    "soft stage rows": {"stage_rows": lfo.StageRows(C, D, [0.8, np.inf], penalty=0.3)},
    "polyhedron": {"control_set": lfo.sets.Polyhedron([[1, 1], [-1, 1], [0, -1]], [0.3, 0.2, 0.4])},
    "ball": {"control_set": lfo.sets.Ball(0.5, [0.1, 0.0])},
    "balls per time": {
        "control_set": [lfo.sets.Ball(0.4 + 0.01 * t) if t % 3 else lfo.Box(-0.4, 1) for t in range(24)]
    },
    "ellipsoid": {"state_set": lfo.sets.Ellipsoid(SPEEDS, 0.6, [0.0, -0.1, 0, 0])},
    "cone and box": {"control_set": lfo.sets.SecondOrderCone([[1, 0]], [0], [0, 0.5], 0.4) & lfo.Box(None, 0.3)},
    "cone and fixed": {
        "control_set": lfo.sets.SecondOrderCone([[1, 0]], [0], [0, 0], 0.2) & lfo.Box([None, 0], [None, 0]),
        "terminal_state": None,
    },
    "soft box": {"control_set": lfo.sets.Soft(lfo.Box([None, -0.3], [0.3, 0.3]), 0.2)},
    "soft polyhedron": {"control_set": lfo.sets.Soft(lfo.sets.Polyhedron([[1, 0], [-1, -1]], [0.2, np.inf]), 0.05)},
    "soft ball": {"state_set": lfo.sets.Soft(lfo.sets.Ball(0.9), 0.1)},
    "initial set": {"initial_state": lfo.sets.Ball(0.5, [1, 0, -1, 0.5])},
    "terminal set": {"terminal_state": lfo.sets.Ellipsoid(np.diag([1, 2, 1, 2]), 0.1, 0.1) & lfo.Box(None, 0.1)},
    "soft terminal set": {"terminal_state": lfo.sets.Soft(lfo.sets.Ellipsoid(np.diag([1.0, 2, 1, 2]), 0.1), 0.05)},
    "L1 cost": {"cost": QUADRATIC + lfo.costs.L1Cost(x=[0.1, 0, 0.2, 0], u=np.linspace(0, 0.5, 48).reshape(24, 2))},
    "largest value": {"cost": QUADRATIC + lfo.costs.LInfCost(x=0.3, u=[0.1, 0.2], x_ref=0.2), "terminal_state": None},
    "terminal norm": {
        "cost": QUADRATIC + lfo.costs.L1Cost(terminal=0.1) + lfo.costs.L1Cost(terminal=0.2),
        "terminal_state": None,
    },
    "mask": {"control_spectrum": lfo.MagnitudeBound(0.3, band=lfo.low_pass(0.5), component="left")},
    "mask with zeros": {"control_spectrum": lfo.MagnitudeBound([np.inf, 0.5, 0.0, 0.0], bins=[0, 2, 3, 12])},
    "mask of zeros": {"control_spectrum": lfo.MagnitudeBound(0.0, bins=[2, 3, 12])},
    "fine mask": {
        "control_spectrum": lfo.MagnitudeBound(
            reference=0.8, limit_db=-20.0, band=lfo.low_pass(0.5), window="hann", oversampling=4
        )
    },
    "soft mask": {"state_spectrum": lfo.MagnitudeBound([0.5, np.inf, 0.1], bins=[2, 5, 12], penalty=0.05)},
    "energy": {"control_spectrum": [lfo.spectrum.EnergyBound(0.1, band=lfo.low_pass(0.4)), lfo.stop_band(bins=[12])]},
    "no energy": {"state_spectrum": lfo.spectrum.EnergyBound(0.0, bins=[2, 3], component=3)},
    "soft energy": {
        "control_spectrum": lfo.spectrum.EnergyBound(0.5, band=lfo.low_pass(0.4), penalty=0.1, oversampling=2)
    },
    "equation": {"control_spectrum": lfo.spectrum.LinearConstraint(SWING, [0.5, -0.2])},
    "soft equation": {"control_spectrum": lfo.spectrum.LinearConstraint(SWING, [0.5, -0.2], penalty=0.005)},
    "output mask": {"output_spectrum": lfo.spectrum.OutputSpectrum(C, D, lfo.MagnitudeBound(0.8, bins=range(2, 13)))},
    "output bands": {
        "output_spectrum": [
            lfo.spectrum.OutputSpectrum(C, None, lfo.stop_band(bins=[3, 4])),
            lfo.spectrum.OutputSpectrum(
                None, D, [lfo.low_pass(2.5), lfo.spectrum.EnergyBound(0.1, bins=[2], component=1)]
            ),
        ]
    },
}


@pytest.mark.parametrize("name", seeds(FEATURES))
def test_every_feature_is_in_the_program(name):
    problem = two_carts(**FEATURES[name])
    result, program = lfo.solve(problem), lfo.to_cvxpy(problem)
    assert np.isfinite(program.solve(solver="CLARABEL"))
    assert program.value == pytest.approx(result.cost, rel=1e-6, abs=1e-6)
    assert len(labelled(program)) == len(program.constraints)
    without = lfo.solve(two_carts(**{key: QUADRATIC if key == "cost" else None for key in FEATURES[name]}))
    assert result.cost > without.cost + 5e-4  # it matters
    for term in problem.terms:
        assert (term.name in labelled(program)) == term.hard
        if term.hard:
            expected = result.multipliers.stage[term.name]
            np.testing.assert_allclose(stage_multipliers(program, term), expected, atol=1e-3 * np.abs(expected).max())


def test_the_dual_of_a_norm_is_the_price_of_its_limit():
    def optimum(radius: float) -> cp.Problem:
        program = lfo.to_cvxpy(two_carts(control_set=lfo.sets.Ball(radius)))
        program.solve(solver="CLARABEL")
        return program

    step, program = 1e-4, optimum(0.5)
    slope = (optimum(0.5 + step).value - optimum(0.5 - step).value) / (2 * step)
    assert labelled(program)["control set"].dual_value[0].sum() == pytest.approx(-slope, rel=1e-4)


@pytest.mark.parametrize("seed", seeds([1, 2, 3, 7, 9, 12, 13, 19, 24, 25, 26, 27]))
def test_random_mixtures_of_features(seed):
    problem = problem_of(random_model(seed))
    program = lfo.to_cvxpy(problem)
    program.solve(solver="CLARABEL")
    assert program.value == pytest.approx(lfo.solve(problem).cost, rel=1e-6, abs=1e-6)


def nodes(expression: cp.Expression) -> int:
    return 1 + sum(nodes(argument) for argument in expression.args)


def test_a_longer_problem_has_no_more_expressions():
    def size(T: int) -> int:
        problem = two_carts(
            horizon=T,
            cost=QUADRATIC + lfo.costs.LInfCost(x=1.0),
            control_set=[lfo.sets.Ball(2), lfo.sets.Soft(lfo.sets.Ball(1), 1.0)] * (T // 2),
            state_set=lfo.sets.Ellipsoid(np.eye(4), 9.0),
            stage_rows=lfo.StageRows(C, D, [1, 1], penalty=1.0),
            control_spectrum=lfo.MagnitudeBound(0.4, band=lfo.low_pass(0.5), oversampling=2),
        )
        program = lfo.to_cvxpy(problem)
        return nodes(program.objective) + sum(nodes(constraint) for constraint in program.constraints)

    assert size(240) == size(24) < 400
