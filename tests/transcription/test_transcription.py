"""The program against its problem: rows, cost, multipliers, units, and the residuals that judge a solver."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from lin_freq_ocp import library
from lin_freq_ocp.backends.base import backend
from lin_freq_ocp.methods.convex.sparse_program import Candidate, scaled_program, solve_convex
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import Band, low_pass, stop_band, time_signal
from lin_freq_ocp.problem.terms.stage_rows import StageRows
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transcription.linear.real_rows import bin_multipliers, real_rows
from lin_freq_ocp.transcription.linear.transcription import LinearTranscription
from lin_freq_ocp.transcription.linear.units import natural_scaling
from lin_freq_ocp.transcription.program import Block, Program, Scaling

# ------------------------------------------------------------------------------------------------------- real rows


def masks(length: int) -> list[np.ndarray]:
    """Return masks of stopped bins: none, all, DC alone, the last alone, and random ones."""
    bins = length // 2 + 1
    rng = np.random.default_rng(length)
    fixed = [np.zeros(bins, bool), np.ones(bins, bool), np.arange(bins) == 0, np.arange(bins) == bins - 1]
    return fixed + [rng.random(bins) < 0.5 for _ in range(3)]


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 12, 13, 240, 241])
def test_real_rows_are_orthonormal_and_as_many_as_the_closed_set_of_bins(length):
    for mask in masks(length):
        rows = real_rows(length, mask)
        closed = {int(k) for k in np.flatnonzero(mask)} | {-int(k) % length for k in np.flatnonzero(mask)}
        assert rows.shape == (len(closed), length)
        np.testing.assert_allclose(rows @ rows.T, np.eye(len(closed)), atol=1e-12)
        assert len(closed) == 0 or np.linalg.matrix_rank(rows) == len(closed)


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 12, 13, 240, 241])
def test_real_rows_measure_the_stopped_bins_and_no_other(length):
    """R v = 0 iff the bins are zero: |R v|^2 is the energy of the closed set of bins over N (Parseval)."""
    rng = np.random.default_rng(length + 1)
    for mask in masks(length):
        rows = real_rows(length, mask)
        v = rng.normal(size=length)
        spectrum = np.fft.rfft(v)
        energy = np.abs(np.fft.fft(v)) ** 2
        closed = sorted({int(k) for k in np.flatnonzero(mask)} | {-int(k) % length for k in np.flatnonzero(mask)})
        assert ((rows @ v) ** 2).sum() == pytest.approx(energy[closed].sum() / length, rel=1e-11, abs=1e-12)
        kept = np.fft.irfft(np.where(mask, 0, spectrum), n=length)
        np.testing.assert_allclose(rows @ kept, 0, atol=1e-12)
        np.testing.assert_allclose(kept, v - rows.T @ (rows @ v), atol=1e-12)  # R'R is the projection on the band


def test_every_row_is_the_formula():
    mask = np.array([True, False, True, True])
    t = np.arange(6)
    expected = [
        np.ones(6) / np.sqrt(6),
        np.sqrt(2 / 6) * np.cos(2 * np.pi * 2 * t / 6),
        -np.sqrt(2 / 6) * np.sin(2 * np.pi * 2 * t / 6),
        (-1.0) ** t / np.sqrt(6),
    ]
    np.testing.assert_allclose(real_rows(6, mask), expected, atol=1e-15)


def test_long_signals_lose_no_digits():
    length = 100_003
    mask = np.zeros(length // 2 + 1, bool)
    mask[-2:] = True
    rows = real_rows(length, mask)
    np.testing.assert_allclose(rows @ rows.T, np.eye(4), atol=1e-12)
    kept = np.fft.irfft(np.where(mask, 0, np.fft.rfft(np.random.default_rng(1).normal(size=length))), n=length)
    np.testing.assert_allclose(rows @ kept, 0, atol=1e-10)


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 12, 13, 240, 241])
def test_bin_multipliers_are_the_duals_as_a_function_of_time(length):
    rng = np.random.default_rng(length + 2)
    for mask in masks(length):
        rows = real_rows(length, mask)
        duals = rng.normal(size=len(rows))
        rho = bin_multipliers(length, mask, duals)
        assert rho.shape == mask.shape
        assert not rho[~mask].any()
        k = np.arange(length // 2 + 1)
        single = (k == 0) | (2 * k == length)
        assert not rho[single].imag.any()
        phase = np.exp(2j * np.pi * np.outer(np.arange(length), k) / length)
        np.testing.assert_allclose((phase @ rho).real, rows.T @ duals, atol=1e-12)
        np.testing.assert_allclose(time_signal(rho[:, None], length)[:, 0], rows.T @ duals, atol=1e-12)


# ------------------------------------------------------------------------------------------------- program of a problem

N, M = 3, 2


def everything_at_once(horizon: int, seed: int = 5, per_time: bool = True) -> OptimalControlProblem:
    """Return a random problem that uses every part of the description, with partly infinite bounds."""
    rng = np.random.default_rng(seed)
    T = horizon
    times = (T,) if per_time else ()

    def psd(size: int, count: tuple[int, ...]) -> np.ndarray:
        root = rng.normal(size=(*count, size, size))
        return root @ np.swapaxes(root, -1, -2)

    H = psd(N + M, times)
    lower, upper = -1 - rng.random((T + 1, N)), 1 + rng.random((T + 1, N))
    lower[rng.random(lower.shape) < 0.4], upper[rng.random(upper.shape) < 0.4] = -np.inf, np.inf
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            rng.normal(size=(*times, N, N)) / 2, rng.normal(size=(*times, N, M)), rng.normal(size=(*times, N))
        ),
        horizon=T,
        cost=QuadraticCost(
            Q=(H[..., :N, :N] + np.swapaxes(H[..., :N, :N], -1, -2)) / 2,
            R=(H[..., N:, N:] + np.swapaxes(H[..., N:, N:], -1, -2)) / 2,
            S=H[..., :N, N:],
            q=rng.normal(size=(*times, N)),
            r=rng.normal(size=(*times, M)),
            P=psd(N, ()),
            p=rng.normal(size=N),
            x_ref=rng.normal(size=(T + 1, N)),
            u_ref=rng.normal(size=(T, M)),
        ),
        state_set=Box(lower, upper),
        control_set=[Box([-1.0 - t, None], [2.0, 0.5 + t]) for t in range(T)],
        initial_state=Box([0.1, None, None], [0.1, 0.5, None]),
        terminal_state=Box([None, -0.3, None], [None, -0.3, 0.2]),
        control_spectrum=[stop_band(bins=[0, 2], component=0), low_pass(1.9, component=1)],
        state_spectrum=[stop_band(bins=[1], component=2), stop_band(bins=[T // 2], component=0)],
        stage_rows=[
            StageRows(rng.normal(size=(*times, 3, N)), rng.normal(size=(3, M)), [1.0, np.inf, 2.0], name="first"),
            StageRows(None, rng.normal(size=(*times, 1, M)), np.where(np.arange(T) % 3, 1.5, np.inf)[:, None]),
        ],
    )


PROBLEMS = [everything_at_once(T, per_time=per_time) for T in (7, 8) for per_time in (True, False)]
each_problem = pytest.mark.parametrize("problem", PROBLEMS, ids=["7", "7 constant", "8", "8 constant"])


def random_trajectory(problem: OptimalControlProblem, seed: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    T = problem.horizon
    return Trajectory(rng.normal(size=(T + 1, N)), rng.normal(size=(T, M)))


def at(values: np.ndarray, t: int, ndim: int) -> np.ndarray:
    """Return what holds at time t, of something that may be given one per time."""
    return values if values.ndim == ndim else values[t]


@each_problem
def test_trajectory_and_point_are_inverse(problem):
    transcription = LinearTranscription(problem)
    trajectory = random_trajectory(problem, 1)
    z = transcription.point(trajectory)
    assert z.shape == transcription.program.q.shape
    back = transcription.trajectory(z)
    np.testing.assert_allclose(back.x, trajectory.x, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(back.u, trajectory.u, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(transcription.point(back), z, rtol=1e-14, atol=1e-14)
    origin, one = transcription.trajectory(0 * z), transcription.trajectory(z)
    units = transcription.column_units(np.array([2.0, 3.0, 5.0]), np.array([7.0, 11.0]))
    scaled = transcription.trajectory(units * z)
    np.testing.assert_allclose(scaled.x - origin.x, (one.x - origin.x) * [2, 3, 5], atol=1e-12)
    np.testing.assert_allclose(scaled.u - origin.u, (one.u - origin.u) * [7, 11], atol=1e-12)


@each_problem
def test_objective_is_the_cost(problem):
    transcription = LinearTranscription(problem)
    program = transcription.program
    assert abs(program.P - program.P.T).max() < 1e-13
    for seed in range(4):
        trajectory = random_trajectory(problem, seed)
        z = transcription.point(trajectory)
        assert program.objective(z) == pytest.approx(problem.cost.value(trajectory.x, trajectory.u), rel=1e-12)
        gradient = np.concatenate([part.ravel() for part in problem.cost.gradient(trajectory.x, trajectory.u)])
        np.testing.assert_allclose(program.P @ z + program.q, gradient, atol=1e-11)


@each_problem
def test_rows_are_the_constraints_under_their_names(problem):
    transcription = LinearTranscription(problem)
    program, T = transcription.program, problem.horizon
    assert sorted(i for rows in program.rows.values() for i in range(rows.start, rows.stop)) == list(
        range(program.A.shape[0])
    )
    trajectory = random_trajectory(problem, 3)
    x, u = trajectory.x, trajectory.u
    value = program.A @ transcription.point(trajectory)

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
    transcription = LinearTranscription(problem)
    program = transcription.program
    inside = Trajectory(problem.state_tube.project(np.zeros((problem.horizon + 1, N))), np.zeros((problem.horizon, M)))
    boxes = np.r_[program.rows[Block.STATE_SET], program.rows[Block.CONTROL_SET]]

    def violation(x: np.ndarray, u: np.ndarray) -> float:
        value = (program.A @ transcription.point(Trajectory(x, u)))[boxes]
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
    transcription = LinearTranscription(problem)
    program, T = transcription.program, problem.horizon
    rng = np.random.default_rng(7)
    y = rng.normal(size=program.A.shape[0])
    multipliers = transcription.multipliers(y, 1.0)
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
    transcription = LinearTranscription(problem)
    y = 1 + np.random.default_rng(8).random(transcription.program.A.shape[0])
    multipliers = transcription.multipliers(y, 0.0)
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


def small_problem(**changes: Any) -> OptimalControlProblem:
    """Return a double integrator with a tight control bound and a stop band."""
    given: dict[str, Any] = {
        "dynamics": LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]]),
        "horizon": 20,
        "cost": QuadraticCost(R=1.0, Q=np.diag([1.0, 0.1])),
        "initial_state": [0.4, 0.0],
        "terminal_state": [0.0, 0.0],
        "control_set": Box(-1.5, 1.5),
        "control_spectrum": stop_band(bins=[5, 8, 10]),
    }
    return OptimalControlProblem(**(given | changes))


def test_a_bin_multiplier_is_the_price_of_its_bin():
    """d J* / d uhat_k = -rho_u[k], the conjugate bin moving with it: by central differences of solved programs."""
    problem = small_problem(terminal_state=Box([0, None], [0, None]))
    transcription = LinearTranscription(problem)
    program, T = transcription.program, problem.horizon
    band = program.rows[Block.CONTROL_SPECTRUM]
    solve = backend("clarabel")
    solution = solve(program, 1e-12, None)
    rho = transcription.multipliers(solution.y, 1.0).rho_u[:, 0]
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
            u = transcription.trajectory(answer.z).u[:, 0]
            assert np.fft.fft(u)[bin_] == pytest.approx(delta, abs=1e-8)
            costs.append(problem.cost.value(*dataclasses.astuple(transcription.trajectory(answer.z))))
        price = -(rho[bin_] * np.conj(direction)).real
        assert abs(price) > 1e-3
        assert (costs[0] - costs[1]) / (2 * step) == pytest.approx(price, rel=1e-4)


# ------------------------------------------------------------------------------------------------------------ units


@each_problem
def test_a_change_of_units_is_undone_exactly(problem):
    program = LinearTranscription(problem).program
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
        _SOLVED[name] = solve_convex(UNIT_PROBLEMS[name], "clarabel", None, None)
    return _SOLVED[name]


@pytest.mark.parametrize("name", UNIT_PROBLEMS)
@pytest.mark.parametrize("units", UNITS.values(), ids=UNITS.keys())
def test_units_change_nothing_but_the_units(name, units):
    """The same optimum and multipliers, relative to the size of each, in units of a million or a millionth."""
    states, controls, cost = np.array(units[:2]), np.array(units[2:3]), units[3]
    before, problem = solved_once(name), UNIT_PROBLEMS[name]
    after = solve_convex(change_units(problem, states, controls, cost), "clarabel", None, None)
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


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ["flexible_satellite", "two_mass_spring"])
def test_models_with_hidden_states_in_random_units(name, seed):
    """Modal states and speeds have no bound, end or reference that would say how large they are."""
    problem = in_bins(getattr(library, name)())
    rng = np.random.default_rng(seed)
    states, controls = 10 ** rng.uniform(-6, 6, problem.state_dim), 10 ** rng.uniform(-6, 6, problem.control_dim)
    cost = float(10 ** rng.uniform(-6, 6))
    before = solve_convex(problem, "clarabel", None, None)
    after = solve_convex(change_units(problem, states, controls, cost), "clarabel", None, None)
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
    scaling = natural_scaling(LinearTranscription(small_problem(**changes)))
    for units in (scaling.columns, scaling.rows, np.array([scaling.cost])):
        assert np.isfinite(units).all()
        assert (units > 0).all()


# -------------------------------------------------------------------------------------- residuals, which judge a solver


def hand_program() -> tuple[Program, np.ndarray, np.ndarray]:
    """Return min 1/2 |z|^2 - 2 z_0 + 5 with z_0 + z_1 = 1, z_1 >= -3, z_0 <= 1.2, and its answer."""
    program = Program(
        P=sp.csc_array(np.eye(2)),
        q=np.array([-2.0, 0.0]),
        constant=5.0,
        A=sp.csc_array(np.array([[1.0, 1.0], [0.0, 1.0], [1.0, 0.0]])),
        lower=np.array([1.0, -3.0, -np.inf]),
        upper=np.array([1.0, np.inf, 1.2]),
        rows={},
    )
    # z = (1.2, -0.2): z_1 + y_0 = 0 gives y_0 = 0.2, and 1.2 - 2 + 0.2 + y_2 = 0 gives y_2 = 0.6
    return program, np.array([1.2, -0.2]), np.array([0.2, 0.0, 0.6])


def test_residuals_of_an_answer_found_by_hand_are_zero():
    program, z, y = hand_program()
    assert program.residuals(z, y).worst < 1e-15
    assert program.objective(z) == pytest.approx(0.5 * (1.44 + 0.04) - 2.4 + 5)
    np.testing.assert_array_equal(program.equality, [True, False, False])


@pytest.mark.parametrize(
    ("dz", "dy", "kind", "size"),
    [
        ((1e-3, 0.0), (0, 0, 0), "primal", 1e-3 / 1.201),  # both z_0 <= 1.2 and the equation
        ((0.0, -1e-3), (0, 0, 0), "primal", 1e-3 / 1.2),
        ((0.0, 0.0), (1e-3, 0, 0), "dual", 1e-3 / 2),
        ((0.0, 0.0), (0, 0, -1e-3), "dual", 1e-3 / 2),
        ((0.0, 0.0), (0, 1e-3, 0), "dual", 1e-3 / 2),  # z_1 has no upper bound: no positive dual
    ],
)
def test_residuals_measure_what_was_perturbed(dz, dy, kind, size):
    program, z, y = hand_program()
    residuals = program.residuals(z + dz, y + dy)
    assert getattr(residuals, kind) == pytest.approx(size, rel=1e-6)
    assert residuals.worst >= getattr(residuals, kind)


def test_residuals_refuse_duals_of_the_wrong_sign():
    """At z <= 0.3, -y fails stationarity; a dual on the side without bound fails even where stationarity holds."""
    program = Program(
        sp.csc_array([[1.0]]), np.array([-1.0]), 0.0, sp.csc_array([[1.0]]), np.array([-np.inf]), np.array([0.3]), {}
    )
    z = np.array([0.3])
    assert program.residuals(z, np.array([0.7])).worst < 1e-15
    assert program.residuals(z, np.array([-0.7])).dual > 0.5
    other = dataclasses.replace(program, q=np.array([1.0]))  # min 1/2 z^2 + z, z <= 0.3: z = -1, y = 0
    assert other.residuals(np.array([-1.0]), np.zeros(1)).worst == 0
    cheat = other.residuals(z, np.array([-1.3]))  # stationary at the bound, with a sign it cannot have
    assert cheat.dual == pytest.approx(1.0)


def test_residuals_see_a_dual_without_an_active_bound():
    """Feasible and stationary, but not complementary: only the gap tells."""
    program = Program(
        sp.csc_array([[1.0]]), np.array([-1.0]), 0.0, sp.csc_array([[1.0]]), np.array([-1.0]), np.array([0.9]), {}
    )
    residuals = program.residuals(np.array([0.5]), np.array([0.5]))
    assert residuals.primal == 0
    assert residuals.dual == 0
    objective = 0.5 * 0.5**2 + 0.5  # its terms in absolute value
    assert residuals.gap == pytest.approx(0.5 * (0.9 - 0.5) / objective)


@pytest.mark.parametrize("broken", ["z", "y", "both"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_residuals_of_an_answer_that_is_no_number_are_never_small(broken, value):
    program, z, y = hand_program()
    if broken in ("z", "both"):
        z = np.array([value, -0.2])
    if broken in ("y", "both"):
        y = np.array([value, 0.0, 0.6])
    with np.errstate(invalid="ignore"):
        worst = program.residuals(z, y).worst
    assert not worst <= 1e-6


def test_the_gap_is_that_of_the_lagrangian_dual():
    """For z and y that are stationary, the gap is J(z) minus the dual function, evaluated here by a fine grid."""
    program = Program(
        sp.csc_array([[2.0]]), np.array([-3.0]), 7.0, sp.csc_array([[1.0]]), np.array([-0.5]), np.array([1.0]), {}
    )
    z = np.array([0.8])
    y = 3.0 - 2 * z  # stationary
    grid = np.linspace(-5, 5, 200_001)
    dual = (grid**2 - 3 * grid + 7 + y * grid).min() - max(y * 1.0, -y * 0.5)
    scale = 0.64 + 3 * 0.8  # what the terms of the objective add up to
    assert program.residuals(z, y).gap == pytest.approx((program.objective(z) - dual[0]) / scale, rel=1e-6)


def test_a_direction_of_unbounded_descent_is_verified():
    """Min -z_1 with z_0 in [0, 1], z_1 >= 0, z_0 + z_1 >= 1 and P = diag(1, 0)."""
    program = Program(
        sp.csc_array(np.diag([1.0, 0.0])),
        np.array([0.0, -2.0]),
        0.0,
        sp.csc_array(np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])),
        np.array([0.0, 0.0, 1.0]),
        np.array([1.0, np.inf, np.inf]),
        {},
    )
    assert program.descent_ray_residual(np.array([0.0, 1.0])) == 0
    assert program.descent_ray_residual(np.array([0.0, 1e-9])) == 0  # its length says nothing
    assert program.descent_ray_residual(np.array([0.0, -1.0])) == np.inf  # ascends
    assert program.descent_ray_residual(np.array([0.0, 0.0])) == np.inf
    assert program.descent_ray_residual(np.array([1e-3, 1.0])) == pytest.approx(0.5e-3)  # curved, leaves z_0 <= 1
    bounded = dataclasses.replace(program, upper=np.array([1.0, 1e6, np.inf]))
    assert bounded.descent_ray_residual(np.array([0.0, 1.0])) == pytest.approx(0.5)
    free = dataclasses.replace(program, lower=np.full(3, -np.inf), upper=np.full(3, np.inf))
    assert free.descent_ray_residual(np.array([0.25, 1.0])) == pytest.approx(0.125)  # curved, and nothing else
    reversed_cost = dataclasses.replace(program, q=np.array([0.0, 2.0]))
    assert reversed_cost.descent_ray_residual(np.array([0.0, -1.0])) == pytest.approx(0.5)  # z_1 >= 0 stops it
