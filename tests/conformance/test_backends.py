"""One table of small programs, with primal and dual known by hand, that every installed solver must get right.

Signs: at a minimum P z + q + A'y = 0, and the dual of a row is positive at its upper and negative at its lower bound.
"""

from __future__ import annotations

import importlib
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import qpsolvers

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.programs import INF, INFEASIBLE, OWN, SOLVABLE, UNBOUNDED, ask, is_accepted, long_program, program
from helpers.seeds import seeds
from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.errors import MissingExtraError, UnsupportedError
from lin_freq_ocp.methods import SOLVED_TOLERANCE, solve_convex
from lin_freq_ocp.program import ITERATION_LIMITS, REGISTER, SETTINGS, Claim, Program, Solution, SolverEntry, backend

ALL = OWN + [f"qpsolvers:{name}" for name in sorted(qpsolvers.available_solvers)]
EXACT = {"clarabel", "osqp", "qpsolvers:clarabel", "qpsolvers:piqp", "qpsolvers:highs"}
"""Solvers that must accept and solve every solvable case; the others may also say that they cannot."""

WITH_BINARIES = ["scip", "daqp"]  # tests/program/hybrid/test_mixed_integer.py has their programs

each_solver = pytest.mark.parametrize("name", ALL)


def test_every_solver_of_the_package_is_here():
    assert {name.partition(":")[0] for name in (*ALL, *WITH_BINARIES)} == set(REGISTER)


def violated_conditions(asked: Program, z: np.ndarray, y: np.ndarray) -> dict[str, float]:
    """Return how much each optimality condition is violated, written out row by row and apart from the package."""
    P, A = asked.P.toarray(), asked.A.toarray()
    feasibility = sign = complementarity = 0.0
    for i in range(len(asked.lower)):
        value = A[i] @ z
        feasibility = max(feasibility, asked.lower[i] - value, value - asked.upper[i])
        if y[i] > 0:
            sign = max(sign, y[i] if asked.upper[i] == INF else 0.0)
            complementarity = max(complementarity, y[i] * min(asked.upper[i] - value, 1e9))
        if y[i] < 0:
            sign = max(sign, -y[i] if asked.lower[i] == -INF else 0.0)
            complementarity = max(complementarity, -y[i] * min(value - asked.lower[i], 1e9))
    stationarity = np.abs(P @ z + asked.q + A.T @ y).max()
    return {"feasible": feasibility, "stationary": stationarity, "sign": sign, "complementary": complementarity}


@pytest.mark.parametrize("case", SOLVABLE.values(), ids=SOLVABLE.keys())
def test_the_table_itself_is_right(case):
    """Each answer of the table satisfies the optimality conditions, and each program is convex."""
    assert np.linalg.eigvalsh(case.program.P.toarray())[0] >= -1e-12
    if case.y is not None:
        conditions = violated_conditions(case.program, np.array(case.z), np.array(case.y))
        assert max(conditions.values()) < 1e-12
        assert case.program.residuals(np.array(case.z), np.array(case.y)).worst < 1e-12


@each_solver
def test_primal_and_dual_of_the_table(name):
    for label in seeds(SOLVABLE):
        case = SOLVABLE[label]
        solution = ask(name, case.program)
        if not is_accepted(case.program, solution):
            assert name not in EXACT, f"{name} must solve this: {solution}"
            continue
        scale = np.abs(np.concatenate([case.program.q, case.y or [1.0]])).max()
        assert np.allclose(solution.z, case.z, atol=2e-6)
        if case.y is not None:
            assert np.allclose(solution.y, case.y, atol=2e-6 * scale)
        conditions = violated_conditions(case.program, solution.z, solution.y)
        assert max(conditions.values()) < 5e-6 * scale, conditions


