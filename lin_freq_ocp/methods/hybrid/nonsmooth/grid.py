"""Dynamic programming on a grid of states and controls: a trajectory to start from, for one or two states.

Values between grid points are interpolated linearly, so the result is near an optimum and proves nothing. Frequency
constraints couple all times; their multipliers, as functions of time, are in the stage costs instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.formulas.jets import values_of
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

if TYPE_CHECKING:
    from scipy.interpolate import RegularGridInterpolator

# Grid points of each state and of each control, by the numbers of states and controls: some 10^5 pairs
POINTS = {(1, 1): (301, 401), (1, 2): (201, 25), (2, 1): (61, 51), (2, 2): (41, 11)}
FINER = 4  # times as many control points in the forward pass
SAMPLES = 64  # random control sequences, for the range of states without bounds
# Of the distance to the terminal set, relative to the spread of stage costs over the range of a state: no control of
# the grid reaches the set exactly; a high price favours the distance, a low one the cost
END_PRICES = (2.0, 10.0, 50.0)


def grid_trajectories(
    problem: OptimalControlProblem, multipliers: Multipliers | None = None, deadline: float = np.inf
) -> Iterator[Trajectory]:
    """Yield trajectories of the grid's values until ``deadline``; none with more than two states, or without bounds.

    The frequency multipliers are in the cost.
    """
    from scipy.interpolate import RegularGridInterpolator  # slow to import

    n, m = problem.state_dim, problem.control_dim
    tube = problem.control_tube
    if (n, m) not in POINTS or not np.isfinite([tube.lower, tube.upper]).all():
        return
    of_states, of_controls = POINTS[n, m]
    lower, upper = _state_range(problem)
    axes = [np.linspace(low, high, of_states) for low, high in zip(lower, upper, strict=True)]
    states = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    controls = _controls(problem, of_controls)
    pairs = np.hstack(
        [np.repeat(states.reshape(-1, n), len(controls), axis=0), np.tile(controls, (states[..., 0].size, 1))]
    )
    after, costs = _successors(problem, pairs), _StageCosts(problem, multipliers)
    spread = float(np.ptp(costs.at(0, pairs)))
    far = 10 * (1 + spread) * problem.horizon
    end = problem.ends[1]
    distance = np.maximum(np.maximum(end.lower - states, states - end.upper), 0.0) / np.maximum(upper - lower, 1e-300)
    last, missed = costs.last(states.reshape(-1, n)).reshape(states.shape[:-1]), spread * distance.sum(axis=-1)
    for price in END_PRICES if missed.any() else END_PRICES[:1]:
        value = last + price * missed
        following: list[RegularGridInterpolator] = []
        for t in range(problem.horizon - 1, -1, -1):
            if now() > deadline:
                return
            following.append(RegularGridInterpolator(axes, value, bounds_error=False, fill_value=far))
            total = costs.at(t, pairs) + np.nan_to_num(following[-1](after), nan=far)
            value = np.minimum(total.reshape(-1, len(controls)).min(axis=1), far).reshape(value.shape)
        found = _followed(problem, costs, following[::-1], far)
        if found is not None:
            yield found


def _followed(
    problem: OptimalControlProblem, costs: _StageCosts, following: list[RegularGridInterpolator], far: float
) -> Trajectory | None:
    controls = _controls(problem, FINER * POINTS[problem.state_dim, problem.control_dim][1])
    box = problem.ends[0]
    x = [np.clip(np.zeros(problem.state_dim), box.lower, box.upper)]
    u: list[Array] = []
    for t in range(problem.horizon):
        pairs = np.hstack([np.tile(x[-1], (len(controls), 1)), controls])
        after = _successors(problem, pairs)
        total = costs.at(t, pairs) + np.nan_to_num(following[t](after), nan=far)
        total = np.where(np.isfinite(after).all(axis=1), total, np.inf)
        best = int(np.argmin(total))
        if not np.isfinite(total[best]):
            return None
        u.append(controls[best])
        x.append(after[best])
    return Trajectory(np.array(x), np.array(u))


class _StageCosts:
    """The quadratic costs of pairs (points, n + m), with the signals of frequency multipliers."""

    def __init__(self, problem: OptimalControlProblem, multipliers: Multipliers | None):
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        self._cost, self._n = problem.quadratic, n
        self._hessians = np.broadcast_to(self._cost.stage_hessians(), (T, n + m, n + m))
        x_ref, u_ref = np.broadcast_to(self._cost.x_ref, (T + 1, n)), np.broadcast_to(self._cost.u_ref, (T, m))
        self._references, self._last = np.hstack([x_ref[:-1], u_ref]), x_ref[-1]
        linear = np.hstack([np.broadcast_to(self._cost.q, (T, n)), np.broadcast_to(self._cost.r, (T, m))])
        self._linear, self._end = linear, np.asarray(self._cost.p)
        if multipliers is not None:
            of_x, of_u = problem.in_time(multipliers.rho_x), time_signal(multipliers.rho_u, T)
            self._linear = linear + np.hstack([of_x[:-1], of_u])
            self._end = self._end + of_x[-1]

    def at(self, t: int, pairs: Array) -> Array:
        """Return the costs at a time, (points,)."""
        y = pairs - self._references[t]
        return 0.5 * np.einsum("pi,ij,pj->p", y, self._hessians[t], y) + y @ self._linear[t]

    def last(self, states: Array) -> Array:
        """Return the costs of the last state, (points,)."""
        a = states - self._last
        return 0.5 * np.einsum("pi,ij,pj->p", a, self._cost.P, a) + a @ self._end


def _successors(problem: OptimalControlProblem, pairs: Array) -> Array:
    """Return the successors of pairs in the first mode that holds, (points, n); NaN where none does."""
    dynamics = piecewise_smooth(problem)
    found = np.full((len(pairs), problem.state_dim), np.nan)
    missing = np.ones(len(pairs), dtype=bool)
    for mode in dynamics.modes:
        values, region, domain = (values_of(part, pairs) for part in (mode.f, mode.region, mode.domain))
        here = missing & (region <= 0).all(axis=1) & (domain > 0).all(axis=1) & np.isfinite(values).all(axis=1)
        found[here] = values[here]
        missing &= ~here
    return found


def _controls(problem: OptimalControlProblem, points: int) -> Array:
    """Return a grid over the bounds of the controls, (points, m)."""
    tube = problem.control_tube
    lower, upper = tube.lower.min(axis=0), tube.upper.max(axis=0)
    axes = [np.linspace(low, high, points) for low, high in zip(lower, upper, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _state_range(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return bounds of the states, (n,) and (n,): as stated, else by simulation with random controls."""
    tube, rng = problem.state_tube, np.random.default_rng(0)
    lower, upper = tube.lower.min(axis=0), tube.upper.max(axis=0)
    if np.isfinite(lower).all() and np.isfinite(upper).all():
        return lower, upper
    start = np.clip(np.zeros(problem.state_dim), problem.ends[0].lower, problem.ends[0].upper)
    low, high = problem.control_tube.lower, problem.control_tube.upper
    reached = [start[None]]
    for i in range(SAMPLES):
        share = rng.random(low.shape) if i % 2 else np.full(low.shape, rng.random())
        try:
            reached.append(simulate(problem, low + share * (high - low), start).x)
        except NumericalError:
            continue
    states = np.vstack(reached)
    margin = 0.05 * np.ptp(states, axis=0) + 1e-3
    return (
        np.where(np.isfinite(lower), lower, states.min(axis=0) - margin),
        np.where(np.isfinite(upper), upper, states.max(axis=0) + margin),
    )
