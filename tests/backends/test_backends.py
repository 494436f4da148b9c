"""One table of small programs, with primal and dual known by hand, that every installed solver must get right.

Signs: at a minimum P z + q + A'y = 0, and the dual of a row is positive at its upper and negative at its lower bound.
"""

from __future__ import annotations

import importlib
import os
import signal
import threading
import time
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp

import lin_freq_ocp as lfo
from lin_freq_ocp.backends import base
from lin_freq_ocp.backends.base import Claim, Solution, backend, register
from lin_freq_ocp.backends.interrupt import interrupts_noted
from lin_freq_ocp.backends.qpsolvers_ import SETTINGS
from lin_freq_ocp.errors import MissingExtraError, UnsupportedError
from lin_freq_ocp.methods.convex import sparse_program as convex
from lin_freq_ocp.methods.convex.attempts import SOLVED_TOLERANCE, UNBOUNDED_TOLERANCE
from lin_freq_ocp.methods.convex.sparse_program import solve_convex
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.transcription.program import Program

OWN = ["clarabel", "osqp"]
ALL = OWN + [f"qpsolvers:{name}" for name in sorted(qpsolvers.available_solvers)]
EXACT = {"clarabel", "osqp", "qpsolvers:clarabel", "qpsolvers:piqp", "qpsolvers:highs"}
"""Solvers that must accept and solve every solvable case; the others may also say that they cannot."""

INF = np.inf
each_solver = pytest.mark.parametrize("name", ALL)


def program(P: Any, q: Any, A: Any, lower: Any, upper: Any) -> Program:
    q = np.array(q, dtype=float)
    return Program(
        P=sp.csc_array(np.array(P, dtype=float).reshape(len(q), len(q))),
        q=q,
        constant=0.0,
        A=sp.csc_array(np.array(A, dtype=float).reshape(-1, len(q))),
        lower=np.array(lower, dtype=float),
        upper=np.array(upper, dtype=float),
        rows={},
    )


@dataclass(frozen=True)
class Case:
    """A program with its only primal answer, and its only dual one or None where there are many."""

    program: Program
    z: list[float]
    y: list[float] | None


