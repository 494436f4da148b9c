"""Figures of a trajectory, each measured in one place: bounds, ends, bands, and how far a replay can be trusted."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory

ZERO_PADDING = 16
"""Length of the zero-padded DFT over that of the signal: 16 samples of the spectrum between neighbouring bins."""

REPLAY_LIMIT = 1e-3
"""Machine precision times the open-loop growth above which a replay shows amplified rounding and nothing else."""

WEIGHTY = 0.1
"""A component with less than this part of a row's largest coefficient is not what the row's limit is about."""

NO_GAIN = 1e-14
"""Entries of a row of [A, B] below this part of its largest one are rounding: no size follows from them."""

FAR_BEYOND = 1e4
"""Factor between a bound and what else is said of a component from which the bound stands for none."""


@dataclass(frozen=True)
class Measures:
    """What a comparison shows of one trajectory; None where there is nothing to measure.

    Attributes
    ----------
    cost : float or None
        J of the trajectory.
    max_control : float
        Largest |u| over times and components.
    control_violation, state_violation : float (the latter or None)
        Largest distance beyond a bound, over times and components, in the units of the component.
    stage_violation : float or None
        Largest excess over a joint row C x_t + D u_t <= e_t; None where there are none.
    terminal_error : float or None
        Largest distance of a component of x_T from the terminal set; None where the end is free.
    terminal_errors : (n,) or None
        That distance for every component.
    stopband_energy, state_stopband_energy : float or None
        Sum of |DFT|^2 over the stopped (or bounded) bins 0 .. Nyquist of the controls, of the states.
    stopband_peak, state_stopband_peak : float or None
        Largest magnitude of the zero-padded spectrum between the first and last bin of each stopped run.
    amplification : float
        Spectral norm of A_{T-1} ... A_0; with modes, of those that the trajectory is in.
    """

    cost: float | None
    max_control: float
    control_violation: float
    state_violation: float | None
    stage_violation: float | None
    terminal_error: float | None
    terminal_errors: tuple[float, ...] | None
    stopband_energy: float | None
    stopband_peak: float | None
    state_stopband_energy: float | None
    state_stopband_peak: float | None
    amplification: float


def measure(problem: OptimalControlProblem, trajectory: Trajectory) -> Measures:
    """Measure a trajectory of the problem's shape."""
    problem.require(trajectory)
    x, u = trajectory.x, trajectory.u
    terminal = problem.terminal_box
    bounds = problem.state_boxes  # the ends apart
    has_end = bool(np.isfinite(np.stack([terminal.lower, terminal.upper])).any())
    missed = terminal.violation(x[-1])
    return Measures(
        cost=problem.value(x, u),
        max_control=float(np.abs(u).max()),
        control_violation=float(problem.control_tube.violation(u).max()),
        state_violation=float(bounds.violation(x).max()),
        stage_violation=max((float(rows.violation(x, u).max()) for rows in problem.stage_rows), default=None),
        terminal_error=float(missed.max()) if has_end else None,
        terminal_errors=tuple(float(miss) for miss in missed) if has_end else None,
        stopband_energy=stopband_energy(u, problem.control_band),
        stopband_peak=stopband_peak(u, problem.control_band),
        state_stopband_energy=stopband_energy(x, problem.state_band),
        state_stopband_peak=stopband_peak(x, problem.state_band),
        amplification=amplification(problem.dynamics_along(trajectory), problem.horizon),
    )


def stopband_energy(signal: Array, stopped: Mask) -> float | None:
    """Return sum |DFT_k|^2 over the stopped bins 0 .. Nyquist; signal (N, components), stopped (N//2+1, components)."""
    if not stopped.any():
        return None
    return float((np.abs(np.fft.rfft(signal, axis=0)) ** 2)[stopped].sum())


def padded_spectrum(signal: Array) -> tuple[Array, Array]:
    """Return frequencies in rad/sample, (points,), and magnitudes, (points, components), of the zero-padded DFT."""
    points = ZERO_PADDING * len(signal)
    magnitude = np.abs(np.fft.rfft(signal, n=points, axis=0))
    return 2 * np.pi * np.arange(len(magnitude)) / points, magnitude


def stopped_runs(stopped: Mask) -> list[tuple[int, int]]:
    """Return (first, last) of every run of neighbouring stopped bins of one component, stopped (bins,)."""
    edges = np.flatnonzero(np.diff(np.r_[False, stopped, False].astype(int)))
    return [(int(first), int(after) - 1) for first, after in zip(edges[::2], edges[1::2], strict=True)]


def stopband_peak(signal: Array, stopped: Mask) -> float | None:
    """Return the largest zero-padded spectrum magnitude within the stopped runs: it is not zero between the bins."""
    if not stopped.any():
        return None
    magnitude, top = padded_spectrum(signal)[1], len(stopped) - 1
    return max(
        float(magnitude[ZERO_PADDING * first : len(magnitude) if last == top else ZERO_PADDING * last + 1, j].max())
        for j in range(stopped.shape[1])
        for first, last in stopped_runs(stopped[:, j])
    )


