"""Units of a program: undone exactly, natural ones near one, and of no effect on answers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from helpers.seeds import seeds
from helpers.transcribed import each_problem, small_problem
from lin_freq_ocp import (
    Box,
    LinearDynamics,
    MagnitudeBound,
    OptimalControlProblem,
    QuadraticCost,
    StageRows,
    library,
    solve,
    stop_band,
)
from lin_freq_ocp.methods import Candidate, solve_convex
from lin_freq_ocp.problem import Band
from lin_freq_ocp.program import (
    Block,
    LinearProgram,
    Scaling,
    backend,
    is_revision,
    natural_scaling,
    point_units,
    scaled_program,
    stated_scaling,
)
from lin_freq_ocp.sets import Ball


@each_problem
def test_a_change_of_units_is_undone_exactly(problem):
    program = LinearProgram(problem).sparse
    rng = np.random.default_rng(9)
    scaling = Scaling(10 ** rng.uniform(-3, 3, len(program.q)), 10 ** rng.uniform(-3, 3, program.A.shape[0]), 0.02)
    scaled = program.scaled(scaling)
    z, y = rng.normal(size=len(program.q)), rng.normal(size=program.A.shape[0])
    own, dual = scaling.primal(z), scaling.dual(y)
    assert scaled.objective(z) == pytest.approx(scaling.cost * program.objective(own), rel=1e-12)
    np.testing.assert_allclose(scaled.A @ z, scaling.rows * (program.A @ own), rtol=1e-10, atol=1e-10)
    stationarity = scaling.cost * scaling.columns * (program.P @ own + program.q + program.A.T @ dual)
    np.testing.assert_allclose(scaled.P @ z + scaled.q + scaled.A.T @ y, stationarity, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(scaled.equality, program.equality)
    np.testing.assert_array_equal(np.isfinite(scaled.upper), np.isfinite(program.upper))
    np.testing.assert_array_equal(np.isfinite(scaled.lower), np.isfinite(program.lower))
    identity = program.scaled(Scaling(np.ones(len(z)), np.ones(len(y)), 1.0))
    assert identity.residuals(z, y) == program.residuals(z, y)
    assert scaled.rows == program.rows


def test_a_point_stays_in_its_cone_in_other_units():
    """The radius is a row without variables, and the state has a unit of its own."""
    linear = LinearProgram(small_problem(state_set=Ball(1e3)))
    program, scaling = linear.sparse, stated_scaling(linear)
    assert len(program.cones) == 19  # both ends are given
    for cone in program.cones:
        assert np.ptp(scaling.rows[cone]) == 0


def change_units(
    problem: OptimalControlProblem, states: np.ndarray, controls: np.ndarray, cost: float
) -> OptimalControlProblem:
    """Return the same problem for x' = states x, u' = controls u, J' = cost J."""
    dynamics, old = problem.dynamics, problem.cost
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            states[:, None] * dynamics.A / states, states[:, None] * dynamics.B / controls, states * dynamics.offset
        ),
        horizon=problem.horizon,
        cost=QuadraticCost(
            Q=cost * old.Q / np.outer(states, states),
            R=cost * old.R / np.outer(controls, controls),
            S=cost * old.S / np.outer(states, controls),
            q=cost * old.q / states,
            r=cost * old.r / controls,
            P=cost * old.P / np.outer(states, states),
            p=cost * old.p / states,
            x_ref=old.x_ref * states,
            u_ref=old.u_ref * controls,
        ),
        control_set=Box(problem.control_tube.lower * controls, problem.control_tube.upper * controls),
        state_set=Box(problem.state_tube.lower * states, problem.state_tube.upper * states),
        initial_state=problem.initial_state.lower * states if problem.initial_state.fixed.all() else None,
        terminal_state=problem.terminal_state.lower * states if problem.terminal_state.fixed.all() else None,
        control_spectrum=problem.control_spectrum,
        state_spectrum=problem.state_spectrum,
        stage_rows=[
            StageRows(cost * rows.C / states, cost * rows.D / controls, cost * rows.e) for rows in problem.stage_rows
        ],
    )


