"""Limits of time and memory: handed on to every path, kept, and told in words."""

from __future__ import annotations

import pickle
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.certificate.hybrid import TreeBound, tree_bound
from lin_freq_ocp.methods import SolveOptions, solve_convex
from lin_freq_ocp.methods.hybrid import SearchLimits, TreeSearch
from lin_freq_ocp.methods.spectral import LARGEST_BORDERED, BorderedQp, RowQp, interior_point
from lin_freq_ocp.problem.hybrid import ModeTree
from lin_freq_ocp.program import LinearProgram, dense_rows
from lin_freq_ocp.program import solve as clarabel_solve

LOOK = 0.01
"""Seconds that a look at the clock takes here: it runs by how often a method looks at it, on every machine the same."""

MOST_LOOKS = 60
"""Looks at the clock at most after a limit is over: solvers are told that no time is left, and words are found."""


def balls(horizon: int) -> lfo.OptimalControlProblem:
    """Return a problem with cones and dense rows: the sparse program is its only method."""
    plain = lfo.library.double_integrator(
        horizon=horizon, sampling_time=4 / horizon, cutoff_hz=horizon / 40, speed_bound=None, control_bound=0.27
    )
    return replace(plain, control_set=lfo.sets.Ball(0.27))


PATHS: dict[str, tuple[Callable[[], lfo.OptimalControlProblem], str]] = {
    "cones and dense rows": (lambda: balls(4000), "auto"),
    "sparse program": (lambda: lfo.library.pendulum(horizon=2000), "convex"),
    "Fourier domain": (lambda: lfo.library.pendulum(horizon=2000, sampling_time=2.4 / 2000), "spectral"),
    "structured": (lambda: lfo.rate_limited(lfo.library.pendulum(horizon=4000), 2.0), "structured"),
    "structured, long": (lambda: lfo.rate_limited(lfo.library.pendulum(horizon=20_000), 2.0), "structured"),
    "structured, cones": (lambda: balls(20_000), "structured"),
    "branch and bound": (lfo.library.cart_pole_with_walls, "branch_and_bound"),
    "enumeration": (lfo.library.ball_and_paddle, "enumerate"),
    "mixed-integer solver": (lfo.library.ball_and_paddle, "miqp"),
    "nonsmooth search": (lfo.library.norm_dynamics, "nonsmooth"),
}


@pytest.mark.parametrize("path", seeds(PATHS))
def test_every_path_ends_at_its_time_limit(path: str) -> None:
    """How long that takes by a real clock is what scripts/verify/limits.py measures."""
    make, method = PATHS[path]
    problem, clock = make(), Clock(LOOK)
    with use_clock(clock), pytest.raises(lfo.errors.LimitError, match=r"time limit|MaxTime|timelimit") as raised:
        lfo.solve(problem, method=method, time_limit=0.05)
    assert clock.seconds < 0.05 + MOST_LOOKS * LOOK
    assert raised.value.result.status == "limit"


def test_the_deadline_and_not_the_limit_reaches_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    limits: list[float | None] = []

    def recorded(program: Any, tolerance: float, time_limit: float | None) -> Any:
        limits.append(time_limit)
        return clarabel_solve(program, tolerance, time_limit)

    substitute(monkeypatch, "program.backend", lambda name: recorded)
    solve_convex(balls(60), "clarabel", SolveOptions(time_limit=1000.0))
    assert limits
    assert all(limit is not None and 0 < limit < 1000.0 for limit in limits)


def test_a_program_whose_set_up_takes_longer_is_not_begun() -> None:
    problem = balls(4000)
    candidate = solve_convex(problem, "clarabel", SolveOptions(time_limit=1.0))
    assert candidate.status == "limit"
    assert candidate.trajectory is None
    assert f"{dense_rows(problem).count} dense rows" in candidate.message


def test_clarabel_stops_when_its_set_up_took_the_time() -> None:
    program = LinearProgram(balls(60)).sparse
    assert clarabel_solve(program, 1e-10, 1e-9).claim.name == "TIME_LIMIT"


def test_small_quadratic_programs_stop_when_told_to() -> None:
    rng = np.random.default_rng(0)
    V = rng.standard_normal((40, 40))
    A, b = V @ V.T / 40, rng.standard_normal(40)
    calls: list[int] = []

    def stop() -> str:
        calls.append(1)
        return "time limit"

    _, content = interior_point(RowQp(A, b, np.full(40, np.inf), *np.zeros((2, 40))), np.zeros(40), stop)
    assert not content
    assert len(calls) == 1
    K, C = np.eye(3), rng.standard_normal((3, 40))
    _, _, content = BorderedQp(3, K, C, A, np.ones(3), b, np.zeros(40), np.full(40, np.inf)).solve(stop)
    assert not content


def test_leaves_that_are_not_looked_at_in_time_prove_nothing() -> None:
    problem = lfo.library.pendulum_with_wall()
    tree = TreeSearch(problem, SearchLimits()).run().tree
    assert np.isfinite(tree_bound(problem, tree).value)
    assert tree_bound(problem, tree, end=-np.inf).value == -np.inf