def one_step_residual(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return x_{t+1} - f_t(x_t, u_t), shape (T, n): meaningful however unstable the dynamics are."""
    return trajectory.x[1:] - problem.dynamics_along(trajectory).successors(trajectory.x, trajectory.u)


def amplification(dynamics: LinearDynamics, horizon: int) -> float:
    """Return the spectral norm of A_{T-1} ... A_0, at most the largest float."""
    logarithm, product = 0.0, np.eye(dynamics.state_dim)
    for t in range(horizon):
        product = dynamics.at(t)[0] @ product
        size = float(np.abs(product).max())
        if size == 0:
            return 0.0
        if not 1e-100 < size < 1e100:
            logarithm, product = logarithm + np.log(size), product / size
    logarithm += float(np.log(np.linalg.norm(product, 2)))
    return float(np.exp(logarithm)) if logarithm < np.log(sys.float_info.max) else sys.float_info.max


def replay_is_meaningful(growth: float) -> bool:
    """Whether an open-loop replay of dynamics with this amplification shows more than rounding errors."""
    return bool(np.finfo(float).eps * growth <= REPLAY_LIMIT)


def stated_sizes(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return sizes of states, (n,), and controls, (m,), as the data state them, before anything is solved.

    A component is as large as its ends and references, else its bounds, else (a control) what other sets and rows
    allow, else what the others make of it within the horizon, else what makes the others as large as they are, else
    what other sets and rows allow; 1 only where nothing at all is said. Bounds far beyond what ends, references and
    dynamics say of a component stand for none.
    """
    n, sizes, limited = problem.state_dim, given_sizes(problem), _limited_sizes(problem)
    sizes[n:] = np.where(sizes[n:] > 0, sizes[n:], limited[n:])
    sizes = _completed(problem, sizes)
    if not sizes.all():
        sizes = _completed(problem, np.where(sizes > 0, sizes, limited))
    sizes = np.where(sizes > 0, sizes, 1.0)
    return sizes[:n], sizes[n:]


def given_sizes(problem: OptimalControlProblem) -> Array:
    """Return sizes of states and controls, (n+m,): of their ends and references, else of their bounds, else 0."""
    cost, n = problem.quadratic, problem.state_dim
    ends = np.maximum(_finite(problem.initial_box).max(0), _finite(problem.terminal_box).max(0))
    ends = np.maximum(ends, np.abs(cost.x_ref).reshape(-1, n).max(0))
    references = np.abs(cost.u_ref).reshape(-1, problem.control_dim).max(0)
    stated = np.concatenate([ends, references])
    bounds = np.concatenate([_bounded_sizes(tube) for tube in (problem.state_tube, problem.control_tube)])
    others = np.where(stated > 0, stated, bounds)
    followed = _completed(problem, stated, np.max) if stated.any() else _implied_sizes(problem, others, np.max)
    bounds = np.where((followed > 0) & (bounds > FAR_BEYOND * followed), followed, bounds)
    return np.where(stated > 0, stated, bounds)


def _bounded_sizes(tube: Box) -> Array:
    """Return how large bounds (times, k) are at most times; of two that are far apart, the smaller one; 0: none."""
    sides = np.ma.masked_equal(_finite(tube), 0.0)
    lower, upper = np.ma.filled(np.ma.median(sides, axis=1), 0.0)
    smaller, larger = np.minimum(lower, upper), np.maximum(lower, upper)
    return np.where((smaller > 0) & (larger > FAR_BEYOND * smaller), smaller, larger)


def _limited_sizes(problem: OptimalControlProblem) -> Array:
    """Return the least value that a limit of a set or row allows a component that weighs in it, 0 where none does."""
    n, m = problem.state_dim, problem.control_dim
    least = np.full(n + m, np.inf)
    for term in problem.terms:
        form = term.map.stage_form(n, m)
        if form is None:
            continue
        limit = (np.broadcast_to(term.penalty.sizes(), term.shape) + np.abs(form[1])).max(0)
        coefficients = np.abs(form[0]).max(0)
        for weights, part in ((coefficients[:, :n], least[:n]), (coefficients[:, n:], least[n:])):
            counts = (weights >= WEIGHTY * weights.max(1, keepdims=True)) & (weights > 0) & (limit[:, None] > 0)
            allowed = np.divide(limit[:, None], weights, out=np.full(weights.shape, np.inf), where=counts)
            np.minimum(part, allowed.min(0), out=part)
    return np.where(np.isfinite(least), least, 0.0)


def _completed(problem: OptimalControlProblem, sizes: Array, chosen: Callable[..., Array] = np.min) -> Array:
    """Return sizes with those that follow from others filled in; ``chosen`` of what makes others as large as they are.

    The smallest keeps within what all of them say; the largest is more than is likely, however small one of them is.
    """
    for _ in range(len(sizes)):  # one more component, at least, is known after each pass
        if sizes.all():
            break
        sizes = np.where(sizes > 0, sizes, _implied_sizes(problem, sizes, chosen))
    return sizes


def _implied_sizes(problem: OptimalControlProblem, known: Array, chosen: Callable[..., Array]) -> Array:
    """Return what |x_i| <= T (|A| |x| + |B| |u| + |d|)_i says of the components that are not known (0) yet."""
    n, m = problem.state_dim, problem.control_dim
    A, B, d = problem.dynamics.gains()
    gain = problem.horizon * np.hstack([A * (1 - np.eye(n)), B])  # what a component makes of itself says nothing
    gain = np.where(gain > NO_GAIN * gain.max(axis=1, keepdims=True), gain, 0.0)
    caused = gain @ known + problem.horizon * d
    useful = (known[:n, None] > 0) & (gain > 0)
    absent = np.inf if chosen is np.min else 0.0
    needed = chosen(np.divide(known[:n, None], gain, out=np.full(gain.shape, absent), where=useful), axis=0)
    forwards = np.append(caused, np.zeros(m))
    return np.where(forwards > 0, forwards, np.where(np.isfinite(needed), needed, 0.0))


def _finite(box: Box) -> Array:
    """Return |lower| and |upper| stacked, with 0 where there is no bound."""
    both = np.abs(np.stack([box.lower, box.upper]))
    return np.where(np.isfinite(both), both, 0.0)