UNIT_PROBLEMS = {
    "bounds everywhere": small_problem(state_set=Box([-2.0, -0.7], [2.0, 0.7])),
    "speed without any number": small_problem(),  # no bound, no reference, both ends at rest
    "nothing but ends": small_problem(control_set=None),
    "one end": small_problem(control_set=None, terminal_state=None),
    "tracking": small_problem(
        cost=QuadraticCost(Q=np.diag([10.0, 0.1]), R=0.1, x_ref=[0.3, 0.0], u_ref=[0.2]),
        initial_state=[0.0, 0.0],
        terminal_state=None,
        control_set=Box(-1.0, 1.0),
        state_spectrum=stop_band(bins=[9], component=0),
    ),
    "drift": small_problem(
        dynamics=LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], [0.0, -0.05]),
        cost=QuadraticCost(R=1.0, r=[0.3], S=[[0.1], [0.2]], Q=np.eye(2), P=3.0, p=[1.0, -1.0]),
        terminal_state=None,
        control_set=None,
    ),
    "joint rows": small_problem(
        control_set=None, stage_rows=StageRows([[0, -1], [1, 0]], [[-0.1], [0.5]], [0.3, 0.35])
    ),
}
UNITS = {
    "control large": (1.0, 1.0, 1e6, 1.0),
    "control small": (1.0, 1.0, 1e-6, 1.0),
    "states large": (1e6, 1e6, 1.0, 1.0),
    "states small": (1e-6, 1e-6, 1.0, 1.0),
    "cost large": (1.0, 1.0, 1.0, 1e6),
    "cost small": (1.0, 1.0, 1.0, 1e-6),
    "against each other": (1e6, 1e-6, 1e6, 1e-6),
    "the other way round": (1e-6, 1e6, 1e-6, 1e6),
    "all small": (1e-6, 1e-6, 1e-6, 1.0),
}
_SOLVED: dict[str, Candidate] = {}


def solved_once(name: str) -> Candidate:
    """Return the answer in the units of the table above."""
    if name not in _SOLVED:
        _SOLVED[name] = solve_convex(UNIT_PROBLEMS[name], "clarabel")
    return _SOLVED[name]


@pytest.mark.parametrize("name", UNIT_PROBLEMS)
@pytest.mark.parametrize("units", UNITS.values(), ids=UNITS.keys())
def test_units_change_nothing_but_the_units(name, units):
    """The same optimum and multipliers, relative to the size of each, in units of a million or a millionth."""
    states, controls, cost = np.array(units[:2]), np.array(units[2:3]), units[3]
    before, problem = solved_once(name), UNIT_PROBLEMS[name]
    after = solve_convex(change_units(problem, states, controls, cost), "clarabel")
    assert before.status == "optimal"
    assert after.status == "optimal"
    old, new = before.multipliers, after.multipliers
    largest = max(np.abs(part).max() for part in (old.eta, old.mu, old.nu, old.rho_u, old.rho_x))
    for found, expected, size in (
        (after.trajectory.x / states, before.trajectory.x, np.abs(before.trajectory.x).max()),
        (after.trajectory.u / controls, before.trajectory.u, np.abs(before.trajectory.u).max()),
        (new.eta * states / cost, old.eta, largest),
        (new.mu * states / cost, old.mu, largest),
        (new.nu * controls / cost, old.nu, largest),
        (new.rho_u * controls / cost, old.rho_u, largest),
        (new.rho_x * states / cost, old.rho_x, largest),
        *((new.stage[name], old.stage[name], largest) for name in old.stage),
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * size)


