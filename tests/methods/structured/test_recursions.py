"""Both kinds of loops against equations written down entry by entry, and against each other."""

from ctypes import ArgumentError

import numpy as np
import pytest
import scipy.linalg as la

from helpers.seeds import seeds
from lin_freq_ocp.methods.structured import BandedLoops, OpenLoop, can_compile, loops

NONE = np.zeros(0, dtype=np.intp)


@pytest.fixture(params=["compiled", "arrays"])
def chosen(request):
    if request.param == "compiled" and not can_compile():
        pytest.skip("no C compiler")
    return loops(request.param == "compiled")


@pytest.fixture
def both():
    if not can_compile():
        pytest.skip("no C compiler")
    return loops(True), loops(False)


def stages(seed, growth=0.0, T=None):
    """Random stages whose states grow by e^growth, with costs of very different sizes."""
    rng = np.random.default_rng(seed)
    n, k, T = int(rng.integers(1, 6)), int(rng.integers(1, 4)), T or int(rng.integers(1, 31))
    A = np.exp(growth / T) * np.linalg.qr(rng.standard_normal((T + 1, n, n)))[0]
    B = rng.standard_normal((T + 1, n, k))
    A[-1], B[-1] = 0.0, 0.0
    root = rng.standard_normal((T + 1, n + k, n + k))
    root[:, :, n:] *= 10.0 ** rng.integers(-1, 3, size=(T + 1, 1, 1))
    Phi = root @ root.swapaxes(1, 2) / (n + k) + 0.1 * np.eye(n + k)
    fixed = rng.random(n) < 0.7
    c = rng.standard_normal((T + 1, n))
    c[-1] = 0.0
    x0 = np.where(fixed, rng.standard_normal(n), 0.0)
    return rng, A, B, Phi, fixed, rng.standard_normal((T + 1, n + k)), c, x0


def rows_of_states(A, B, y):
    """x_{t+1} - A x_t - B w_t, t < T."""
    n = A.shape[1]
    return y[1:, :n] - np.einsum("tij,tj->ti", A[:-1], y[:-1, :n]) - np.einsum("tij,tj->ti", B[:-1], y[:-1, n:])


def stationarity(A, B, Phi, r, y, eta, lam0):
    """Phi y + r + the adjoint of the rows of the states and of x_0."""
    n = A.shape[1]
    out = np.einsum("tij,tj->ti", Phi, y) + r
    out[1:, :n] += eta[:-1]
    out[:, :n] -= np.einsum("tji,tj->ti", A, eta)
    out[:, n:] -= np.einsum("tji,tj->ti", B, eta)
    out[0, :n] += lam0
    return out


def dense_solution(A, B, Phi, fixed, r, c, x0):
    """The same from one dense matrix, its columns made by the two functions above."""
    shape, n = r.shape, A.shape[1]
    T, free = len(A) - 1, np.flatnonzero(~fixed)

    def residual(v):
        y, eta, lam0 = v[: r.size].reshape(shape), np.zeros((T + 1, n)), v[r.size + T * n :]
        eta[:-1] = v[r.size : r.size + T * n].reshape(T, n)
        first = np.where(fixed, y[0, :n], lam0)
        return np.concatenate(
            [stationarity(A, B, Phi, 0, y, eta, lam0).ravel(), rows_of_states(A, B, y).ravel(), first]
        )

    size = r.size + (T + 1) * n
    matrix = np.stack([residual(row) for row in np.eye(size)], axis=1)
    v = np.linalg.solve(matrix, np.concatenate([-r.ravel(), c[:-1].ravel(), x0]))
    assert np.abs(v[r.size + T * n + free]).max(initial=0.0) < 1e-9
    return v[: r.size].reshape(shape), v[r.size : r.size + T * n].reshape(T, n), v[r.size + T * n :]


