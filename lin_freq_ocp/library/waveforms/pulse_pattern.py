"""Pulse patterns of multilevel inverters: harmonics removed with few levels, and least distortion with few switches."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief, positive_integer, positive_number
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.levels import FiniteSet
from lin_freq_ocp.problem.hybrid.pulse_train import QUARTER, PulseTrain
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import stop_band
from lin_freq_ocp.problem.spectrum.bounds import MagnitudeBound

LEVELS = (-2.0, -1.0, 0.0, 1.0, 2.0)
FUNDAMENTAL = 1.5  # amplitude of the first harmonic
REMOVED = (3, 5, 7)
STEP, THIRD = 0.5, 0.01  # between levels of an optimal pulse pattern, and the largest third harmonic


def pulse_pattern(
    kind: str = "shep", samples: int = 128, tolerance: float | None = None, modulation: float = 0.9, switches: int = 8
) -> OptimalControlProblem:
    """Switch an inverter between five levels: harmonics removed, or least distortion with a budget of switches.

    Selective harmonic elimination ("shep"): of u_t in {-2, -1, 0, 1, 2}, t = 0 .. N-1, the harmonics
    b_k = 2/N sum u_t sin(2 pi k t / N) and a_k, with cosines, are b_1 = 1.5 and zero for a_1 and k = 3, 5, 7; the mean
    of u_t^2 is least. Samples may be shared between levels: no more than 8 need be, the number of equations. With a
    tolerance, every sample takes one level, and |a_1|, |b_1 - 1.5| and |a_k + i b_k| may be as large as it.

    Optimal pulse pattern ("opp"): u(theta) in {-1, -1/2, 0, 1/2, 1} with quarter-wave symmetry and u(0) = 0 changes by
    one level at no more than k free angles of a period. With dI/dtheta = u, b_1 = M and |b_3| <= 0.01, the cost is the
    square of the total demand distortion, 1/pi times the integral of I^2, less M^2: the sum of (b_k / k)^2 over k >= 3.

    Parameters
    ----------
    kind : str
        "shep" or "opp".
    samples : int
        "shep": N, at least 16, of one period.
    tolerance : float or None
        "shep": of every harmonic, in the unit of the levels, with whole samples at levels; None: exact, with duty
        cycles.
    modulation : float
        "opp": M, above 0 and up to 4/pi.
    switches : int
        "opp": k, a multiple of 4.

    Returns
    -------
    OptimalControlProblem
        "shep": with a_1 and b_1 of the samples so far as states. "opp": a ``PulseTrain`` of k/4 + 1 dwells.

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Miller, Karamanakos and Geyer, arXiv 2512.07585 and 2512.08201, have optimal pulse patterns with bounds.
    docs/levels.md has the relaxations, what is proven of them, and figures.

    Examples
    --------
    >>> round(lfo.solve(lfo.library.pulse_pattern(kind="shep", samples=128)).cost, 8)
    1.25898269
    >>> round(lfo.solve(lfo.library.pulse_pattern(kind="opp", modulation=0.9, switches=8)).cost ** 0.5, 6)
    0.042203
    """
    if kind == "shep":
        return _elimination(samples, tolerance)
    if kind == "opp":
        return _optimal_pattern(modulation, switches)
    raise ProblemError("kind", brief(kind), "'shep' or 'opp'", suggestion(kind, ["shep", "opp"]))


def _elimination(samples: int, tolerance: float | None) -> OptimalControlProblem:
    N = positive_integer("samples", samples)
    if N < 2 * max(REMOVED) + 2:
        raise ProblemError("samples", str(N), "at least 16: the seventh harmonic is removed")
    wide = 0.0 if tolerance is None else positive_number("tolerance", tolerance)
    target = np.array([0.0, FUNDAMENTAL])
    band = stop_band(bins=list(REMOVED))
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            np.eye(2),
            _fundamental(N),
            state_names=["cosine of the fundamental", "sine of the fundamental"],
            control_names=["level"],
        ),
        horizon=N,
        cost=QuadraticCost(),
        control_set=FiniteSet(LEVELS, costs=np.square(LEVELS) / N, duty_cycles=tolerance is None),
        initial_state=np.zeros(2),
        terminal_state=Box(target - wide, target + wide),
        control_spectrum=band if tolerance is None else MagnitudeBound(wide * N / 2, band=band),
        name="pulse_pattern",
    )


def _optimal_pattern(modulation: float, switches: int) -> OptimalControlProblem:
    M, k = positive_number("modulation", modulation), positive_integer("switches", switches)
    if M > 4 / np.pi:
        raise ProblemError("modulation", brief(modulation), "at most 4/pi, the fundamental of a square wave")
    if k % 4:
        raise ProblemError("switches", str(k), "a multiple of 4", "Each of a quarter period happens four times.")
    dynamics = PulseTrain(STEP, orders=(1, 3))
    energy = -(M**2)  # with what the trajectory adds, the square of the distortion at the end
    return OptimalControlProblem(
        dynamics=dynamics,
        horizon=k // 4 + 1,
        cost=QuadraticCost(p=[0, 0, 0, 1, 0, 0]),
        control_set=Box([0, -1], [QUARTER, 1]),
        state_set=Box([0, -1, -QUARTER, energy, -2, -2], [QUARTER, 1, QUARTER, 4, 2, 2]),
        initial_state=Box([0, 0, -QUARTER, energy, 0, 0], [0, 0, QUARTER, energy, 0, 0]),
        terminal_state=Box([QUARTER, -1, 0, energy, M, -THIRD], [QUARTER, 1, 0, 4, M, THIRD]),
        name="pulse_pattern",
    )


def _fundamental(samples: int) -> Array:
    """Return B_t, (N, 2, 1): what a unit of u_t adds to a_1 and b_1."""
    angle = 2 * np.pi * np.arange(samples) / samples
    return 2 / samples * np.stack([np.cos(angle), np.sin(angle)], axis=1)[..., None]
