"""Random infeasible problems, tightened in one respect around a trajectory: ``random_infeasible(seed)``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo

LONGEST, LARGEST = 50, 4  # largest horizon and number of states
KINDS = ("too weak", "too far", "too narrow", "too slow")


def random_infeasible(seed: int) -> tuple[str, lfo.OptimalControlProblem]:
    """Return how a problem around a random trajectory was made infeasible, and the problem."""
    rng = np.random.default_rng(seed)
    for _ in range(100):
        kind, problem = KINDS[rng.integers(len(KINDS))], _around_a_trajectory(rng)
        for _ in range(6):
            problem = _tightened(rng, kind, problem)
            if lfo.solve(problem, throw=False).status == "infeasible":
                return kind, problem
    raise RuntimeError(f"seed {seed}: every problem remained feasible")


def _around_a_trajectory(rng: np.random.Generator) -> lfo.OptimalControlProblem:
    n, m, T = int(rng.integers(1, LARGEST + 1)), int(rng.integers(1, 3)), int(rng.integers(8, LONGEST + 1))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.7, 1.03) / np.abs(np.linalg.eigvals(A)).max()
    if rng.random() < 0.25:
        A = A * np.minimum(1.0, 1 + 0.1 * np.sin(np.arange(T)))[:, None, None]
    dynamics = lfo.LinearDynamics(A, rng.standard_normal((n, m)), offset=0.1 * rng.standard_normal(n))
    bands = [lfo.low_pass(float(rng.uniform(1.0, 3.0)), component=j) for j in range(m) if rng.random() < 0.7]
    free = lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(), control_spectrum=bands)
    u = np.fft.irfft(np.where(free.control_stop, 0, np.fft.rfft(rng.standard_normal((T, m)), axis=0)), n=T, axis=0)
    x = lfo.simulate(free, u, rng.standard_normal(n)).x
    return replace(
        free,
        cost=lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(u.min(0) - 0.1, u.max(0) + 0.1),
        state_set=lfo.Box(x.min(0) - 0.1, x.max(0) + 0.1) if rng.random() < 0.5 else None,
        initial_state=x[0],
        terminal_state=x[-1],
    )


def _tightened(rng: np.random.Generator, kind: str, problem: lfo.OptimalControlProblem) -> lfo.OptimalControlProblem:
    if kind == "too weak":
        tube = problem.control_tube
        return replace(problem, control_set=lfo.Box(0.6 * tube.lower, 0.6 * tube.upper))
    if kind == "too far":
        away = problem.terminal_box.lower + 0.5 * rng.standard_normal(problem.state_dim)
        boxes = problem.state_boxes
        within = np.clip(away, boxes.lower[-1], boxes.upper[-1])
        return replace(problem, terminal_state=within)
    if kind == "too narrow":
        passed = ~problem.control_stop
        highest = int(np.flatnonzero(passed.any(1)).max())
        narrower = problem.control_stop.copy()
        narrower[max(1, int(0.7 * highest)) :] = True
        bands = [
            lfo.stop_band(bins=np.flatnonzero(narrower[:, j]).tolist(), component=j) for j in range(passed.shape[1])
        ]
        return replace(problem, control_spectrum=bands)
    row = rng.standard_normal((1, problem.control_dim))
    families = [*problem.stage_rows, lfo.StageRows(None, row, [0.02], name=f"family {len(problem.stage_rows)}")]
    return replace(problem, stage_rows=families)
