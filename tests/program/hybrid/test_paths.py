"""Path relaxations: tighter than shares of modes, proven by any duals; without compiled code, shares have to do."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.modes import random_problem
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate.hybrid import tree_bound
from lin_freq_ocp.methods.hybrid import TOLERANCES, path_library, solve_relaxation
from lin_freq_ocp.problem.hybrid import ModeNode, ModeTree
from lin_freq_ocp.program.hybrid import ModeRelaxation, PathRelaxation
from lin_freq_ocp.transform.hybrid import piecewise_affine

FULL = lfo.QuadraticCost(Q=[[2, 1.5], [1.5, 2]], R=0.3, S=[[0.2], [0.1]], P=[[3, -1], [-1, 1]], x_ref=[0.3, -0.2])
TURNED = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
FIELDS = {
    "plain": {},
    "band": {"control_spectrum": lfo.stop_band(bins=[1])},
    "full": {"cost": FULL},
    "free": {"initial_state": None},
    "end": {"terminal_state": [0.2, 0.1]},
    "rows of the end": {"terminal_state": lfo.sets.Polyhedron(TURNED, [0.5, 0.3, 0.2, 0.1])},
    "one state without cost": {"cost": lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=1.0, x_ref=[0.5, 0.0])},
}


@pytest.fixture(params=["paths", "shares"])
def solver(request, monkeypatch):
    """Solve nodes by compiled code, or as if there were none."""
    if request.param == "shares":
        substitute(monkeypatch, "methods.hybrid.path_library", lambda: None)
    elif path_library() is None:
        pytest.skip("no C compiler")
    return request.param


def root(problem, kind=PathRelaxation):
    relaxation = kind(problem)
    everything = np.ones((problem.horizon, len(problem.dynamics.modes)), dtype=bool)
    return relaxation, relaxation.reach.from_start(everything)


@pytest.mark.parametrize("name", seeds(FIELDS))
def test_a_solution_is_proven_by_its_duals_and_by_the_judge(name, solver):
    problem = random_problem(4, horizon=5, **FIELDS[name])
    relaxation, reach = root(problem)
    answer = solve_relaxation(relaxation, reach)
    assert (answer.duals.vertices is None) == (solver == "shares")
    close = 1e-2 if name == "full" else 1e-6  # a Hessian that is not diagonal is bounded from below by one that is
    proven = relaxation.proven(reach, answer.duals)
    assert proven == pytest.approx(answer.bound, rel=close)
    node = ModeNode(-1, -1, reach.allowed, answer.bound, relaxation.multipliers(answer.duals))
    assert tree_bound(problem, ModeTree((node,))).value == pytest.approx(answer.bound, rel=close)
    best, shares = lfo.solve(problem).cost, solve_relaxation(*root(problem, ModeRelaxation)).bound
    assert shares - 1e-6 * abs(best) <= answer.bound <= best + 1e-6 * abs(best)


@needs_kernel
def test_paths_leave_less_open_than_shares():
    problem = lfo.library.buck_affine(horizon=10, control_spectrum="freq")
    best = lfo.solve(problem).cost
    shares, paths = (best - solve_relaxation(*root(problem, kind)).bound for kind in (ModeRelaxation, PathRelaxation))
    assert 0 < paths < 0.5 * shares


@expensive
@needs_kernel
@pytest.mark.parametrize("name", ["plain", "band", "rows of the end"])
def test_any_duals_prove_less_than_any_trajectory_costs(name):
    problem = random_problem(1, horizon=4, **FIELDS[name])
    relaxation, reach = root(problem)
    best, rng = lfo.solve(problem).cost, np.random.default_rng(0)
    duals = solve_relaxation(relaxation, reach).duals
    for size in (0.01, 0.1, 1.0):
        factor = {part: 1 + size * rng.normal() for part in ("vertices", "images", "sides")}
        moved = replace(
            duals,
            regions=np.abs(duals.regions + size * rng.normal(size=duals.regions.shape)),
            **{part: factor[part] * (getattr(duals, part) + size * rng.normal()) for part in factor},
        )
        assert relaxation.proven(reach, moved) <= best + 1e-9 * abs(best)
        node = ModeNode(-1, -1, reach.allowed, 0.0, relaxation.multipliers(moved))
        judged = tree_bound(problem, ModeTree((node,))).value
        assert judged <= best + 1e-9 * abs(best)


def test_a_cutoff_ends_relaxations_early_with_a_bound_that_holds(solver):
    relaxation, reach = root(random_problem(2, horizon=6, kinks=2))
    exact = solve_relaxation(relaxation, reach).bound
    for cutoff in (exact - 0.3 * abs(exact), exact + 0.3 * abs(exact)):
        rough = solve_relaxation(relaxation, reach, TOLERANCES, np.inf, cutoff)
        assert (rough.bound > cutoff) == (exact > cutoff)
        assert rough.bound <= exact + 1e-6 * abs(exact)
        assert rough.bound == pytest.approx(exact, rel=1e-2) or rough.bound > cutoff


@pytest.mark.parametrize("seed", seeds(range(3)))
def test_any_duals_of_rows_at_all_times_prove_less_than_any_trajectory_costs(seed):
    """Rows of states before the end are those of all modes together: shares of modes solve them, not paths."""
    diamond = lfo.sets.Polyhedron(TURNED, np.full(4, 1.5))
    problem = random_problem(seed, horizon=4, initial_state=[0.3, 0.2], state_set=diamond)
    relaxation, reach = root(problem)
    assert relaxation.path_member(reach) is None
    answer, best, rng = solve_relaxation(relaxation, reach), lfo.solve(problem).cost, np.random.default_rng(0)
    assert relaxation.proven(reach, answer.duals) == pytest.approx(answer.bound, rel=1e-5)
    for size in (0.01, 0.1, 1.0):
        moved = replace(answer.duals, sides=answer.duals.sides + size * rng.normal(size=answer.duals.sides.shape))
        assert relaxation.proven(reach, moved) <= best + 1e-9 * abs(best)


@needs_kernel
def test_rows_of_the_end_that_no_reachable_state_violates_are_left_out():
    problem = random_problem(4, horizon=5, **FIELDS["rows of the end"])
    relaxation, reach = root(problem)
    assert relaxation.path_member(reach).program.ends.tolist() == [0, 1, 2, 3]
    far = replace(problem, terminal_state=lfo.sets.Polyhedron(TURNED, [0.5, 90.0, 0.2, 80.0]))
    relaxation, reach = root(far)
    assert relaxation.path_member(reach).program.ends.tolist() == [0, 2]
    assert not solve_relaxation(relaxation, reach).duals.sides[[1, 3]].any()


@pytest.mark.parametrize("name", ["plain", "band", "free", "rows of the end"])
def test_the_bound_of_compiled_code_is_that_of_its_multipliers(name):
    if path_library() is None:
        pytest.skip("no C compiler")
    relaxation, reach = root(random_problem(2, horizon=6, kinks=2, **FIELDS[name]))
    exact = solve_relaxation(relaxation, reach).bound
    for cutoff in (exact - abs(exact), exact - 0.1 * abs(exact), exact + 0.1 * abs(exact), exact + 5 * abs(exact)):
        answer = solve_relaxation(relaxation, reach, TOLERANCES, np.inf, cutoff)
        assert answer.bound == pytest.approx(relaxation.proven(reach, answer.duals), rel=1e-9)
        assert answer.bound < exact - 1e-3 * abs(exact)  # it ended early
        assert (answer.bound > cutoff) == (exact > cutoff)


def test_what_has_no_trajectory_is_proven_empty(solver):
    problem = random_problem(0, horizon=4, terminal_state=[2, 2], control_spectrum=lfo.stop_band(bins=[1]))
    relaxation, reach = root(problem)
    answer = solve_relaxation(relaxation, reach)
    assert answer.bound == np.inf
    node = ModeNode(-1, -1, reach.allowed, np.inf, relaxation.multipliers(answer.duals))
    assert tree_bound(problem, ModeTree((node,))).value == np.inf


@pytest.mark.parametrize("name", seeds(["buck_affine", "switched_rotation", "pendulum_with_wall"]))
def test_searches_agree_with_and_without_compiled_code(name, solver):
    given = {"initial_state": (-6, 7)} if name == "switched_rotation" else {}
    problem = lfo.library.by_name(name)(horizon=8, control_spectrum="freq", **given)
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert abs(result.gap) < 1e-6
    assert result.cost == pytest.approx(lfo.solve(problem, method="enumerate").cost, rel=1e-6)


def test_where_edges_of_many_modes_are_many_shares_have_to_do():
    relaxation, reach = root(random_problem(0, horizon=6, kinks=3))
    assert relaxation.path_member(reach) is None
    assert np.isfinite(solve_relaxation(relaxation, reach).bound)
    relaxation, reach = root(random_problem(0, horizon=3, kinks=3))  # the reach leaves few
    assert relaxation.path_member(reach) is not None


@expensive
def test_a_small_cost_gets_units_in_which_its_tree_is_proven():
    """Weights of a Riccati equation, a thousand times those of the stages; a cost a ten-thousandth of what is usual."""
    base = lfo.library.cart_pole_with_walls(12, damping=10.0, initial_state=(0.43, -0.05, 0.3, 0.0))
    free = next(mode.linear for mode in piecewise_affine(base).modes if mode.name == "free")
    Q, R = 0.0025 * np.eye(4), 0.0025 * np.eye(1)
    problem = replace(base, cost=lfo.QuadraticCost(Q, R, P=solve_discrete_are(free.A, free.B, Q, R)))
    result = lfo.solve(problem)
    usual, small = PathRelaxation(problem), PathRelaxation(problem, 2 * result.cost)
    assert usual.objective(result.cost) < 0.01
    assert small.objective(result.cost) == pytest.approx(0.5)
    assert result.status == "optimal"
    assert abs(result.gap) < 1e-6
