"""Plants known by their frequency response: y_k = G_k u_k + g_k at every bin of the DFT.

The states of such a problem are the outputs: x_t = y_t for t = 0 .. T, with eta_t the multiplier of x_{t+1} = y_{t+1}.
A periodic record has x_T = x_0; a zero-padded one has an equation for the first output. Measured responses are tables
of frequency, real and imaginary part, interpolated at the bins of a record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    ComplexArray,
    assign,
    brief,
    complex_array,
    positive_integer,
    positive_number,
    real_array,
    with_columns,
)
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import first_few, plural
from lin_freq_ocp.problem.dynamics.base import Dynamics, StateEquations, Step, signal_labels
from lin_freq_ocp.problem.dynamics.measured import read_response
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.sets.linked_ends import Periodic
from lin_freq_ocp.problem.terms.maps import StageMap, SumMap
from lin_freq_ocp.problem.terms.penalties import Within
from lin_freq_ocp.problem.terms.term import Link

MODES = ("periodic", "zero-padded")
REAL_TOLERANCE = 1e-12  # of the largest response: an imaginary part at bins 0 and N/2 that is rounding


@dataclass(frozen=True, eq=False, init=False)
class FrequencyResponse(StateEquations):
    """Outputs y = irfft(G_k u_k + g_k) + d of all controls at once: measured plants, boundary-element data.

    The states of the problem are the outputs: x_t = y_t at t = 0 .. T. Costs, sets, stage rows and frequency
    constraints apply to them and to the controls.

    Parameters
    ----------
    G : complex (N//2 + 1, p, m), or (N//2 + 1,) for one output and one control
        The response at the frequencies 2 pi k / N rad/sample, k = 0 .. N/2, of exp(+iwt); real at 0 and N/2.
    sampling_time : float, optional
        Seconds per step. Needed wherever a frequency is given in Hz.
    offset : complex (N//2 + 1, p), or (N//2 + 1,) for one output, optional
        DFT of outputs without controls, in the units of numpy.fft.rfft: a sine of amplitude a has |g_k| = a N / 2.
    disturbance : (T, p), zero-padded (T+1, p), optional
        Outputs without controls, as a signal in time; added to ``offset``.
    mode : {"periodic", "zero-padded"}
        Periodic: N = T, the record is one period, and x_T = x_0. Zero-padded: N = 2T, the plant is at rest before the
        record, the controls are zero after it, and x_0 .. x_T are the outputs of t = 0 .. T.
    state_names, control_names : sequences of str, optional
        One name per output and control, with its unit in brackets: ``"velocity [m/s]"``.

    Raises
    ------
    ProblemError
        If shapes do not match, entries are not finite, or the response is not real at 0 or N/2.

    Methods
    -------
    from_table(table, samples, sampling_time)
        Interpolate a table of frequency, real and imaginary part.
    from_csv(path, samples, sampling_time)
        Interpolate such a table from a CSV file.
    from_frd(plant, samples)
        Interpolate a frequency response of python-control.

    References
    ----------
    docs/frequency_response.md: the conditions of the maximum principle, the bound, and the convexity of costs.

    Examples
    --------
    >>> dynamics = lfo.FrequencyResponse([1.0, 0.5 - 0.5j, 0.0])  # a period of 4 samples
    >>> problem = lfo.OptimalControlProblem(dynamics, 4, lfo.QuadraticCost(Q=1.0, R=1.0, x_ref=[2.0]))
    >>> round(float(lfo.solve(problem).trajectory.x[3, 0]), 9)
    1.0
    """

    G: ComplexArray
    sampling_time: float | None
    offset: ComplexArray
    disturbance: Array | None
    mode: str
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    _cached_response: ClassVar[Response | None] = None  # of the last horizon

    def __init__(
        self,
        G: ArrayLike,
        sampling_time: float | None = None,
        offset: ArrayLike | None = None,
        disturbance: ArrayLike | None = None,
        mode: str = "periodic",
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ):
        response = complex_array("dynamics.G", G)
        response = response[:, None, None] if response.ndim == 1 else response
        if response.ndim != 3 or len(response) < 2 or 0 in response.shape:
            expected = "(N//2 + 1, p, m), or (N//2 + 1,) for one output and one control: bins first"
            raise ProblemError("dynamics.G", f"shape {np.shape(G)}", expected)
        if mode not in MODES:
            raise ProblemError("dynamics.mode", brief(mode), "'periodic' or 'zero-padded'")
        bins, p, m = response.shape
        known = complex_array("dynamics.offset", np.zeros((bins, p)) if offset is None else offset)
        known = known[:, None] if known.ndim == 1 and p == 1 else known
        if known.shape != (bins, p):
            raise ProblemError("dynamics.offset", f"shape {known.shape}", f"shape {(bins, p)}, a spectrum as long as G")
        signal = None if disturbance is None else real_array("dynamics.disturbance", disturbance)
        signal = signal[:, None] if signal is not None and signal.ndim == 1 and p == 1 else signal
        if signal is not None and (signal.ndim != 2 or signal.shape[1] != p):
            raise ProblemError("dynamics.disturbance", f"shape {signal.shape}", f"shape (T, {p}): time is axis 0")
        _require_real("dynamics.G", response, 0)
        _require_real("dynamics.offset", known, 0)
        labels = signal_labels(p, m, sampling_time, state_names, control_names)
        assign(self, G=response, offset=known, disturbance=signal, mode=mode, **labels)

    @classmethod
    def from_table(
        cls,
        table: ArrayLike,
        samples: int,
        sampling_time: float,
        outside: str = "refuse",
        disturbance: ArrayLike | None = None,
        mode: str = "periodic",
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> FrequencyResponse:
        """Interpolate a table of one output and one control at the bins of a record.

        Parameters
        ----------
        table : (k, 3) or (k, 4)
            Increasing frequency in Hz, real part, imaginary part; a coherence is for ``Discs.from_table``. Between
            frequencies, both parts are linear. At the Nyquist frequency only the real part counts; at 0 the response
            must be real.
        samples : int
            N, the samples of the record: the horizon, or twice the horizon if zero-padded.
        sampling_time : float
            Seconds per step.
        outside : {"refuse", "zero"}
            Bins outside the table: raise an error that names them, or have a response of 0.
        disturbance, mode, state_names, control_names
            As for the constructor.

        Raises
        ------
        ProblemError
            If the table has another shape, its frequencies do not increase, or do not cover the bins.

        Examples
        --------
        >>> table = [[0.0, 1.0, 0.0], [0.5, 0.0, -1.0]]
        >>> lfo.FrequencyResponse.from_table(table, samples=4, sampling_time=1.0).G[:, 0, 0].tolist()
        [(1+0j), (0.5-0.5j), 0j]
        """
        rows = real_array("dynamics.table", table)
        if rows.ndim != 2 or rows.shape[1] not in (3, 4):
            expected = "(k, 3): frequency in Hz, real part, imaginary part, or (k, 4) with a coherence"
            raise ProblemError("dynamics.table", f"shape {rows.shape}", expected)
        values = rows[:, 1] + 1j * rows[:, 2]
        G = response_at_bins("dynamics.table", rows[:, 0], values, samples, sampling_time, outside)
        return cls(G, sampling_time, None, disturbance, mode, state_names, control_names)

    @classmethod
    def from_csv(
        cls,
        path: str | PathLike[str],
        samples: int | None = None,
        sampling_time: float | None = None,
        outside: str = "refuse",
        disturbance: ArrayLike | None = None,
        mode: str = "periodic",
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> FrequencyResponse:
        """Interpolate the response in a CSV file; see ``from_table``.

        The first line, which may be a comment, says what the columns are: ``frequency [Hz], re, im`` or
        ``omega [rad/s], magnitude [dB], phase [deg]``, and a coherence (``Discs.from_csv``). Without it, they are
        frequency in Hz, real and imaginary part. Semicolons, tabs and decimal commas are read, too. ``samples`` and
        ``sampling_time`` must be stated, because a file does not have them: the error of a missing one says what the
        file suggests.
        """
        table = read_response(Path(path))
        last = table[-1, 0]
        if sampling_time is None:
            advice = f"The table ends at {last:g} Hz, the Nyquist frequency of {0.5 / last:g} s." if last > 0 else ""
            raise ProblemError("sampling_time", "nothing", "sampling_time=, seconds per step of the problem", advice)
        if samples is None:
            expected = "samples=, the length of the record: the horizon, twice the horizon if zero-padded"
            raise ProblemError("samples", "nothing", expected)
        further = disturbance, mode, state_names, control_names
        return cls.from_table(table, samples, sampling_time, outside, *further)

    @classmethod
    def from_frd(
        cls,
        plant: object,
        samples: int,
        sampling_time: float | None = None,
        outside: str = "refuse",
        disturbance: ArrayLike | None = None,
        mode: str = "periodic",
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> FrequencyResponse:
        """Interpolate a ``control.FrequencyResponseData`` at the bins of a record; see ``from_table``.

        Default: the sampling time of a discrete plant, and the signal names of the plant.
        """
        import control  # here, because it takes seconds to import and only its users need it

        if not isinstance(plant, control.FrequencyResponseData):
            raise ProblemError("plant", type(plant).__name__, "a control.FrequencyResponseData", "See control.frd.")
        step = plant.dt if sampling_time is None and isinstance(plant.dt, float) else sampling_time
        if not step:
            raise ProblemError("sampling_time", "nothing", "seconds per step", "The plant is continuous.")
        values = np.moveaxis(np.asarray(plant.frdata, dtype=complex), -1, 0)
        hertz = np.asarray(plant.omega, dtype=np.float64) / (2 * np.pi)
        G = response_at_bins("plant", hertz, values, samples, float(step), outside)
        outputs, inputs = state_names or plant.output_labels or None, control_names or plant.input_labels or None
        return cls(G, float(step), None, disturbance, mode, outputs, inputs)

    @property
    def padded(self) -> bool:
        """Whether as many zeros follow the record."""
        return self.mode == "zero-padded"

    def record(self, horizon: int) -> int:
        """Return N: the frequencies of G are 2 pi k / N."""
        return 2 * horizon if self.padded else horizon

    def require_horizon(self, horizon: int) -> None:
        """Raise ProblemError unless G, the offset and the disturbance are those of a record of the horizon."""
        N = self.record(horizon)
        if len(self.G) != N // 2 + 1:
            expected = f"{N // 2 + 1} bins, 0 .. {N // 2} of a record of {N} samples at a horizon of {horizon}"
            advice = "from_table, from_csv and from_frd interpolate."
            raise ProblemError("dynamics.G", f"{len(self.G)} bins", expected, advice)
        if N % 2 == 0:
            _require_real("dynamics.G", self.G, N // 2)
            _require_real("dynamics.offset", self.offset, N // 2)
        samples = horizon + self.padded
        if self.disturbance is not None and len(self.disturbance) != samples:
            raise ProblemError("dynamics.disturbance", f"{len(self.disturbance)} times", f"{samples} times")

    def response(self, horizon: int) -> Response:
        """Return the map from all controls to all outputs."""
        if self._cached_response is None or self._cached_response.horizon != horizon:
            N = self.record(horizon)
            base = np.fft.irfft(self.offset, n=N, axis=0)
            if self.disturbance is not None:
                base[: len(self.disturbance)] += self.disturbance
            assign(self, _cached_response=Response(self.G, base[np.arange(horizon + 1) % N], horizon, N))
        assert self._cached_response is not None
        return self._cached_response

    def links(self, horizon: int) -> tuple[Link, ...]:
        """Return x_T = x_0 for a periodic record; else the equation of the first output x_0."""
        if not self.padded:
            return Periodic().links(self.state_dim, horizon)
        response, p = self.response(horizon), self.state_dim
        of_u = response.matrix[:p].reshape(p, horizon, -1).swapaxes(0, 1)
        x_0 = StageMap(np.array([0]), np.eye(p), None, np.zeros(p))
        first = SumMap((x_0, StageMap(np.arange(horizon), None, -of_u, np.zeros(p))), -response.base[0])
        return (Link("first output", first, Within(0.0), periodic=False, repeats=False),)

    def successors(self, x: Array, u: Array) -> Array:
        """Return y_1 .. y_T, (T, p)."""
        return self.response(len(u)).states(u)[1:]

    def successor_sizes(self, x: Array, u: Array) -> Array:
        """Return |y - base| + |base|."""
        response = self.response(len(u))
        return (np.abs(response.linear(u)) + np.abs(response.base))[1:]

    def pull_back(self, eta: Array) -> Array:
        """Return zeros, because no state depends on another, and the adjoint of the response, (T, p + m)."""
        later = np.vstack([np.zeros((1, self.state_dim)), eta]).astype(eta.dtype)
        return np.hstack([np.zeros_like(eta), self.response(len(eta)).pull_back(later)])

    def pulled_sizes(self, eta: Array) -> Array:
        """Return the absolute values of the adjoint."""
        return np.abs(self.pull_back(eta))

    def stepper(self, horizon: int) -> Step:
        """Raise UnsupportedError: outputs depend on all controls."""
        raise UnsupportedError("dynamics: a FrequencyResponse cannot be stepped; its outputs depend on all controls.")

    def gains(self) -> tuple[Array, Array, Array]:
        """Return zeros (p, p), the largest |G| over all bins (p, m), and the amplitudes of the known outputs (p,)."""
        known = 2 * np.abs(self.offset).sum(0) / (2 * (len(self.G) - 1))
        if self.disturbance is not None:
            known = known + np.abs(self.disturbance).max(0)
        return np.zeros((self.state_dim, self.state_dim)), np.abs(self.G).max(0), known

    def translated(self, origin: Array, horizon: int) -> FrequencyResponse:
        """Return the response of y - origin: bin 0 of the offset is the sum of a record."""
        offset = self.offset.copy()
        offset[0] -= self.record(horizon) * origin
        return replace(self, offset=offset)

    def stacked(self, plants: Sequence[Dynamics], names: Sequence[str], horizon: int) -> FrequencyResponse:
        """Return the response of the outputs of several plants to the same controls, with these names."""
        plants, times = cast("Sequence[FrequencyResponse]", plants), horizon + self.padded
        signals = [np.zeros((times, one.state_dim)) if one.disturbance is None else one.disturbance for one in plants]
        known = np.hstack(signals)
        G, offset = np.hstack([one.G for one in plants]), np.hstack([one.offset for one in plants])
        return FrequencyResponse(G, self.sampling_time, offset, known, self.mode, names, self.control_names)

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> FrequencyResponse:
        """Return the response with the outputs w_{t+1} = B u_t too; a recursion A other than zero is refused."""
        if A.any():
            raise UnsupportedError("dynamics: a FrequencyResponse takes no added states with a recursion.")
        delay = np.exp(-2j * np.pi * np.arange(len(self.G)) / self.record(horizon))
        if self.record(horizon) % 2 == 0:
            delay[-1] = -1.0
        k, signal = len(B), self.disturbance
        return FrequencyResponse(
            np.concatenate([self.G, delay[:, None, None] * B], axis=1),
            self.sampling_time,
            np.hstack([self.offset, np.zeros((len(self.offset), k))]),
            None if signal is None else with_columns(signal, k),
            self.mode,
            [*self.state_names, *names],
            self.control_names,
        )

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return the map in words."""
        known = " + g" if self.offset.any() else ""
        size = f"{plural(self.state_dim, 'output')}, {plural(self.control_dim, 'control')}"
        text = f"frequency response: y = G u{known} at {len(self.G)} bins, {self.mode}, {size}"
        return [("dynamics", text + ("; disturbance given in time" if self.disturbance is not None else ""))]

    def __str__(self) -> str:
        return self.facts(())[0][1]


def _require_real(field: str, spectrum: ComplexArray, k: int) -> None:
    """Raise ProblemError unless a spectrum is real at bin k."""
    imaginary = float(np.abs(spectrum[k].imag).max())
    if imaginary > REAL_TOLERANCE * float(np.abs(spectrum).max()):
        what = "frequency 0" if k == 0 else "the Nyquist frequency, N/2"
        expected = f"a real response at {what}, where signals are real"
        advice = "Take its real part, or remove that bin by a stop band and set it to 0."
        raise ProblemError(f"{field}[{k}]", f"imaginary part {imaginary:g}", expected, advice)


OUTSIDE = ("refuse", "zero")
COVERED = 1e-9  # of the distance of bins: a bin so little outside a table of rounded frequencies is covered


def response_at_bins(
    field: str, frequencies: Array, values: ComplexArray, samples: int, sampling_time: float, outside: str
) -> ComplexArray:
    """Return the response at the bins of a record, (N//2 + 1, ...), from values (k, ...) at frequencies (k,) in Hz.

    Between two frequencies, real and imaginary part are linear. A bin outside the table raises an error that names it,
    or has a response of 0. At the Nyquist frequency N/2 the response is real, because a sampled signal has no phase
    there.
    """
    if outside not in OUTSIDE:
        raise ProblemError("outside", brief(outside), "'refuse' or 'zero'")
    if len(frequencies) < 2 or frequencies[0] < 0 or (np.diff(frequencies) <= 0).any():
        got = f"{len(frequencies)} frequencies from {frequencies[:3].tolist()}"
        raise ProblemError(field, got, "at least two frequencies in Hz, zero or above, each above the one before")
    N = positive_integer("samples", samples)
    spacing = 1 / (N * positive_number("dynamics.sampling_time", sampling_time))
    bins = spacing * np.arange(N // 2 + 1)
    slack = COVERED * spacing
    missing = np.flatnonzero((bins < frequencies[0] - slack) | (bins > frequencies[-1] + slack))
    if len(missing) and outside == "refuse":
        named = first_few([f"{k} ({bins[k]:.6g} Hz)" for k in missing], 6)
        got = f"frequencies from {frequencies[0]:.6g} to {frequencies[-1]:.6g} Hz"
        advice = f"Not covered: bins {named}. outside='zero' makes the response 0 there; remove them by a stop band."
        raise ProblemError(field, got, f"all bins of the record, 0 to {bins[-1]:.6g} Hz", advice)
    columns = values.reshape(len(values), -1).T
    response = np.stack([np.interp(bins, frequencies, column) for column in columns], axis=1)
    response[missing] = 0.0
    if N % 2 == 0:
        response[-1] = response[-1].real
    return response.reshape(len(bins), *values.shape[1:])
