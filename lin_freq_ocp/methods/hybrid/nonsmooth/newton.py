"""A semismooth Newton method on the conditions of the maximum principle for piecewise-smooth dynamics (``system``).

Steps solve the linearised equations, with the term of Levenberg and Marquardt where these are singular, and are
shortened until |Phi|^2 falls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.hybrid.nonsmooth.system import System, SystemValue
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.real_rows import spectrum_multipliers

NEAR_KINK = 1e-3  # distance in natural units at which a switching surface or zero of a norm gets a selection
CONVERGED = 1e-12  # |Phi| of equations of order 1 at which nothing is left to gain
SLOPE_SHARE, SHORTEST = 1e-4, 2.0**-14  # Armijo's constant, and the shortest step
SMALL_NORMALS = 1e-2  # weight of multipliers of bounds in the fit of multipliers: the others come first
SINGULAR = 1e-13  # reciprocal condition number of the linearised equations below which a step is damped
# Relative to |J|^2 |Phi|, until a step is found: they vanish with the residual, so that convergence stays fast
DAMPINGS = (0.0, 1e-8, 1e-6, 1e-4, 1e-2)
MOST_STEPS = 40


@dataclass(frozen=True, eq=False)
class NewtonRun:
    """The end of Newton's method; ``residuals`` are |Phi| before the first step and after each."""

    trajectory: Trajectory
    multipliers: Multipliers
    residuals: tuple[float, ...]
    converged: bool


def newton(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers | None,
    sequence: Indices,
    near: float = NEAR_KINK,
    most_steps: int = MOST_STEPS,
) -> NewtonRun:
    """Solve the conditions of the maximum principle from a point near to a solution, in a mode sequence (T,).

    Kinks nearer than ``near``, in natural units, get a selection. Of the multipliers, eta, rho and weights are used;
    None: the best fit, with normals to the bounds nearer than ``near``. Raises UnsupportedError if the problem has more
    than bounds, stop bands and a quadratic cost.
    """
    if problem.terms:
        raise UnsupportedError(f"{problem.terms[0].name}: the semismooth Newton method takes bounds and stop bands.")
    system = System.of(problem, trajectory, sequence, near)
    runs: list[NewtonRun] = []
    for weights in ("of the side", "one half"):
        start = starting_point(system, trajectory, multipliers, near, weights == "one half")
        runs.append(_run(system, start, most_steps))
        if runs[-1].converged or multipliers is not None or not system.switches:
            break
    return min(runs, key=lambda run: run.residuals[-1])


def _run(system: System, v: Array, most_steps: int) -> NewtonRun:
    value = system.at(v)
    residuals = [float(np.linalg.norm(value.phi))]
    while residuals[-1] > CONVERGED and len(residuals) <= most_steps:
        stepped = _stepped(system, v, value)
        if stepped is None:
            break
        v, value = stepped
        residuals.append(float(np.linalg.norm(value.phi)))
    found, multipliers = _answer(system, v, value)
    return NewtonRun(found, multipliers, tuple(residuals), residuals[-1] <= 1e3 * CONVERGED)


def _stepped(system: System, v: Array, value: SystemValue) -> tuple[Array, SystemValue] | None:
    """Return the point after a step that decreases |Phi|^2, damped as little as possible, or None."""
    U, sizes, V = np.linalg.svd(value.slopes)
    gradient, along = value.slopes.T @ value.phi, U.T @ value.phi
    for damping in DAMPINGS:
        if not damping and sizes[-1] <= SINGULAR * sizes[0]:
            continue
        weight = damping * sizes[0] ** 2 * min(1.0, float(np.linalg.norm(value.phi)))
        step = -V.T @ (sizes / (sizes**2 + weight) * along)
        slope, length = float(gradient @ step), 1.0
        while length >= SHORTEST:
            after = system.at(v + length * step)
            if after.phi @ after.phi <= value.phi @ value.phi + 2 * SLOPE_SHARE * length * slope:
                return v + length * step, after
            length /= 2
    return None


