"""Random convex problems with linear dynamics, around a random trajectory: ``random_problem(seed)``."""

from __future__ import annotations

import warnings

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.problem import Band


def random_problem(seed: int) -> tuple[str, lfo.OptimalControlProblem]:
    """Return the kind of dynamics and a problem around a random trajectory; one end in six may be out of reach."""
    rng = np.random.default_rng(seed)
    n, m, T = int(rng.integers(1, 6)), int(rng.integers(1, 4)), int(rng.integers(5, 120))
    kind, dynamics = random_dynamics(rng, n, m, T)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.BandWarning)
        bands = random_bands(rng, m)
        state_band = (
            [lfo.stop_band(bins=[int(rng.integers(1, 3))], component=0)] if rng.random() < 0.2 and T > 30 else None
        )
        free = lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(), control_spectrum=bands)
        u = rng.standard_normal((T, m)) + rng.standard_normal(m)
        u = np.fft.irfft(np.where(free.control_stop, 0, np.fft.rfft(u, axis=0)), n=T, axis=0)
        x = lfo.simulate(free, u, rng.standard_normal(n)).x
        reachable = rng.random() > 1 / 6
        end = x[-1] if reachable else x[-1] + 3 * rng.standard_normal(n) * np.abs(x).max(0)
        problem = lfo.OptimalControlProblem(
            dynamics=dynamics,
            horizon=T,
            cost=random_cost(rng, n, m, T),
            control_set=box_around(rng, u),
            state_set=[lfo.sets.Everything(), *[box_around(rng, x)] * (T - 1), lfo.sets.Everything()],
            initial_state=x[0],
            terminal_state=end if rng.random() < 0.6 else None,
            control_spectrum=bands,
            state_spectrum=state_band,
            name=f"random {seed}",
        )
    return kind, problem


def random_dynamics(rng: np.random.Generator, n: int, m: int, T: int) -> tuple[str, lfo.LinearDynamics]:
    """Return stable, marginal, unstable or time-varying dynamics with an offset."""
    kind = str(rng.choice(["stable", "marginal", "unstable", "time-varying"]))
    A = rng.standard_normal((n, n))
    radius = {"stable": 0.9, "marginal": 1.0, "unstable": 1.05, "time-varying": 0.98}[kind]
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    B = rng.standard_normal((n, m))
    if kind == "time-varying":
        swing = 1 + 0.1 * np.sin(np.arange(T) * rng.uniform(0.1, 1))
        A, B = A * np.minimum(swing, 1.0)[:, None, None], B * swing[:, None, None]
    return kind, lfo.LinearDynamics(A, B, offset=0.1 * rng.standard_normal(n), sampling_time=0.1)


def random_bands(rng: np.random.Generator, m: int) -> list[Band]:
    """Return one band per control, or none for some."""
    makers = [
        lambda j: lfo.low_pass(rng.uniform(0.5, 3.0), component=j),
        lambda j: lfo.spectrum.high_pass(rng.uniform(0.0, 0.5), component=j),
        lambda j: lfo.spectrum.notch(rng.uniform(0.5, 2.5), rng.uniform(0.1, 0.6), component=j),
        lambda j: lfo.spectrum.band_pass(0.0, rng.uniform(1.0, 3.0), component=j),
    ]
    return [makers[rng.integers(len(makers))](j) for j in range(m) if rng.random() < 0.8]


def random_cost(rng: np.random.Generator, n: int, m: int, T: int) -> lfo.QuadraticCost:
    """Return a convex cost with cross terms, linear terms and references, of any size."""
    factor = rng.standard_normal((n + m, n + m)) * (rng.random() < 0.7)
    M = 10.0 ** rng.uniform(-4, 4) * (factor @ factor.T + np.diag([0.0] * n + [0.5] * m))
    P = rng.standard_normal((n, n))
    return lfo.QuadraticCost(
        Q=(M[:n, :n] + M[:n, :n].T) / 2,
        R=(M[n:, n:] + M[n:, n:].T) / 2,
        S=M[:n, n:],
        q=M.max() * 0.1 * rng.standard_normal(n) if rng.random() < 0.3 else 0.0,
        P=M.max() * (P @ P.T + (P @ P.T).T) / 2,
        x_ref=rng.standard_normal((T + 1, n)) if rng.random() < 0.5 else 0.0,
    )


def box_around(rng: np.random.Generator, signal: np.ndarray) -> lfo.Box:
    """Return bounds that the signal just meets, some of them absent."""
    lower, upper = signal.min(0), signal.max(0)
    margin = 1e-3 * (upper - lower) + 1e-6
    return lfo.Box(
        np.where(rng.random(len(lower)) < 0.7, lower - margin, -np.inf),
        np.where(rng.random(len(lower)) < 0.7, upper + margin, np.inf),
    )
