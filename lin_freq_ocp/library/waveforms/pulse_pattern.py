"""Pulse patterns of multilevel inverters: harmonics removed with few levels, and least distortion with few switches."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array, brief, positive_integer, positive_number
from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.finite import FiniteSet
from lin_freq_ocp.problem.spectrum.bands import stop_band
from lin_freq_ocp.problem.spectrum.bounds import MagnitudeBound

LEVELS = (-2.0, -1.0, 0.0, 1.0, 2.0)
FUNDAMENTAL = 1.5  # amplitude of the first harmonic
REMOVED = (3, 5, 7)


def pulse_pattern(kind: str = "shep", samples: int = 128, tolerance: float | None = None) -> OptimalControlProblem:
    """Switch an inverter between five levels: a fundamental of 1.5, harmonics 3, 5 and 7 removed.

    Selective harmonic elimination: of u_t in {-2, -1, 0, 1, 2}, t = 0 .. N-1, the harmonics
    b_k = 2/N sum u_t sin(2 pi k t / N) and a_k, with cosines, are b_1 = 1.5 and zero for a_1 and k = 3, 5, 7; the mean
    of u_t^2 is least. Samples may be shared between levels: no more than 8 need be, the number of equations. With a
    tolerance, every sample takes one level, and a_1 and b_1 - 1.5 and |a_k + i b_k| may be as large as it.

    Parameters
    ----------
    kind : str
        "shep": selective harmonic elimination.
    samples : int
        N, at least 16, of one period.
    tolerance : float or None
        Of every harmonic, in the unit of the levels, with whole samples at levels; None: exact, with duty cycles.

    Returns
    -------
    OptimalControlProblem
        With a_1 and b_1 of the samples so far as states.

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    docs/levels.md has the relaxation, what is proven of it, and figures.

    Examples
    --------
    >>> round(lfo.solve(lfo.library.pulse_pattern(kind="shep", samples=128)).cost, 8)
    1.25898269
    """
    if kind != "shep":
        raise ProblemError("kind", brief(kind), "'shep'", suggestion(kind, ["shep"]))
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


def _fundamental(samples: int) -> Array:
    """Return B_t, (N, 2, 1): what a unit of u_t adds to a_1 and b_1."""
    angle = 2 * np.pi * np.arange(samples) / samples
    return 2 / samples * np.stack([np.cos(angle), np.sin(angle)], axis=1)[..., None]
