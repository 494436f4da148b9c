"""Horizons long enough for a first working set guessed from cheaper problems: a wrong guess must do no harm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from helpers.spectral_plants import END, START, A, B, moving, plant, problem_of, residuals, wave
from lin_freq_ocp.methods.spectral import first_working_set, lti_problem, natural_units

LONG = 640
"""A horizon from which a first working set is guessed from cheaper problems."""

SLOW = plant(0.05 * A + 0.95 * np.eye(3), 0.2 * B)
QUICK = plant(A, B)


def limits_at(times: Any, size: float) -> lfo.Box:
    """Return |u| <= size at the times, and none elsewhere."""
    upper = np.full((LONG, 2), np.inf)
    upper[times] = size
    return lfo.Box(-upper, upper)


def fixed_at(times: Any, value: float, size: float) -> lfo.Box:
    box = limits_at(slice(None), size)
    lower, upper = box.lower.copy(), box.upper.copy()
    lower[times] = upper[times] = value
    return lfo.Box(lower, upper)


OTHERS = np.flatnonzero(np.arange(LONG) % 8 != 3)
LONG_CASES: dict[str, dict[str, Any]] = {
    "control bounds": {"control_set": lfo.Box(-0.3, 0.3)},
    "control bounds of quick dynamics": {"control_set": lfo.Box(-0.3, 0.3), "dynamics": QUICK},
    "bounds per time": {"control_set": moving(LONG, 2, 0.5, 3)},
    "bounds at half of the times": {"control_set": limits_at(slice(LONG // 2, None), 0.3)},
    "bounds at most times": {"control_set": limits_at(OTHERS, 0.3)},
    "values fixed for a while": {"control_set": fixed_at(slice(100, 120), 0.1, 0.3)},
    "values fixed now and then": {"control_set": fixed_at(slice(3, None, 8), 0.3, 0.3)},
    "state bounds": {"state_set": lfo.Box(-1.0, 1.0)},
    "state bounds now and then": {
        "state_set": [lfo.sets.Everything() if t % 8 != 5 else lfo.Box(-1.0, 1.0) for t in range(LONG + 1)]
    },
    "joint rows": {"stage_rows": lfo.StageRows([[0.1, 0, 0]], [[1.0, -1.0]], [0.3])},
    "joint rows at most times": {
        "stage_rows": lfo.StageRows(
            [[0.1, 0, 0]], [[1.0, -1.0]], np.where(np.isin(np.arange(LONG), OTHERS), 0.3, np.inf)[:, None]
        )
    },
    "free ends": {"initial_state": None, "terminal_state": None, "control_set": lfo.Box(-0.3, 0.3)},
    "boxed ends": {
        "initial_state": lfo.Box(START - 0.2, START + 0.2),
        "terminal_state": lfo.Box(END - 0.2, END + 0.2),
        "control_set": lfo.Box(-0.3, 0.3),
    },
    "offset": {"dynamics": plant(SLOW.A, SLOW.B, wave(LONG, 3, 0.02, 3)), "control_set": lfo.Box(-0.3, 0.3)},
    "state band": {"state_spectrum": lfo.stop_band(bins=range(60, 70), component=1), "dynamics": QUICK},
}


@pytest.mark.parametrize("name", seeds(LONG_CASES))
def test_long_horizons_with_a_guessed_first_working_set(name):
    target = np.cumsum(wave(LONG + 1, 3, 0.05, 1), axis=0) + np.linspace(START, END, LONG + 1)
    problem = problem_of(
        **{
            "dynamics": SLOW,
            "horizon": LONG,
            "cost": lfo.QuadraticCost(Q=0.3, R=1.0, x_ref=target),
            "control_set": None,
            "control_spectrum": [lfo.low_pass(2.0, component=0), lfo.spectrum.high_pass(0.05, component=1)],
        }
        | LONG_CASES[name]
    )
    result = lfo.solve(problem, method="spectral")
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.globally_optimal
    assert abs(result.gap) < 1e-8
    assert max(residuals(problem, result.trajectory).values()) < 1e-11


@pytest.mark.parametrize(("horizon", "sampling_time"), [(10_000, 0.01), (1000, 0.0024)])
def test_the_guess_is_near_what_is_active_in_the_end(horizon, sampling_time):
    problem = lfo.library.pendulum(horizon=horizon, sampling_time=sampling_time)
    guess = first_working_set(lti_problem(problem, natural_units(problem)), lambda: None, {})
    active = lfo.SpectralSolver(problem).solve().active
    forces = active.t[active.f == 4]
    near = [(np.abs(guess.t[guess.f == 4] - t) <= 8).any() for t in forces]
    assert len(forces) > 20
    assert np.mean(near) > 0.9
    assert len(guess.t) < 2 * len(active.t)


def test_equations_alone_need_no_guess():
    """Values that bounds fix are equations: no row can be violated."""
    upper = np.full((LONG, 2), np.inf)
    upper[40:44] = 0.1
    fixed = lfo.Box(np.where(upper < 1, upper, -np.inf), upper)
    problem = problem_of(dynamics=SLOW, horizon=LONG, cost=lfo.QuadraticCost(Q=0.3, R=1.0), control_set=fixed)
    lti = lti_problem(problem, natural_units(problem))
    assert not lti.has_limits
    assert first_working_set(lti, lambda: None, {}) is None
    solution = lfo.SpectralSolver(problem).solve()
    assert (solution.status, solution.rounds) == ("optimal", 1)
    np.testing.assert_allclose(solution.trajectory.u[40:44], 0.1)
    bounded = problem_of(dynamics=SLOW, horizon=LONG, cost=problem.cost, control_set=fixed_at([40], 0.1, 0.3))
    assert lti_problem(bounded, natural_units(bounded)).has_limits
    ends = lfo.Box([-9.0, None, None], [9.0, None, None])
    bounded = problem_of(dynamics=SLOW, horizon=LONG, cost=problem.cost, control_set=fixed, terminal_state=ends)
    units = natural_units(bounded)
    assert lti_problem(bounded, units).has_limits
    free = lti_problem(
        problem_of(dynamics=SLOW, horizon=LONG, cost=problem.cost, control_set=None, terminal_state=None), units
    )
    assert not free.has_limits
    assert free.with_ends(bounded.ends, units.x).has_limits  # other ends may bring limits


@expensive
def test_rows_near_working_rows_save_half_of_the_rounds(monkeypatch):
    """As on long horizons: without a model of all values, and with neighbourhoods or without."""
    substitute(monkeypatch, "methods.spectral.MOST_VALUES", 0)
    rounds = []
    for horizon in (1, np.inf):
        substitute(monkeypatch, "methods.spectral.NEIGHBOURHOOD_HORIZON", horizon)
        problems = lfo.library.scanner(), lfo.library.crane(), lfo.library.mass_chain()
        rounds.append(sum(lfo.SpectralSolver(problem).solve().rounds for problem in problems))
    assert 2 * rounds[0] <= rounds[1]
