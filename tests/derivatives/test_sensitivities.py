"""Derivatives of the optimal cost, from the multipliers, against differences of problems solved again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.derivatives import sensitivities_of

STEP = 1e-4
"""Of order-1 data: the cost is quadratic between changes of the active bounds, central differences of it are exact."""

T, N, M = 24, 3, 2
UPPER, LOWER = np.array([0.9, 0.8]), np.array([-0.7, -0.9])


def random_problem(seed: int) -> lfo.OptimalControlProblem:
    """Bounds on all signals, joint rows, stop bands on controls and a state, offset, fixed ends; some of it active."""
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((N, N)), rng.standard_normal((N, M))
    A *= rng.uniform(0.6, 1.02) / np.abs(np.linalg.eigvals(A)).max()
    calm = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B, offset=0.05 * rng.standard_normal((T, N))),
        T,
        lfo.QuadraticCost(Q=0.1, R=np.diag([1.0, 2.0])),
        initial_state=rng.standard_normal(N),
        control_spectrum=[lfo.stop_band(bins=[4, 5], component=0), lfo.stop_band(bins=[8], component=1)],
    )
    waves = np.array([[np.cos(2 * np.pi * 2 * t / T), np.sin(2 * np.pi * 3 * t / T)] for t in range(T)])
    reached = lfo.simulate(calm, 0.5 * waves)
    wish = 2.0 * rng.standard_normal((T, M))
    return replace(
        calm,
        cost=lfo.QuadraticCost(Q=0.1, R=np.diag([1.0, 2.0]), u_ref=wish),
        terminal_state=reached.x[-1],
        control_set=lfo.Box(np.tile(LOWER, (T, 1)), np.tile(UPPER, (T, 1))),
        state_set=lfo.Box(np.tile(reached.x.min(0) - 0.05, (T + 1, 1)), np.tile(reached.x.max(0) + 0.05, (T + 1, 1))),
        stage_rows=lfo.StageRows(None, [[1.0, 1.0]], np.full((T, 1), 0.8), name="sum"),
        state_spectrum=lfo.stop_band(bins=[9], component=0) if seed % 2 else None,
    )


def cost(problem: lfo.OptimalControlProblem) -> float:
    return float(lfo.solve(problem, tolerance=1e-11).cost)


def moved(
    problem: lfo.OptimalControlProblem, field: str, place: tuple[int, ...], by: float
) -> lfo.OptimalControlProblem:
    """Return the problem with one number of its data changed."""

    def plus(array: Any) -> np.ndarray:
        changed = np.array(array)
        changed[place] += by
        return changed

    if field in ("initial_state", "terminal_state"):
        return replace(problem, **{field: plus(getattr(problem, field).lower)})
    if field == "offset":
        return replace(problem, dynamics=replace_offset(problem, plus(problem.dynamics.offset)))
    if field == "stage_rows":
        rows = problem.stage_rows[0]
        return replace(problem, stage_rows=lfo.StageRows(rows.C, rows.D, plus(rows.e), name=rows.name))
    name = "state_set" if field.startswith("state") else "control_set"
    box = getattr(problem, name)
    sides = {"upper": box.upper, "lower": box.lower}
    side = field.split("_")[1]
    return replace(problem, **{name: lfo.Box(**(sides | {side: plus(sides[side])}))})


def replace_offset(problem: lfo.OptimalControlProblem, offset: np.ndarray) -> lfo.LinearDynamics:
    return lfo.LinearDynamics(problem.dynamics.A, problem.dynamics.B, offset=offset)


def with_bin(problem: lfo.OptimalControlProblem, k: int, j: int, value: complex) -> lfo.OptimalControlProblem:
    """Return the problem in u - w, whose bin k of control j is 0 where that of u is ``value``."""
    spectrum = np.zeros((T // 2 + 1, M), dtype=complex)
    spectrum[k, j] = value
    w = np.fft.irfft(spectrum, n=T, axis=0)
    rows, box = problem.stage_rows[0], problem.control_set
    return replace(
        problem,
        dynamics=replace_offset(problem, problem.dynamics.offset + w @ problem.dynamics.B.T),
        cost=lfo.QuadraticCost(Q=0.1, R=np.diag([1.0, 2.0]), u_ref=problem.cost.u_ref - w),
        control_set=lfo.Box(box.lower - w, box.upper - w),
        stage_rows=lfo.StageRows(rows.C, rows.D, rows.e - w @ rows.D.T, name=rows.name),
    )


def difference(plus: lfo.OptimalControlProblem, minus: lfo.OptimalControlProblem, step: float) -> float:
    return (cost(plus) - cost(minus)) / (2 * step)


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_derivatives_are_differences_of_costs(seed):
    problem = random_problem(seed)
    found = lfo.solve(problem, tolerance=1e-11).sensitivities
    fields = {
        name: getattr(found, name)
        for name in (
            "initial_state",
            "terminal_state",
            "state_upper",
            "state_lower",
            "control_upper",
            "control_lower",
            "offset",
        )
    } | {"stage_rows": found.stage_rows["sum"]}
    size = max(np.abs(values).max() for values in fields.values())
    for field, values in fields.items():
        place = np.unravel_index(np.argmax(np.abs(values)), values.shape)  # the one that counts most
        if np.abs(values[place]) < 1e-2:
            continue
        problems = [moved(problem, field, place, by) for by in (STEP, -STEP)]
        assert difference(*problems, STEP) == pytest.approx(values[place], rel=1e-4, abs=1e-5 * size), field


@pytest.mark.parametrize("seed", seeds(range(4)))
@pytest.mark.parametrize("direction", [1.0, 1.0j])
def test_the_price_of_a_bin_is_a_difference_of_costs(seed, direction):
    problem = random_problem(seed)
    prices = lfo.solve(problem, tolerance=1e-11).sensitivities.control_bins
    for k, j in ((4, 0), (5, 0), (8, 1)):
        step = 1e-3 * direction
        change = difference(*(with_bin(problem, k, j, sign * step) for sign in (1, -1)), 1e-3)
        assert change == pytest.approx((np.conj(prices[k, j]) * direction).real, rel=1e-4, abs=1e-5)
        assert abs(prices[k, j]) > 1e-3
    assert not prices[~problem.control_stop].any()


def test_signs_and_absences_say_what_they_must():
    problem = replace(random_problem(0), terminal_state=None)
    found = lfo.solve(problem).sensitivities
    assert (found.control_upper <= 0).all()
    assert (found.control_lower >= 0).all()
    assert (found.state_upper <= 0).all()
    assert (found.state_lower >= 0).all()
    assert np.isnan(found.terminal_state).all()
    assert np.isfinite(found.initial_state).all()
    assert not found.state_upper[0].any()


def test_only_an_optimum_has_sensitivities():
    problem = replace(random_problem(0), control_set=lfo.Box(-0.01, 0.01))
    result = lfo.solve(problem, throw=False)
    assert result.status == "infeasible"
    with pytest.raises(lfo.errors.SolveError, match="Only an optimum has sensitivities"):
        _ = result.sensitivities


def test_abnormal_multipliers_price_nothing():
    problem = random_problem(0)
    result = lfo.solve(problem)
    multipliers = result.multipliers
    fields = {name: getattr(multipliers, name) for name in ("eta", "mu", "nu", "rho_u", "rho_x", "stage")}
    with pytest.raises(lfo.errors.UnsupportedError, match="eta_C = 0"):
        sensitivities_of(problem, result.trajectory, lfo.results.Multipliers(eta_C=0.0, **fields))