@pytest.mark.parametrize("seed", seeds(range(20)))
def test_solution_is_that_of_the_dense_equations(chosen, seed):
    _, A, B, Phi, fixed, r, c, x0 = stages(seed)
    y, eta, lam0 = chosen.factor(A, B, Phi, fixed).solve(r, c, x0)
    y_dense, eta_dense, lam0_dense = dense_solution(A, B, Phi, fixed, r, c, x0)
    assert np.abs(y - y_dense).max() < 1e-9 * np.abs(y_dense).max()
    assert np.abs(eta[:-1] - eta_dense).max() < 1e-9 * (1 + np.abs(eta_dense).max())
    assert np.abs(lam0 - lam0_dense).max() < 1e-9 * (1 + np.abs(eta_dense).max())
    assert not eta[-1].any()


@pytest.mark.parametrize("seed", seeds(range(10)))
def test_equations_hold_where_the_states_grow_by_seventeen_decades(chosen, seed):
    _, A, B, Phi, fixed, r, c, x0 = stages(seed, growth=40.0, T=80)
    y, eta, lam0 = chosen.factor(A, B, Phi, fixed).solve(r, c, x0)
    sizes = np.abs(A).max() * max(np.abs(y).max(), np.abs(eta).max()) + np.abs(Phi).max() * np.abs(y).max()
    assert np.abs(rows_of_states(A, B, y) - c[:-1]).max() < 1e-12 * sizes
    assert np.abs(stationarity(A, B, Phi, r, y, eta, lam0)).max() < 1e-12 * sizes
    assert np.allclose(y[0, : len(fixed)][fixed], x0[fixed], rtol=0, atol=1e-12 * sizes)


def test_an_array_that_is_not_contiguous_is_refused(both):
    _, A, B, Phi, fixed, r, c, x0 = stages(3)
    with pytest.raises(ArgumentError, match="strides"):
        both[0].factor(A, B, Phi, fixed).solve(r[::-1], c, x0)


def test_without_a_compiler_numpy_computes_the_loops(no_compiler):
    with no_compiler("loops.c could not be compiled"):
        assert isinstance(loops(), BandedLoops)


