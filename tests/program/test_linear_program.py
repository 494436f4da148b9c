"""The program against its problem: rows, cost and multipliers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.linear_kinds import KINDS, T
from helpers.transcribed import M, N, each_problem, small_problem
from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost, Trajectory
from lin_freq_ocp.problem import StageMap, SumMap, Term, TermKind, Within
from lin_freq_ocp.program import Block, Claim, LinearProgram, backend, real_rows


def random_trajectory(problem: OptimalControlProblem, seed: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    T = problem.horizon
    return Trajectory(rng.normal(size=(T + 1, N)), rng.normal(size=(T, M)))


def at(values: np.ndarray, t: int, ndim: int) -> np.ndarray:
    """Return what holds at time t, of something that may be given one per time."""
    return values if values.ndim == ndim else values[t]


@each_problem
def test_trajectory_and_point_are_inverse(problem):
    linear = LinearProgram(problem)
    trajectory = random_trajectory(problem, 1)
    z = linear.point(trajectory)
    assert z.shape == linear.sparse.q.shape
    back = linear.trajectory(z)
    np.testing.assert_allclose(back.x, trajectory.x, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(back.u, trajectory.u, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(linear.point(back), z, rtol=1e-14, atol=1e-14)
    origin, one = linear.trajectory(0 * z), linear.trajectory(z)
    units = linear.column_units(np.array([2.0, 3.0, 5.0]), np.array([7.0, 11.0]))
    scaled = linear.trajectory(units * z)
    np.testing.assert_allclose(scaled.x - origin.x, (one.x - origin.x) * [2, 3, 5], atol=1e-12)
    np.testing.assert_allclose(scaled.u - origin.u, (one.u - origin.u) * [7, 11], atol=1e-12)


@each_problem
def test_objective_is_the_cost(problem):
    linear = LinearProgram(problem)
    program = linear.sparse
    assert abs(program.P - program.P.T).max() < 1e-13
    for seed in range(4):
        trajectory = random_trajectory(problem, seed)
        z = linear.point(trajectory)
        assert program.objective(z) == pytest.approx(problem.cost.value(trajectory.x, trajectory.u), rel=1e-12)
        gradient = np.concatenate([part.ravel() for part in problem.cost.gradient(trajectory.x, trajectory.u)])
        np.testing.assert_allclose(program.P @ z + program.q, gradient, atol=1e-11)


@each_problem
def test_rows_are_the_constraints_under_their_names(problem):
    linear = LinearProgram(problem)
    program, T = linear.sparse, problem.horizon
    assert sorted(i for rows in program.rows.values() for i in range(rows.start, rows.stop)) == list(
        range(program.A.shape[0])
    )
    trajectory = random_trajectory(problem, 3)
    x, u = trajectory.x, trajectory.u
    value = program.A @ linear.point(trajectory)

    def of(block: Block) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = program.rows[block]
        return value[rows], program.lower[rows], program.upper[rows]

    found, lower, upper = of(Block.DYNAMICS)
    missed = []
    for t in range(T):
        A, B, d = problem.dynamics.at(t)
        missed.append(x[t + 1] - A @ x[t] - B @ u[t] - d)
    np.testing.assert_array_equal(lower, upper)
    np.testing.assert_allclose((found - lower).reshape(T, N), missed, atol=1e-12)

    for block, tube, signal in ((Block.STATE_SET, problem.state_tube, x), (Block.CONTROL_SET, problem.control_tube, u)):
        found, lower, upper = of(block)
        expected = [
            (signal[t, i] - tube.lower[t, i], tube.upper[t, i] - signal[t, i])
            for t in range(len(signal))
            for i in range(signal.shape[1])
            if np.isfinite(tube.lower[t, i]) or np.isfinite(tube.upper[t, i])
        ]
        assert 0 < len(expected)
        np.testing.assert_allclose(np.column_stack([found - lower, upper - found]), expected, atol=1e-13)

    found, lower, upper = of(Block.TERMS)
    left = [
        at(rows.e, t, 1)[i] - at(rows.C, t, 2)[i] @ x[t] - at(rows.D, t, 2)[i] @ u[t]
        for rows in problem.stage_rows
        for t in range(T)
        for i in range(rows.rows)
        if np.isfinite(at(rows.e, t, 1)[i])
    ]
    assert len(left) == 2 * T + sum(t % 3 > 0 for t in range(T))
    assert (lower == -np.inf).all()
    np.testing.assert_allclose(upper - found, left, atol=1e-12)

    for block, stop, signal in (
        (Block.STATE_SPECTRUM, problem.state_stop, x),
        (Block.CONTROL_SPECTRUM, problem.control_stop, u),
    ):
        found, lower, upper = of(block)
        np.testing.assert_array_equal(lower, upper)
        length = len(signal)
        full = np.array([[stop[min(k, length - k), j] for j in range(stop.shape[1])] for k in range(length)])
        assert len(found) == full.sum() > 0
        energy = np.abs(np.fft.fft(signal, axis=0)) ** 2
        assert ((found - lower) ** 2).sum() == pytest.approx(energy[full].sum() / length, rel=1e-11)


@each_problem
def test_feasible_points_of_the_program_are_those_of_the_problem(problem):
    """A signal in its bands and boxes gives no residual in those rows; leaving any one of them gives one."""
    linear = LinearProgram(problem)
    program = linear.sparse
    inside = Trajectory(problem.state_tube.project(np.zeros((problem.horizon + 1, N))), np.zeros((problem.horizon, M)))
    boxes = np.r_[program.rows[Block.STATE_SET], program.rows[Block.CONTROL_SET]]

    def violation(x: np.ndarray, u: np.ndarray) -> float:
        value = (program.A @ linear.point(Trajectory(x, u)))[boxes]
        return float(np.maximum(program.lower[boxes] - value, value - program.upper[boxes]).max())

    assert violation(inside.x, inside.u) <= 0
    for tube, which in ((problem.state_tube, 0), (problem.control_tube, 1)):
        for t, i in np.ndindex(tube.lower.shape):
            for bound, sign in ((tube.upper, 1), (tube.lower, -1)):
                if np.isfinite(bound[t, i]):
                    parts = [inside.x.copy(), inside.u.copy()]
                    parts[which][t, i] = bound[t, i] + sign * 0.125
                    assert violation(*parts) == pytest.approx(0.125)


@each_problem
def test_multipliers_are_those_of_the_lagrangian_of_the_theorem(problem):
    """For any duals y, A'y is the gradient of <eta, x+ - f> + <mu, x> + <nu, u> + <rho, DFT>, here by explicit sums."""
    linear = LinearProgram(problem)
    program, T = linear.sparse, problem.horizon
    rng = np.random.default_rng(7)
    y = rng.normal(size=program.A.shape[0])
    multipliers = linear.multipliers(y, 1.0)
    eta, rho_x, rho_u = multipliers.eta, multipliers.rho_x, multipliers.rho_u

    def in_time(rho: np.ndarray, t: int, length: int) -> np.ndarray:
        return sum((rho[k] * np.exp(2j * np.pi * k * t / length)).real for k in range(len(rho)))

    in_x, in_u = np.array(multipliers.mu), np.array(multipliers.nu)
    for t in range(T + 1):
        in_x[t] += in_time(rho_x, t, T + 1)
        if t > 0:
            in_x[t] += eta[t - 1]
        if t < T:
            A, B, _ = problem.dynamics.at(t)
            in_x[t] -= A.T @ eta[t]
            in_u[t] += in_time(rho_u, t, T) - B.T @ eta[t]
            for rows in problem.stage_rows:
                in_x[t] += at(rows.C, t, 2).T @ multipliers.stage[rows.name][t]
                in_u[t] += at(rows.D, t, 2).T @ multipliers.stage[rows.name][t]
    gradient = np.split(program.A.T @ y, [(T + 1) * N])
    np.testing.assert_allclose(gradient[0].reshape(T + 1, N), in_x, atol=1e-12)
    np.testing.assert_allclose(gradient[1].reshape(T, M), in_u, atol=1e-12)
    assert multipliers.eta_C == 1.0


