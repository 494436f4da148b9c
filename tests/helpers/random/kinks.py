"""Random problems with continuous piecewise-affine dynamics, kinks of rank one: ``random_problem(seed)``."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo

KINDS = ("one kink", "two parallel kinks", "two crossing kinks", "three wedges")


def random_map(rng: np.random.Generator, n: int, m: int, kind: str) -> lfo.PiecewiseAffineDynamics:
    """Return f = F y + c plus kinks of rank one: continuous everywhere."""
    F = np.hstack([rng.standard_normal((n, n)) * 0.8 / np.sqrt(n), rng.standard_normal((n, m))])
    c = 0.2 * rng.standard_normal(n)
    g1, g2 = rng.standard_normal((2, n))
    h1, h2 = rng.standard_normal((2, n + m))
    d1, d2 = 0.4 * rng.standard_normal(2)

    def mode(
        pieces: list[tuple[np.ndarray, np.ndarray, float]], rows: list[tuple[np.ndarray, float]]
    ) -> lfo.AffineMode:
        matrix, offset = F.copy(), c.copy()
        for g, h, d in pieces:
            matrix, offset = matrix + np.outer(g, h), offset - g * d
        G, limits = np.array([row for row, _ in rows]), np.array([limit for _, limit in rows])
        return lfo.AffineMode(matrix[:, :n], matrix[:, n:], offset, G[:, :n], G[:, n:], limits)

    def above(h: np.ndarray, d: float) -> tuple[np.ndarray, float]:
        return -h, -d

    one, two = (g1, h1, d1), (g2, h2, d2)
    if kind == "one kink":
        modes = [mode([], [(h1, d1)]), mode([one], [above(h1, d1)])]
    elif kind == "two parallel kinks":
        further = d1 + abs(d2) + 0.1
        second = (g2, h1, further)
        modes = [
            mode([], [(h1, d1)]),
            mode([one], [above(h1, d1), (h1, further)]),
            mode([one, second], [above(h1, further)]),
        ]
    elif kind == "two crossing kinks":
        modes = [
            mode([], [(h1, d1), (h2, d2)]),
            mode([one], [above(h1, d1), (h2, d2)]),
            mode([two], [(h1, d1), above(h2, d2)]),
            mode([one, two], [above(h1, d1), above(h2, d2)]),
        ]
    else:  # g max(0, h1'y - d1, h2'y - d2)
        same = (g1, h2, d2)
        modes = [
            mode([], [(h1, d1), (h2, d2)]),
            mode([one], [above(h1, d1), above(h1 - h2, d1 - d2)]),
            mode([same], [above(h2, d2), above(h2 - h1, d2 - d1)]),
        ]
    return lfo.PiecewiseAffineDynamics(modes)


def random_problem(seed: int) -> tuple[str, lfo.OptimalControlProblem, np.ndarray]:
    """Return the kind of map, a problem around a random trajectory, and the controls of that trajectory."""
    rng = np.random.default_rng(seed)
    kind, n, m, T = KINDS[seed % len(KINDS)], *rng.integers(1, 4, 2), int(rng.integers(3, 7))
    dynamics = random_map(rng, n, m, kind)
    factor = rng.standard_normal((n + m, n + m))
    M = factor @ factor.T / (n + m) + np.diag([0.0] * n + [0.2] * m)
    M = (M + M.T) / 2
    P = rng.standard_normal((n, n))
    cost = lfo.QuadraticCost(
        Q=M[:n, :n], R=M[n:, n:], S=M[:n, n:], q=rng.standard_normal(n), P=P @ P.T, p=2 * rng.standard_normal(n)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.BandWarning)
        band = lfo.stop_band(bins=[int(rng.integers(1, T // 2 + 1))], component=0) if rng.random() < 0.5 else None
        problem = lfo.OptimalControlProblem(
            dynamics=dynamics,
            horizon=T,
            cost=cost,
            control_set=lfo.Box(-2.0, 2.0) if rng.random() < 0.7 else None,
            initial_state=_initial(rng, dynamics, n, m),
            control_spectrum=band,
            name=f"{kind} {seed}",
        )
        u = np.clip(rng.standard_normal((T, m)), -1, 1)
        u = np.fft.irfft(np.where(problem.control_stop, 0, np.fft.rfft(u, axis=0)), n=T, axis=0)
        u = u / max(1.0, np.abs(u).max())
        x = lfo.simulate(problem, u).x
        if rng.random() < 0.5:  # bounds that the trajectory meets, so that it is feasible
            size = np.abs(x).max(0) + 0.2
            problem = replace(problem, state_set=lfo.Box(-size, size))
        if rng.random() < 0.2:
            problem = replace(problem, terminal_state=x[-1])
    return kind, problem, u


def _initial(rng: np.random.Generator, dynamics: lfo.PiecewiseAffineDynamics, n: int, m: int) -> np.ndarray:
    """Return an initial state, at times one that u = 0 has on a border."""
    x, region = rng.standard_normal(n), dynamics.modes[0].region
    if rng.random() < 0.2:
        h, limit = region.C[0], region.e[0]
        x += h * (limit - h @ x) / (h @ h)
    return x
