"""Whether a problem with an indefinite Hessian is convex on its dynamics, against the reduced Hessian."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as la

from lin_freq_ocp.methods.structured.kkt.recursions import loops


def reduced(A, B, Phi, fixed):
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


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("compiled", [False, None])
def test_convexity_is_that_of_the_reduced_hessian(seed, compiled):
    rng = np.random.default_rng(seed)
    stages, n, k = 6, 2, 2
    A, B = rng.normal(size=(stages, n, n)), rng.normal(size=(stages, n, k))
    A[-1], B[-1] = 0.0, 0.0
    Phi = rng.normal(size=(stages, n + k, n + k))
    Phi = 0.3 * (Phi + Phi.swapaxes(1, 2))
    fixed = np.array([True, seed % 2 == 0])
    units = np.broadcast_to(np.eye(n + k), Phi.shape)
    least = float(la.eigh(reduced(A, B, Phi, fixed), reduced(A, B, units, fixed), eigvals_only=True)[0])
    own = loops(compiled)
    assert own.is_convex(A, B, Phi - (least - 1e-6) * units, fixed)
    assert not own.is_convex(A, B, Phi - (least + 1e-6) * units, fixed)
