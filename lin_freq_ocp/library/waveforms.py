"""Waveforms whose moments or spectra are prescribed, and one that a plant known by its frequency response absorbs.

Gradient pulses of magnetic resonance imaging, the move of a printer's axis that leaves a resonance nearly still, and a
wave-energy converter, known by boundary-element coefficients per frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask, brief, positive_integer, positive_number, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.library.common import sampled_plant, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import notch, stop_band
from lin_freq_ocp.problem.spectrum.bounds import MagnitudeBound
from lin_freq_ocp.problem.spectrum.residual_vibration import ResidualVibration

MS_PER_S = 1e3
BAND_LEVEL = 145.17  # mT/m: 5 % of the largest |V| of the default pulse without bands, 2903.35 mT/m at 632 Hz


@dataclass(frozen=True)
class StimulatedAxis:
    """The numbers of the SAFE model of nerve stimulation for one axis of a scanner.

    Parameters
    ----------
    time_constants, weights : (float, float, float)
        tau_1, tau_2, tau_3 in ms, and c_1, c_2, c_3, of the filters of the slew, its magnitude, and the slew again.
    limit : float
        The stimulation that counts as 1, in T/m/s.
    scale : float
        Of the stimulation.

    Raises
    ------
    ProblemError
        If a time constant, the limit or the scale is not above zero, or a weight is below zero.

    Examples
    --------
    >>> lfo.library.StimulatedAxis((1.5, 2.5, 0.15), (0.55, 0.15, 0.3), limit=15.0, scale=0.31).limit
    15.0
    """

    time_constants: tuple[float, float, float]
    weights: tuple[float, float, float]
    limit: float
    scale: float

    def __post_init__(self) -> None:
        for name, values in (("time_constants", self.time_constants), ("weights", self.weights)):
            given = real_array(name, values)
            if given.shape != (3,) or (given < 0).any() or (name == "time_constants" and not given.all()):
                least = "above zero" if name == "time_constants" else "zero or above"
                raise ProblemError(name, brief(values), f"three numbers, {least}")
        positive_number("limit", self.limit)
        positive_number("scale", self.scale)


EXAMPLE_AXES = {  # safe_example_hw_peripheral.m
    "x": StimulatedAxis((0.2, 0.03, 3.0), (0.4, 0.1, 0.5), 30.0, 0.35),
    "y": StimulatedAxis((1.5, 2.5, 0.15), (0.55, 0.15, 0.3), 15.0, 0.31),
    "z": StimulatedAxis((2.0, 0.12, 1.0), (0.42, 0.4, 0.18), 25.0, 0.25),
}


def mri_gradient(
    horizon: int = 132,
    zeroth_moment: float | None = 0.0,
    first_moment: float | None = 11.74,
    second_moment: float | None = None,
    moment_tolerance: float = 1e-3,
    amplitude: float = 40.0,
    slew_rate: float = 200.0,
    raster: float = 0.01,
    forbidden_bands_hz: Sequence[Sequence[float]] | None = None,
    band_level: float = BAND_LEVEL,
    stimulation: float | None = None,
    hardware: str | StimulatedAxis = "y",
) -> OptimalControlProblem:
    """Shape a gradient pulse with given moments: minimum time, forbidden bands, limited stimulation of nerves.

    Minimise 1/2 sum of g_t^2 over the samples g_0 .. g_{T-1} of a gradient with g_0 = g_{T-1} = 0, |g_t| <= amplitude
    and |g_t - g_{t-1}| <= slew_rate * raster. Sample t is at the time t * raster, and the moment of order k is
    sum_t g_t (t raster)^k raster: a plain sum, a state with A = I, so that a waveform with zeros appended has the same
    moments. The horizon is the number of samples, both zeros counted: with the defaults (a bipolar pulse for flow
    encoding, 1.32 ms) 132 samples are feasible and 131 are not; that is so, too, with moments about the centres of
    samples. A prephaser is ``zeroth_moment=11.0, first_moment=None``, or with further moments of zero.

    With ``stimulation``, the SAFE model limits what nerves feel of the slew s_t = (g_t - g_{t-1}) / raster. Three
    low-pass filters w+ = w + a (input - w), a = raster / (tau + raster), have the inputs s, |s| and s, and
    (c_1 |w_1| + c_2 w_2 + c_3 |w_3|) scale / limit <= stimulation after every sample. A second control v >= |s| stands
    for |s|: a larger v only adds stimulation, and so the least horizon is the same.

    Parameters
    ----------
    horizon : int
        T, the number of samples; at least 2.
    zeroth_moment, first_moment, second_moment : float or None
        In mT/m ms, mT/m ms^2 and mT/m ms^3; None: free.
    moment_tolerance : float
        Of each moment, in its unit.
    amplitude : float
        In mT/m.
    slew_rate : float
        In mT/m/ms, which is T/m/s.
    raster : float
        Time of a sample in ms.
    forbidden_bands_hz : sequence of (low, high), or None
        Bands in which |sum_t g_t exp(-iwt)| <= band_level at every frequency, as (560, 620), (960, 1310), (1860, 1950).
    band_level : float
        In mT/m. Default: 5 % of the largest |sum_t g_t exp(-iwt)| of the default pulse without bands.
    stimulation : float or None
        The largest stimulation, as a share of the one that the hardware's limit stands for; None: free.
    hardware : str or StimulatedAxis
        The numbers of the SAFE model; "x", "y" or "z": an axis of the published example, which is no real scanner.

    Returns
    -------
    OptimalControlProblem
        With the moments, the sample before, g_{t-1}, and with ``stimulation`` w_1, w_2, w_3 as states.

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Loecher, Middione and Ennis, "A gradient optimization toolbox for general purpose time-optimal MRI gradient
    waveform design", Magnetic Resonance in Medicine 84(6), 2020: GrOpt, whose flow-encoding pulse is the default.
    Hebrank and Gebhardt, "SAFE model: a new method for predicting peripheral nerve stimulations in MRI", Proceedings of
    the ISMRM 8, 2000.

    Examples
    --------
    >>> lfo.minimum_time(lfo.library.mri_gradient, horizons=(120, 140)).horizon
    132
    >>> felt = lambda horizon: lfo.library.mri_gradient(horizon, stimulation=1.0)
    >>> lfo.minimum_time(felt, horizons=(120, 140)).horizon
    135
    """
    T = positive_integer("horizon", horizon)
    if T < 2:
        raise ProblemError("horizon", str(T), "at least 2 samples: the first and the last are zero")
    step, limit = positive_number("raster", raster), positive_number("amplitude", amplitude)
    tolerance = _number("moment_tolerance", moment_tolerance)
    if tolerance < 0:
        raise ProblemError("moment_tolerance", brief(moment_tolerance), "a number, zero or above")
    given = {"zeroth": zeroth_moment, "first": first_moment, "second": second_moment}
    moments = [
        (k, name, _number(f"{name}_moment", value))
        for k, (name, value) in enumerate(given.items())
        if value is not None
    ]
    values = np.array([value for _, _, value in moments])
    change, bound = positive_number("slew_rate", slew_rate) * step, np.full((T, 1), limit)
    bound[0] = 0.0
    before, gains = np.append(np.zeros(len(moments)), 1.0), np.ones((T, len(moments) + 1, 1))
    for i, (k, _, _) in enumerate(moments):  # the sum that g_t adds to each moment, per unit
        gains[:, i, 0] = step * (step * np.arange(T)) ** k
    level = positive_number("band_level", band_level)
    edges = np.zeros((0, 2)) if forbidden_bands_hz is None else real_array("forbidden_bands_hz", forbidden_bands_hz)
    if edges.ndim != 2 or edges.shape[1] != 2 or (edges[:, 0] >= edges[:, 1]).any() or (edges < 0).any():
        raise ProblemError("forbidden_bands_hz", brief(forbidden_bands_hz), "pairs (low, high) in Hz, 0 <= low < high")
    pulse = OptimalControlProblem(
        dynamics=LinearDynamics(
            np.diag(1.0 - before),
            gains,
            sampling_time=step / MS_PER_S,
            state_names=[f"{name} moment [mT/m ms{f'^{k + 1}' if k else ''}]" for k, name, _ in moments]
            + ["gradient before [mT/m]"],
            control_names=["gradient [mT/m]"],
        ),
        horizon=T,
        cost=QuadraticCost(R=1.0),
        control_set=Box(-bound, bound),
        initial_state=np.zeros(len(before)),
        terminal_state=Box(np.append(values - tolerance, 0.0), np.append(values + tolerance, 0.0)),
        control_spectrum=[
            MagnitudeBound(
                level, band=notch(centre_hz=(low + high) / 2, width_hz=high - low), every_frequency=True, component=0
            )
            for low, high in edges.tolist()
        ]
        or None,
        stage_rows=StageRows(np.stack([-before, before]), [[1.0], [-1.0]], [change, change], name="slew rate"),
        name="mri_gradient",
    )
    return pulse if stimulation is None else _limit_stimulation(pulse, stimulation, hardware, step, change / step)


def _limit_stimulation(
    pulse: OptimalControlProblem, stimulation: float, hardware: str | StimulatedAxis, step: float, slew: float
) -> OptimalControlProblem:
    """Return the pulse with the filters of the SAFE model; the last of its states is the sample before."""
    share = positive_number("stimulation", stimulation)
    axis = EXAMPLE_AXES.get(hardware) if isinstance(hardware, str) else hardware
    if not isinstance(axis, StimulatedAxis):
        raise ProblemError("hardware", brief(hardware), f"a StimulatedAxis, or one of {', '.join(EXAMPLE_AXES)}")
    dynamics, T, n, tube, end = pulse.linear, pulse.horizon, pulse.state_dim, pulse.control_tube, pulse.terminal_box
    a = step / (np.array(axis.time_constants) + step)
    A, B = np.pad(dynamics.A, (0, 3)), np.pad(dynamics.B, ((0, 0), (0, 3), (0, 1)))
    A[n:, n:], A[[n, n + 2], n - 1] = np.diag(1.0 - a), -a[::2] / step
    B[:, [n, n + 2], 0], B[:, n + 1, 1] = a[::2] / step, a[1]
    before = np.eye(n + 3)[n - 1] / step
    signs = np.array([(first, 1.0, last) for first in (1.0, -1.0) for last in (1.0, -1.0)])
    felt = signs * np.array(axis.weights) * axis.scale / axis.limit
    # a filter of a slew within the slew rate stays within it: these bounds limit nothing, and make proofs short
    low, high, free = np.array([-slew, 0.0, -slew]), np.full(3, slew), np.full(n, np.inf)
    return replace(
        pulse,
        dynamics=LinearDynamics(
            A,
            B,
            sampling_time=dynamics.sampling_time,
            state_names=[
                *pulse.state_names,
                *(f"filtered {kind} [T/m/s]" for kind in ("slew 1", "|slew| 2", "slew 3")),
            ],
            control_names=[*pulse.control_names, "|slew| [T/m/s]"],
        ),
        cost=QuadraticCost(R=np.diag([1.0, 0.0])),
        control_set=Box(np.hstack([tube.lower, np.zeros((T, 1))]), np.hstack([tube.upper, np.full((T, 1), slew)])),
        state_set=Box(np.append(-free, low), np.append(free, high)),
        initial_state=np.zeros(n + 3),
        terminal_state=Box(np.append(end.lower, low), np.append(end.upper, high)),
        stage_rows=[
            StageRows(
                np.stack([-before, before]), [[1 / step, -1.0], [-1 / step, -1.0]], np.zeros(2), name="slew rate"
            ),
            StageRows(felt @ A[n:], felt @ B[0, n:], np.full(4, share), name="stimulation"),
        ],
    )


def _number(parameter: str, given: float) -> float:
    value = real_array(parameter, given)
    if value.ndim:
        raise ProblemError(parameter, brief(given), "one number")
    return float(value)


def printer_move(
    horizon: int = 22,
    sampling_time: float = 0.005,
    distance: float = 0.02,
    speed_bound: float | None = 0.5,
    acceleration_bound: float | None = 10.0,
    resonance_hz: float = 20.0,
    uncertainty: float = 0.1,
    damping: Sequence[float] = (0.02, 0.1),
    vibration_bound: float | None = 0.5,
) -> OptimalControlProblem:
    """Move an axis from rest to rest, with little vibration of a resonance that is known to 10 %.

    Minimise 1/2 sum of a_t^2 over the accelerations of a position and a speed, held between the samples. What rings
    after the move is a mode q'' + 2 zeta w q' + w^2 q = w^2 a of the frame: its amplitude is bounded for every w and
    zeta of a box. With the defaults 22 samples (0.11 s) are feasible and 21 are not; without the bound on the vibration
    18 are. ``lfo.compare`` compares the move with input shapers of the same robustness.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    distance : float
        Of the move in m.
    speed_bound, acceleration_bound : float or None
        Symmetric bounds on the speed [m/s] and the acceleration [m/s^2].
    resonance_hz : float
        Nominal natural frequency w / (2 pi) in Hz.
    uncertainty : float
        From 0 to below 1: the natural frequency lies within resonance_hz * (1 - uncertainty .. 1 + uncertainty).
    damping : (lowest, highest)
        Damping ratios, from 0 to below 1.
    vibration_bound : float or None
        Largest amplitude of q after the move, in m/s^2: a constant acceleration a moves q by a. Default: 5 % of the
        bound on the acceleration. None: no bound.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Singer and Seering, "Preshaping command inputs to reduce system vibration", Journal of Dynamic Systems, Measurement,
    and Control 112, 1990. The numbers are chosen here, of the size of those of desktop 3D printers.

    Examples
    --------
    >>> lfo.minimum_time(lfo.library.printer_move, horizons=(18, 26)).horizon
    22
    """
    centre, spread = positive_number("resonance_hz", resonance_hz), real_array("uncertainty", uncertainty)
    if spread.ndim or not 0 <= spread < 1:
        raise ProblemError("uncertainty", brief(uncertainty), "a number from 0 to below 1")
    frequency = [centre * (1 - float(spread)), centre * (1 + float(spread))]
    return OptimalControlProblem(
        dynamics=sampled_plant(
            [[0, 1], [0, 0]], [[0], [1]], sampling_time, "position [m], speed [m/s]", "acceleration [m/s^2]"
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("acceleration_bound", acceleration_bound),
        state_set=symmetric("speed_bound", [None, speed_bound]),
        initial_state=[0.0, 0.0],
        terminal_state=[positive_number("distance", distance), 0.0],
        control_spectrum=None if vibration_bound is None else ResidualVibration(frequency, damping, vibration_bound),
        name="printer_move",
    )


RADII, HEIGHTS = (0.88, 0.35), (0.17, 0.20)  # m: a cylinder in the water, and the cone frustum below it
DENSITY, GRAVITY = 1025.0, 9.81  # kg/m^3, m/s^2
FRUSTUM = HEIGHTS[1] / 3 * (RADII[0] ** 2 + RADII[0] * RADII[1] + RADII[1] ** 2)  # m^3 over pi
MASS = DENSITY * np.pi * (RADII[0] ** 2 * HEIGHTS[0] + FRUSTUM)  # kg: of the displaced water
STIFFNESS = DENSITY * GRAVITY * np.pi * RADII[0] ** 2  # N/m
RESOLUTION = 1e-9  # in bins: how far the wave may be from a harmonic of the record


def wave_energy(
    force: float | None = 2000.0,
    wave_frequency: float = 0.3,
    amplitude: float = 0.0625,
    record: float = 20.0,
    horizon: int = 400,
    least_damping: float = 45.0,
    stroke: float | None = None,
) -> OptimalControlProblem:
    """Absorb the most power from a wave, with a plant known by its frequency response only.

    The heave velocity v (state, m/s) of a WaveBot under the force u (control, N) of its power take-off and the force F
    of a regular wave, at every frequency

        Z v = F + u,    Z = i w (m + A) + B + k / (i w),

    with the mass m and stiffness k of the hull, and added mass A, radiation damping B and F from boundary elements. The
    record is one period. The cost is the mean power (1/T) sum v_t u_t that the force gives to the water, in W, so that
    minus the cost is the absorbed power. The control has the harmonics of the record that have coefficients, 0.05 to
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
    stroke : float or None
        Bound on the position of the hull in m, which is then a second output; None: no bound and no such output.

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
    names, to_outputs = ["velocity [m/s]"], np.ones((len(frequencies), 1), dtype=complex)
    if stroke is not None:
        names = [*names, "position [m]"]
        integral = np.where(known.valid, 1.0 / (2j * np.pi * np.where(known.valid, frequencies, 1.0)), 0.0)
        to_outputs = np.column_stack([to_outputs, integral])
    dynamics = FrequencyResponse(
        (known.admittance[:, None] * to_outputs)[:, :, None],
        sampling_time=length / T,
        offset=offset[:, None] * to_outputs,
        state_names=names,
        control_names=["force [N]"],
    )
    bound = None if stroke is None else positive_number("stroke", stroke)
    return OptimalControlProblem(
        dynamics,
        T,
        QuadraticCost(S=np.eye(len(names), 1) / T),
        control_set=symmetric("force", force),
        state_set=None if bound is None else Box([None, -bound], [None, bound]),
        control_spectrum=stop_band(bins=np.flatnonzero(~known.valid).tolist()),
        name="wave energy",
    )


