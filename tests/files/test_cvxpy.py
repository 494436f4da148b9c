"""The problem as CVXPY sees it: its optimum, its duals as the theorem's multipliers, and its limits."""

from __future__ import annotations

import subprocess
import sys

import cvxpy as cp
import numpy as np
import pytest

from helpers.seeds import expensive
from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost, low_pass, stop_band, to_cvxpy
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.library import pendulum
from lin_freq_ocp.program import real_rows


def labelled(program: cp.Problem) -> dict[str, cp.Constraint]:
    return {constraint.label: constraint for constraint in program.constraints}


def bound_multipliers(program: cp.Problem, box: Box, label: str) -> np.ndarray:
    """Return upper minus lower dual, plus the dual of fixed entries, in the shape of the box."""
    result, duals = np.zeros(box.lower.shape), labelled(program)
    parts = (
        (box.fixed, label, 1.0),
        (~box.fixed & np.isfinite(box.lower), f"{label} lower", -1.0),
        (~box.fixed & np.isfinite(box.upper), f"{label} upper", 1.0),
    )
    for where, name, sign in parts:
        assert (name in duals) == where.any()
        if where.any():
            result[where] += sign * duals[name].dual_value
    return result


def frequency_force(program: cp.Problem, stopped: np.ndarray, length: int, label: str) -> np.ndarray:
    """Return R' rho per component, shape (length, components)."""
    result, taken = np.zeros((length, stopped.shape[1])), 0
    for i in np.flatnonzero(stopped.any(axis=0)):
        rows = real_rows(length, stopped[:, i])
        result[:, i] = rows.T @ labelled(program)[label].dual_value[taken : taken + len(rows)]
        taken += len(rows)
    return result


def assert_maximum_principle(problem: OptimalControlProblem, program: cp.Problem, tolerance: float) -> None:
    """Check adjoint equation, transversality at T and the stationarity of H in u, with the signs of section 3."""
    x, u = (program.var_dict[name].value for name in "xu")
    eta = labelled(program)["dynamics"].dual_value
    assert eta.shape == (problem.horizon, problem.state_dim)
    T, n = problem.horizon, problem.state_dim
    states = np.full((2, T + 1, n), [[[-np.inf]], [[np.inf]]])
    if problem.state_set is not None:
        states[0], states[1] = problem.state_set.lower, problem.state_set.upper
    for t, end in ((0, problem.initial_state), (T, problem.terminal_state)):
        states[0, t, end.fixed], states[1, t, end.fixed] = -np.inf, np.inf
    mu = bound_multipliers(program, Box(*states), "state set")
    mu[0] += bound_multipliers(program, problem.initial_state, "initial state")
    mu[T] += bound_multipliers(program, problem.terminal_state, "terminal state")
    nu = bound_multipliers(program, problem.control_tube, "control set")
    in_x, in_u = problem.cost.gradient(x, u)
    in_x += frequency_force(program, problem.state_stop, T + 1, "state spectrum")
    in_u += frequency_force(program, problem.control_stop, T, "control spectrum")
    back_x, back_u = np.split(problem.dynamics.pull_back(eta), [problem.state_dim], axis=1)
    scale = max(1.0, np.abs(back_x).max())
    assert np.abs(eta[:-1] - (back_x - in_x[:-1] - mu[:-1])[1:]).max() <= tolerance * scale
    assert np.abs(eta[-1] + in_x[-1] + mu[-1]).max() <= tolerance * scale
    assert np.abs(back_u - in_u - nu).max() <= tolerance * max(1.0, np.abs(in_u).max())
    assert np.abs(back_x[0] - in_x[0] - mu[0]).max() <= tolerance * scale


def test_the_optimum_and_the_adjoint_of_the_pendulum():
    problem = pendulum()
    program = to_cvxpy(problem)
    program.solve(solver="CLARABEL")
    assert program.value == pytest.approx(3199.18631986, rel=1e-6)
    assert labelled(program).keys() >= {"dynamics", "initial state", "terminal state", "control spectrum"}
    assert_maximum_principle(problem, program, 1e-6)


