"""The semismooth Newton method from a start near a known optimum: whether it comes back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.methods.hybrid.smooth.newton import NewtonRun, newton
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth

SAME_COST = 1e-8
NEAR = 3.0  # kinks within so many times the noise get a selection
PROBLEMS: dict[str, Callable[[], lfo.OptimalControlProblem]] = {
    "norm, x_0 = (1, 1), T = 10": lambda: lfo.library.norm_dynamics((1.0, 1.0), 10),
    "buck, T = 8": lambda: lfo.library.buck_converter(8),
    "buck, T = 8, bins 3 to 5": lambda: lfo.library.buck_converter(8, control_spectrum=[3, 4, 5]),
    "buck on the border, T = 4": lambda: lfo.library.buck_converter(4, terminal_state=None, terminal_price=-40.0),
}


def noisy(
    problem: lfo.OptimalControlProblem, result: lfo.results.Result, level: float, rng: np.random.Generator
) -> lfo.Trajectory:
    """Return the optimum's trajectory with noise, within the bounds."""
    assert result.trajectory is not None
    x, u = result.trajectory.x, result.trajectory.u
    x = x + level * np.abs(x).max(axis=0) * rng.standard_normal(x.shape)
    u = u + level * np.abs(u).max(axis=0) * rng.standard_normal(u.shape)
    tubes = problem.state_tube, problem.control_tube
    return lfo.Trajectory(*(np.clip(one, tube.lower, tube.upper) for one, tube in zip((x, u), tubes, strict=True)))


def run(
    problem: lfo.OptimalControlProblem, result: lfo.results.Result, level: float, seed: int
) -> tuple[NewtonRun, bool]:
    """Return one run from a noisy start, and whether it returned to the optimum."""
    start = noisy(problem, result, level, np.random.default_rng(seed))
    sequence = piecewise_smooth(problem).sequence_of(start.x, start.u)
    found = newton(problem, start, None, sequence, near=max(NEAR * level, 1e-3))
    cost = problem.value(found.trajectory.x, found.trajectory.u)
    assert result.cost is not None
    return found, found.converged and abs(cost - result.cost) <= SAME_COST * max(1.0, abs(result.cost))