@pytest.mark.parametrize("name", [name for name in ALL if name in OWN or name.removeprefix("qpsolvers:") in SETTINGS])
def test_a_solver_that_is_told_its_tolerance_keeps_it(name):
    """What it calls solved at 1e-9 is within the 1e-6 at which methods.convex accepts it."""
    for asked in [*(case.program for case in SOLVABLE.values()), *map(random_program, RANDOM_SEEDS)]:
        solution = ask(name, asked)
        if solution.claim is Claim.SOLVED:
            assert asked.residuals(solution.z, solution.y).worst <= SOLVED_TOLERANCE


@each_solver
def test_every_solver_solves_some_of_the_table(name):
    """A solver that refuses everything would pass all other tests."""
    accepted = [label for label, case in SOLVABLE.items() if is_accepted(case.program, ask(name, case.program))]
    assert len(accepted) >= len(SOLVABLE) // 3, accepted


@each_solver
def test_infeasible_programs_have_no_answer(name):
    for label in INFEASIBLE:
        asked, solution = INFEASIBLE[label], ask(name, INFEASIBLE[label])
        assert not is_accepted(asked, solution)
        assert solution.claim is not Claim.UNBOUNDED
        if name in OWN:
            assert solution.claim is Claim.INFEASIBLE
        if solution.claim is Claim.INFEASIBLE:  # Farkas: A'y = 0 while max <y, A z> over the bounds is negative
            y = solution.y / np.abs(solution.y).max()
            bound = np.where(y > 1e-6, asked.upper, np.where(y < -1e-6, asked.lower, 0.0))
            assert np.isfinite(bound).all()
            assert np.abs(asked.A.T @ y).max() < 1e-4
            assert y @ bound < -0.1


@each_solver
def test_unbounded_programs_have_no_answer(name):
    for label in UNBOUNDED:
        asked, solution = UNBOUNDED[label], ask(name, UNBOUNDED[label])
        assert not is_accepted(asked, solution)
        assert solution.claim is not Claim.INFEASIBLE
        if name in OWN:
            assert solution.claim is Claim.UNBOUNDED
        if solution.claim is Claim.UNBOUNDED:  # a direction: no curvature, no bound in its way, downhill
            z = solution.z / np.abs(solution.z).max()
            assert asked.q @ z < -0.1
            assert np.abs(asked.P @ z).max() < 1e-6
            assert ((asked.A @ z)[np.isfinite(asked.upper)] < 1e-6).all()
            assert ((asked.A @ z)[np.isfinite(asked.lower)] > -1e-6).all()


def enumerated(asked: Program) -> tuple[np.ndarray, np.ndarray]:
    """Return primal and dual of a strictly convex program by trying every active set."""
    P, A, rows = asked.P.toarray(), asked.A.toarray(), len(asked.lower)
    for sides in product((0, 1, -1), repeat=rows):
        active = np.flatnonzero(sides)
        bound = np.where(np.array(sides) > 0, asked.upper, asked.lower)[active]
        if not np.isfinite(bound).all() or any(sides[i] == 0 for i in np.flatnonzero(asked.equality)):
            continue
        size = len(active)
        kkt = np.block([[P, A[active].T], [A[active], np.zeros((size, size))]])
        if np.linalg.matrix_rank(kkt) < len(kkt):
            continue
        answer = np.linalg.solve(kkt, np.concatenate([-asked.q, bound]))
        z, y = answer[: len(asked.q)], np.zeros(rows)
        y[active] = answer[len(asked.q) :]
        if max(violated_conditions(asked, z, y).values()) < 1e-9:
            return z, y
    raise AssertionError("no active set is optimal")


RANDOM_SEEDS = range(6)


