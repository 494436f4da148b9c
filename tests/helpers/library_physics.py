"""Energy, frequencies and removed bins of library problems, and their optima by CVXPY."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from lin_freq_ocp import OptimalControlProblem


def solved(problem: OptimalControlProblem) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the optimal cost, x and u; this shares nothing with the package but the description of the problem."""
    T, n, m, cost = problem.horizon, problem.state_dim, problem.control_dim, problem.cost
    assert not any(term.any() for term in (cost.q, cost.r, cost.p))
    x, u = cp.Variable((T + 1, n)), cp.Variable((T, m))
    A, B, offset = zip(*(problem.dynamics.at(t) for t in range(T)), strict=True)
    A, B = (sp.block_diag([sp.csr_array(block) for block in blocks]) for blocks in (A, B))
    successors = A @ cp.vec(x[:-1], order="C") + B @ cp.vec(u, order="C")
    constraints = [cp.vec(x[1:], order="C") == successors + np.concatenate(offset)]
    for signal, tube in ((x, problem.state_tube), (u, problem.control_tube)):
        fixed = tube.lower == tube.upper
        for sign, bound in ((1, tube.upper), (-1, -tube.lower)):
            bounded = np.isfinite(bound) & ~fixed
            if bounded.any():
                constraints.append(sign * signal[bounded] <= bound[bounded])
        if fixed.any():
            constraints.append(signal[fixed] == tube.lower[fixed])
    for signal, stop, length in ((x, problem.state_stop, T + 1), (u, problem.control_stop, T)):
        for j in np.flatnonzero(stop.any(axis=0)):
            phase = 2 * np.pi * np.outer(np.flatnonzero(stop[:, j]), np.arange(length)) / length
            rows = np.vstack([np.cos(phase), np.sin(phase)])
            rows = rows[np.linalg.norm(rows, axis=1) > 1e-6]  # bin 0 and the Nyquist bin have no sine
            constraints.append(rows @ signal[:, j] == 0)
    values, vectors = np.linalg.eigh(np.block([[cost.Q, cost.S], [cost.S.T, cost.R]]))
    root = vectors * np.sqrt(np.maximum(values, 0))
    deviation = cp.hstack([x - np.broadcast_to(cost.x_ref, x.shape), np.zeros((T + 1, m))])[:-1]
    deviation += cp.hstack([np.zeros((T, n)), u - np.broadcast_to(cost.u_ref, u.shape)])
    objective = cp.sum_squares(deviation @ root) / 2 + cp.quad_form(x[-1] - cost.x_ref.reshape(-1, n)[-1], cost.P) / 2
    program = cp.Problem(cp.Minimize(objective), constraints)
    program.solve(cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    assert program.status == "optimal"
    return float(program.value), x.value, u.value


def energy(x: np.ndarray, mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return 1/2 v'M v + 1/2 q'K q for states (q, v)."""
    q, v = np.hsplit(x, 2)
    return np.einsum("ti,ij,tj->t", v, mass, v) / 2 + np.einsum("ti,ij,tj->t", q, stiffness, q) / 2


def frequencies(problem: OptimalControlProblem) -> np.ndarray:
    """Return the natural frequencies of constant dynamics in rad/s, from the eigenvalues of the sampled A."""
    poles = np.log(np.linalg.eigvals(problem.dynamics.A).astype(complex)) / problem.sampling_time
    return np.sort(np.abs(poles[poles.imag > 1e-3]))


def removed(problem: OptimalControlProblem, component: int) -> list[int]:
    """Return the bins removed from a state."""
    return np.flatnonzero(problem.state_stop[:, component]).tolist()


def bins_around(frequency: float, width_hz: float, problem: OptimalControlProblem) -> list[int]:
    """Return the bins of the states within half the width of a frequency in rad/s."""
    hertz = np.fft.rfftfreq(problem.horizon + 1, problem.sampling_time)
    return np.flatnonzero(np.abs(hertz - frequency / (2 * np.pi)) < width_hz / 2).tolist()
