"""What the judge shares with a search or a solver's scaling, broken on purpose: no wrong answer is called optimal."""

import ast
import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.seeds import expensive, seeds
from helpers.sweeps import SHORT
from lin_freq_ocp import PiecewiseSmoothDynamics, certify
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.certificate import hamiltonian, rays
from lin_freq_ocp.certificate.hybrid import IntervalReach
from lin_freq_ocp.methods.hybrid.search import branch_and_bound
from lin_freq_ocp.methods.hybrid.search import multipliers as search_weights
from lin_freq_ocp.problem import measures
from lin_freq_ocp.problem.hybrid import ModeArrays
from lin_freq_ocp.program import units
from lin_freq_ocp.results import Status
from lin_freq_ocp.transform import stated_sizes
from lin_freq_ocp.transform.hybrid import ModeReach, piecewise_affine

library = lfo.library

ALLOWED = {
    "lin_freq_ocp.problem.hybrid.mode_tree": {"ModeMultipliers", "ModeTree", "PathMultipliers"},
    "lin_freq_ocp.transform.sizes": {"stated_sizes"},
}
"""What the judge imports of modules that searches and scalings use: plain data, and one size (docs/judge.md)."""

SEARCHED_WITH = {
    f"lin_freq_ocp.{name}"
    for name in (
        "problem.measures",
        "problem.hybrid.mode_tree",
        "transform.sizes",
        "transform.response_curvature",
        "transform.level_rows",
        "transform.hybrid.mode_reach",
    )
}

WALL = {"name": "pendulum_with_wall", "horizon": 6, "cost": 34.990971}
ROTATION = {
    "name": "switched_rotation",
    "horizon": 5,
    "initial_state": (1, 1),
    "terminal_cost": False,
    "cost": 2.837155,
}
BUCK = {"name": "buck_affine", "horizon": 6, "cost": 32.681386}
"""Problems of the reference values, and their optima."""


def made(given):
    rest = {key: value for key, value in given.items() if key not in ("name", "cost")}
    return library.by_name(given["name"])(**rest)


def wrongly_optimal(result, cost):
    return result.status == Status.OPTIMAL and abs(result.cost - cost) > 1e-5 * abs(cost)


def test_the_judge_imports_nothing_else_that_a_search_uses():
    folder = Path(hamiltonian.__file__).parent
    found = {}
    assert all(importlib.util.find_spec(name) for name in SEARCHED_WITH)
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module in SEARCHED_WITH:
                found.setdefault(node.module, set()).update(alias.name for alias in node.names)
    assert found == ALLOWED


def shrunk(images, by):
    """Return images of boxes, with a part cut off at both sides."""

    def wrong(self, t, low, high):
        least, most = images(self, t, low, high)
        middle, half = (least + most) / 2, (most - least) / 2
        return middle - by * half, middle + by * half

    return wrong


@pytest.mark.parametrize("given", seeds([WALL, ROTATION, BUCK]))
@pytest.mark.parametrize("by", [0.5, 0.1, 0.0])
def test_a_search_that_loses_trajectories_proves_nothing(monkeypatch, given, by):
    monkeypatch.setattr(ModeReach, "images", shrunk(ModeReach.images, by))
    result = lfo.solve(made(given), throw=False)
    assert not wrongly_optimal(result, given["cost"])
    assert result.status != Status.INFEASIBLE
    assert result.tree_bound.value <= given["cost"] * (1 + 1e-6)


@expensive
def test_that_search_would_have_been_wrong(monkeypatch):
    """The mutation above makes the search lose the optimum: without a judge of its own, this would be 'infeasible'."""
    monkeypatch.setattr(ModeReach, "images", shrunk(ModeReach.images, 0.0))
    results = [lfo.solve(made(given), throw=False) for given in (WALL, ROTATION, BUCK)]
    assert any(not result.tree_bound.covers for result in results)