def everything_at_once(time_varying: bool) -> OptimalControlProblem:
    T, n, m = 24, 3, 2
    rng = np.random.default_rng(2)
    times = (T,) if time_varying else ()
    root = rng.normal(size=(*times, n + m, n + m + 1))
    hessian = root @ np.swapaxes(root, -1, -2)
    A, B = 0.9 * np.eye(n) + 0.1 * rng.normal(size=(*times, n, n)), rng.normal(size=(*times, n, m))
    return OptimalControlProblem(
        dynamics=LinearDynamics(A, B, offset=0.1 * rng.normal(size=(*times, n))),
        horizon=T,
        cost=QuadraticCost(
            Q=hessian[..., :n, :n],
            R=hessian[..., n:, n:],
            S=hessian[..., :n, n:],
            q=rng.normal(size=(*times, n)),
            r=rng.normal(size=(*times, m)),
            P=np.diag([1.0, 0.0, 2.0]),
            p=rng.normal(size=n),
            x_ref=rng.normal(size=(T + 1, n)),
            u_ref=rng.normal(size=(T, m)),
        ),
        control_set=Box([-1.5, None], [None, 1.5]),
        state_set=Box([-4.0, -4.0, None], [4.0, None, None]),
        initial_state=Box([0.5, -1, 0.2], [0.5, 1, 0.2]),
        terminal_state=Box([None, -2, 0.1], [3, 2, 0.1]),
        control_spectrum=[low_pass(2.4), stop_band(bins=[5], component=0)],
        state_spectrum=stop_band(bins=[12, 9], component="x_1"),
    )


@pytest.mark.parametrize("time_varying", [False, True])
def test_value_and_multipliers_where_every_field_is_given(time_varying):
    problem = everything_at_once(time_varying)
    program = to_cvxpy(problem)
    program.solve(solver="CLARABEL")
    x, u = (program.var_dict[name].value for name in "xu")
    assert program.value == pytest.approx(problem.cost.value(x, u), rel=1e-8)
    np.testing.assert_allclose(x[1:], problem.dynamics.successors(x, u), atol=1e-7)
    assert problem.state_tube.contains(x, 1e-6).all()
    assert problem.control_tube.contains(u, 1e-6).all()
    assert np.abs(np.fft.rfft(u, axis=0)[problem.control_stop]).max() <= 1e-6
    assert np.abs(np.fft.rfft(x, axis=0)[problem.state_stop]).max() <= 1e-6
    assert_maximum_principle(problem, program, 1e-5)


def test_sets_that_fix_components_at_some_times():
    dynamics = LinearDynamics([[1.0]], [[1.0]])
    rest = [Box(0, 0) if t % 2 else Box(-1, 1) for t in range(6)]
    problem = OptimalControlProblem(
        dynamics=dynamics,
        horizon=6,
        cost=QuadraticCost(R=1.0),
        control_set=rest,
        initial_state=[0],
        terminal_state=[1.5],
    )
    program = to_cvxpy(problem)
    program.solve(solver="CLARABEL")
    np.testing.assert_allclose(program.var_dict["u"].value[:, 0], [0.5, 0, 0.5, 0, 0.5, 0], atol=1e-7)
    assert_maximum_principle(problem, program, 1e-6)


def test_a_bound_that_the_end_touches_does_not_disturb():
    problem = pendulum(horizon=60, cutoff=None, initial_state=(0.2, 0, 0, 0), terminal_state=None, control_bound=None)
    program = to_cvxpy(problem)
    program.solve(solver="CLARABEL")
    assert program.status == "optimal"
    assert labelled(program)["state set upper"].shape == (60 * 4,)


def test_a_user_can_extend_the_problem():
    program = to_cvxpy(pendulum(cutoff=None))
    assert program.var_dict.keys() == {"x", "u"}
    u = program.var_dict["u"]
    slower = cp.Problem(program.objective, [*program.constraints, cp.abs(cp.diff(u, axis=0)) <= 0.3])
    slower.solve(solver="CLARABEL")
    assert np.abs(np.diff(u.value, axis=0)).max() == pytest.approx(0.3, rel=1e-6)  # the limit is active
    assert slower.value > program.solve(solver="CLARABEL")


def test_rounding_in_a_semidefinite_hessian_is_accepted():
    v = np.random.default_rng(0).normal(size=(4, 1))
    Q = v @ v.T - 1e-15 * np.eye(4)
    problem = pendulum(horizon=30, cutoff=None, terminal_state=None)
    rounded = OptimalControlProblem(
        dynamics=problem.dynamics, horizon=30, cost=QuadraticCost(Q=Q, R=1.0), initial_state=problem.initial_state
    )
    program = to_cvxpy(rounded)
    assert program.is_dcp()
    program.solve(solver="CLARABEL")
    assert program.status == "optimal"


@pytest.mark.parametrize(
    ("cost", "where"), [(QuadraticCost(R=-1.0), "at t = 0"), (QuadraticCost(R=1.0, P=-2.0), "P has the eigenvalue -2")]
)
def test_a_cost_that_is_not_convex_is_refused(cost, where):
    problem = OptimalControlProblem(dynamics=LinearDynamics([[1.0]], [[1.0]]), horizon=3, cost=cost)
    with pytest.raises(UnsupportedError, match=where):
        to_cvxpy(problem)


@expensive
def test_cvxpy_is_imported_by_its_users_only():
    code = "import sys, lin_freq_ocp.files.conversions; sys.exit('cvxpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
