"""Random systems of a step, and the residual of a solution from the rows as they are written down."""

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.methods.structured import (
    Balls,
    Compliance,
    Coupling,
    Equations,
    Inequalities,
    SparseRows,
    SpectrumRows,
    Stages,
    System,
    SystemSolution,
    loops,
)


def stop_band(channels, entry, T, bins, scale):
    """Rows of the plain DFT of one entry of y; the imaginary parts at 0 and T/2 do not exist."""
    real = (bins == 0) | (2 * bins == T)
    kept = np.column_stack([np.ones(len(bins), dtype=bool), ~real]).ravel()
    return SpectrumRows((channels == entry) * 1.7, np.full(T, 1.5), T, bins, scale, kept)


def random_rows(rng, count, T, channels, n):
    """Rows on all times of the channels, but not on w_T."""
    rows = rng.standard_normal((count, T + 1, len(channels)))
    rows[:, -1, channels >= n] = 0.0
    return SparseRows(sp.csr_array(rows.reshape(count, -1)))


def random_coupling(rng, T, n, controls, others):
    """Stop bands on all controls but the last, part of x_T; and rows of every other kind."""
    channels = np.concatenate([[0], n + controls])
    equations = []
    for control in controls[: max(1, len(controls) - 1)]:
        bins = np.flatnonzero(rng.random(T // 2 + 1) < 0.6)
        rows = stop_band(channels, n + control, T, bins, rng.uniform(0.5, 2, len(bins)))
        equations.append(Equations(rows, np.zeros(rows.count)))
    terminal = np.flatnonzero(rng.random(n) < 0.6)
    end = np.zeros(len(terminal))
    if not others:
        coupling = Coupling(channels, terminal, end, tuple(equations))
        return coupling, Compliance(np.full(coupling.count, 1e-12), ())
    equations.insert(int(rng.integers(0, 2)), Equations(random_rows(rng, 1, T, channels, n), np.zeros(1)))
    inequalities = Inequalities(random_rows(rng, 2, T, channels, n), np.zeros(2))
    first = (channels == 0) * 1.0
    fine = SpectrumRows(first, np.ones(T), 2 * T, np.array([1, 3]), np.ones(2), np.ones(4, dtype=bool))
    soft = Balls(SpectrumRows(first, np.ones(T), T, np.array([2]), np.ones(1), np.ones(2, dtype=bool)), np.ones(1))
    head = np.zeros((1, T + 1, len(channels)))
    head[0, T // 2, -1] = 1.0
    soft = Balls(soft.rows, soft.radius, SparseRows(sp.csr_array(head.reshape(1, -1))))
    coupling = Coupling(channels, terminal, end, tuple(equations), (inequalities,), (Balls(fine, np.ones(2)), soft))
    roots = rng.standard_normal((2, 2, 2)), rng.standard_normal((1, 3, 3))
    squares = tuple(root @ root.swapaxes(1, 2) for root in roots)
    return coupling, Compliance(
        np.concatenate([np.full(coupling.equation_count, 1e-12), rng.random(2)]), squares, (np.linalg.inv(roots[0]),)
    )


def random_system(seed, growth=0.0, others=True, T=None):
    """Stages whose states grow by e^growth, with slacks among the entries of w; Phi, C, and a right-hand side."""
    rng = np.random.default_rng(seed)
    n, k, slacks, T = rng.integers(1, 5), rng.integers(1, 4), rng.integers(0, 3), T or int(rng.integers(12, 31))
    nz = int(n + k + slacks)
    A = np.exp(growth / T) * np.linalg.qr(rng.standard_normal((T + 1, n, n)))[0]
    controls = np.sort(rng.permutation(k + slacks)[:k])
    B = np.zeros((T + 1, n, k + slacks))
    B[:, :, controls] = rng.standard_normal((T + 1, n, k))
    A[-1], B[-1] = 0.0, 0.0
    root = rng.standard_normal((T + 1, nz, nz))
    root[:, :, n:] *= 10.0 ** rng.integers(-1, 3, size=(T + 1, 1, 1))
    Phi = root @ root.swapaxes(1, 2) / nz + 0.1 * np.eye(nz)
    coupling, C = random_coupling(rng, T, n, controls, others)
    initial = np.where(rng.random(n) < 0.6, 1.0, np.nan)
    rows = np.zeros((T + 1, 0, nz)), np.zeros((T + 1, 0))
    stages = Stages(A, B, np.zeros((T + 1, n)), Phi, np.zeros((T + 1, nz)), *rows, (), initial, coupling)
    c = rng.standard_normal((T + 1, n))
    c[-1] = 0.0
    x0 = np.where(stages.fixed, rng.standard_normal(n), 0.0)
    return stages, Phi, C, (rng.standard_normal((T + 1, nz)), c, x0, rng.standard_normal(coupling.count))


def residual(stages, Phi, C, right, step):
    """What is left of the four right-hand sides of kkt/system.py."""
    gradient, c, x0, f = right
    coupling, system, nu = stages.coupling, System(stages, loops(False)), step.coupling
    dynamics, initial, _, *rows = system.rows(step.y)
    balls = [
        -(values if part.heads is not None else values[:, 1:])
        for part, values in zip(coupling.balls, rows[2:], strict=True)
    ]
    values = np.concatenate([rows[0], rows[1][:, 0], *(part.ravel() for part in balls)])
    S = np.zeros((coupling.count, coupling.count))
    C.add_to(S)
    counts = [coupling.equation_count, len(C.rows) - coupling.equation_count, *(part.size for part in balls)]
    equations, unequal, *rest = np.split(nu, np.cumsum(counts)[:-1])
    z = [step.eta, step.initial, np.zeros(stages.g.shape), equations, unequal[:, None]]
    for part, own in zip(coupling.balls, rest, strict=True):
        own = -own.reshape(len(part.radius), -1)
        z.append(own if part.heads is not None else np.column_stack([np.zeros(len(own)), own]))
    of_y = np.einsum("tij,tj->ti", Phi, step.y) + gradient + system.adjoint(z)
    return of_y, c - dynamics, x0 - initial, f - (values - S @ nu)


def solved(solver, stages, Phi, C, right, refinements=2):
    """The solution, refined as the embedding does, and its residual relative to the largest term."""
    solver.factor(Phi, C)
    step = solver.solve(*right)
    for _ in range(refinements):
        more = solver.solve(*residual(stages, Phi, C, right, step))
        step = SystemSolution(*(a + b for a, b in zip(step, more, strict=True)))
    left = residual(stages, Phi, C, right, step)
    size = max(np.abs(part).max(initial=0.0) for part in (*step, *right, Phi[0]))
    return step, max(np.abs(part).max(initial=0.0) for part in left) / size