@expensive
@pytest.mark.parametrize("given", [WALL, ROTATION])
def test_boxes_of_the_judge_that_are_too_small_are_seen_by_trajectories(given):
    """The judge's boxes hold every replayed trajectory, those on the border of the sets too."""
    problem, rng = made(given), np.random.default_rng(0)
    reach = IntervalReach(problem)
    tube, inside = problem.control_tube, 0
    for _ in range(400):
        share = rng.choice([0.0, 0.3, 0.5, 0.8, 1.0], size=tube.lower.shape)
        u = np.clip(tube.lower + share * (tube.upper - tube.lower), -1e3, 1e3)
        x = lfo.simulate(problem, u).x
        if (problem.state_tube.violation(x) > 0)[:-1].any():
            continue
        inside += 1
        assert ((reach.whole.lower <= x) & (x <= reach.whole.upper))[:-1].all()
        for (centre, generators), state in zip(reach.zonotopes[:-1], x[:-1], strict=True):
            assert (np.abs(state - centre) <= np.abs(generators).sum(axis=1) + 1e-9).all()
    assert inside > 20


@expensive
def test_a_search_that_ends_too_early_is_not_called_optimal(monkeypatch):
    right = branch_and_bound.search_scale
    monkeypatch.setattr(branch_and_bound, "search_scale", lambda *given: 1e6 * right(*given))
    for given in (WALL, ROTATION, BUCK):
        result = lfo.solve(made(given), throw=False)
        assert not wrongly_optimal(result, given["cost"])
        assert result.status == Status.OPTIMAL or abs(result.certificate.gap) > 1e-6


@pytest.mark.parametrize("factor", [1e6, 1e-6])
@pytest.mark.parametrize("make", seeds([library.pendulum, SHORT, library.crane]))
def test_natural_units_that_are_wrong_cost_digits_only(monkeypatch, make, factor):
    problem, right = make(), units.stated_sizes
    cost = lfo.solve(problem).cost
    monkeypatch.setattr(units, "stated_sizes", lambda given: tuple(factor * size for size in right(given)))
    for method in ("convex", "auto"):
        assert not wrongly_optimal(lfo.solve(problem, method=method, throw=False), cost)


def test_modes_that_the_search_takes_for_meeting_are_not_believed(monkeypatch):
    """With sizes 1e6 times too large, all modes seem to meet everywhere: weights of those that do not are refused."""
    right = search_weights.measured_modes

    def wrong(problem):
        arrays = right(problem)
        return replace(arrays, least=tuple(1e12 * size for size in arrays.least))

    monkeypatch.setattr(search_weights, "measured_modes", wrong)
    for given in (WALL, BUCK):
        result = lfo.solve(made(given), throw=False)
        assert not wrongly_optimal(result, given["cost"])
        bad = np.full((given["horizon"], len(result.problem.dynamics.modes)), 1.0)
        bad /= bad.shape[1]
        judged = certify(result.problem, result.trajectory, replace(result.multipliers, weights=bad))
        assert judged.pmp == "violated"


@expensive
@pytest.mark.parametrize("factor", [0.0, 1e-9])
def test_distances_from_regions_that_are_too_small_are_not_believed(monkeypatch, factor):
    """Every mode seems to hold everywhere, to the search and to what it shares: the judge measures by itself."""
    solved = [lfo.solve(made(given), throw=False) for given in (WALL, BUCK)]
    right = ModeArrays.distance
    monkeypatch.setattr(ModeArrays, "distance", lambda self, x, u: factor * right(self, x, u))
    for given, true in zip((WALL, BUCK), solved, strict=True):
        result = lfo.solve(made(given), throw=False)
        assert not wrongly_optimal(result, given["cost"])
        judged = certify(true.problem, true.trajectory, true.multipliers)
        assert (judged.pmp, judged.feasible) == (true.certificate.pmp, True)
        for mode in range(len(true.problem.dynamics.modes)):
            replayed = lfo.simulate(
                replace(true.problem, dynamics=piecewise_affine(true.problem).along(np.full(given["horizon"], mode))),
                true.trajectory.u,
            )
            if np.abs(replayed.x - true.trajectory.x).max() > 1e-3:  # led by a mode whose region it has left
                assert not certify(true.problem, replayed, true.multipliers).feasible


