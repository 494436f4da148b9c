"""Each slip of the paper that docs/errata.md tells of, proved."""

from importlib import import_module

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.problem import time_signal


def test_the_adjoint_equation_has_the_jacobian():
    """On an optimum with a state stop band, the Jacobian form holds; any one number in its place does not."""
    problem = lfo.library.two_mass_spring()
    result = lfo.solve(problem)
    x, eta, mu = result.trajectory.x, result.multipliers.eta, result.multipliers.mu
    A = problem.dynamics.A
    left = eta[:-1] - eta[1:] @ A + mu[1:-1]  # eta_{t-1} - A' eta_t + mu_t, no state cost here
    jacobian = time_signal(result.multipliers.rho_x, len(x))[1:-1]
    assert np.abs(left + jacobian).max() < 1e-9 * np.abs(eta).max()
    best_number = -left.mean(axis=1, keepdims=True)  # the same for every component: what phi_t(x_t)' eta_xhat can be
    assert np.abs(left + best_number).max() > 1e-3 * np.abs(jacobian).max()


def test_the_adjoint_equation_starts_at_one():
    """At t = 0 what stands is D_x H_0 = mu_0; with mu_0 = 0 an eta_{-1} would have to vanish, and mu_0 does not."""
    result = lfo.solve(lfo.library.pendulum())
    multipliers = result.multipliers
    in_x = multipliers.eta[0] @ result.problem.dynamics.A
    assert in_x == pytest.approx(multipliers.mu[0], rel=1e-8)
    assert np.abs(multipliers.mu[0]).max() > 1
    assert len(multipliers.eta) == result.problem.horizon


def test_the_hamiltonian_need_not_be_maximal():
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 1, lfo.QuadraticCost(R=-2.0, P=4.0), lfo.Box(-1, 1), initial_state=[0.0]
    )
    grid = np.linspace(-1, 1, 201)
    costs = [problem.cost.value(*trajectory(problem, u)) for u in grid]
    assert grid[np.argmin(costs)] == pytest.approx(0, abs=1e-12)
    eta_0 = -4.0 * 0.0  # eta_{T-1} = -D c_T(x_T)
    hamiltonian = eta_0 * grid + grid**2  # <eta_0, x_0 + u> - c_0
    assert np.argmin(hamiltonian) == 100  # u* = 0: the least value of H over U, not the largest
    assert hamiltonian.max() == pytest.approx(1.0)
    assert lfo.certify(problem, np.zeros((1, 1))).pmp == "satisfied"  # the first-order condition holds


def trajectory(problem, u):
    found = lfo.simulate(problem, [[u]])
    return found.x, found.u


def test_the_shifted_set_lies_in_the_tangent_cone():
    """At u* = 2 of U = [1, 2], p is tangent iff u* + theta p stays in U for small theta > 0."""
    box, star = lfo.Box(np.array([1.0]), np.array([2.0])), np.array([2.0])

    def tangent(p):
        return bool(box.contains(star + 1e-6 * np.array([p])))

    points = np.linspace(1, 2, 11)
    assert not any(tangent(point) for point in points)
    assert all(tangent(point - 2.0) for point in points)


def test_tangent_cone_of_an_intersection():
    """(1, 0) is a limit of directions into each set, and into their intersection there is none at all."""
    x = 10.0 ** -np.arange(1, 8)
    for sign in (1, -1):
        points = np.column_stack([x, sign * x**2])  # in the set sign * y >= x^2
        directions = points / np.linalg.norm(points, axis=1)[:, None]
        assert directions[-1] == pytest.approx([1, 0], abs=1e-6)
    grid = np.linspace(-1, 1, 201)
    X, Y = np.meshgrid(grid, grid)
    both = (X**2 <= Y) & (Y <= -(X**2))
    assert np.argwhere(both).tolist() == [[100, 100]]


def test_lipschitz_without_one_sided_derivatives():
    def f(x):
        return x * np.sin(np.log(np.abs(x)))

    rng = np.random.default_rng(0)
    a, b = rng.uniform(1e-9, 1, (2, 10_000))
    assert (np.abs(f(a) - f(b)) <= np.sqrt(2) * np.abs(a - b) + 1e-15).all()
    quotients = f(theta := np.exp(-np.arange(100, 200) * 0.5)) / theta
    assert quotients.min() < -0.99
    assert quotients.max() > 0.99


pendulum_module = import_module("lin_freq_ocp.library.paper")

PRINTED_A = {
    (0, 1): -4.823e-5,
    (0, 3): -1.607e-7,
    (1, 1): 1.001,
    (1, 3): 1.0003e-2,
    (2, 1): -9.649e-3,
    (3, 1): 1.994e-1,
}
PRINTED_B = [1.9139e-5, -3.2814e-5, 382.78e-5, -656.4e-5]


def printed(A, B):
    """Whether the matrices agree with the digits in the paper's source, which truncates."""
    same = [abs(A[place] / value - 1) < 1e-3 for place, value in PRINTED_A.items()]
    return all(same) and np.allclose(B[:, 0], PRINTED_B, rtol=1e-4)


def test_the_printed_matrices(monkeypatch):
    def sampled(**keywords):
        dynamics = lfo.library.pendulum(**keywords).dynamics
        return dynamics.A, dynamics.B

    assert printed(*sampled())
    assert not printed(*sampled(sampling_time=0.1))
    assert not printed(*sampled(parameters="physical"))
    m, M, length = pendulum_module.PENDULUM_MASS, pendulum_module.CART_MASS, pendulum_module.HALF_LENGTH
    J = 4 / 3 * m * length**2
    assert m + M - ((m * length) ** 2 / J + m * length**2) == pytest.approx(2.6125)
    assert m + M - (m * length) ** 2 / (J + m * length**2) == pytest.approx(2.8429, abs=5e-5)
    monkeypatch.setattr(pendulum_module, "HALF_LENGTH", 0.0025)  # 0.25 cm, as printed
    assert not printed(*sampled())


