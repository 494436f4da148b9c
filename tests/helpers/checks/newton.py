"""The semismooth Newton method from a start near a known optimum: whether it comes back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import lsq_linear

import lin_freq_ocp as lfo
from lin_freq_ocp.methods.hybrid import NewtonRun, NewtonSystem, iterate_from
from lin_freq_ocp.transform.hybrid import piecewise_smooth

SAME_COST = 1e-8
SMALL_NORMALS = 1e-2  # weight of multipliers of bounds in the fit of multipliers: the others come first
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


def fitted_start(
    system: NewtonSystem, trajectory: lfo.Trajectory, near: float, halved: bool
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the unknowns at a trajectory with multipliers of least squares, and normals to bounds that are ``near``.

    Weights are one half if ``halved``, else those of the trajectory's side.
    """
    v = np.zeros(len(system.units))
    v[system.x], v[system.u], v[system.alpha] = trajectory.x, trajectory.u, 0.5
    if not halved:  # 1 where a switching surface is crossed
        y = np.hstack([trajectory.x[: system.problem.horizon], trajectory.u])
        regions = piecewise_smooth(system.problem).jets_at(y).regions
        crossed = [regions[system.sequence[t]].values[t, row] > 0 for t, _, row in system.switches]
        v[system.alpha] = np.array(crossed, dtype=float)
    F, J = system.equations(v)
    v /= system.units
    signals = np.concatenate([system.x.ravel(), system.u.ravel()])
    signals = signals[system.lower[signals] < system.upper[signals]]
    at_lower, at_upper = v[signals] <= system.lower[signals] + near, v[signals] >= system.upper[signals] - near
    at_bounds = np.flatnonzero(at_lower | at_upper)
    multipliers = np.concatenate([system.eta.ravel(), system.rho_x, system.rho_u])
    slopes = system.scales[signals, None] * J[signals][:, multipliers].toarray() * system.units[multipliers]
    normals = np.zeros((len(signals), len(at_bounds)))
    normals[at_bounds, np.arange(len(at_bounds))] = 1.0
    small = np.hstack([np.zeros((len(at_bounds), len(multipliers))), SMALL_NORMALS * np.eye(len(at_bounds))])
    right = np.concatenate([-system.scales[signals] * F[signals], np.zeros(len(at_bounds))])
    free = np.full(len(multipliers), np.inf)
    above, below = np.where(at_upper[at_bounds], np.inf, 0.0), np.where(at_lower[at_bounds], -np.inf, 0.0)
    bounds = np.append(-free, below), np.append(free, above)
    v[multipliers] = lsq_linear(np.vstack([np.hstack([slopes, normals]), small]), right, bounds).x[: len(multipliers)]
    return v


def run(
    problem: lfo.OptimalControlProblem, result: lfo.results.Result, level: float, seed: int
) -> tuple[NewtonRun, bool]:
    """Return one run from a noisy start, and whether it returned to the optimum."""
    start = noisy(problem, result, level, np.random.default_rng(seed))
    sequence = piecewise_smooth(problem).sequence_of(start.x, start.u)
    near, runs = max(NEAR * level, 1e-3), list[NewtonRun]()
    system = NewtonSystem.around(problem, start, sequence, near)
    for halved in (False, True):
        runs.append(iterate_from(system, fitted_start(system, start, near, halved)))
        if runs[-1].converged or not system.switches:
            break
    found = min(runs, key=lambda run: run.residuals[-1])
    cost = problem.value(found.trajectory.x, found.trajectory.u)
    assert result.cost is not None
    return found, found.converged and abs(cost - result.cost) <= SAME_COST * max(1.0, abs(result.cost))
