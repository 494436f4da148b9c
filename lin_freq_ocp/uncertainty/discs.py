"""Plants whose frequency response is known up to a disc at each bin: |G_kij - Ghat_kij| <= radius_kij.

A row c'y_t + d'u_t <= e holds for all of them if and only if c'yhat_t + d'u_t + |c|'margin(u) <= e, where

    margin_i(u) = 1/N sum_k w_k sum_j radius_kij |uhat_kj|,    w_k = 1 at k = 0 and N/2, else 2.

The number is the same for all times and both signs. These rows are convex in the controls, so the robust problem is an
ordinary one, with an ordinary certificate (docs/robust.md).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    SAME,
    Array,
    ComplexArray,
    Indices,
    brief,
    complex_array,
    positive_integer,
    real_array,
)
from lin_freq_ocp.base.errors import ClosedLoopWarning, ProblemError, UnsupportedError, rename_field, warn_user
from lin_freq_ocp.base.phrases import first_few, join_words, number, plural
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse, response_at_bins
from lin_freq_ocp.problem.dynamics.measured import read_response
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, OutputSpectrum, Signal, entries_of
from lin_freq_ocp.problem.terms.maps import JoinedMap, StageMap
from lin_freq_ocp.problem.terms.norm_rows import NormRows
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.terms.term import Term, TermKind
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.transform.reformulations import augment_states, translation_of
from lin_freq_ocp.transform.simulation import simulate
from lin_freq_ocp.uncertainty.leakage import bin_values
from lin_freq_ocp.uncertainty.protocol import Uncertainty
from lin_freq_ocp.uncertainty.worst_loads import Worst, WorstCase, closest_bin, limit_rows, limited_spectra

WORST_POWER = "worst case of the cost"
FEWEST_AVERAGES = 2
MEASURED = "discs.coherence"  # a field of problem files


class Discs(Uncertainty):
    """At each bin, each entry of the response is anywhere within a disc around the given one, independently.

    Parameters
    ----------
    radius : (bins, p, m), or (bins,) with one output and one control, or a number
        Of the discs, in the units of G; see ``radius_of_coherence``.
    cost : {"nominal", "worst"}
        "worst" minimises the cost of the worst plant instead of that of the given response: for costs y'S u + u'R u
        of one control, such as absorbed power.

    Raises
    ------
    ProblemError
        If a radius is negative or not a number; what does not fit a problem is found with it.

    Notes
    -----
    Real plants are causal and smooth over frequency, so that the true worst case may be less. ``docs/robust.md`` has
    the theorem.

    Examples
    --------
    >>> problem = lfo.library.wave_energy(horizon=100, stroke=0.13)
    >>> discs = lfo.Discs(0.05 * abs(problem.dynamics.G))
    >>> found = lfo.solve(lfo.robust(problem, discs))
    >>> found.status, bool(lfo.worst_case(problem, discs, found))
    ('optimal', True)
    """

    table = "discs"

    def __init__(self, radius: ArrayLike, cost: Literal["nominal", "worst"] = "nominal"):
        self.radius = real_array("discs.radius", radius)
        if self.radius.ndim not in (0, 1, 3) or (self.radius < 0).any():
            got = brief(radius) if self.radius.ndim in (0, 1, 3) else f"shape {self.radius.shape}"
            raise ProblemError("discs.radius", got, "radii of shape (bins, p, m), zero or above")
        if cost not in ("nominal", "worst"):
            raise ProblemError("discs.cost", brief(cost), "'nominal' or 'worst'")
        self.cost: Literal["nominal", "worst"] = cost

    @classmethod
    def from_table(
        cls,
        table: ArrayLike,
        samples: int,
        sampling_time: float,
        averages: int,
        confidence: float = 0.95,
        cost: Literal["nominal", "worst"] = "nominal",
        outside: str = "refuse",
    ) -> Discs:
        """Return the discs of a response and its coherence, measured at some frequencies, at the bins of a record.

        Between two frequencies, the radius is linear, as the response of ``FrequencyResponse.from_table`` is.

        Parameters
        ----------
        table : (k, 4)
            Increasing frequency in Hz, real part, imaginary part, coherence.
        samples, sampling_time
            As for ``FrequencyResponse.from_table``.
        averages, confidence
            As for ``radius_of_coherence``; the probability is that of all frequencies of the table together.
        cost
            As for the constructor.
        outside : {"refuse", "zero"}
            Bins outside the table: raise an error that names them, or have radius 0.

        Raises
        ------
        ProblemError
            If the table has another shape, does not cover the bins, or an argument does not fit its description.

        Examples
        --------
        >>> table = [[0.0, 1.0, 0.0, 0.99], [0.5, 0.0, -1.0, 0.9]]
        >>> lfo.Discs.from_table(table, samples=4, sampling_time=1.0, averages=16).radius.round(4).tolist()
        [0.0531, 0.1145, 0.176]
        """
        frequencies, G, coherence = _measured_columns(table)
        radius = radius_of_coherence(G, coherence, averages, confidence, len(G)).astype(np.complex128)
        return cls(response_at_bins(MEASURED, frequencies, radius, samples, sampling_time, outside).real, cost)

    @classmethod
    def from_csv(
        cls,
        path: str | PathLike[str],
        samples: int,
        sampling_time: float,
        averages: int,
        confidence: float = 0.95,
        cost: Literal["nominal", "worst"] = "nominal",
        outside: str = "refuse",
    ) -> Discs:
        """Return the discs of the response and the coherence in a CSV file; see ``from_table``.

        The header names the columns, as for ``FrequencyResponse.from_csv``: ``frequency [Hz], re, im, coherence``.
        """
        return cls.from_table(read_response(Path(path)), samples, sampling_time, averages, confidence, cost, outside)

    def radii(self, problem: OptimalControlProblem) -> Array:
        """Return the radii (bins, p, m) for a problem, which must have a frequency response."""
        if problem.response is None:
            expected, advice = "a FrequencyResponse, with Discs", "Loads of a LinearDynamics are lfo.Disturbance."
            raise ProblemError("dynamics", type(problem.dynamics).__name__, expected, advice)
        shape, given = problem.response.G.shape, self.radius
        given = given[:, None, None] if given.ndim == 1 and shape[1:] == (1, 1) else given
        if given.ndim and (given.ndim != 3 or given.shape[::2] != shape[::2] or given.shape[1] > shape[1]):
            raise ProblemError("discs.radius", f"shape {self.radius.shape}", f"shape {shape}, that of G, or one number")
        further = shape[1] - given.shape[1] if given.ndim else 0  # outputs that rate_limited adds are known
        return np.pad(given, ((0, 0), (0, further), (0, 0))) if further else np.broadcast_to(given, shape)

    def plan_limits(self, problem: OptimalControlProblem, end: Literal["invariant"] | None = None) -> dict[str, object]:
        """Return the fields with the limits of all plants; see ``robust``."""
        radius = self.radii(problem)
        self.require_plain(problem, end)
        n, wide = problem.state_dim, problem
        if self.cost == "worst":
            wide, radius = _with_worst_cost(problem, radius), np.pad(radius, ((0, 0), (0, 1), (0, 0)))
        fixed = [end.fixed.any() for end in problem.ends]
        soft = [term.hard or term.map.stage_form(n, problem.control_dim) is None for term in problem.terms]
        masks = {one[0]: one[1:] for one in limited_spectra(wide) if _is_of_bins(wide, *one[1:])}
        rest = np.ones((problem.horizon + 1, n)), np.zeros((problem.horizon, problem.control_dim))
        spectra = [term for term in problem.terms if term.kind.is_spectrum and term.name not in masks]
        kept = {
            "fixed and linked ends": any(fixed) or bool(problem.terminal_state.links(n, problem.horizon)),
            "soft limits": not all(soft),
            "stop bands, energies and masks between bins of outputs": bool(
                problem.state_stop.any() or any(term.map.sizes(*rest).any() for term in spectra)
            ),
        }
        if any(kept.values()):
            named = join_words([words for words, there in kept.items() if there])
            text = f"robust: {named} hold for the plan. lfo.worst_case says what other plants do to bins of a period."
            warn_user(text, ClosedLoopWarning)
        found = [*_limits_of_all(wide, radius), *(_mask_of_all(radius, *mask) for mask in masks.values())]
        same: dict[str, object] = {field.name: getattr(wide, field.name) for field in fields(OptimalControlProblem)}
        return same | {"output_spectrum": [*entries_of(wide.output_spectrum), *found] or None}

    def worst(self, problem: OptimalControlProblem, plan: Trajectory, solved: Outcome | None) -> WorstCase:
        """Return what the worst plant does to the controls of a plan; see ``worst_case``."""
        radius, T = self.radii(problem), problem.horizon
        u, limits, soft, leaks = plan.u, list[Worst](), list[Worst](), list[Worst]()
        if u.shape != (T, problem.control_dim):
            raise ProblemError("plan", f"controls {u.shape}", f"shape {(T, problem.control_dim)}")
        translation = translation_of(problem)
        problem = translation.problem
        response, nominal = _response(problem), simulate(problem, u)
        cost = problem.value(nominal.x, u) + translation.cost
        size = np.abs(np.fft.rfft(u, n=response.record, axis=0))
        margin = np.einsum("k,kij,kj->i", response.weight / response.record, radius, size)
        for rows in limit_rows(problem, True, margin > 0):
            for one, c, d in rows.closest(nominal.x, u, np.broadcast_to(np.abs(rows.C) @ margin, rows.limits.shape)):
                k = np.arange(len(radius))
                wave = np.exp(-2j * np.pi * (k * one.index % response.record) / response.record)
                G, under = _worst_plant(problem, radius, u, c, wave)
                value = float(under.x[one.index] @ c + u[one.index : one.index + 1].sum(axis=0) @ d)
                found = replace(one, attained=one.sign * value, trajectory=under, plant=G)
                (soft if rows.soft else limits).append(found.of_given(translation, c))
        for name, spectrum, levels in limited_spectra(problem):
            of_x = np.zeros(problem.state_dim) if spectrum.C is None else np.abs(spectrum.C)
            if of_x.any() and not _is_of_bins(problem, replace(spectrum, joint=False)):
                got = "a spectrum of outputs with a window, between bins, or of a zero-padded response"
                raise UnsupportedError(f"{name}: got {got}; expected bins of a periodic one.")
            values = bin_values(spectrum, nominal)
            added = np.einsum("i,kij,kj->k", of_x, radius, size)[spectrum.bins] if of_x.any() else np.zeros(len(values))
            k, one = closest_bin(name, spectrum, levels, np.abs(values), added)
            if of_x.any():
                wave = np.exp(1j * np.angle(values[k])) * (np.arange(len(radius)) == spectrum.bins[k])
                G, under = _worst_plant(problem, radius, u, np.asarray(spectrum.C), wave)
                attained, under = float(np.abs(bin_values(spectrum, under)[k])), translation.trajectory(under)
                one = replace(one, attained=attained, plant=G, trajectory=under)
            if of_x.any() or not np.isnan(one.limit):
                (leaks if np.isnan(one.limit) else limits).append(one)
        largest = number(float(radius.max(initial=0.0)), 3)
        words = f"every plant within discs of radii up to {largest}; u = v"
        return WorstCase(words, tuple(limits), tuple(leaks), cost=cost, soft=tuple(soft))


def radius_of_coherence(
    G: ArrayLike, coherence: ArrayLike, averages: int, confidence: float = 0.95, bins: int = 1
) -> Array:
    """Return the radii of discs that contain a measured response with a probability, at all of so many bins together.

    For the estimate Gxy / Gxx of independent records and Gaussian noise at the output this is exact, whatever the
    input: |G - Ghat|^2 <= |Ghat|^2 (1 - c)/c (a^(-1/(averages - 1)) - 1) with a = (1 - confidence)/bins, a quantile of
    an F distribution with 2 and 2 averages - 2 degrees of freedom.

    Parameters
    ----------
    G : (k,) or (k, p, m) complex
        The estimate.
    coherence : as G
        c of each, above 0 and at most 1.
    averages : int
        Independent records, at least 2; overlapping segments count less than their number.
    confidence : float
        Probability that the discs contain the response, between 0 and 1.
    bins : int
        Over how many bins at once.

    Returns
    -------
    array, as G

    Raises
    ------
    ProblemError
        If an argument does not fit its description.

    References
    ----------
    Bendat and Piersol, "Random Data", chapter 9.

    Examples
    --------
    >>> lfo.uncertainty.radius_of_coherence([1.0, 2.0], [0.9, 0.99], averages=16, confidence=0.9).round(4).tolist()
    [0.1358, 0.0819]
    """
    estimate, c = complex_array("G", G), real_array("coherence", coherence)
    number_of_bins = positive_integer("bins", bins)
    if c.shape != estimate.shape or not ((c > 0) & (c <= 1)).all():
        got = brief(coherence) if c.shape == estimate.shape else f"shape {c.shape}"
        expected, advice = f"shape {estimate.shape}, above 0 and at most 1", "It is |Gxy|^2 / (Gxx Gyy) of each bin."
        raise ProblemError("coherence", got, expected, advice)
    if not isinstance(averages, Integral) or averages < FEWEST_AVERAGES:
        expected = f"a whole number of independent records, at least {FEWEST_AVERAGES}"
        raise ProblemError("averages", brief(averages), expected, "One record has coherence 1 whatever the noise.")
    if not isinstance(confidence, Real) or not 0 < confidence < 1:
        advice = "State 95 % as 0.95."
        raise ProblemError("confidence", brief(confidence), "a probability between 0 and 1", advice)
    surplus = np.expm1(-np.log((1 - confidence) / number_of_bins) / (averages - 1))
    return np.abs(estimate) * np.sqrt((1 - c) / c * surplus)


def discs_of(
    radius: ArrayLike | None = None,
    cost: Literal["nominal", "worst"] = "nominal",
    coherence: ArrayLike | None = None,
    averages: int | None = None,
    confidence: float = 0.95,
) -> Callable[[OptimalControlProblem], Discs]:
    """Return what makes the discs for a problem: of radii, or of the coherence of its response.

    That is one at all bins, or a table (k, 4) with the response at measured frequencies.
    """
    if (radius is None) == (coherence is None) or (averages is None) != (coherence is None):
        given = {"radius": radius, "coherence": coherence, "averages": averages}
        stated = [name for name, value in given.items() if value is not None]
        raise ProblemError("discs", join_words(stated) if stated else "nothing", "radius, or coherence with averages")

    def make(problem: OptimalControlProblem) -> Discs:
        if radius is not None or problem.response is None:
            return Discs(0.0 if radius is None else radius, cost)
        plant, c = _plant(problem), real_array(MEASURED, coherence)
        G = plant.G[:, 0, 0] if c.ndim == 1 and plant.G.shape[1:] == (1, 1) else plant.G
        with rename_field(lambda name: name if "." in name else f"discs.{name}"):
            if c.ndim != 2:
                return Discs(radius_of_coherence(G, c, averages or 0, confidence, len(G)), cost)
            record = problem.response.record, plant.sampling_time or 0.0
            _require_measured(c, plant, *record)
            return Discs.from_table(c, *record, averages or 0, confidence, cost, "zero")

    return make


def _measured_columns(table: ArrayLike) -> tuple[Array, ComplexArray, Array]:
    """Return the frequencies, the response and the coherence of a table, (k,) each."""
    rows = real_array(MEASURED, table)
    if rows.ndim != 2 or rows.shape[1] != 4:
        expected = "(k, 4): frequency in Hz, real part, imaginary part, coherence"
        advice = "The header of a CSV file names them: 'frequency [Hz],re,im,coherence'."
        raise ProblemError(MEASURED, f"shape {rows.shape}", expected, advice)
    return rows[:, 0], rows[:, 1] + 1j * rows[:, 2], rows[:, 3]


def _require_measured(table: Array, plant: FrequencyResponse, samples: int, sampling_time: float) -> None:
    """Raise ProblemError unless the response of a table is that of a plant, which is zero where the table has none."""
    frequencies, measured, _ = _measured_columns(table)
    if plant.G.shape[1:] != (1, 1):
        got = f"a table, for a response of shape {plant.G.shape}"
        raise ProblemError(MEASURED, got, "the coherence of each entry at each bin, or a radius")
    own = plant.G[:, 0, 0]
    stated = response_at_bins(MEASURED, frequencies, measured, samples, sampling_time, "zero")
    if (other := np.flatnonzero(np.abs(own - stated) > SAME * (np.abs(own) + np.abs(stated)))).size:
        named = first_few([f"{k} ({k / (samples * sampling_time):.6g} Hz)" for k in other], 6)
        advice = "The dynamics and the discs take the same file, {csv = ..}; radius has discs around another response."
        raise ProblemError(MEASURED, f"another response than that of the dynamics, at bins {named}", "the same", advice)


class DiscLimits(FrequencyConstraint):
    """Limits on linear outputs at each time, for every plant of discs: rows with norms of bins of the controls.

    Parameters
    ----------
    limits : (samples, outputs)
        Upper limits; infinite where there is none.
    radii : (outputs, bins, controls)
        By how much one unit of |uhat_kj| moves the output at most.
    record : int
        N, of the spectra of controls.
    """

    label = "limits for every plant"

    def __init__(self, limits: Array, radii: Array, record: int):
        self.limits, self.radii, self.record = limits, radii, record

    def describe(self, names: Sequence[str]) -> str:
        """Return the constraint in words."""
        return f"{plural(int(np.isfinite(self.limits).sum()), 'limit')} of outputs for every plant of the discs"

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        """Yield the only term."""
        of_x, of_u = (itertools.repeat(None) if part is None else part[:, None] for part in (signal.C, signal.D))
        limited = np.isfinite(self.limits.T)
        times = [np.flatnonzero(own) for own in limited]
        rows = [StageMap(own, C, D, np.zeros(1)) for own, C, D in zip(times, of_x, of_u, strict=False)]
        kinds, kind = np.unique(self.radii, axis=0, return_inverse=True)
        bins = [np.flatnonzero(kinds[..., j].any(axis=0)) for j in range(kinds.shape[2])]
        window, units = np.ones(signal.length - (signal.D is None)), np.eye(len(bins))
        spectra = [SpectrumMap(None, row, window, self.record, own) for row, own in zip(units, bins, strict=True)]
        share = np.hstack([kinds[:, own, j] for j, own in enumerate(bins)])
        counts = [len(own) for own in times]
        norm_rows = NormRows(self.limits.T[limited], share, np.repeat(kind.ravel(), counts))
        yield Term(self.label, TermKind.OUTPUT_LIMITS, JoinedMap((*rows, *spectra)), norm_rows, source)

    def translated(self, mean: Array) -> DiscLimits:
        """Return the limits on the outputs less a constant, (outputs,)."""
        return DiscLimits(self.limits - mean, self.radii, self.record)

    def augmented(self, n: int, k: int) -> Sequence[FrequencyConstraint]:
        """Return itself: it is on outputs."""
        return [self]


class DiscMask(FrequencyConstraint):
    """|yhat_k| + sum_j radius_kj |uhat_kj| <= level_k at bins of an output of one period: a mask for every plant.

    Parameters
    ----------
    levels, bins : (bins,)
    radii : (bins, controls)
        By how much one unit of uhat_kj moves the bin at most.
    record : int
        N.
    """

    label = "mask for every plant"

    def __init__(self, levels: Array, bins: Indices, radii: Array, record: int):
        self.limits, self.bins, self.radii, self.record = levels, bins, radii, record

    def describe(self, names: Sequence[str]) -> str:
        """Return the constraint in words."""
        return f"mask of {names[0]} at {plural(len(self.bins), 'bin')} for every plant of the discs"

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        """Yield the only term; the values beside the norms are zero."""
        C, D = (None if part is None else part[0] for part in (signal.C, signal.D))
        controls = [(None, unit) for unit in np.eye(self.radii.shape[1])]
        spectra = [SpectrumMap(*row, np.ones(self.record), self.record, self.bins) for row in [(C, D), *controls]]
        none = StageMap(0 * self.bins, None if C is None else 0 * C[None], None, np.zeros(1))
        share = np.hstack([np.eye(len(self.bins)), *(np.diag(radii) for radii in self.radii.T)])
        rows = NormRows(self.limits, share, np.arange(len(self.bins)))
        yield Term(self.label, TermKind.OUTPUT_LIMITS, JoinedMap((none, *spectra)), rows, source)

    def augmented(self, n: int, k: int) -> Sequence[FrequencyConstraint]:
        """Return itself: it is on an output."""
        return [self]


def _is_of_bins(problem: OptimalControlProblem, spectrum: SpectrumMap, levels: Array | None = None) -> bool:
    """Whether a spectrum of outputs is that of bins of one period, without a window, and has these levels."""
    response = _response(problem)
    limited = levels is None or not np.isnan(levels).any()
    whole = response.closed and spectrum.points == response.record == len(spectrum.window)
    return whole and limited and spectrum.C is not None and not spectrum.joint and bool((spectrum.window == 1).all())


def _mask_of_all(radius: Array, spectrum: SpectrumMap, levels: Array) -> OutputSpectrum:
    """Return a mask of an output at bins, for every plant."""
    limited = np.flatnonzero(np.isfinite(levels))
    bins, C = spectrum.bins[limited], cast("Array", spectrum.C)
    radii = np.einsum("i,kij->kj", np.abs(C), radius[bins][:, : len(C)])
    mask = DiscMask(levels[limited], bins, radii, spectrum.points)
    return OutputSpectrum(C[None], None if spectrum.D is None else spectrum.D[None], mask)


def _limits_of_all(problem: OptimalControlProblem, radius: Array) -> list[OutputSpectrum]:
    """Return the hard limits of outputs, for every plant; none without such limits."""
    response, T, found = _response(problem), problem.horizon, list[OutputSpectrum]()
    weights = response.weight / response.record
    every = limit_rows(problem, True, np.ones(problem.state_dim, dtype=bool))
    for one in (rows for rows in every if not rows.soft):
        limits = one.limits.copy()
        if response.closed:  # the last state is the first
            limits[0], limits[T] = np.minimum(limits[0], limits[T]), np.inf
        if one.C.ndim == 3:
            raise UnsupportedError(f"{one.term}: got rows that depend on time, with Discs; expected constant ones.")
        used = np.flatnonzero(one.C.any(axis=1) & np.isfinite(limits).any(axis=0))
        if len(used):
            C, D = one.C[used], one.D[used] if one.D.any() else None
            radii = np.einsum("k,oi,kij->okj", weights, np.abs(C), radius)
            limited = DiscLimits(limits[: T + (D is None), used], radii, response.record)
            found.append(OutputSpectrum(C, D, limited, [one.names[i] for i in used.tolist()]))
    return found


def _with_worst_cost(problem: OptimalControlProblem, radius: Array) -> OptimalControlProblem:
    """Return the problem with the cost of its worst plant: the products of controls and a further output.

    The mean of y'S u of one control is largest for the plant G + radius sign(S): convex, if the given cost is.
    """
    cost, plant = problem.quadratic, _plant(problem)
    if cost.Q.any() or cost.P.any() or cost.q.any() or cost.p.any() or cost.S.ndim == 3 or problem.control_dim > 1:
        expected = "y'S u + u'R u + r'u of one control, such as absorbed power"
        raise UnsupportedError(f"discs.cost: got 'worst' with another cost; expected {expected}.")
    larger = np.einsum("ij,kij->kj", np.abs(cost.S), radius)[:, None]
    worst = FrequencyResponse(larger, plant.sampling_time, mode=plant.mode)
    both = plant.stacked([plant, worst], [*plant.state_names, WORST_POWER], problem.horizon)
    free = np.full(1, np.inf)
    wide = augment_states(problem, both, Box(-free, free), -free, cost)
    return replace(wide, cost=replace(wide.quadratic, S=np.vstack([cost.S, np.ones((1, 1))])))


def _worst_plant(
    problem: OptimalControlProblem, radius: Array, u: Array, c: Array, wave: ComplexArray
) -> tuple[ComplexArray, Trajectory]:
    """Return the plant G of the discs which adds to each bin of c'y in the direction of a wave (bins,); 0: nothing.

    With it, what the controls do to this plant.
    """
    plant, response = _plant(problem), _response(problem)
    turned = np.conj(np.fft.rfft(u, n=response.record, axis=0)) * wave[:, None]
    size = np.abs(turned)
    phase: ComplexArray = np.where(size > 0, turned / np.where(size > 0, size, 1.0), np.abs(wave)[:, None])
    real = response.weight == 1
    phase[real] = np.sign(phase[real].real)
    other = replace(plant, G=plant.G + np.sign(c)[:, None] * radius * phase[:, None, :])
    return other.G, simulate(replace(problem, dynamics=other), u)


def _plant(problem: OptimalControlProblem) -> FrequencyResponse:
    return cast("FrequencyResponse", problem.dynamics)  # radii requires it


def _response(problem: OptimalControlProblem) -> Response:
    return cast("Response", problem.response)