SOLVABLE = {
    # one variable: min 1/2 z^2 - z, whose free minimum is z = 1, so that y = 1 - z at whatever holds it back
    "upper": Case(program(1, [-1], [1], [-INF], [0.3]), [0.3], [0.7]),
    "lower": Case(program(1, [-1], [1], [1.5], [INF]), [1.5], [-0.5]),
    "equation below": Case(program(1, [-1], [1], [0.3], [0.3]), [0.3], [0.7]),
    "equation above": Case(program(1, [-1], [1], [1.5], [1.5]), [1.5], [-0.5]),
    "two sides, upper": Case(program(1, [-1], [1], [-0.5], [0.3]), [0.3], [0.7]),
    "two sides, lower": Case(program(1, [-1], [1], [1.5], [4.0]), [1.5], [-0.5]),
    "two sides, neither": Case(program(1, [-1], [1], [-5], [7]), [1], [0]),
    "a row without bounds": Case(program(1, [-1], [[1], [1]], [-INF, -INF], [INF, 0.3]), [0.3], [0, 0.7]),
    "negative coefficient": Case(program(1, [-1], [-2], [-0.6], [INF]), [0.3], [-0.35]),  # 0.3 - 1 - 2 y = 0
    "negative coefficient, upper": Case(program(1, [-1], [-2], [-INF], [-3]), [1.5], [0.25]),
    "no rows": Case(program(1, [-1], [], [], []), [1], []),
    # min 1/2 |z|^2 on z_0 + z_1 + z_2 = 3 and z_0 - z_1 = 1: z = a (1,1,1) + b (1,-1,0)
    "equations only": Case(
        program(np.eye(3), [0, 0, 0], [[1, 1, 1], [1, -1, 0]], [3, 1], [3, 1]), [1.5, 0.5, 1], [-1, -0.5]
    ),
    # [[2, 1], [1, 2]] z = -q - A'y with z_0 = 1 held from above: 1 + 2 z_1 = 0, y = 4 - 2 - z_1
    "off-diagonal Hessian": Case(
        program([[2, 1], [1, 2]], [-4, 0], [[1, 0], [0, 1]], [-INF, -9], [1, INF]), [1, -0.5], [2.5, 0]
    ),
    "equation, bounds on both sides": Case(
        # min 1/2 |z|^2, sum z = 3, z_0 <= 0.5, z_2 >= 1.5: z_1 = 1, y_eq = -1, y_0 = 1 - 0.5, y_2 = 1 - 1.5
        program(np.eye(3), [0, 0, 0], [[1, 1, 1], [1, 0, 0], [0, 0, 1]], [3, -INF, 1.5], [3, 0.5, INF]),
        [0.5, 1, 1.5],
        [-1, 0.5, -0.5],
    ),
    "semidefinite Hessian": Case(  # z_1 has no curvature: its bound holds it, 0 + 1 + y = 0
        program(np.diag([1.0, 0.0]), [-1, 1], [0, 1], [-2], [INF]), [1, -2], [-1]
    ),
    "linear programme": Case(  # max z_0 + 2 z_1 on the simplex
        program(np.zeros((2, 2)), [-1, -2], [[1, 1], [1, 0], [0, 1]], [-INF, 0, 0], [1, INF, INF]), [0, 1], [2, -1, 0]
    ),
    "linear programme, equation": Case(
        program(np.zeros((2, 2)), [3, 1], [[1, 1], [1, 0], [0, 1]], [1, 0, 0], [1, 0.4, 0.7]), [0.3, 0.7], [-3, 0, 2]
    ),
    "the same equation twice": Case(program(np.eye(2), [-2, 0], [[1, 1], [2, 2]], [1, 2], [1, 2]), [1.5, -0.5], None),
    "the same bound twice": Case(program(1, [-1], [[1], [2]], [-INF, -INF], [0.3, 0.6]), [0.3], None),
    "bounds that leave one point": Case(  # z_0 >= 0, z_1 >= 0, z_0 + z_1 <= 0: no interior at all
        program(np.eye(2), [-1, -2], [[1, 0], [0, 1], [1, 1]], [0, 0, -INF], [INF, INF, 0]), [0, 0], None
    ),
    "large and small numbers": Case(  # min 1/2 1e4 z^2 - 1e2 z, 1e-2 z <= 5e-5: z = 5e-3, 50 - 100 + 1e-2 y = 0
        program(1e4, [-1e2], [1e-2], [-INF], [5e-5]), [5e-3], [5e3]
    ),
}

INFEASIBLE = {
    "bounds": program(1, [0], [[1], [1]], [1, -INF], [INF, 0]),
    "equations": program(np.eye(2), [0, 0], [[1, 1], [1, 1]], [1, 2], [1, 2]),
    "equation outside bounds": program(
        np.eye(2), [1, -1], [[1, 1], [1, 0], [0, 1]], [3, -1, -1], [3, 1, 1]
    ),  # 1 + 1 < 3
}

UNBOUNDED = {
    "linear": program(0, [-1], [1], [0], [INF]),
    "without curvature": program(np.diag([1.0, 0.0]), [0, -1], [[1, 0], [0, 1]], [0, 0], [1, INF]),
    "along an equation": program(np.zeros((2, 2)), [-1, 0], [[1, -1], [0, 1]], [0, -3], [0, INF]),
}


def ask(name: str, asked: Program, tolerance: float = 1e-9, time_limit: float | None = None) -> Solution:
    return backend(name)(asked, tolerance, time_limit)


