"""A wave-energy converter, known by boundary-element coefficients per frequency: power is what the control absorbs."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask, brief, positive_integer, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.library.common import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.response.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import stop_band

RADII, HEIGHTS = (0.88, 0.35), (0.17, 0.20)  # m: a cylinder in the water, and the cone frustum below it
DENSITY, GRAVITY = 1025.0, 9.81  # kg/m^3, m/s^2
FRUSTUM = HEIGHTS[1] / 3 * (RADII[0] ** 2 + RADII[0] * RADII[1] + RADII[1] ** 2)  # m^3 over pi
MASS = DENSITY * np.pi * (RADII[0] ** 2 * HEIGHTS[0] + FRUSTUM)  # kg: what the hull displaces
STIFFNESS = DENSITY * GRAVITY * np.pi * RADII[0] ** 2  # N/m
RESOLUTION = 1e-9  # in bins: how far the wave may be from a harmonic of the record


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Of the converter at frequencies (k,): 1/Z in m/s/N, excitation in N/m, and where they are known (else zero)."""

    admittance: ComplexArray
    excitation: ComplexArray
    valid: Mask


def coefficients_at(frequencies: Array, least_damping: float) -> Coefficients:
    """Return the coefficients at frequencies in Hz, linear between those of the file; infinite ones are not known."""
    text = files("lin_freq_ocp.library.waveforms").joinpath("wavebot.csv").read_text("utf-8")
    table = np.loadtxt(text.splitlines(), delimiter=",", skiprows=4)
    w, known = 2 * np.pi * frequencies, table[:, 0]
    step = known[1] - known[0]
    valid = (w >= known[0] - RESOLUTION * step) & (w <= known[-1] + RESOLUTION * step)
    A, B, real, imaginary = (np.interp(w, known, column) for column in table[:, 1:].T)
    w = np.where(valid, w, 1.0)
    Z = 1j * w * (MASS + A) + np.maximum(B, positive_number("least_damping", least_damping)) + STIFFNESS / (1j * w)
    return Coefficients(np.where(valid, 1 / Z, 0.0), np.where(valid, real + 1j * imaginary, 0.0), valid)


def wave_energy(
    force: float | None = 2000.0,
    wave_frequency: float = 0.3,
    amplitude: float = 0.0625,
    record: float = 20.0,
    horizon: int = 400,
    least_damping: float = 45.0,
) -> OptimalControlProblem:
    """Absorb the most power from a wave, with a plant known by its frequency response only.

    The heave velocity v (state, m/s) of a WaveBot under the force u (control, N) of its power take-off and the force F
    of a regular wave, at every frequency

        Z v = F + u,    Z = i w (m + A) + B + k / (i w),

    with the mass m and stiffness k of the hull, and added mass A, radiation damping B and F from boundary elements. The
    record is one period. The cost is the mean power (1/T) sum v_t u_t that the force gives to the water, in W, so that
    minus the cost is what is absorbed. The control has the harmonics of the record that have coefficients, 0.05 to
    2.5 Hz; between these, A, B and F are interpolated linearly.

    Parameters
    ----------
    force : float or None
        Bound on |u_t| at the samples in N; None: no bound.
    wave_frequency : float
        In Hz; a multiple of 1/record.
    amplitude : float
        Of the wave, in m.
    record : float
        Length in s.
    horizon : int
        Samples of the record.
    least_damping : float
        Smallest B in N s/m: computed values below zero would make the power unbounded.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    WecOptTool (Sandia National Laboratories): the converter, its mesh and its coefficients. Bacelli and Coe, "Comments
    on control of wave energy converters", IEEE Transactions on Control Systems Technology 29(1), 2021: impedances.
    Without a bound, the most is |F|^2 / (8 Re Z), 140.007195 W with the defaults; 98.11269 W within 2000 N.

    Examples
    --------
    >>> round(-lfo.solve(lfo.library.wave_energy(force=None)).cost, 5)
    140.0072
    """
    T, length = positive_integer("horizon", horizon), positive_number("record", record)
    frequencies = np.arange(T // 2 + 1) / length
    known = coefficients_at(np.where(2 * np.arange(T // 2 + 1) < T, frequencies, np.inf), least_damping)
    wave = positive_number("wave_frequency", wave_frequency) * length
    k = round(wave)
    if abs(wave - k) > RESOLUTION or k >= T / 2 or not known.valid[k]:
        expected = f"a multiple of 1/record = {1 / length:g} Hz from 0.05 to 2.5 Hz, below T/(2 record)"
        raise ProblemError("wave_frequency", brief(wave_frequency), expected)
    offset = np.zeros(len(frequencies), dtype=complex)
    offset[k] = positive_number("amplitude", amplitude) * known.excitation[k] * known.admittance[k] * T / 2
    dynamics = FrequencyResponse(
        known.admittance,
        sampling_time=length / T,
        offset=offset,
        state_names=["velocity [m/s]"],
        control_names=["force [N]"],
    )
    return OptimalControlProblem(
        dynamics,
        T,
        QuadraticCost(S=[[1.0 / T]]),
        control_set=symmetric("force", force),
        control_spectrum=stop_band(bins=np.flatnonzero(~known.valid).tolist()),
        name="wave energy",
    )