def test_the_deadline_reaches_the_proof_of_leaves_that_were_solved_again(monkeypatch: pytest.MonkeyPatch) -> None:
    ends: list[float] = []

    def weak(problem: lfo.OptimalControlProblem, tree: ModeTree, end: float = np.inf) -> TreeBound:
        ends.append(end)
        return TreeBound(-np.inf, True, np.full(len(tree.nodes), -np.inf))

    substitute(monkeypatch, "certificate.hybrid.tree_bound", weak)
    lfo.solve(lfo.library.pendulum_with_wall(horizon=4), time_limit=1000.0, throw=False)
    assert len(ends) == 6  # three of each of the searches: below rest, and below nothing
    assert np.isfinite(ends).all()


@expensive
def test_explaining_stops_at_its_limit() -> None:
    """The proof takes 135 looks at the clock, its whole explanation 750 more."""
    problem = replace(lfo.library.pendulum(horizon=240), control_set=lfo.Box(-0.01, 0.01))
    clock = Clock(LOOK)
    with use_clock(clock), pytest.raises(lfo.errors.InfeasibleError) as raised:
        lfo.solve(problem, time_limit=400 * LOOK)
    assert clock.seconds < (400 + MOST_LOOKS) * LOOK
    assert not raised.value.result.explanation.cures


@expensive
def test_a_limit_error_says_cost_bound_and_gap() -> None:
    problem = lfo.library.cart_pole_with_walls()
    with use_clock(Clock(LOOK)), pytest.raises(lfo.errors.LimitError) as raised:
        lfo.solve(problem, time_limit=200 * LOOK)
    error, result = raised.value, raised.value.result
    assert (error.cost, error.bound, error.gap) == (result.cost, result.lower_bound, result.gap)
    for value in (error.cost, error.bound, error.gap):
        assert value is None or f"{value:.6g}" in str(error)
    assert error.cost is None or error.bound is None or error.bound <= error.cost


def test_a_limit_error_without_a_result_has_none_of_them() -> None:
    error = lfo.errors.LimitError("stopped")
    assert (error.cost, error.bound, error.gap) == (None, None, None)
    again = pickle.loads(pickle.dumps(error))
    assert (again.cost, str(again)) == (None, "stopped")


def small_memory(monkeypatch: pytest.MonkeyPatch, size: float) -> None:
    substitute(monkeypatch, "base.memory_limit", lambda: size)
    substitute(monkeypatch, "base.ALWAYS_THERE", 0.0)


@expensive
def test_dense_rows_that_do_not_fit_are_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: Any) -> Any:
        raise AssertionError("dense rows were made")

    substitute(monkeypatch, "program.stop_band_rows", never)
    problem = lfo.library.pendulum(horizon=5000)
    small_memory(monkeypatch, 1e8)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"memory: .*dense rows.* GiB.*spectral"):
        lfo.solve(problem, method="convex")


def test_rows_are_counted_as_they_are_made() -> None:
    problem = lfo.library.pendulum(horizon=41)
    linear = LinearProgram(problem)
    made = np.diff(linear.sparse.A.tocsr().indptr) > 30
    assert made.sum() <= dense_rows(problem).count <= made.sum() + 2


def test_a_horizon_that_does_not_fit_is_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    small_memory(monkeypatch, 1e9)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"memory: .*horizon = 10{8},.* GiB.*shorter horizon"):
        lfo.library.pendulum(horizon=10**8)


def test_the_fourier_domain_method_refuses_what_does_not_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = lfo.library.pendulum(horizon=20_000)
    small_memory(monkeypatch, 1e6)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"memory: method 'spectral' with horizon = 20000"):
        lfo.SpectralSolver(problem)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"dense rows.*'structured'.*memory: method 'spectral'"):
        lfo.solve(problem)


def test_working_rows_that_do_not_fit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = lfo.SpectralSolver(lfo.library.pendulum(horizon=12_000))
    small_memory(monkeypatch, 1e4)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"memory: .*working rows"):
        solver.solve()


def test_a_large_border_is_refused_before_it_is_made() -> None:
    problem = lfo.library.double_integrator(horizon=2 * LARGEST_BORDERED)
    lower, upper = np.full((2 * LARGEST_BORDERED, 1), -1.0), np.full((2 * LARGEST_BORDERED, 1), 1.0)
    lower[::2] = upper[::2] = 0.0
    fixed = replace(problem, control_set=lfo.Box(lower, upper))
    tracemalloc.start()
    try:
        with pytest.raises(lfo.errors.UnsupportedError, match=r"values within the horizon|bordering unknowns"):
            lfo.SpectralSolver(fixed)
        assert tracemalloc.get_traced_memory()[1] < 8 * LARGEST_BORDERED**2 / 2
    finally:
        tracemalloc.stop()
