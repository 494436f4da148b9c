"""A plant of three states and two controls for tests of the Fourier-domain method, with sets and residuals."""

from __future__ import annotations

from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.methods import SolveOptions
from lin_freq_ocp.problem import one_step_residual
from lin_freq_ocp.solving import solve_spectral

A = np.array([[0.9, 0.3, 0.0], [-0.2, 0.8, 0.1], [0.0, 0.2, 0.7]])
B = np.array([[0.5, 0.0], [0.2, 0.6], [0.3, -0.4]])
START, END = np.array([1.0, -0.5, 0.3]), np.array([-0.4, 0.6, 0.2])
T = 24
TIGHT = lfo.Box([-0.3, -0.25], [0.25, 0.3])
CONTROL_BOX = lfo.Box([-0.7, -0.8], [0.6, 0.7])
STATE_BOX = lfo.Box([-1.1, -0.53, -0.25], [1.05, 0.65, 0.42])
LARGE_BOX = lfo.Box([-1.4, -0.7, -0.4], [1.2, 0.7, 0.5])


def plant(a: Any = A, b: Any = B, offset: Any = 0.0) -> lfo.LinearDynamics:
    return lfo.LinearDynamics(a, b, offset) if np.any(offset) else lfo.LinearDynamics(a, b)


def certificate_of_claim(problem: lfo.OptimalControlProblem) -> lfo.results.Certificate:
    """Judge what the Fourier-domain method itself returns; ``solve`` would correct a wrong answer."""
    claim = solve_spectral(problem, SolveOptions())
    return judge(problem, claim.trajectory, claim.multipliers)


def problem_of(**changes: Any) -> lfo.OptimalControlProblem:
    """Bounded controls, a stop band on each, fixed ends; ``changes`` replace fields."""
    fields = {
        "dynamics": plant(),
        "horizon": T,
        "cost": lfo.QuadraticCost(Q=0.3, R=np.diag([1.0, 2.0])),
        "control_set": CONTROL_BOX,
        "initial_state": START,
        "terminal_state": END,
        "control_spectrum": [lfo.stop_band(bins=[5, 6, 7], component=0), lfo.stop_band(bins=[9, 10], component=1)],
    }
    return lfo.OptimalControlProblem(**(fields | changes))


def wave(times: int, components: int, size: float = 1.0, seed: int = 0) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal((times, components))


def residuals(problem: lfo.OptimalControlProblem, trajectory: lfo.Trajectory) -> dict[str, float]:
    """Relative residuals of dynamics, bounds and stop bands, from the problem's data alone."""
    x, u = trajectory.x, trajectory.u
    size = max(np.abs(x).max(), np.abs(u).max())
    bounds = [problem.state_tube.violation(x), problem.control_tube.violation(u)]
    bounds += [rows.violation(x, u) for rows in problem.stage_rows]
    return {
        "dynamics": np.abs(one_step_residual(problem, trajectory)).max() / size,
        "bounds": max(v.max() for v in bounds) / size,
        "control bands": np.abs(np.fft.rfft(u, axis=0)[problem.control_stop]).max(initial=0.0)
        / max(np.linalg.norm(u), 1e-4),
        "state bands": np.abs(np.fft.rfft(x, axis=0)[problem.state_stop]).max(initial=0.0) / np.linalg.norm(x),
    }


def tube(box: lfo.Box, times: int, **points: Any) -> lfo.Box:
    """Return the box for all times, with single values fixed: t10_1=0.3 fixes component 1 at t = 10."""
    lower, upper = np.tile(box.lower, (times, 1)), np.tile(box.upper, (times, 1))
    for place, value in points.items():
        t, i = (int(part) for part in place[1:].split("_"))
        lower[t, i] = upper[t, i] = value
    return lfo.Box(lower, upper)


def moving(times: int, components: int, width: float, seed: int) -> lfo.Box:
    middle = wave(times, components, 0.2 * width, seed)
    return lfo.Box(middle - width, middle + width)