def test_slow_sampling_cannot_be_replayed():
    A = lfo.library.pendulum(sampling_time=0.1).dynamics.A
    growth = np.abs(np.linalg.eigvals(A)).max() ** 240
    assert 1e46 < growth < 1e47
    assert np.abs(np.linalg.eigvals(lfo.library.pendulum().dynamics.A)).max() ** 240 == pytest.approx(4.5e4, rel=0.02)


def test_the_passed_bins_count_from_zero():
    F = [*range(1, 97), *range(144, 241)]
    from_zero = {k % 240 for k in F}
    from_one = {k - 1 for k in F}
    assert {-k % 240 for k in from_zero} == from_zero
    assert {-k % 240 for k in from_one} != from_one
    removed = sorted(set(range(240)) - from_zero)
    assert removed == list(range(97, 144))
    assert np.flatnonzero(lfo.library.pendulum().control_stop[:, 0]).tolist() == [k for k in removed if k <= 120]
    rows = np.exp(-2j * np.pi * np.outer(removed, np.arange(240)) / 240)
    stacked = np.vstack([rows.real, rows.imag])
    assert stacked.shape == (94, 240)
    assert np.linalg.matrix_rank(stacked) == 47


def test_the_printed_bound_is_one_sided():
    pendulum = lfo.library.pendulum()
    printed_problem = lfo.OptimalControlProblem(
        pendulum.dynamics,
        240,
        pendulum.cost,
        control_set=lfo.Box(None, 5),
        state_set=pendulum.state_set,
        initial_state=pendulum.initial_state,
        terminal_state=pendulum.terminal_state,
        control_spectrum=pendulum.control_spectrum,
    )
    result = lfo.solve(printed_problem)
    assert result.control.min() < -5.1
    assert result.cost < lfo.solve(pendulum).cost - 1


SLOPES = np.linspace(-10, 10, 4001)
"""Candidates for one multiplier."""


def test_the_printed_transversality_fails_at_an_optimum():
    u = np.linspace(-2, 2, 4001)
    assert u[np.argmin(u**2 - (abs(0.0) + u))] == pytest.approx(0.5)
    eta_0 = 1.0  # eta_{T-1} = -D c_T
    up, down = (eta_0 * abs(y) - SLOPES * y for y in (1.0, -1.0))  # D_y H - mu_0 y, which must be <= 0
    assert not ((up <= 0) & (down <= 0)).any()
    assert (np.maximum(up, down) >= 1).all()
    alpha = (SLOPES / eta_0 + 1) / 2  # the joint inclusion: mu_0 = alpha eta_0 - (1 - alpha) eta_0
    assert (abs(SLOPES[(alpha >= 0) & (alpha <= 1)]) <= 1 + 1e-12).all()
    assert ((alpha >= 0) & (alpha <= 1)).sum() > 100


def test_the_printed_adjoint_equation_fails_at_an_optimum():
    a, b = np.meshgrid(np.linspace(0, 1, 201), np.linspace(-1, 1, 401), indexing="ij")
    cost = 2 * a + a**2 / 2 + b**2 - (abs(a) + b)
    best = np.unravel_index(np.argmin(cost), cost.shape)
    assert (a[best], b[best]) == pytest.approx((0.0, 0.5))
    eta_1 = 1.0
    assert not ((eta_1 <= SLOPES) & (eta_1 <= -SLOPES)).any()  # eta_0 y >= D_y H_1 = |y| for y = 1 and -1
    joint = abs(SLOPES) <= eta_1
    stationary = SLOPES - 2 <= 0  # nu_0 = eta_0 - 2 is a normal of [0, 1] at 0
    assert (joint & stationary).any()


def test_partial_inclusions_fail_at_an_optimum():
    def h(x, u):
        return np.maximum(np.minimum(x, -u), u - x)

    v = np.linspace(-1, 1, 2001)
    assert v[np.argmin(-v / 2 + h(v, -v))] == pytest.approx(0.0, abs=1e-12)
    t = np.array([1.0, -1.0])
    in_x = -(h(t, 0.0) - h(0.0, 0.0))  # the derivatives of <eta_1, h>, eta_1 = -1, along x and along u
    in_u = -(h(0.0, t) - h(0.0, 0.0))
    rho = SLOPES[:, None]
    fits_x = ((rho - 0.5) * t >= in_x - 1e-12).all(axis=1)  # eta_0 = rho, p_x = eta_0 - 1/2
    fits_u = (rho * t >= in_u - 1e-12).all(axis=1)
    assert SLOPES[fits_x].min() == pytest.approx(0.5)
    assert SLOPES[fits_u].max() == pytest.approx(0.0, abs=1e-12)
    assert not (fits_x & fits_u).any()
    corners = np.array([[-1.0, 0.0, 1.0], [0.0, 1.0, -1.0], [1.0, 1.0, 1.0]])  # gradients of <eta_1, h>, and ones
    weights = np.linalg.solve(corners, np.array([SLOPES - 0.5, SLOPES, np.ones_like(SLOPES)]))
    joint = (weights >= -1e-12).all(axis=0)
    assert SLOPES[joint].min() == pytest.approx(-1 / 6, abs=5e-3)
    assert SLOPES[joint].max() == pytest.approx(2 / 3, abs=5e-3)