def in_bins(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem with its bands as bins, free of any unit of time."""

    def bands(stop: np.ndarray) -> list[Band]:
        return [stop_band(bins=np.flatnonzero(stop[:, j]), component=j) for j in np.flatnonzero(stop.any(axis=0))]

    changes = {"control_spectrum": bands(problem.control_stop), "state_spectrum": bands(problem.state_stop)}
    return dataclasses.replace(problem, **changes)


@pytest.mark.parametrize("seed", seeds(range(6)))
@pytest.mark.parametrize("name", ["flexible_satellite", "two_mass_spring"])
def test_models_with_hidden_states_in_random_units(name, seed):
    """Modal states and speeds have no bound, end or reference that would say how large they are."""
    problem = in_bins(getattr(library, name)())
    rng = np.random.default_rng(seed)
    states, controls = 10 ** rng.uniform(-6, 6, problem.state_dim), 10 ** rng.uniform(-6, 6, problem.control_dim)
    cost = float(10 ** rng.uniform(-6, 6))
    before = solve_convex(problem, "clarabel")
    after = solve_convex(change_units(problem, states, controls, cost), "clarabel")
    assert before.status == "optimal"
    assert after.status == "optimal"
    x, u = after.trajectory.x / states, after.trajectory.u / controls
    optimum = problem.cost.value(before.trajectory.x, before.trajectory.u)
    assert problem.cost.value(x, u) == pytest.approx(optimum, rel=1e-6)
    sizes = np.abs(before.trajectory.x).max(axis=0)
    np.testing.assert_allclose(x / sizes, before.trajectory.x / sizes, rtol=0, atol=1e-4)
    np.testing.assert_allclose(u, before.trajectory.u, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", UNIT_PROBLEMS)
def test_natural_units_see_numbers_near_one(name):
    problem = UNIT_PROBLEMS[name]
    _, scaling, program = scaled_program(problem)
    states, controls = np.split(scaling.columns, [2 * (problem.horizon + 1)])
    assert set(states[::2]) == {states[0]}  # one unit per component, whatever the time
    assert set(states[1::2]) == {states[1]}
    assert set(controls) == {controls[0]}
    A, dynamics = program.A.toarray(), program.rows[Block.DYNAMICS]
    successors = A[dynamics][:, 2 : 2 * (problem.horizon + 1)]
    np.testing.assert_allclose(np.diag(successors), 1, rtol=1e-12)  # x_{t+1} in its own unit
    np.testing.assert_allclose(np.linalg.norm(A[dynamics.stop :], axis=1), 1, rtol=1e-12)
    solution = backend("clarabel")(program, 1e-9, None)
    assert program.residuals(solution.z, solution.y).worst < 1e-8
    assert 0.1 < np.abs(solution.z).max() < 100
    assert 1e-3 < np.abs(solution.y).max() < 1e4


@pytest.mark.parametrize(
    "changes",
    [
        {"cost": QuadraticCost(), "terminal_state": None},
        {"initial_state": None, "terminal_state": None, "control_set": None},
        {"initial_state": [0.0, 0.0]},
        {"dynamics": LinearDynamics(np.eye(2), np.zeros((2, 1)))},  # the end cannot be reached
        {"dynamics": LinearDynamics(30 * np.eye(2), np.ones((2, 1)))},  # grows by 1e29
        {"state_set": Box(0.0, 0.0), "initial_state": None, "terminal_state": None},
        {"control_set": Box(0.0, 0.0), "terminal_state": None},
        {"cost": QuadraticCost(p=[1e-300, 0.0])},
    ],
    ids=["no cost", "no numbers", "at rest", "unreachable", "unstable", "no state", "no control", "tiny cost"],
)
def test_units_exist_whatever_the_problem(changes):
    scaling = natural_scaling(LinearProgram(small_problem(**changes)))
    for units in (scaling.columns, scaling.rows, np.array([scaling.cost])):
        assert np.isfinite(units).all()
        assert (units > 0).all()


def test_a_point_that_is_no_number_keeps_its_units():
    linear = LinearProgram(small_problem())
    units = natural_scaling(linear).columns
    point = np.full(len(units), np.nan)
    np.testing.assert_array_equal(point_units(linear, point, units), units)
    assert not is_revision(point_units(linear, point, units) / units, 1.0)


@pytest.mark.parametrize("limit", [0.2, 1e9])
@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1.0, 1e6])
def test_a_mask_is_a_cone_of_order_one_in_every_unit(unit, limit):
    """Its limit stands in a row of zeros, which kept its cone in the unit of the control."""
    one = LinearDynamics([[0.9]], [[1.0 / unit]])
    mask = MagnitudeBound(limit * unit, bins=[1, 2])
    cost = QuadraticCost(Q=1.0, R=0.5 / unit**2)
    problem = OptimalControlProblem(one, 6, cost, Box(-unit, unit), None, [0.5], control_spectrum=mask)
    linear = LinearProgram(problem)
    scaled = linear.sparse.scaled(natural_scaling(linear))
    for cone in scaled.cones:
        assert 0.1 < max(abs(scaled.A[cone]).max(), np.abs(scaled.lower[cone]).max()) <= 1.0 + 1e-12
    answers = [solve(problem, method) for method in ("convex", "structured")]
    assert [one.status for one in answers] == ["optimal"] * 2
    assert answers[0].cost == pytest.approx(answers[1].cost, rel=1e-6)
