"""Soft bounds and rows in the Fourier-domain method: multipliers up to their prices, where bounds are exceeded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.sets import Polyhedron, Soft

T = 40
PLANT = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]], offset=[0.0, 0.01], sampling_time=0.1)
SLOW = lfo.Box([None, -0.1], [0.9, 0.35])
ROWS = lfo.StageRows([[0.3, 1.0]], [[0.05]], [0.4], penalty=2.0)
LOW, HIGH = 1e-3, 1e4  # prices below and above all multipliers


def problem(**changes) -> lfo.OptimalControlProblem:
    given = {"initial_state": [0, 0], "terminal_state": [1, 0], "control_spectrum": lfo.low_pass(1.5), **changes}
    return lfo.OptimalControlProblem(PLANT, T, lfo.QuadraticCost(Q=0.01, R=1.0, P=5.0, x_ref=[1.0, 0.0]), **given)


CASES = {
    "states": {"state_set": Soft(SLOW, 1.0)},
    "states, free end": {"state_set": Soft(SLOW, 0.3), "terminal_state": None},
    "states, free start": {"state_set": Soft(SLOW, 0.3), "initial_state": lfo.Box([-0.1, 0.5], [0.1, 0.6])},
    "controls": {"control_set": Soft(lfo.Box(-0.3, 0.2), 0.5)},
    "end": {"terminal_state": Soft(lfo.sets.Point([1.2, 0.0]), 0.7)},
    "end, beside a hard one": {"terminal_state": lfo.Box(None, [0.8, None]) & Soft(lfo.Box([0.9, None], [None, 0]), 1)},
    "rows": {"stage_rows": ROWS},
    "polyhedron": {"state_set": Soft(Polyhedron([[0.3, 1.0], [0.5, 0.1]], [0.4, 0.48]), 0.5), "terminal_state": None},
    "hard and soft on one side": {"state_set": lfo.Box(None, [None, 0.6]) & Soft(SLOW, 0.5)},
    "a hard polyhedron too": {"state_set": Polyhedron([[0.3, 1.0]], [0.6]) & Soft(SLOW, 0.5)},
    "prices per time": {"state_set": [Soft(SLOW, 1.0)] * 20 + [Soft(SLOW, 0.1)] * (T - 19)},
    "all": {
        "state_set": Soft(SLOW, 1.0),
        "control_set": Soft(lfo.Box(-0.5, 0.5), 0.5),
        "stage_rows": ROWS,
        "terminal_state": lfo.Box(0.8, None),
    },
    "all satisfied": {"state_set": Soft(lfo.Box(None, [0.9, 0.26]), HIGH), "terminal_state": [0.85, 0.0]},
    "all exceeded": {"state_set": Soft(lfo.Box([None, None], [None, -1.0]), LOW)},
}


@pytest.mark.parametrize("name", seeds(CASES))
def test_the_optimum_is_that_of_the_other_methods_and_its_multipliers_those_of_the_sets(name):
    given = problem(**CASES[name])
    ours, theirs = lfo.solve(given, method="spectral"), lfo.solve(given, method="convex")
    assert ours.certificate.pmp == "satisfied"
    assert abs(ours.gap) < 1e-8
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-8)
    assert set(ours.multipliers.stage) == {term.name for term in given.terms}
    for term in given.terms:
        weights = ours.multipliers.stage[term.name]
        assert weights.shape == term.shape
        assert (weights <= np.broadcast_to(term.penalty.weights, term.shape) * (1 + 1e-12)).all()
        if ours.uniqueness.unique:
            np.testing.assert_allclose(weights, theirs.multipliers.stage[term.name], atol=1e-5)


def test_the_cases_have_saturated_rows_and_rows_that_hold():
    def share(name):
        one = lfo.solve(problem(**CASES[name]), method="spectral").multipliers.stage["state set"]
        price = problem(**CASES[name]).terms[0].penalty.weights.max()
        return (one > 0).mean(), (one >= price * (1 - 1e-12)).mean()

    active, saturated = share("states")
    assert active > saturated > 0
    active, saturated = share("all satisfied")
    assert active > saturated == 0
    active, saturated = share("all exceeded")
    assert active == saturated == 0.25  # the side that has a limit, at all times


def test_auto_takes_soft_bounds_and_the_structured_method_agrees():
    given = problem(**CASES["all"])
    ours, theirs = lfo.solve(given), lfo.solve(given, method="structured")
    assert ours.method == "spectral"
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-8)


def test_a_soft_set_does_not_hide_that_hard_bounds_contradict_each_other():
    given = problem(control_set=lfo.Box(-0.05, 0.05), state_set=Soft(SLOW, 1.0), stage_rows=ROWS)
    result = lfo.solve(given, method="spectral", throw=False)
    assert result.status == "infeasible"
    assert prove_infeasible(given, result.ray).bound.kind == "rigorous"
    soft = replace(given, control_set=Soft(lfo.Box(-0.05, 0.05), 1.0))
    assert lfo.solve(soft, method="spectral").certificate.pmp == "satisfied"


def test_a_ray_pays_no_soft_set_even_where_a_fixed_end_violates_it():
    given = problem(control_set=lfo.Box(-0.05, 0.05), state_set=Soft(SLOW, 1.0))
    ray = lfo.SpectralSolver(given).solve().ray
    assert (ray.eta_C, np.abs(ray.stage["state set"]).max()) == (0, 0)


@pytest.mark.parametrize("states", [1e6, 1e-6])
@pytest.mark.parametrize("cost", [1.0, 1e-9])
def test_units_do_not_change_the_verdict(states, cost):
    bounds = lfo.Box([None, -0.1 * states], [0.9 * states, 0.35 * states])
    given = lfo.OptimalControlProblem(
        lfo.LinearDynamics(PLANT.A, states * PLANT.B, offset=states * PLANT.offset),
        T,
        lfo.QuadraticCost(Q=0.01 * cost / states**2, R=cost, P=5.0 * cost / states**2, x_ref=[states, 0.0]),
        initial_state=[0, 0],
        terminal_state=[states, 0],
        control_spectrum=lfo.low_pass(1.5),
        state_set=Soft(bounds, cost / states),
    )
    result = lfo.solve(given, method="spectral")
    assert result.certificate.pmp == "satisfied"
    assert result.cost / cost == pytest.approx(lfo.solve(problem(**CASES["states"])).cost, rel=1e-9)


@expensive
@pytest.mark.parametrize("name", ["states", "states, free end", "all", "prices per time"])
def test_a_warm_solve_gives_what_a_cold_one_gives(name):
    given = problem(**CASES[name])
    solver, last = lfo.SpectralSolver(given), None
    for first in (0.0, 0.02, -0.1, 0.3, 0.95):
        last = solver.solve(initial_state=[first, 0.1], warm_start=last)
        moved = given.with_ends([first, 0.1])
        assert last.status == "optimal"
        cold = lfo.solve(moved, method="spectral")
        assert moved.value(last.trajectory.x, last.trajectory.u) == pytest.approx(cold.cost, rel=1e-9)
        assert lfo.certify(last.problem, last.trajectory, last.multipliers).pmp == "satisfied"


def test_soft_bounds_can_be_exchanged_between_solves():
    given = problem(**CASES["states"])
    solver = lfo.SpectralSolver(given)
    first = solver.solve()
    for bounds in (Soft(SLOW, 3.0), Soft(lfo.Box(None, [None, 0.3]), 1.0), lfo.Box(None, [None, 0.6])):
        other = solver.solve(bounds={"state_set": bounds}, warm_start=first)
        expected = lfo.solve(replace(given, state_set=bounds), method="convex").cost
        assert other.problem.value(other.trajectory.x, other.trajectory.u) == pytest.approx(expected, rel=1e-8)


@expensive
@pytest.mark.parametrize("name", ["states", "hard and soft on one side", "all", "all exceeded"])
def test_rounds_without_the_model_of_all_values_find_the_same(name, monkeypatch):
    """As on long horizons, where each round looks for rays: a soft row that the ends decide is none."""
    given = problem(**CASES[name])
    expected = lfo.solve(given, method="spectral").cost
    substitute(monkeypatch, "methods.spectral.MOST_VALUES", 0)
    result = lfo.solve(given, method="spectral")
    assert result.certificate.pmp == "satisfied"
    assert result.cost == pytest.approx(expected, rel=1e-9)


def test_long_horizons_begin_with_the_rows_of_a_shorter_problem():
    base = lfo.library.double_integrator(horizon=600)
    given = replace(base, state_set=Soft(lfo.Box([None, None], [None, 0.1]), 2.0))
    ours = lfo.solve(given, method="spectral")
    assert ours.certificate.pmp == "satisfied"
    assert (ours.multipliers.stage["state set"] > 0).any()
    assert ours.certificate.bound.kind == "rigorous"
    assert abs(ours.gap) < 1e-8


def test_norm_balls_are_refused_with_the_reason():
    with pytest.raises(lfo.errors.UnsupportedError, match="state set: only boxes"):
        lfo.solve(problem(state_set=Soft(lfo.sets.Ball(0.5), 1.0)), method="spectral")