def starting_point(
    system: System, trajectory: Trajectory, multipliers: Multipliers | None, near: float, halved: bool
) -> Array:
    """Return the unknowns at a trajectory, in natural units; see ``newton`` for the multipliers.

    Where there are none, weights are one half if ``halved``, else those of the trajectory's side.
    """
    v = np.zeros(len(system.units))
    v[system.x], v[system.u] = trajectory.x, trajectory.u
    if multipliers is None:
        v[system.alpha] = 0.5 if halved else _sides(system, trajectory)
        return _fitted(system, v / system.units, near)
    v[system.eta] = multipliers.eta
    for block, rows, signal in (
        (system.rho_x, system.rows_x, system.problem.in_time(multipliers.rho_x)),
        (system.rho_u, system.rows_u, time_signal(multipliers.rho_u, len(trajectory.u))),
    ):
        if len(block):
            v[block] = np.linalg.lstsq(rows.T, signal.ravel(), rcond=None)[0]
    for k, (t, second, _) in enumerate(system.switches):
        v[system.alpha[k]] = 0.5 if multipliers.weights is None else np.clip(multipliers.weights[t, second], 0, 1)
    return v / system.units


def _sides(system: System, trajectory: Trajectory) -> Array:
    """Return 1 where a switching surface is crossed, else 0."""
    T = system.problem.horizon
    found = piecewise_smooth(system.problem).jets_at(np.hstack([trajectory.x[:T], trajectory.u]))
    crossed = [found.regions[system.sequence[t]].values[t, row] > 0 for t, _, row in system.switches]
    return np.array(crossed, dtype=float)


def _fitted(system: System, v: Array, near: float) -> Array:
    """Return the unknowns with the multipliers of least squares."""
    from scipy.optimize import lsq_linear  # slow to import

    F, J = system.equations(v * system.units)
    signals = np.concatenate([system.x.ravel(), system.u.ravel()])
    signals = signals[system.lower[signals] < system.upper[signals]]
    at_lower, at_upper = v[signals] <= system.lower[signals] + near, v[signals] >= system.upper[signals] - near
    held = np.flatnonzero(at_lower | at_upper)
    found = np.concatenate([system.eta.ravel(), system.rho_x, system.rho_u])
    slopes = system.scales[signals, None] * J[np.ix_(signals, found)] * system.units[found]
    normals = np.zeros((len(signals), len(held)))
    normals[held, np.arange(len(held))] = 1.0
    small = np.hstack([np.zeros((len(held), len(found))), SMALL_NORMALS * np.eye(len(held))])
    right = np.concatenate([-system.scales[signals] * F[signals], np.zeros(len(held))])
    free = np.full(len(found), np.inf)
    above = np.where(at_upper[held], np.inf, 0.0)
    below = np.where(at_lower[held], -np.inf, 0.0)
    bounds = np.append(-free, below), np.append(free, above)
    v[found] = lsq_linear(np.vstack([np.hstack([slopes, normals]), small]), right, bounds).x[: len(found)]
    return v


def _answer(system: System, v: Array, value: SystemValue) -> tuple[Trajectory, Multipliers]:
    """Return the trajectory and the multipliers of unknowns in natural units."""
    problem, values, F = system.problem, v * system.units, value.F / system.scales
    T = problem.horizon
    weights = np.zeros((T, len(piecewise_smooth(problem).modes)))
    weights[np.arange(T), system.sequence] = 1.0
    for k, (t, second, _) in enumerate(system.switches):
        share = float(np.clip(values[system.alpha[k]], 0.0, 1.0))
        weights[t, system.sequence[t]], weights[t, second] = 1 - share, share
    x = np.clip(values[system.x], problem.state_tube.lower, problem.state_tube.upper)
    u = np.clip(values[system.u], problem.control_tube.lower, problem.control_tube.upper)
    mu, nu = (
        np.where(np.isfinite(box.lower) | np.isfinite(box.upper), -F[block], 0.0)
        for block, box in ((system.x, problem.state_tube), (system.u, problem.control_tube))
    )
    rho_u = spectrum_multipliers(problem.control_stop, T, values[system.rho_u])
    rho_x = spectrum_multipliers(problem.state_stop, problem.state_samples, values[system.rho_x])
    return Trajectory(x, u), Multipliers(1.0, values[system.eta], mu, nu, rho_u, rho_x, None, weights)