@pytest.mark.parametrize("width", [3, 11])
@pytest.mark.parametrize("seed", seeds(range(10)))
def test_responses_are_solutions_side_by_side(chosen, seed, width):
    rng, A, B, Phi, fixed, r, c, _ = stages(seed, T=30 + seed)
    nz, n = r.shape[1], A.shape[1]
    channels = rng.permutation(nz)[: int(rng.integers(1, nz + 1))]
    R, E = rng.standard_normal((len(A), len(channels), width)), rng.standard_normal((n, width))
    regulator = chosen.factor(A, B, Phi, fixed)
    Y, X = regulator.responses(channels, R, E)
    for j in range(width):
        gradient = np.zeros_like(r)
        gradient[:, channels] = R[:, :, j]
        gradient[-1, :n] += E[:, j]
        y = regulator.solve(gradient, np.zeros_like(c), np.zeros(n))[0]
        assert np.allclose(Y[:, :, j], y[:, channels], rtol=0, atol=1e-10 * np.abs(y).max())
        assert np.allclose(X[:, j], y[-1, :n], rtol=0, atol=1e-10 * np.abs(y).max())
    gram = np.tril(regulator.gram(channels, R, E))
    gram += np.tril(gram, -1).T
    expected = -np.einsum("tci,tcj->ij", R, Y) - E.T @ X
    assert np.allclose(gram, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    assert np.linalg.eigvalsh(gram).min() > -1e-14 * np.abs(gram).max()
    others = np.setdiff1d(np.arange(nz), channels)[:1]
    Y, _ = regulator.responses(others, R[:, : len(others)], E)
    assert Y.shape[1] == len(others)


def test_an_entry_without_cost_has_a_finite_answer(chosen):
    _, A, B, Phi, fixed, r, c, x0 = stages(3)
    n = A.shape[1]
    B[:, :, 0], Phi[:, n], Phi[:, :, n], r[:, n] = 0.0, 0.0, 0.0, 0.0
    y, eta, lam0 = chosen.factor(A, B, Phi, fixed).solve(r, c, x0)
    assert np.abs(stationarity(A, B, Phi, r, y, eta, lam0)).max() < 1e-10 * np.abs(Phi).max() * np.abs(y).max()
    R = np.ones((len(A), 1, 12))
    assert np.isfinite(chosen.factor(A, B, Phi, fixed).responses(np.array([0]), R, np.zeros((n, 12)))[0]).all()


def test_weights_of_rows_and_cones(chosen):
    rng = np.random.default_rng(5)
    T, nz, linear, cones = 6, 4, 3, (2, 3)
    G, H = rng.standard_normal((T + 1, linear + 5, nz)), np.zeros((T + 1, nz, nz))
    weights, points = rng.random((T + 1, linear + 2)) + 0.1, np.zeros((T + 1, 5))
    absent = rng.random((T + 1, linear + 2)) < 0.3
    weights[absent] = 0.0
    found = chosen.gram(H, G, weights, points, cones)
    for t in range(T + 1):
        expected = G[t, :linear].T @ np.diag(weights[t, :linear]) @ G[t, :linear]
        assert np.allclose(
            found[t] - expected,
            -weights[t, linear] * G[t, 3:5].T @ np.diag([1, -1]) @ G[t, 3:5]
            - weights[t, linear + 1] * G[t, 5:].T @ np.diag([1, -1, -1]) @ G[t, 5:],
        )
    points[:, [1, 3, 4]] = rng.standard_normal((T + 1, 3))
    points[:, 0], points[:, 2] = np.hypot(1, points[:, 1]), np.sqrt(1 + points[:, 3] ** 2 + points[:, 4] ** 2)
    found = chosen.gram(H, G, weights, points, cones)
    for t in range(T + 1):
        expected = G[t, :linear].T @ np.diag(weights[t, :linear]) @ G[t, :linear]
        for cone, weight in ((slice(0, 2), weights[t, linear]), (slice(2, 5), weights[t, linear + 1])):
            w, rows = points[t, cone], G[t, linear:][cone]
            J = np.diag([1.0] + [-1.0] * (len(w) - 1))
            if weight:
                squared = (2 * np.outer(w, w) - J) / weight
                expected += rows.T @ np.linalg.inv(squared) @ rows
        assert np.allclose(found[t], expected)


@pytest.mark.parametrize("seed", seeds(range(8)))
def test_backward_is_the_adjoint_of_forward(chosen, seed):
    rng, A, B, _, _, gradient, c, _ = stages(seed)
    n, k = B.shape[1:]
    breaks = np.flatnonzero(rng.random(len(A)) < 0.2)
    breaks = breaks[breaks > 0]
    starts, prices = rng.standard_normal((2, len(breaks), n))
    y = np.zeros((len(A), n + k))
    y[:, n:] = rng.standard_normal((len(A), k))
    ends = chosen.forward(A, B, np.zeros_like(c), breaks, starts, y)
    # gradient'y - prices'ends as a function of w and the starts is linear
    value = np.vdot(gradient, y) - np.vdot(prices, ends)
    costates, gw, gstarts = chosen.backward(A, B, gradient, breaks, prices)
    assert np.isclose(value, np.vdot(gw, y[:, n:]) + np.vdot(gstarts, starts), rtol=1e-12, atol=1e-12)
    expected = gradient.copy()
    expected[:-1, :n] += np.einsum("tji,tj->ti", A[:-1], costates[1:])
    own = np.setdiff1d(np.arange(len(A)), breaks)
    assert np.allclose(costates[own], expected[own, :n], rtol=1e-12, atol=1e-12)
    assert np.allclose(costates[breaks], -prices)


def test_states_follow_from_the_offsets(chosen):
    _, A, B, _, _, y, c, _ = stages(11)
    chosen.forward(A, B, c, NONE, np.zeros((0, A.shape[1])), y)
    assert np.allclose(rows_of_states(A, B, y), c[:-1], rtol=0, atol=1e-12 * np.abs(y).max())


@pytest.mark.parametrize("seed", seeds(range(10)))
def test_both_kinds_agree(both, seed):
    rng, A, B, Phi, fixed, r, c, x0 = stages(seed, growth=3.0)
    for first, second in zip(*(kind.factor(A, B, Phi, fixed).solve(r, c, x0) for kind in both), strict=True):
        assert np.abs(first - second).max() <= 1e-10 * np.abs(first).max()
    R, E = rng.standard_normal((len(A), r.shape[1], 12)), np.zeros((A.shape[1], 12))
    channels = np.arange(r.shape[1])
    for first, second in zip(*(kind.factor(A, B, Phi, fixed).responses(channels, R, E) for kind in both), strict=True):
        assert np.abs(first - second).max() <= 1e-10 * np.abs(first).max()


@pytest.mark.parametrize("seed", seeds(range(16)))
def test_columns_are_sweeps_side_by_side(chosen, seed):
    rng, A, B, Phi, _, _, c, _ = stages(seed, T=1 + 4 * seed)
    n, k = B.shape[1:]
    breaks = 1 + np.flatnonzero(rng.random(len(A) - 1) < [0.0, 0.05, 0.3, 1.0][seed % 4])
    W, starts = rng.standard_normal((len(A), k, 3)), rng.standard_normal((len(breaks), n, 3))
    GW, gstarts, ends, X = OpenLoop(A, B, Phi, breaks).columns(starts, W)
    for j in range(3):
        y = np.zeros((len(A), n + k))
        y[:, n:] = W[:, :, j]
        ended = chosen.forward(A, B, np.zeros_like(c), breaks, starts[:, :, j].copy(), y)
        _, gw, gs = chosen.backward(A, B, np.einsum("tij,tj->ti", Phi, y), breaks, np.zeros((len(breaks), n)))
        size = np.abs(gw).max()
        assert np.allclose(GW[:, :, j], gw, rtol=0, atol=1e-11 * size)
        assert np.allclose(gstarts[:, :, j], gs, rtol=0, atol=1e-11 * size)
        assert np.allclose(ends[:, :, j], ended, rtol=0, atol=1e-11 * np.abs(y).max())
        assert np.allclose(X[:, j], y[-1, :n], rtol=0, atol=1e-11 * np.abs(y).max())


def reduced_hessian(A, B, Phi, fixed):
    """Return the Hessian in (free x_0, w)."""
    stages, n, k = B.shape
    free = np.flatnonzero(~fixed)
    size = len(free) + stages * k
    x, total = np.zeros((n, size)), np.zeros((size, size))
    x[free, np.arange(len(free))] = 1.0
    for t in range(stages):
        w = np.zeros((k, size))
        w[:, len(free) + t * k : len(free) + (t + 1) * k] = np.eye(k)
        y = np.vstack([x, w])
        total += y.T @ Phi[t] @ y
        x = A[t] @ x + B[t] @ w
    return total


@pytest.mark.parametrize("seed", seeds(range(12)))
@pytest.mark.parametrize("compiled", [False, True])
def test_convexity_is_that_of_the_reduced_hessian(seed, compiled):
    rng = np.random.default_rng(seed)
    stages, n, k = 6, 2, 2
    A, B = rng.normal(size=(stages, n, n)), rng.normal(size=(stages, n, k))
    A[-1], B[-1] = 0.0, 0.0
    Phi = rng.normal(size=(stages, n + k, n + k))
    Phi = 0.3 * (Phi + Phi.swapaxes(1, 2))
    fixed = np.array([True, seed % 2 == 0])
    units = np.broadcast_to(np.eye(n + k), Phi.shape)
    least = float(la.eigh(reduced_hessian(A, B, Phi, fixed), reduced_hessian(A, B, units, fixed), eigvals_only=True)[0])
    own = loops(compiled)
    assert own.is_convex(A, B, Phi - (least - 1e-6) * units, fixed)
    assert not own.is_convex(A, B, Phi - (least + 1e-6) * units, fixed)
