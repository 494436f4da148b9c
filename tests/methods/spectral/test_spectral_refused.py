"""What the Fourier-domain method does not solve, and says so: refusals, proofs of infeasibility, unbounded costs."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from helpers.spectral_plants import END, START, A, B, T, plant, problem_of, tube
from lin_freq_ocp.api import raise_for
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.problem import time_signal
from lin_freq_ocp.program import real_rows

FREE = lfo.sets.Everything()


def repeated(matrix: Any) -> np.ndarray:
    return np.tile(np.asarray(matrix, dtype=float), (T, 1, 1))


REFUSED = {
    "A per time": ({"dynamics": lfo.LinearDynamics(repeated(A), B)}, "A or B depends on time"),
    "B per time": ({"dynamics": lfo.LinearDynamics(A, repeated(B))}, "A or B depends on time"),
    "Q per time": ({"cost": lfo.QuadraticCost(Q=repeated(np.eye(3)), R=1.0)}, "Q, R or S depends on time"),
    "R per time": ({"cost": lfo.QuadraticCost(R=repeated(np.eye(2)))}, "Q, R or S depends on time"),
    "S per time": ({"cost": lfo.QuadraticCost(Q=1.0, R=1.0, S=np.zeros((T, 3, 2)))}, "Q, R or S depends on time"),
    "C per time": ({"stage_rows": lfo.StageRows(np.ones((T, 1, 3)), None, [9.0])}, "C or D of a stage row"),
    "no cost": ({"cost": lfo.QuadraticCost(P=1.0)}, "neither Q nor R is above zero"),
    "one control without cost": ({"cost": lfo.QuadraticCost(R=np.diag([1.0, 0.0]))}, "give every control a cost"),
    "two controls without cost that do the same": (
        {"cost": lfo.QuadraticCost(Q=1.0), "dynamics": plant(A, B[:, [0, 0]])},
        "give every control a cost",
    ),
    "nonconvex": ({"cost": lfo.QuadraticCost(Q=np.diag([1.0, -0.1, 1.0]), R=1.0)}, "eigenvalue -0.1"),
    "nonconvex end": ({"cost": lfo.QuadraticCost(R=1.0, P=-1.0)}, "P has the eigenvalue -1"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_says_why(name):
    changes, words = REFUSED[name]
    problem = problem_of(**changes)
    with pytest.raises(lfo.errors.UnsupportedError, match=words):
        lfo.SpectralSolver(problem)
    with pytest.raises(lfo.errors.UnsupportedError, match=words):
        lfo.solve(problem, method="spectral")


def test_what_is_refused_goes_to_the_sparse_program():
    for name in ("A per time", "one control without cost"):
        result = lfo.solve(problem_of(**REFUSED[name][0]))
        assert (result.method, result.status) == ("convex", "optimal")
    assert lfo.solve(problem_of()).method == "spectral"


def test_a_control_without_cost_is_not_refused_where_every_bin_of_it_is_stopped():
    cost = lfo.QuadraticCost(R=np.diag([1.0, 0.0]))
    with pytest.warns(lfo.errors.BandWarning, match="removes every bin"):
        problem = problem_of(
            cost=cost, terminal_state=None, control_spectrum=lfo.stop_band(bins=range(13), component=1)
        )
    assert lfo.SpectralSolver(problem).solve().status == "optimal"


def test_too_many_state_band_rows_are_refused_and_just_enough_are_not():
    def wide(bins: int) -> lfo.OptimalControlProblem:
        return problem_of(horizon=2400, state_spectrum=lfo.stop_band(bins=range(100, 100 + bins), component=0))

    with pytest.raises(lfo.errors.UnsupportedError, match="2002 dense rows; the Fourier-domain method takes 2000"):
        lfo.SpectralSolver(wide(1001))


def dual_balance(result: lfo.results.Result, u: np.ndarray) -> tuple[float, float]:
    """Return what the ray's weighted constraints add up to on the trajectory of u, and the most that they allow.

    On every trajectory that obeys the dynamics the sum is the same; where it exceeds what sets allow, none is feasible.
    """
    problem, ray = result.problem, result.ray
    start = np.where(problem.state_tube.fixed[0], problem.state_tube.lower[0], 0.7)
    x = lfo.simulate(problem, u, start).x
    total = float((ray.mu * x).sum() + (ray.nu * u).sum())
    total += float((time_signal(ray.rho_u, T) * u).sum() + (time_signal(ray.rho_x, T + 1) * x).sum())
    allowed = 0.0
    for box, weights in ((problem.state_tube, ray.mu), (problem.control_tube, ray.nu)):
        bounded = np.isfinite(np.where(weights > 0, box.upper, box.lower))
        assert np.abs(weights[~bounded]).max(initial=0.0) <= 1e-10 * np.abs(ray.mu).max()
        allowed += float(box.support(np.where(bounded, weights, 0.0)).sum())
    for rows in problem.stage_rows:
        weights = ray.stage.get(rows.name, np.zeros((T, rows.rows)))
        assert weights.min() >= 0
        total += float((weights * rows.values(x, u)).sum())
        allowed += float((weights * rows.e).sum())
    return total, allowed


ROTATION = np.array([[0, 1.0, 0], [-1.0, 0, 0], [0, 0, 0.5]])
INFEASIBLE: dict[str, tuple[dict[str, Any], list[str]]] = {  # changes, and what the conflict names
    "an end out of reach of the bounds": (
        {"terminal_state": [8.0, 0.0, 0.0]},
        ["terminal state", "control bound on u_1"],
    ),
    "a mode that the band leaves to itself": (
        {"dynamics": plant(ROTATION), "control_spectrum": lfo.stop_band(bins=[6]), "control_set": None},
        ["initial state", "terminal state", "control stop band on u_0", "control stop band on u_1"],
    ),
    "an integrator whose DC is stopped": (
        {
            "dynamics": plant(np.diag([1.0, 0.5, 0.3]), np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])),
            "control_spectrum": lfo.stop_band(bins=[0], component=0),
            "control_set": None,
        },
        ["initial state", "terminal state", "control stop band on u_0"],
    ),
    "a state that no control reaches": (
        {"dynamics": plant(np.diag([0.9, 0.5, 0.3]), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))},
        ["initial state", "terminal state"],
    ),
    "no control that acts on anything": ({"dynamics": plant(A, np.zeros((3, 2)))}, ["initial state", "terminal state"]),
    "control bounds too tight for the band": (
        {"control_set": lfo.Box([-0.12, -0.2], [0.12, 0.2])},
        ["initial state", "terminal state", "control bound on u_0"],
    ),
    "state bounds too tight": (
        {"state_set": lfo.Box([-0.5, -0.55, -0.3], [1.0, 0.61, 0.31])},
        ["initial state", "terminal state", "state bound on x_0"],
    ),
    "values fixed inside that do not follow one another": (
        {"state_set": tube(lfo.Box(-2.0, 2.0).at_dimension(3, ""), T + 1, t10_0=1.5, t11_0=-1.5)},
        ["state bound on x_0"],
    ),
    "joint rows that exclude each other": (
        {
            "stage_rows": lfo.StageRows([[1.0, 0, 0], [-1.0, 0, 0]], [[0, 1.0], [0, -1.0]], [0.2, -0.3]),
            "terminal_state": None,
            "control_set": None,
        },
        ["row 0 of stage rows", "row 1 of stage rows"],
    ),
    "a joint row that the start violates": (
        {"stage_rows": lfo.StageRows([[1.0, 0, 0]], None, [0.9])},
        ["initial state", "row 0 of stage rows"],
    ),
    "a state band without DC above a bound": (
        {
            "initial_state": None,
            "terminal_state": None,
            "state_set": lfo.Box([0.1, -np.inf, -np.inf], np.inf),
            "state_spectrum": lfo.stop_band(bins=[0], component=0),
        },
        ["state bound on x_0", "state stop band on x_0"],
    ),
    "a state band against an end": (
        {"state_spectrum": lfo.stop_band(bins=range(1, 13), component=2), "control_set": None},
        ["initial state", "state stop band on x_2"],
    ),
    "boxed ends too far apart": (
        {"initial_state": lfo.Box(START, START + 0.1), "terminal_state": lfo.Box([7.0, 0, 0], [9.0, 1, 1])},
        ["terminal state", "control bound on u_0"],
    ),
}


# The rows in conflict cancel on controls without bounds, in exact arithmetic only: rays exclude sizes up to a limit.
CLAIMED = (
    "a mode that the band leaves to itself",
    "an integrator whose DC is stopped",
    "joint rows that exclude each other",
    "a state band against an end",
)


@pytest.mark.parametrize("name", INFEASIBLE)
def test_infeasible_problems_are_excluded_in_words(name):
    changes, blocks = INFEASIBLE[name]
    problem = problem_of(**changes)
    result = lfo.solve(problem, method="spectral", throw=False)
    with pytest.raises(lfo.errors.InfeasibleError) as caught:
        raise_for(result)
    named = {one.block for one in result.conflict}
    assert set(blocks) <= named, named
    assert all(block in str(caught.value) for block in blocks)
    status, bound = ("infeasible_claimed", "numerical") if name in CLAIMED else ("infeasible", "rigorous")
    assert (result.method, result.status, result.bound, result.trajectory) == ("spectral", status, bound, None)
    excluded = [float(size) for size in re.findall(r"\| <= ([^ ,]+)", result.message)]
    assert all(size > 1e10 for size in excluded)
    assert bool(excluded) == (name in CLAIMED)
    rng = np.random.default_rng(0)
    balances = [dual_balance(result, size * rng.standard_normal((T, 2))) for size in (0.0, 0.1, 1.0)]
    totals, allowed = [total for total, _ in balances], balances[0][1]
    assert np.ptp(totals) < 1e-6 * (totals[0] - allowed)
    assert totals[0] > allowed


@pytest.mark.parametrize("name", INFEASIBLE)
def test_a_ray_is_found_within_few_rounds(name):
    solution = lfo.SpectralSolver(problem_of(**INFEASIBLE[name][0])).solve()
    assert solution.status == "infeasible"
    assert solution.rounds <= 16
    assert solution.ray is not None
    assert (solution.trajectory, solution.multipliers, solution.active) == (None, None, None)


@pytest.mark.parametrize(("end", "status"), [(None, "optimal"), ([0.3], "infeasible")])
def test_a_control_without_any_bin(end, status):
    with pytest.warns(lfo.errors.BandWarning, match="removes every bin"):
        problem = lfo.OptimalControlProblem(
            lfo.LinearDynamics([[0.8]], [[1.0]]),
            6,
            lfo.QuadraticCost(R=1.0),
            initial_state=[1.0],
            terminal_state=end,
            control_spectrum=lfo.stop_band(bins=range(4)),
        )
    assert lfo.solve(problem, method="spectral", throw=False).status == status


def test_a_ray_proves_nothing_of_a_relaxed_problem_nor_with_its_sign_changed():
    problem = problem_of(**INFEASIBLE["an end out of reach of the bounds"][0])
    ray = lfo.SpectralSolver(problem).solve().ray
    fields = {name: getattr(ray, name) for name in ("eta", "mu", "nu", "rho_u", "rho_x")}
    assert prove_infeasible(problem, ray) is not None
    assert prove_infeasible(problem, lfo.results.Multipliers(0.0, **{k: -v for k, v in fields.items()})) is None
    assert prove_infeasible(replace(problem, control_set=lfo.Box(-9.0, 9.0)), ray) is None


def test_just_feasible_and_just_infeasible_are_told_apart():
    """The least control bound that the ends allow, from a linear program in (u, bound); 0.1 % more or less of it."""
    reach = np.hstack([np.linalg.matrix_power(A, T - 1 - t) @ B for t in range(T)])
    stop = problem_of().control_stop
    bands = [np.kron(real_rows(T, stop[:, j]), np.eye(2)[j]) for j in range(2)]
    equations = np.hstack([np.vstack([reach, *bands]), np.zeros((3 + sum(map(len, bands)), 1))])
    values = np.concatenate([END - np.linalg.matrix_power(A, T) @ START, np.zeros(len(equations) - 3)])
    rows = np.hstack([np.vstack([np.eye(2 * T), -np.eye(2 * T)]), -np.ones((4 * T, 1))])
    least = linprog(np.eye(2 * T + 1)[-1], rows, np.zeros(4 * T), equations, values, bounds=(None, None)).fun
    above, below = (problem_of(control_set=lfo.Box(-size, size)) for size in (1.001 * least, 0.999 * least))
    assert lfo.solve(above, method="spectral").certificate.globally_optimal
    assert lfo.solve(below, method="spectral", throw=False).status == "infeasible"


UNBOUNDED = {
    "an end": {"cost": lfo.QuadraticCost(R=1.0, p=[1.0, 0, 0]), "initial_state": None, "terminal_state": None},
    "linear terms of a free start": {"cost": lfo.QuadraticCost(R=1.0, q=[0, 1.0, 0]), "initial_state": None},
    "a bound on the wrong side": {
        "cost": lfo.QuadraticCost(R=1.0, p=[1.0, 0, 0]),
        "initial_state": None,
        "terminal_state": None,
        "state_set": lfo.Box(None, [3.0, np.inf, np.inf]),
    },
}


@expensive
@pytest.mark.parametrize("name", UNBOUNDED)
def test_a_cost_without_lower_bound_is_not_called_optimal(name):
    problem = problem_of(**({"terminal_state": None} | UNBOUNDED[name]))
    result = lfo.solve(problem, method="spectral", throw=False)
    assert result.status == "unbounded"
    assert result.lower_bound is None or not result.certificate.globally_optimal
    with pytest.raises(lfo.errors.UnboundedError, match="no lower bound"):
        lfo.solve(problem, method="spectral")
    held = replace(problem, state_set=lfo.Box(-10.0, 10.0))
    assert lfo.solve(held, method="spectral").certificate.globally_optimal


def test_infeasible_comes_before_unbounded():
    problem = problem_of(
        **UNBOUNDED["linear terms of a free start"],
        terminal_state=None,
        dynamics=plant(np.diag([0.9, 0.5, 0.3]), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])),
        state_set=[FREE] * 5
        + [lfo.Box([1.0, -np.inf, -np.inf], [1.0, np.inf, np.inf])]
        + [FREE] * (T - 6)
        + [lfo.Box([2.0, -np.inf, -np.inf], np.inf)],
    )
    assert lfo.solve(problem, method="spectral", throw=False).status == "infeasible"