def is_accepted(asked: Program, solution: Solution) -> bool:
    """Whether methods.convex would call this an optimum."""
    if solution.claim not in (Claim.SOLVED, Claim.FAILED) or solution.z is None or solution.y is None:
        return False
    with np.errstate(invalid="ignore", over="ignore"):
        return asked.residuals(solution.z, solution.y).worst <= SOLVED_TOLERANCE


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
@pytest.mark.parametrize("label", SOLVABLE)
def test_primal_and_dual_of_the_table(name, label):
    case = SOLVABLE[label]
    solution = ask(name, case.program)
    if not is_accepted(case.program, solution):
        assert name not in EXACT, f"{name} must solve this: {solution}"
        return
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
@pytest.mark.parametrize("label", INFEASIBLE)
def test_infeasible_programs_have_no_answer(name, label):
    asked = INFEASIBLE[label]
    solution = ask(name, asked)
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
@pytest.mark.parametrize("label", UNBOUNDED)
def test_unbounded_programs_have_no_answer(name, label):
    asked = UNBOUNDED[label]
    solution = ask(name, asked)
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
        assert asked.descent_ray_residual(solution.z) <= UNBOUNDED_TOLERANCE


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
@pytest.mark.parametrize("seed", RANDOM_SEEDS)
def test_random_programs_against_enumeration_of_active_sets(name, seed):
    asked = random_program(seed)
    z, y = enumerated(asked)
    solution = ask(name, asked)
    if not is_accepted(asked, solution):
        assert name not in EXACT - {"qpsolvers:highs"}  # its quadratic solver sometimes stops at 1e-5
        return
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
    candidate = solve_convex(problem, name, None, None)
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
    candidate = solve_convex(problem, name, None, None)
    if candidate.status != "optimal":
        assert name not in EXACT
        return
    np.testing.assert_allclose(candidate.trajectory.u[:, 0], [-0.3, -0.7], atol=1e-5)
    np.testing.assert_allclose(candidate.trajectory.x[:, 0], [1.0, 0.7, 0.0], atol=1e-5)
    np.testing.assert_allclose(candidate.multipliers.eta[:, 0], [-0.7, -0.7], atol=1e-5)  # B'eta_1 = u_1
    np.testing.assert_allclose(candidate.multipliers.nu[:, 0], [-0.4, 0.0], atol=1e-5)  # B'eta_0 = u_0 + nu_0
    np.testing.assert_allclose(candidate.multipliers.mu[:, 0], [-0.7, 0.0, 0.7], atol=1e-5)


# ------------------------------------------------------------------------------------------ names, limits, Ctrl-C


@pytest.mark.parametrize("name", ["gurobi", "", "clarabel:fast", "qpsolvers", "qpsolvers:", ":piqp", "Clarabel"])
def test_unknown_names_are_refused(name):
    with pytest.raises(UnsupportedError, match="expected 'clarabel', 'osqp' or 'qpsolvers:NAME'"):
        backend(name)


def test_a_solver_that_is_not_installed_says_how_to_get_it():
    with pytest.raises(MissingExtraError, match=r"pip install 'qpsolvers\[gurobi_from_the_future\]'") as caught:
        backend("qpsolvers:gurobi_from_the_future")
    assert isinstance(caught.value, ImportError)
    assert "piqp" in str(caught.value)  # what is installed


def test_the_test_dependencies_are_installed():
    """Piqp and highs are declared for the tests: without them the table above would shrink unseen."""
    assert {"piqp", "highs", "clarabel", "osqp"} <= set(qpsolvers.available_solvers)
    for module in ("piqp", "highspy"):
        importlib.import_module(module)


