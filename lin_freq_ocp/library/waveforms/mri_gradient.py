"""Gradient waveforms of magnetic resonance imaging: shortest pulses with prescribed moments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief, positive_integer, positive_number, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import notch
from lin_freq_ocp.problem.spectrum.bounds import MagnitudeBound
from lin_freq_ocp.problem.terms.stage_rows import StageRows

MS_PER_S = 1e3
BAND_LEVEL = 145.17  # mT/m: 5 % of the largest |V| of the default pulse without bands, 2903.35 mT/m at 632 Hz


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
) -> OptimalControlProblem:
    """Shape a gradient pulse with given moments: minimum time, forbidden bands of acoustic resonances.

    Minimise 1/2 sum of g_t^2 over the samples g_0 .. g_{T-1} of a gradient with g_0 = g_{T-1} = 0, |g_t| <= amplitude
    and |g_t - g_{t-1}| <= slew_rate * raster. Sample t stands at the time t * raster, and the moment of order k is
    sum_t g_t (t raster)^k raster: a plain sum, a state with A = I, so that a waveform with zeros appended has the same
    moments. The horizon is the number of samples, both zeros counted: with the defaults (a bipolar pulse for flow
    encoding, 1.32 ms) 132 samples are feasible and 131 are not; that is so, too, with moments about the centres of
    samples. A prephaser is ``zeroth_moment=11.0, first_moment=None``, or with further moments of zero.

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

    Returns
    -------
    OptimalControlProblem
        With the moments and the sample before, g_{t-1}, as states.

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Loecher, Middione and Ennis, "A gradient optimization toolbox for general purpose time-optimal MRI gradient
    waveform design", Magnetic Resonance in Medicine 84(6), 2020: GrOpt, whose flow-encoding pulse is the default.

    Examples
    --------
    >>> lfo.minimum_time(lfo.library.mri_gradient, horizons=(120, 140)).horizon
    132
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
    before = np.append(np.zeros(len(moments)), 1.0)
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            np.diag(1.0 - before),
            _gains([k for k, _, _ in moments], T, step),
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
        control_spectrum=_masks(forbidden_bands_hz, positive_number("band_level", band_level)),
        stage_rows=StageRows(np.stack([-before, before]), [[1.0], [-1.0]], [change, change], name="slew rate"),
        name="mri_gradient",
    )


def _number(parameter: str, given: float) -> float:
    value = real_array(parameter, given)
    if value.ndim:
        raise ProblemError(parameter, brief(given), "one number")
    return float(value)


def _gains(orders: Sequence[int], horizon: int, step: float) -> Array:
    """Return B_t, (T, n, 1): what a unit of g_t adds to each moment, and to the sample before of the next step."""
    times = step * np.arange(horizon)
    gains = np.ones((horizon, len(orders) + 1, 1))
    for i, k in enumerate(orders):
        gains[:, i, 0] = step * times**k
    return gains


def _masks(bands: Sequence[Sequence[float]] | None, level: float) -> list[MagnitudeBound] | None:
    if bands is None:
        return None
    edges = real_array("forbidden_bands_hz", bands)
    if edges.ndim != 2 or edges.shape[1] != 2 or (edges[:, 0] >= edges[:, 1]).any() or (edges < 0).any():
        raise ProblemError("forbidden_bands_hz", brief(bands), "pairs (low, high) in Hz, 0 <= low < high")
    return [
        MagnitudeBound(level, band=notch(centre_hz=(low + high) / 2, width_hz=high - low), every_frequency=True)
        for low, high in edges.tolist()
    ] or None