@dataclass(frozen=True, eq=False)
class ConverterCoefficients:
    """Of the converter at frequencies (k,): 1/Z in m/s/N, excitation in N/m, and where they are known (else zero)."""

    admittance: ComplexArray
    excitation: ComplexArray
    valid: Mask


def coefficients_at(frequencies: Array, least_damping: float) -> ConverterCoefficients:
    """Return the coefficients at frequencies in Hz, linear between those of the file; infinite ones are not known."""
    text = files("lin_freq_ocp.library").joinpath("wavebot.csv").read_text("utf-8")
    table = np.loadtxt(text.splitlines(), delimiter=",", skiprows=4)
    w, known = 2 * np.pi * frequencies, table[:, 0]
    step = known[1] - known[0]
    valid = (w >= known[0] - RESOLUTION * step) & (w <= known[-1] + RESOLUTION * step)
    A, B, real, imaginary = (np.interp(w, known, column) for column in table[:, 1:].T)
    w = np.where(valid, w, 1.0)
    Z = 1j * w * (MASS + A) + np.maximum(B, positive_number("least_damping", least_damping)) + STIFFNESS / (1j * w)
    return ConverterCoefficients(np.where(valid, 1 / Z, 0.0), np.where(valid, real + 1j * imaginary, 0.0), valid)