def long_program(size: int) -> Program:
    """Return a program of many dense rows, which takes every solver some time."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(2 * size, size))
    root = rng.normal(size=(size, size)) / np.sqrt(size)
    return program(root @ root.T, rng.normal(size=size), A, np.full(2 * size, -1.0), np.full(2 * size, 1.0))


@pytest.mark.parametrize("name", [*OWN, "qpsolvers:clarabel", "qpsolvers:osqp", "qpsolvers:highs"])
def test_a_time_limit_is_a_limit_and_no_failure(name):
    asked = long_program(150)
    solution = ask(name, asked, 1e-9, 1e-4)
    assert solution.claim is Claim.LIMIT
    assert not is_accepted(asked, solution)


@pytest.mark.parametrize("name", OWN)
def test_a_generous_time_limit_changes_nothing(name):
    case = SOLVABLE["equation, bounds on both sides"]
    np.testing.assert_allclose(ask(name, case.program, 1e-9, 60.0).z, case.z, atol=1e-6)


posix = pytest.mark.skipif(os.name != "posix", reason="a process cannot send itself Ctrl-C there")


def interrupt_when_listening(before: Any, stop: threading.Event) -> None:
    """Send this process a Ctrl-C as soon as somebody else than ``before`` would receive it."""
    while not stop.is_set():
        if signal.getsignal(signal.SIGINT) is not before:
            os.kill(os.getpid(), signal.SIGINT)
            return
        time.sleep(1e-4)


@posix
def test_ctrl_c_stops_the_solver_at_a_point_and_gives_the_handler_back():
    asked = long_program(300)
    before = signal.getsignal(signal.SIGINT)
    stop = threading.Event()
    sender = threading.Thread(target=interrupt_when_listening, args=(before, stop))
    sender.start()
    try:
        solution = ask("clarabel", asked)
    finally:
        stop.set()
        sender.join()
    assert signal.getsignal(signal.SIGINT) is before
    assert solution.claim is Claim.INTERRUPTED
    assert solution.z.shape == asked.q.shape
    assert np.isfinite(solution.z).all()
    assert not is_accepted(asked, solution)
    assert is_accepted(SOLVABLE["upper"].program, ask("clarabel", SOLVABLE["upper"].program))  # and the next one runs


@pytest.mark.parametrize("solve", [1, 2])
def test_ctrl_c_is_remembered_in_whichever_solve_it_came(solve, monkeypatch):
    """A solve in revised units is a second one: stopping that one is stopping, too."""
    problem = OptimalControlProblem(
        LinearDynamics([[1.0]], [[1.0]]), 4, QuadraticCost(R=1.0), initial_state=[1.0], terminal_state=[0.0]
    )
    calls: list[Claim] = []

    def interrupted_later(asked: Program, tolerance: float, time_limit: float | None) -> Solution:
        answer = ask("clarabel", asked)
        claim = Claim.INTERRUPTED if len(calls) + 1 == solve else answer.claim
        calls.append(claim)
        return replace(answer, claim=claim)

    monkeypatch.setattr(convex, "backend", lambda name: interrupted_later)
    monkeypatch.setattr(convex, "ACCURATE", -1.0)
    monkeypatch.setattr(convex, "revised_scaling", lambda transcription, scaling, z: scaling)
    candidate = solve_convex(problem, "clarabel", None, None)
    assert calls[-1] is Claim.INTERRUPTED
    assert candidate.interrupted
    assert candidate.trajectory is not None


@posix
def test_interrupts_are_noted_and_not_raised():
    before = signal.getsignal(signal.SIGINT)
    with interrupts_noted() as noted:
        assert not noted.is_set()
        os.kill(os.getpid(), signal.SIGINT)
        assert noted.wait(5)
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_the_handler_is_given_back_after_an_error_too():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ZeroDivisionError), interrupts_noted():
        _ = 1 / 0
    assert signal.getsignal(signal.SIGINT) is before


def test_outside_the_main_thread_nothing_is_installed():
    before = signal.getsignal(signal.SIGINT)
    seen: list[Any] = []

    def work() -> None:
        with interrupts_noted() as noted:
            seen.append((signal.getsignal(signal.SIGINT), noted.is_set()))
        seen.append(ask("clarabel", SOLVABLE["upper"].program).claim)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [(before, False), Claim.SOLVED]


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
    monkeypatch.setattr("lin_freq_ocp.backends.base._REGISTER", dict(base._REGISTER))
    register("toy", lambda member: least_squares)
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
