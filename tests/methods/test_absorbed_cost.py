"""Random problems over frequency responses against dense matrices and CVXPY."""

import cvxpy as cp
import numpy as np
import pytest
from scipy.linalg import dft

import lin_freq_ocp as lfo
from helpers.seeds import seeds

MODES = ["periodic", "zero-padded"]


def random_problem(seed, mode):
    """Return a problem, its kernels (N, p, m), known outputs (T+1, p) and S: in half of them a power is minimised."""
    rng = np.random.default_rng(seed)
    T, p = int(rng.integers(8, 20)), int(rng.integers(1, 3))
    power = bool(rng.integers(2))
    m = p if power else int(rng.integers(1, 3))
    N = T if mode == "periodic" else 2 * T
    z = np.exp(2j * np.pi * np.arange(N) / N)
    if power:  # C (zI - A)^{-1} B + D that is passive at every bin, as a sum of passive ones
        G = sum(np.outer(b, b) / (1.3 - rng.uniform(0, 1) / z)[:, None, None] for b in rng.standard_normal((p + 1, p)))
        skew = rng.standard_normal((p, p))
        G = G + (skew - skew.T)
    else:
        G = np.fft.fft(rng.standard_normal((N, p, m)) * np.exp(-np.arange(N) / 3)[:, None, None], axis=0)
    kernel = np.fft.ifft(G, axis=0).real
    known = rng.standard_normal((T if mode == "periodic" else T + 1, p))
    S = np.eye(p) if power else np.zeros((p, m))
    cost = lfo.QuadraticCost(
        Q=0.0 if power else np.diag(rng.uniform(0.1, 1, p)),
        R=0.0 if power else np.diag(rng.uniform(0.1, 1, m)),
        S=S,
        q=rng.standard_normal(p),
        x_ref=rng.standard_normal((T + 1, p)),
        u_ref=rng.standard_normal(m),
    )
    stop = lfo.low_pass(cutoff=2.2, component="u_0") if rng.integers(2) else None
    problem = lfo.OptimalControlProblem(
        lfo.FrequencyResponse(G[: N // 2 + 1], disturbance=known, mode=mode),
        T,
        cost,
        control_set=lfo.Box(-0.5, 0.5),
        state_set=lfo.Box(-4, 4) if rng.integers(2) else None,
        control_spectrum=stop,
    )
    return problem, kernel, np.vstack([known, known[:1]])[: T + 1]


def reference_cost(problem, kernel, known):
    """Return the optimal cost with dense matrices, u as a vector."""
    T, N, (p, m) = problem.horizon, len(kernel), kernel.shape[1:]
    Y = np.block([[kernel[(t - s) % N] for s in range(T)] for t in range(T + 1)])
    cost, u = problem.quadratic, cp.Variable(T * m)
    Q, R = np.kron(np.eye(T), cost.Q), np.kron(np.eye(T), cost.R)
    S, stage = np.kron(np.eye(T), cost.S), Y[: T * p]
    a_0 = (known[:-1] - cost.x_ref[:-1]).ravel()
    u_ref = np.tile(cost.u_ref, T)
    H = stage.T @ Q @ stage + stage.T @ S + S.T @ stage + R
    if problem.control_stop.any():
        F = np.kron(dft(T)[: T // 2 + 1], np.eye(m))[problem.control_stop.ravel()]
        basis = np.linalg.svd(np.vstack([F.real, F.imag]))
        null = basis[2][int((basis[1] > 1e-9).sum()) :].T
    else:
        null = np.eye(T * m)
    v = cp.Variable(null.shape[1])
    u = null @ v
    reduced = null.T @ H @ null
    root = np.linalg.cholesky((reduced + reduced.T) / 2 + 1e-13 * np.eye(len(reduced)))
    slope = stage.T @ (Q @ a_0 - S @ u_ref) + S.T @ a_0 - R @ u_ref + stage.T @ np.tile(cost.q, T)
    constant = 0.5 * a_0 @ Q @ a_0 - a_0 @ S @ u_ref + 0.5 * u_ref @ R @ u_ref + known[:-1].ravel() @ np.tile(cost.q, T)
    x = Y @ u + known.ravel()
    limits = [cp.abs(u) <= 0.5]
    if problem.state_set is not None:
        limits.append(cp.abs(x) <= 4)
    program = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(root.T @ v) + slope @ u + constant), limits)
    program.solve(solver="CLARABEL", tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    return program.status, program.value


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", seeds(range(10)))
def test_costs_are_those_of_dense_matrices(seed, mode):
    problem, kernel, known = random_problem(seed, mode)
    status, value = reference_cost(problem, kernel, known)
    result = lfo.solve(problem)
    assert (status == "infeasible") == (str(result.status) == "infeasible")
    if status != "infeasible":
        assert result.cost == pytest.approx(value, rel=1e-7)
        assert result.certificate.globally_optimal
        assert result.certificate.pmp == "satisfied"