@each_problem
def test_multipliers_live_only_where_there_are_constraints(problem):
    linear = LinearProgram(problem)
    y = 1 + np.random.default_rng(8).random(linear.sparse.A.shape[0])
    multipliers = linear.multipliers(y, 0.0)
    assert multipliers.eta_C == 0.0
    for values, where in (
        (multipliers.mu, np.isfinite(problem.state_tube.lower) | np.isfinite(problem.state_tube.upper)),
        (multipliers.nu, np.isfinite(problem.control_tube.lower) | np.isfinite(problem.control_tube.upper)),
        (multipliers.rho_x, problem.state_stop),
        (multipliers.rho_u, problem.control_stop),
        *((multipliers.stage[rows.name], np.isfinite(rows.e)) for rows in problem.stage_rows),
    ):
        assert where.any()
        np.testing.assert_array_equal(values != 0, np.broadcast_to(where, values.shape))


def test_a_bin_multiplier_is_the_price_of_its_bin():
    """d J* / d uhat_k = -rho_u[k], the conjugate bin moving with it: by central differences of solved programs."""
    problem = small_problem(terminal_state=Box([0, None], [0, None]))
    linear = LinearProgram(problem)
    program, T = linear.sparse, problem.horizon
    band = program.rows[Block.CONTROL_SPECTRUM]
    solve = backend("clarabel")
    solution = solve(program, 1e-12, None)
    rho = linear.multipliers(solution.y, 1.0).rho_u[:, 0]
    step = 1e-3
    for bin_, direction in ((5, 1), (5, 1j), (8, 1), (8, 1j), (10, 1)):
        costs = []
        for delta in (step * direction, -step * direction):
            wave = np.real(np.fft.ifft([delta if k == bin_ else 0 for k in range(T)]))
            wave = wave if 2 * bin_ == T else 2 * wave  # the signal whose bins k and N - k are delta and its conjugate
            right = program.lower.copy()
            right[band] = real_rows(T, problem.control_stop[:, 0]) @ wave
            moved = dataclasses.replace(
                program,
                lower=np.where(program.equality, right, program.lower),
                upper=np.where(program.equality, right, program.upper),
            )
            answer = solve(moved, 1e-12, None)
            u = linear.trajectory(answer.z).u[:, 0]
            assert np.fft.fft(u)[bin_] == pytest.approx(delta, abs=1e-8)
            costs.append(problem.cost.value(*dataclasses.astuple(linear.trajectory(answer.z))))
        price = -(rho[bin_] * np.conj(direction)).real
        assert abs(price) > 1e-3
        assert (costs[0] - costs[1]) / (2 * step) == pytest.approx(price, rel=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_another_origin_changes_the_variables_only(kind):
    problem, rng = KINDS[kind](), np.random.default_rng(4)
    origin = Trajectory(rng.normal(size=(problem.horizon + 1, 2)), rng.normal(size=(problem.horizon, 2)))
    trajectory = Trajectory(origin.x + 0.3, origin.u - 0.2)
    plain, moved = LinearProgram(problem), LinearProgram(problem, origin)
    z, other = plain.point(trajectory), moved.point(trajectory)
    np.testing.assert_allclose(moved.trajectory(other).x, trajectory.x, atol=1e-14)
    np.testing.assert_allclose(moved.trajectory(other).u, trajectory.u, atol=1e-14)
    assert moved.sparse.objective(other) == pytest.approx(problem.value(trajectory.x, trajectory.u), rel=1e-12)
    for side in ("lower", "upper"):
        margins = [getattr(each.sparse, side) - each.sparse.A @ at for each, at in ((plain, z), (moved, other))]
        np.testing.assert_allclose(*margins, atol=1e-12)
    y = rng.normal(size=len(plain.sparse.lower))
    one, same = plain.multipliers(y, 1.0), moved.multipliers(y, 1.0)
    for name in one.stage:
        np.testing.assert_array_equal(one.stage[name], same.stage[name])


@pytest.mark.parametrize(("constant", "rows"), [(0.0, 0), (1.0, 1)])
def test_an_equation_without_coefficients_is_left_out_only_where_it_holds(constant, rows):
    problem = KINDS["no constraint"]()
    empty = SumMap((StageMap(np.arange(2), np.zeros((2, 1, 2)), None, np.zeros(1)),), np.array([constant]))
    problem.__dict__["terms"] = (Term("nothing", TermKind.STATE_SPECTRUM, empty, Within(0.0)),)
    program = LinearProgram(problem).sparse
    found = program.rows[Block.TERMS]
    assert found.stop - found.start == rows
    if rows:
        assert backend("clarabel")(program, 1e-9, None).claim is Claim.INFEASIBLE


def test_the_layout_has_one_place_for_every_multiplier():
    problem = KINDS["coasting with a band"]()
    program = LinearProgram(problem)
    layout, rng = program.layout, np.random.default_rng(1)
    values, eta = rng.normal(size=layout.count), rng.normal(size=(T, 2))
    found = layout.multipliers(eta, np.append(np.arange(layout.count), -1), np.append(values, 9.0), 0.0)
    flat = [found.mu, found.nu]
    for rho in (found.rho_x, found.rho_u):
        flat.append(np.stack([rho.T.real, rho.T.imag], axis=-1))
    flat += [found.stage[term.name] for term in problem.terms]
    np.testing.assert_array_equal(np.concatenate([part.ravel() for part in flat]), values)
    assert found.eta_C == 0.0
    # duals of one multiplier add up
    twice = layout.multipliers(eta, np.array([3, 3]), np.array([1.0, 0.5]), 1.0)
    assert twice.mu.ravel()[3] == 1.5


def test_a_program_with_the_matrices_of_another_is_that_of_its_own_problem():
    """The second of two problems differs in its offset, linear terms, references, bounds and ends."""
    old, new = (
        OptimalControlProblem(
            LinearDynamics([[0.9]], [[1.0]], offset=[0.1 * k]),
            3,
            QuadraticCost(Q=1.0, R=1.0, P=1.0, q=[0.2 * k], x_ref=1.0 + k, u_ref=0.5 * k),
            Box(-1.0 - k, 1.0),
            initial_state=[0.3 * k],
        )
        for k in range(2)
    )
    shared, own = LinearProgram(new), LinearProgram(new)
    assert shared.share_matrices(LinearProgram(old))
    for part in ("q", "constant", "lower", "upper"):
        np.testing.assert_array_equal(getattr(shared.sparse, part), getattr(own.sparse, part))


def test_the_origin_is_as_near_to_a_reference_as_a_state_can_be():
    """Signals and slacks are deviations that bounds and dynamics leave, however far the reference is."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0, 0.0], [0.0, 1.0]], np.eye(2)),
        5,
        lfo.QuadraticCost(Q=1.0, R=1.0, x_ref=[1e6, 3.0]) + lfo.costs.L1Cost(x=[1.0, 0.0]) + lfo.costs.LInfCost(x=2.0),
        lfo.Box(-1.0, 1.0),
        initial_state=[0.0, 1.0],
    )
    linear, trajectory = LinearProgram(problem), lfo.simulate(problem, np.ones((5, 2)))
    np.testing.assert_array_equal(linear.origin.x[:, 1], 3.0)
    assert np.abs(linear.origin.x[:, 0]).max() <= 10.0
    z = linear.point(trajectory)
    assert np.abs(z).max() < 50.0
    assert linear.sparse.objective(z) == pytest.approx(problem.value(trajectory.x, trajectory.u), rel=1e-14)
    shifted = dataclasses.replace(problem, initial_state=[1e6, 1.0], cost=lfo.costs.L1Cost(x=1.0))
    slacks = LinearProgram(shifted).of_terms[0].origin.reshape(5, 2)
    np.testing.assert_allclose(slacks[:, 0], 1e6, atol=20.0)
