"""Figures of a trajectory: distances from bounds and ends, energy in bands, amplification of errors."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.phrases import runs_of
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

ZERO_PADDING = 16  # length of the zero-padded DFT over that of the signal
REPLAY_LIMIT = 1e-3  # machine precision times the amplification, above which a simulation is amplified rounding


@dataclass(frozen=True)
class Measures:
    """The figures of a trajectory in a comparison; None if there is nothing to measure.

    Attributes
    ----------
    max_control : float
        Largest |u| over times and components.
    control_violation, state_violation : float (the latter or None)
        Largest distance beyond a bound, over times and components, in the units of the component.
    stage_violation : float or None
        Largest violation of a joint row C x_t + D u_t <= e_t; None where there are none.
    terminal_error, terminal_errors : float or None, (n,) or None
        Largest distance of a component of x_T from the terminal set, and that of each; None where the end is free.
    stopband_energy, state_stopband_energy : float or None
        Sum of |DFT|^2 over the stopped (or bounded) bins 0 .. Nyquist of the controls, of the states.
    stopband_peak, state_stopband_peak : float or None
        Largest magnitude of the zero-padded spectrum between the first and last bin of each stopped run.
    amplification : float
        Spectral norm of A_{T-1} ... A_0; with modes, of the modes along the trajectory.
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
    periods = x[: problem.state_samples]
    has_end = bool(np.isfinite(np.stack([terminal.lower, terminal.upper])).any())
    errors = terminal.violation(x[-1])
    return Measures(
        cost=problem.value(x, u),
        max_control=float(np.abs(u).max()),
        control_violation=float(problem.control_tube.violation(u).max()),
        state_violation=float(problem.state_boxes.violation(x).max()),  # without the ends
        stage_violation=max((float(rows.violation(x, u).max()) for rows in problem.stage_rows), default=None),
        terminal_error=float(errors.max()) if has_end else None,
        terminal_errors=tuple(errors.tolist()) if has_end else None,
        stopband_energy=stopband_energy(u, problem.control_band),
        stopband_peak=stopband_peak(u, problem.control_band),
        state_stopband_energy=stopband_energy(periods, problem.state_band),
        state_stopband_peak=stopband_peak(periods, problem.state_band),
        amplification=growth_along(problem, trajectory),
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
    return runs_of(np.flatnonzero(stopped))


def stopband_peak(signal: Array, stopped: Mask) -> float | None:
    """Return the largest magnitude of the zero-padded spectrum within the stopped runs, also between the bins."""
    if not stopped.any():
        return None
    magnitude, top = padded_spectrum(signal)[1], len(stopped) - 1
    return max(
        float(magnitude[ZERO_PADDING * first : len(magnitude) if last == top else ZERO_PADDING * last + 1, j].max())
        for j in range(stopped.shape[1])
        for first, last in stopped_runs(stopped[:, j])
    )


def one_step_residual(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return x_{t+1} - f_t(x_t, u_t), shape (T, n); unstable dynamics do not amplify it."""
    dynamics = problem.dynamics_along(trajectory) if problem.response is None else problem.equations
    return trajectory.x[1:] - dynamics.successors(trajectory.x, trajectory.u)


def growth_along(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return the ``amplification`` of the dynamics along a trajectory; 0 of a frequency response, without recursion."""
    if problem.response is not None:
        return 0.0
    return amplification(problem.dynamics_along(trajectory), problem.horizon)


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
    """Whether an open-loop simulation of dynamics with this amplification shows more than rounding errors."""
    return bool(np.finfo(float).eps * growth <= REPLAY_LIMIT)