@pytest.mark.parametrize("factors", [(1e6, 1e6), (1e-6, 1e-6), (1e6, 1e-6), (1e-6, 1e6)])
@pytest.mark.parametrize("make", seeds([library.pendulum, SHORT, library.crane]))
def test_sizes_that_are_wrong_prove_nothing_of_a_problem_with_an_optimum(monkeypatch, make, factors):
    """They bound the box of a numerical ray, and measure directions: no optimum is called infeasible or unbounded."""
    problem, right, rng = make(), stated_sizes, np.random.default_rng(0)
    result = lfo.solve(problem)
    monkeypatch.setattr(
        rays, "stated_sizes", lambda given: tuple(f * s for f, s in zip(factors, right(given), strict=True))
    )
    for method in ("convex", "auto"):
        found = lfo.solve(problem, method=method)
        assert (found.status, found.cost) == (Status.OPTIMAL, pytest.approx(result.cost))
    for _ in range(10):
        given = {
            field: rng.normal(size=getattr(result.multipliers, field).shape) * getattr(result.multipliers, field)
            for field in ("eta", "mu", "nu", "rho_u", "rho_x")
        }
        ray = replace(result.multipliers, eta_C=0.0, **given)
        proof = rays.prove_infeasible(problem, ray)
        assert proof is None or proof.bound.kind == "numerical"
    assert rays.unbounded_direction(problem, result.trajectory) is None


@pytest.mark.parametrize("factor", [0.0, 0.5, 2.0])
def test_wrong_signals_of_frequency_multipliers_fail(monkeypatch, factor):
    problem = library.pendulum()
    result, right = lfo.solve(problem), hamiltonian.time_signal
    assert np.abs(result.multipliers.rho_u).max() > 0
    monkeypatch.setattr(hamiltonian, "time_signal", lambda *given: factor * right(*given))
    judged = certify(problem, result)
    assert judged.pmp == "violated"
    assert not judged.globally_optimal


@expensive
def test_a_wrong_linearisation_proves_no_global_optimum(monkeypatch):
    """Its stationary points are others; the bound by intervals does not use it."""
    problem = library.norm_dynamics()
    cost, right = (
        lfo.solve(problem, method=lfo.solvers.Nonsmooth(global_bound=False)).cost,
        PiecewiseSmoothDynamics.jets_at,
    )

    def wrong(self, *given, **options):
        found = right(self, *given, **options)
        return replace(found, f=tuple(replace(one, slopes=1.05 * one.slopes) for one in found.f))

    monkeypatch.setattr(PiecewiseSmoothDynamics, "jets_at", wrong)
    with use_clock(Clock(1.0)):
        assert not wrongly_optimal(lfo.solve(problem, throw=False, time_limit=200.0), cost)


def test_a_missed_step_is_seen_without_the_measures_of_reports(monkeypatch):
    problem = library.double_integrator()
    result = lfo.solve(problem)
    monkeypatch.setattr(measures, "one_step_residual", lambda *given: np.zeros_like(result.trajectory.x[1:]))
    x = result.trajectory.x.copy()
    x[3] += 1e-3 * np.abs(x).max()
    judged = certify(problem, lfo.Trajectory(x, result.trajectory.u), result.multipliers)
    assert not judged.feasible
    assert not judged.globally_optimal


@expensive
@pytest.mark.parametrize("name", ["pendulum", "two_mass_spring", "crane", "flexible_satellite", "elliptic_rendezvous"])
def test_certify_says_what_solve_says_of_linear_problems(name):
    result = lfo.solve(library.by_name(name)())
    _same(result, certify(result.problem, result))


@pytest.mark.parametrize(
    "given", seeds([WALL, ROTATION, BUCK, {"name": "absolute_value"}, {"name": "max_min_network"}])
)
def test_certify_says_what_solve_says_of_modes(given):
    result = lfo.solve(made(given))
    _same(result, certify(result.problem, result))


@expensive
@pytest.mark.parametrize("given", [{"name": "norm_dynamics"}, {"name": "buck_converter", "horizon": 3}])
def test_certify_says_what_solve_says_of_smooth_pieces(given):
    """The bound by dynamic programming takes seconds and is not repeated: certify never says more."""
    result = lfo.solve(made(given), method=lfo.solvers.Nonsmooth(global_bound=False), throw=False)
    _same(result, certify(result.problem, result))


def _same(result, judged):
    own = result.certificate
    assert (judged.pmp, judged.normal, judged.feasible) == (own.pmp, own.normal, own.feasible)
    assert judged.globally_optimal == own.globally_optimal
    assert judged.cost == own.cost
    assert judged.gap == (None if own.gap is None else pytest.approx(own.gap, abs=1e-12))