def random_program(seed: int) -> Program:
    """Return a strictly convex program of four variables with one equation and four two-, one-sided or free rows."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4))
    inside = rng.normal(size=4)
    A = rng.normal(size=(5, 4))
    lower, upper = A @ inside - rng.random(5), A @ inside + rng.random(5)
    lower[0] = upper[0] = A[0] @ inside
    lower[rng.integers(1, 5)], upper[rng.integers(1, 5)] = -INF, INF
    return program(root @ root.T + 0.3 * np.eye(4), 3 * rng.normal(size=4), A, lower, upper)


@each_solver
def test_random_programs_against_enumeration_of_active_sets(name):
    for seed in seeds(RANDOM_SEEDS):
        asked = random_program(seed)
        z, y = enumerated(asked)
        solution = ask(name, asked)
        if not is_accepted(asked, solution):
            assert name not in EXACT - {"qpsolvers:highs"}  # its quadratic solver sometimes stops at 1e-5
            continue
        assert np.allclose(solution.z, z, atol=1e-5)
        assert np.allclose(solution.y, y, atol=1e-5 * max(1.0, np.abs(y).max()))


def test_the_random_programs_have_bounds_at_work():
    active = [np.sign(enumerated(random_program(seed))[1][1:]) for seed in RANDOM_SEEDS]
    assert (np.array(active) > 0).any()
    assert (np.array(active) < 0).any()
    assert (np.array(active) == 0).any()


@each_solver
def test_a_program_is_not_changed_by_solving_it(name):
    asked = random_program(1)
    copies = [np.array(part) for part in (asked.q, asked.lower, asked.upper, asked.P.toarray(), asked.A.toarray())]
    first, second = ask(name, asked), ask(name, asked)
    for copy, part in zip(
        copies, (asked.q, asked.lower, asked.upper, asked.P.toarray(), asked.A.toarray()), strict=True
    ):
        np.testing.assert_array_equal(copy, part)
    if is_accepted(asked, first):
        np.testing.assert_allclose(first.z, second.z, atol=1e-6)


@each_solver
def test_answers_are_numbers_or_absent(name):
    """Absent is None, never NaN: a NaN would slip through comparisons further on."""
    for asked in [*INFEASIBLE.values(), *UNBOUNDED.values(), random_program(0)]:
        solution = ask(name, asked)
        for part, size in ((solution.z, len(asked.q)), (solution.y, len(asked.lower))):
            assert part is None or (part.shape == (size,) and np.isfinite(part).all())
        assert isinstance(solution.message, str)
        if solution.claim is Claim.SOLVED:
            assert solution.z is not None
            assert solution.y is not None


@each_solver
def test_an_unbounded_control_problem_is_never_optimal(name):
    """From the problem down: whatever the solver makes of it, nothing crashes and nothing is called an optimum."""
    problem = OptimalControlProblem(
        LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]]),
        5,
        QuadraticCost(p=[1.0, 0.0]),
        initial_state=[0.0, 0.0],
    )
    candidate = solve_convex(problem, name)
    assert candidate.status in (("unbounded",) if name in OWN else ("unbounded", "numerical_error"))


@each_solver
def test_a_control_problem_by_every_solver(name):
    """x+ = x + u from 1 to 0 in two steps, u_0 >= -0.3: u = (-0.3, -0.7); eta_t = u_t + nu_t by hand."""
    problem = OptimalControlProblem(
        LinearDynamics([[1.0]], [[1.0]]),
        2,
        QuadraticCost(R=1.0),
        control_set=Box([[-0.3], [-9.0]], None),
        initial_state=[1.0],
        terminal_state=[0.0],
    )
    candidate = solve_convex(problem, name)
    if candidate.status != "optimal":
        assert name not in EXACT
        return
    np.testing.assert_allclose(candidate.trajectory.u[:, 0], [-0.3, -0.7], atol=1e-5)
    np.testing.assert_allclose(candidate.trajectory.x[:, 0], [1.0, 0.7, 0.0], atol=1e-5)
    np.testing.assert_allclose(candidate.multipliers.eta[:, 0], [-0.7, -0.7], atol=1e-5)  # B'eta_1 = u_1
    np.testing.assert_allclose(candidate.multipliers.nu[:, 0], [-0.4, 0.0], atol=1e-5)  # B'eta_0 = u_0 + nu_0
    np.testing.assert_allclose(candidate.multipliers.mu[:, 0], [-0.7, 0.0, 0.7], atol=1e-5)


@pytest.mark.parametrize("name", ["gurobi", "", "clarabel:fast", "qpsolvers", "qpsolvers:", ":piqp", "Clarabel"])
def test_unknown_names_are_refused(name):
    with pytest.raises(UnsupportedError, match="expected 'clarabel', 'osqp' or 'qpsolvers:NAME'"):
        backend(name)


def test_a_solver_that_is_not_installed_says_how_to_get_it():
    with pytest.raises(MissingExtraError, match=r"pip install 'qpsolvers\[mosek\]'") as caught:
        backend("qpsolvers:mosek")
    assert isinstance(caught.value, ImportError)
    assert "piqp" in str(caught.value)  # what is installed


@pytest.mark.parametrize(("name", "advice"), [("nosuch", "Installed: .*piqp"), ("pipq", "Did you mean 'piqp'")])
def test_a_name_that_is_no_solver_advises_no_extra(name, advice):
    with pytest.raises(UnsupportedError, match=rf"got 'qpsolvers:{name}', which is no solver of qpsolvers\. {advice}"):
        backend(f"qpsolvers:{name}")


def test_the_test_dependencies_are_installed():
    """Piqp and highs are declared for the tests: without them the table above would shrink unseen."""
    assert {"piqp", "highs", "clarabel", "osqp"} <= set(qpsolvers.available_solvers)
    for module in ("piqp", "highspy"):
        importlib.import_module(module)


@pytest.mark.parametrize("name", [*OWN, "qpsolvers:clarabel", "qpsolvers:osqp", "qpsolvers:highs"])
def test_a_time_limit_is_a_limit_and_no_failure(name):
    asked = long_program(150)
    with use_clock(Clock(1.0)):
        solution = ask(name, asked, 1e-9, 1e-6)
    assert solution.claim is Claim.TIME_LIMIT
    assert not is_accepted(asked, solution)


def test_a_solver_without_a_limit_of_its_own_has_one(monkeypatch):
    """HiGHS 1.11 cycles for ever on one of the programs of a pendulum that its bounds keep from its end."""
    monkeypatch.setitem(ITERATION_LIMITS, "highs", dict.fromkeys(ITERATION_LIMITS["highs"], 3))
    assert ask("qpsolvers:highs", long_program(150)).claim is Claim.FAILED


@pytest.mark.parametrize("name", OWN)
def test_a_generous_time_limit_changes_nothing(name):
    case = SOLVABLE["equation, bounds on both sides"]
    np.testing.assert_allclose(ask(name, case.program, 1e-9, 60.0).z, case.z, atol=1e-6)


def least_squares(program, tolerance, time_limit):
    """Solve a program whose rows are equations, or inactive, by its KKT equations: a solver as others may add it."""
    rows = np.flatnonzero(program.equality)
    A, P = program.A.toarray()[rows], program.P.toarray()
    matrix = np.block([[P, A.T], [A, np.zeros((len(rows), len(rows)))]])
    z, y = np.split(np.linalg.lstsq(matrix, np.append(-program.q, program.upper[rows]))[0], [len(program.q)])
    duals = np.zeros(len(program.lower))
    duals[rows] = y
    return Solution(Claim.SOLVED, z, duals, "solved")


def test_a_new_solver_is_one_registration(monkeypatch):
    monkeypatch.setitem(REGISTER, "toy", SolverEntry(lambda member: least_squares))
    problem = OptimalControlProblem(
        dynamics=LinearDynamics(A=[[1.0, 0.1], [0.0, 1.0]], B=[[0.0], [0.1]]),
        horizon=10,
        cost=QuadraticCost(Q=1.0, R=0.1),
        initial_state=[1.0, 0.0],
    )
    result = lfo.solve(problem, method="convex", backend="toy")
    assert result.status == "optimal"
    assert result.cost == pytest.approx(lfo.solve(problem, method="convex").cost, rel=1e-9)
    with pytest.raises(UnsupportedError, match="'toy' solves quadratic programs only"):
        lfo.solve(replace(problem, state_set=lfo.sets.Ball(2.0)), method="convex", backend="toy")
    with pytest.raises(UnsupportedError, match="for a mixed-integer program"):
        backend("toy", binaries=True)
