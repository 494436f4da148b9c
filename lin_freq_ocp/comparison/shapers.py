"""Input shapers: impulses whose vibrations cancel, those of the literature, and shorter ones at any times.

A shaper is impulses A_i >= 0 at times T_0 = 0 < ... < T_n with the sum 1; a command is convolved with them. A mode with
the eigenvalue s = 2 pi f (-zeta + i sqrt(1 - zeta^2)) vibrates afterwards with |V|, relative to one impulse at T_n:

    V(s) = sum_i A_i exp(s (T_n - T_i)).

Shapers of the literature have impulses a part of the period of damped vibration apart, over which a vibration decays
by the factor K. Their amplitudes, divided by their sum, are

    ZV        1, K                                  half a period apart: zero vibration at (f, zeta);
    MZV       a, b K, a K^2                         3/8 of a period apart, a = 1 - 1/sqrt(2), b = sqrt(2) - 1;
    ZVD       1, 2 K, K^2                           the derivative by f is zero, too: ZV convolved with itself;
    EI        (1 + v)/4, (1 - v)/2 K, (1 + v)/4 K^2      v of the vibration at f, and zero on both sides;
    2HUMP_EI, 3HUMP_EI                              v at two and three peaks, with four and five impulses.

The formulas of the last three are exact without damping, and the usual first approximation with it. Each impulse of a
sampled shaper is at the sample nearest to its time.

``shorten`` moves impulses off a grid: it lowers T_n over all amplitudes and times by linear programs within a trust
region, in which |V| at modes on the edges of the boxes is linear, with an exact penalty on what exceeds the limit.

References: Singer and Seering, Journal of Dynamic Systems, Measurement, and Control 112, 1990 (ZV, ZVD). Singhose,
Command Generation for Flexible Systems, PhD thesis, MIT 1997 (EI, its humps, shapers for several modes by
convolution). MZV: the formula of the firmware Klipper for 3D printers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import join_words, low_to_high, runs_of
from lin_freq_ocp.certificate.peaks import proven_peak
from lin_freq_ocp.problem.terms.semi_infinite import VibrationLimit, VibrationMap

INSENSITIVITY = 0.05  # v of EI and its humps: the customary 5 %
SHAPERS = ("ZV", "MZV", "ZVD", "EI", "2HUMP_EI", "3HUMP_EI")
LONGEST_KNOWN = 2.0  # periods: the duration of 3HUMP_EI
USUAL_SHAPERS = ("ZV", "ZVD", "EI")  # where no names are given

MODES_PER_BIN = (
    64  # modes on an edge for each bin of the impulses' spectrum, at which |V| is limited while impulses move
)
NEGLIGIBLE = 1e-6  # amplitudes, of a sum of 1, that belong to no impulse of the optimum but to its inaccuracy
MOST_LINEAR_PROGRAMS = 60  # linear programs; ten to thirty reach the smallest radius
LEAST_RADIUS = 1e-9  # of the duration: where the search ends
FIRST_RADIUS = 0.1  # of the mean distance of impulses
WATCHED_SHARE = 0.5  # of the limit: modes that vibrate less are left out of a linear program
REPAIRS = 20  # times that the limit at modes falls, at most; two or three reach the limit
LEFT_OVER = 1e-4  # of a limit, by which impulses that linear programs bring below it exceed it at most
REPAIRED = 1e-6  # of the limit, by which it falls more than it is exceeded
FREQUENCIES_TRIED = 400  # frequencies over all bands at which a shaper of the literature is tried
BAND_MARGIN = 0.05  # of its edges by which a measured band is widened
PRICE = (
    10.0  # durations, for a vibration of twice the limit: more than a multiplier of the limit in every case measured
)


@dataclass(frozen=True, eq=False)
class Impulses:
    """Impulses (k,) with the sum 1, and their times in seconds (k,), ascending from zero."""

    amplitudes: Array
    times: Array

    @property
    def duration(self) -> float:
        """Return the time of the last impulse in seconds."""
        return float(self.times[-1])

    def response(self, s: ComplexArray) -> ComplexArray:
        """Return V at eigenvalues (k,), (k,)."""
        waves: ComplexArray = np.exp(np.multiply.outer(s, self.duration - self.times))
        return waves @ self.amplitudes.astype(complex)

    def samples(self, step: float) -> Array:
        """Return the impulses as samples, (length,), each at the sample nearest to its time."""
        at = np.rint(self.times / step).astype(int)
        samples = np.zeros(at[-1] + 1)
        np.add.at(samples, at, self.amplitudes)
        return samples


def known_shaper(name: str, frequency: float, damping: float, insensitivity: float = INSENSITIVITY) -> Impulses:
    """Return a shaper of the literature for a natural frequency in Hz and a damping ratio."""
    v, apart = insensitivity, 0.375 if name == "MZV" else 0.5
    if name in ("ZV", "ZVD"):
        factors = [1.0, 1.0] if name == "ZV" else [1.0, 2.0, 1.0]
    elif name == "MZV":
        factors = [1 - 0.5**0.5, 2**0.5 - 1, 1 - 0.5**0.5]
    elif name == "EI":
        factors = [(1 + v) / 4, (1 - v) / 2, (1 + v) / 4]
    elif name == "2HUMP_EI":
        X = (v**2 * (np.sqrt(1 - v**2) + 1)) ** (1 / 3)
        first = (3 * X**2 + 2 * X + 3 * v**2) / (16 * X)
        factors = [first, 0.5 - first, 0.5 - first, first]
    else:
        first, second = (1 + 3 * v + 2 * np.sqrt(2 * (v**2 + v))) / 16, (1 - v) / 4
        factors = [first, second, 1 - 2 * (first + second), second, first]
    root = float(np.sqrt(1 - damping**2))
    times = np.arange(len(factors), dtype=np.float64) * (apart / (frequency * root))
    amplitudes = np.array(factors) * np.exp(-2 * np.pi * frequency * damping * times)
    return Impulses(amplitudes / amplitudes.sum(), times)


@dataclass(frozen=True)
class Modes:
    """Bands of natural frequencies in Hz, and a range of damping ratios."""

    bands: tuple[tuple[float, float], ...]
    damping: tuple[float, float]

    def __str__(self) -> str:
        bands = join_words([low_to_high(*band) for band in self.bands])
        return f"every mode of {bands} Hz with a damping ratio of {low_to_high(*self.damping)}"

    @property
    def highest(self) -> float:
        """Return the largest |s| in rad/s."""
        return 2 * np.pi * max(high for _, high in self.bands)

    def boxes(self, samples: int, step: float) -> list[VibrationLimit]:
        """Return |V| <= 1 of samples for each band."""
        plain = VibrationMap(None, np.ones(1), np.ones(samples), np.zeros((0, 2)), step, relative=True)
        corners = [np.stack([band, self.damping], axis=1) for band in self.bands]
        return [VibrationLimit(plain, low, high, 1.0, step) for low, high in corners]

    def eigenvalues(self, duration: float) -> ComplexArray:
        """Return s of modes on the edges of the boxes, where the largest |V| is, (k,)."""
        modes = [
            box.points_on(edge, np.linspace(0.0, 1.0, int(np.ceil(MODES_PER_BIN * box.bins(edge))) + 1))
            for box in self.boxes(2, duration / 2)
            for edge in box.edges
        ]
        return eigenvalues_of(*np.concatenate(modes).T)

    def proven_vibration(self, impulses: Impulses, step: float) -> float:
        """Return an upper bound on |V| of all modes, for impulses whose times are multiples of a step."""
        samples = impulses.samples(step)
        return max(proven_peak(box, samples).ratio for box in self.boxes(len(samples), step))


def eigenvalues_of(frequencies: Array, damping: Array) -> ComplexArray:
    """Return s of natural frequencies in Hz and damping ratios, which are broadcast against each other."""
    return 2 * np.pi * frequencies * (-damping + 1j * np.sqrt(1 - damping**2))


def join_groups(samples: Array, groups: Sequence[Indices], step: float) -> Impulses:
    """Return one impulse for each group of samples, at its centre; times begin at zero."""
    amplitudes = np.array([samples[group].sum() for group in groups])
    times = step * np.array([group @ samples[group] for group in groups]) / amplitudes
    return Impulses(amplitudes / amplitudes.sum(), times - times[0])


def with_widest_split(samples: Array, groups: Sequence[Indices]) -> list[Indices]:
    """Return groups of samples of which the one with the largest moment of inertia is split at its centre."""
    centres = [group @ samples[group] / samples[group].sum() for group in groups]
    inertia = [samples[group] @ (group - centre) ** 2 for group, centre in zip(groups, centres, strict=True)]
    k = int(np.argmax(inertia))
    group, first = groups[k], groups[k] < centres[k]
    return [*groups[:k], group[first], group[~first], *groups[k + 1 :]] if len(group) > 1 else list(groups)


def shorten(impulses: Impulses, s: ComplexArray, limit: float) -> Impulses:
    """Return impulses with |V| <= limit at eigenvalues (k,) and a duration that is least near the given ones.

    If none near the given ones keep the limit, the result exceeds it.
    """
    A, T, n = impulses.amplitudes, impulses.times, len(impulses.times)
    radius = FIRST_RADIUS / n  # of the duration, for times; of the sum, for amplitudes

    def merit(candidate: Impulses) -> float:
        excess = float(np.abs(candidate.response(s)).max()) / limit - 1
        return candidate.duration + PRICE * impulses.duration * max(excess, 0.0)

    best, least = impulses, merit(impulses)
    for _ in range(MOST_LINEAR_PROGRAMS):
        step = _linear_step(best, s, limit, radius)
        if step is not None:
            A, T = best.amplitudes + step[:n], best.times + step[n:]
            moved = Impulses(A / A.sum(), T - T[0])
            if (value := merit(moved)) < least:
                best, least, radius = moved, value, 1.5 * radius
                continue
        radius /= 3
        if radius < LEAST_RADIUS:
            break
    return best


def _linear_step(at: Impulses, s: ComplexArray, limit: float, radius: float) -> Array | None:
    """Return the changes of amplitudes and times, (2 n,), that lower the duration most where |V| is linear.

    The unknowns are the changes of amplitudes, of times in durations, and the excess of the vibration in limits.
    """
    from scipy.optimize import linprog  # slow to import

    A, T, n = at.amplitudes, at.times, len(at.times)
    waves = np.exp(np.multiply.outer(s, at.duration - T))
    V = waves @ A
    size = np.abs(V)
    watched = size > WATCHED_SHARE * limit
    waves, V, size, s = waves[watched], V[watched], size[watched], s[watched]
    turn, s = (V.conj() / (size * limit))[:, None], s * at.duration
    by_amplitude, by_time = (turn * waves).real, (-turn * s[:, None] * waves * A).real
    by_time[:, -1] += (turn[:, 0] * s * V).real  # T_n - T_i grows for all i
    order = np.hstack([np.zeros((n - 1, n)), np.eye(n - 1, n) - np.eye(n - 1, n, 1), np.zeros((n - 1, 1))])
    below = np.hstack([by_amplitude, by_time, np.full((len(s), 1), -1.0)])
    lower = np.concatenate([np.maximum(-A, -radius), [0.0], np.full(n - 1, -radius), [0.0]])
    upper = np.concatenate([np.full(n, radius), [0.0], np.full(n - 1, radius), [np.inf]])
    answer = linprog(
        np.concatenate([np.zeros(2 * n - 1), [1.0, PRICE]]),
        np.vstack([below, order]),
        np.concatenate([1.0 - size / limit, np.diff(T) / at.duration]),
        np.concatenate([np.ones(n), np.zeros(n + 1)])[None],
        [0.0],
        list(zip(lower.tolist(), upper.tolist(), strict=True)),
    )
    return None if answer.x is None else answer.x[: 2 * n] * np.repeat([1.0, at.duration], n)


def few_impulses(samples: Array, modes: Modes, limit: float, most: int, steps: tuple[float, float]) -> Impulses:
    """Return at most so many impulses with |V| <= limit, proven, as short as found near samples that keep the limit.

    The steps are that of the samples, and that of the times.

    Raises
    ------
    ProblemError
        If no impulses as few as that were found.
    """
    step, fine = steps
    groups = [np.arange(first, last + 1) for first, last in runs_of(np.flatnonzero(samples > NEGLIGIBLE))]
    found, keeps = _keep_limit(join_groups(samples, groups, step), modes, limit, fine)
    while not keeps and len(groups) < np.count_nonzero(samples > NEGLIGIBLE):  # an impulse cannot be what a cluster is
        groups = with_widest_split(samples, groups)
        found, keeps = _keep_limit(join_groups(samples, groups, step), modes, limit, fine)
    reached = f"{len(found.times)} do." if keeps else ""
    while len(found.times) > most:
        kept = np.delete(np.arange(len(found.times)), found.amplitudes.argmin())
        amplitudes, times = found.amplitudes[kept], found.times[kept]
        found, keeps = _keep_limit(Impulses(amplitudes / amplitudes.sum(), times - times[0]), modes, limit, fine)
    if not keeps:
        got = f"{most}, and no shaper of so few that keeps the limit was found"
        raise ProblemError("shaper.impulses", got, "more impulses, or a larger vibration", reached)
    return found


def _keep_limit(start: Impulses, modes: Modes, limit: float, step: float) -> tuple[Impulses, bool]:
    """Return the shortest impulses near the given ones at times on a fine grid, and whether they keep the limit.

    The limit at modes falls by what the rounding of times and the modes between add.
    """
    at_modes, found, largest = limit, start, np.inf
    for _ in range(REPAIRS):
        s = modes.eigenvalues(start.duration)
        start = shorten(start, s, at_modes)
        found = Impulses(start.amplitudes, step * np.rint(start.times / step))
        largest = float(np.abs(found.response(s)).max())
        if largest <= limit:
            largest = modes.proven_vibration(found, step)  # takes longer
        if largest <= limit or float(np.abs(start.response(s)).max()) > (1 + LEFT_OVER) * at_modes:
            break  # in the second case, no impulses near these keep the limit
        at_modes *= limit / largest * (1 - REPAIRED)
    return found, largest <= limit


def shortest_known(name: str, modes: Modes, limit: float) -> tuple[float, Impulses] | None:
    """Return a shaper of the literature at the frequency in Hz at which it is shortest; None if none keeps the limit.

    The vibration is that of modes on the edges of the boxes.
    """
    found, (low, high) = list[tuple[float, Impulses]](), modes.damping
    s = modes.eigenvalues(LONGEST_KNOWN / modes.bands[0][0])
    for damping in sorted({low, (low + high) / 2, high}):
        for frequency in np.linspace(modes.bands[-1][1], modes.bands[0][0], FREQUENCIES_TRIED).tolist():
            tried = known_shaper(name, frequency, damping, limit)
            if np.abs(tried.response(s)).max() <= limit:
                found.append((frequency, tried))
                break
    return min(found, key=lambda one: one[1].duration, default=None)


def bands_of(frequencies: Array, power: Array, share: float) -> tuple[tuple[float, float], ...]:
    """Return the bands in which a power, (k,), is above a share of its largest value, widened, and joined if they meet.

    Frequencies are in Hz, ascending.
    """
    bands = list[tuple[float, float]]()
    for first, last in runs_of(np.flatnonzero(power > share * power.max())):
        low, high = frequencies[first] * (1 - BAND_MARGIN), frequencies[last] * (1 + BAND_MARGIN)
        if bands and low <= bands[-1][1]:
            low = bands.pop()[0]
        bands.append((round(float(low), 1), round(float(high), 1)))
    return tuple(bands)
