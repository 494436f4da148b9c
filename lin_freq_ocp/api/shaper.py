"""shaper(), the shortest input shaper for bands of modes, with the proof how much shorter another one can be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.api.minimum_time import MinimumTime, minimum_time
from lin_freq_ocp.base.activity import activity
from lin_freq_ocp.base.arrays import Array, brief, freeze, positive_integer, positive_number, real_array
from lin_freq_ocp.base.errors import InfeasibleError, ProblemError
from lin_freq_ocp.base.phrases import html_table, number, plural
from lin_freq_ocp.comparison.shapers import SHAPERS, Impulses, Modes, eigenvalues_of, few_impulses, shortest_known
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.residual_vibration import ResidualVibration

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALLOWANCE = 4e-3  # of the limit: how much impulses between two samples may add; the grid's step follows
TIMES_IN_PERIOD = 1e4  # times that are told apart, in a period of the highest frequency
FIRST_PERIODS, MOST_PERIODS = 1.2, 76.8  # periods of the lowest frequency: durations that are tried first, and at most
SAMPLES_BELOW = 8  # samples below the least horizon, where that of impulses at any times is looked for


@final
@dataclass(frozen=True, eq=False)
class Shaper(Impulses):
    """An input shaper: impulses A_i >= 0 at times T_i that sum to one.

    Attributes
    ----------
    amplitudes, times : (k,)
        A, and T in seconds, ascending from zero.
    modes : Modes
        ``modes.bands`` of natural frequencies in Hz, and the range ``modes.damping`` of damping ratios.
    limit : float
        Of the vibration after the last impulse, relative to a single impulse then.
    largest : float
        The largest vibration of these modes, proven.
    shortest : float
        Seconds: no shorter shaper keeps the limit, whatever the times of its impulses. Proven.
    on_grid : MinimumTime
        The shortest shaper with impulses at samples, with its proof.
    interrupted : bool
        Whether Ctrl-C ended the proof: ``shortest`` is zero then.
    known : dict of str to (float, Impulses)
        Shapers of the literature that keep the limit at some frequency, by name: the frequency in Hz at which each is
        shortest, and its impulses. Their vibration is that of modes on the edges of the bands: measured, not proven.

    Examples
    --------
    >>> found = lfo.shaper((0.9, 1.1), vibration=0.3)
    >>> len(found.times), sorted(found.known)[-1], bool(found.vibration(1.0, 0.1) <= found.largest <= 0.3)
    (2, 'ZVD', True)
    """

    modes: Modes
    limit: float
    largest: float
    shortest: float
    on_grid: MinimumTime
    known: Mapping[str, tuple[float, Impulses]]
    interrupted: bool = False

    @property
    def proof(self) -> str:
        """Return what is proven, in words."""
        fact = f"vibration at most {number(100 * self.largest)} % for {self.modes}"
        if self.interrupted:
            return f"{fact}; nothing is proven of shorter ones (interrupted)"
        return (
            f"{fact}; no shaper shorter than {number(1e3 * self.shortest)} ms keeps {number(100 * self.limit)} %, "
            "whatever the times of its impulses"
        )

    def vibration(self, frequency: ArrayLike, damping: ArrayLike) -> Array:
        """Return the vibration after the last impulse, relative to a single impulse then.

        Natural frequencies in Hz and damping ratios below one are broadcast against each other.
        """
        s = eigenvalues_of(real_array("frequency", frequency), real_array("damping", damping))
        return np.abs(self.response(s.ravel())).reshape(s.shape)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Return the facts: a term and its text each."""
        listed = [
            ("A", f"[{', '.join(f'{value:.6f}' for value in self.amplitudes)}]"),
            ("T", f"[{', '.join(f'{value:.9g}' for value in self.times)}] s"),
        ]
        for name in SHAPERS:
            at, one = self.known.get(name, (0.0, None))
            reached = "" if one is None else f"{number(1e3 * one.duration, 6)} ms, made for {number(at, 4)} Hz"
            listed.append((name, reached or f"reaches {number(100 * self.limit)} % at no frequency"))
        head = f"{plural(len(self.times), 'impulse')}, {number(1e3 * self.duration, 6)} ms"
        return [("shaper", head), ("proof", self.proof), *listed]

    def __str__(self) -> str:
        return "\n".join(f"{term:8}  {text}" for term, text in self.rows)

    def __repr__(self) -> str:
        return f"Shaper({plural(len(self.times), 'impulse')}, {number(1e3 * self.duration, 6)} ms, {self.modes})"

    def _repr_html_(self) -> str:
        return html_table("Input shaper", self.rows)

    def plot(self) -> Figure:
        """Return the vibration over the natural frequency, a line for each damping ratio, with bands and limit."""
        from lin_freq_ocp.pages.figures.continua import shaper_figure  # Matplotlib is slow to import

        return shaper_figure(self, self.modes, self.limit)


@activity("looking for the shortest shaper")
def shaper(
    bands: ArrayLike, damping: ArrayLike = 0.1, vibration: float = 0.05, impulses: int = 5, step: float | None = None
) -> Shaper:
    """Find the shortest input shaper for bands of modes, and prove how much shorter another one can be.

    Impulses at samples first: each duration is a convex program, and the least one is proven. Then few impulses at any
    times, by linear programs from there. An impulse between two samples, split over both, changes the vibration by at
    most (2 pi f step)^2 / 8: what no samples reach within a limit larger by that, no times reach.

    Parameters
    ----------
    bands : (lowest, highest), or a list of these
        Natural frequencies of the modes in Hz.
    damping : float, or (lowest, highest)
        Damping ratios of the modes, from zero to below one.
    vibration : float
        The largest vibration after the last impulse, relative to a single impulse then: 0.05 is the customary 5 %.
    impulses : int
        The most impulses; firmware of 3D printers takes five.
    step : float, optional
        Seconds between the samples. Default: impulses between two samples add at most 0.4 % to the limit.

    Returns
    -------
    Shaper

    Raises
    ------
    ProblemError
        If a value is not of this kind, or no shaper of so few impulses was found that keeps the limit.
    InfeasibleError
        If no shaper of up to 70 periods of the lowest frequency keeps the limit, with the proof.
    KeyboardInterrupt
        If Ctrl-C arrives before a shaper is known; later, it ends the proof.

    References
    ----------
    Singer and Seering, "Preshaping command inputs to reduce system vibration", Journal of Dynamic Systems, Measurement,
    and Control 112, 1990. Singhose, "Command Generation for Flexible Systems", PhD thesis, MIT 1997.

    Examples
    --------
    >>> found = lfo.shaper((35, 60), damping=0.0)
    >>> len(found.times), bool(found.largest <= 0.05), bool(0.027 <= found.shortest < found.duration < 0.0271)
    (4, True, True)
    """
    modes, limit = Modes(_bands(bands), _damping_range(damping)), positive_number("shaper.vibration", vibration)
    if limit >= 1:
        raise ProblemError("shaper.vibration", brief(vibration), "a number below 1", "A single impulse has 1.")
    if positive_integer("shaper.impulses", impulses) == 1:
        raise ProblemError("shaper.impulses", "1", "2 or more: a single impulse is no shaper")
    if step is None:
        step = rounded_down(np.sqrt(8 * ALLOWANCE * limit) / modes.highest)
    elif positive_number("shaper.step", step) * modes.highest > 1:
        raise ProblemError("shaper.step", brief(step), f"at most {number(1 / modes.highest)} s for these frequencies")
    on_grid = _shortest_on_grid(modes, limit, step)
    horizon, control = on_grid.horizon, None if on_grid.result is None else on_grid.result.control
    if on_grid.interrupted:
        raise KeyboardInterrupt
    assert horizon is not None
    assert control is not None
    fine = rounded_down(2 * np.pi / (TIMES_IN_PERIOD * modes.highest))
    found = few_impulses(control[:, 0], modes, limit, impulses, (step, fine))
    known = {name: one for name in SHAPERS if (one := shortest_known(name, modes, limit)) is not None}
    largest, shortest = modes.proven_vibration(found, fine), _shortest_at_any_times(modes, limit, step, horizon)
    found_at, least = (freeze(found.amplitudes), freeze(found.times)), shortest or 0.0
    return Shaper(*found_at, modes, limit, largest, least, on_grid, known, interrupted=shortest is None)


def _bands(bands: ArrayLike) -> tuple[tuple[float, float], ...]:
    """Return the bands as pairs, ascending."""
    given = np.atleast_2d(real_array("shaper.bands", bands))
    if (
        given.ndim != 2
        or given.shape[1] != 2
        or not len(given)
        or (given <= 0).any()
        or (given[:, 0] > given[:, 1]).any()
    ):
        raise ProblemError("shaper.bands", brief(bands), "(lowest, highest) in Hz, above zero, or a list of these")
    return tuple((low, high) for low, high in sorted(given.tolist()))


def _damping_range(damping: ArrayLike) -> tuple[float, float]:
    """Return the lowest and the highest damping ratio."""
    given = np.atleast_1d(real_array("shaper.damping", damping))
    if given.shape not in ((1,), (2,)) or not 0 <= given[0] <= given[-1] < 1:
        raise ProblemError("shaper.damping", brief(damping), "a damping ratio from 0 to below 1, or (lowest, highest)")
    return float(given[0]), float(given[-1])


def rounded_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    exponent = int(np.floor(np.log10(value)))
    return max(found for digit in (1, 2, 5) if (found := float(f"{digit}e{exponent}")) <= value)


def _impulse_problem(modes: Modes, limit: float, step: float, horizon: int) -> OptimalControlProblem:
    """Return the problem of impulses at samples: their sum goes from 0 to 1, and they leave little vibration."""
    return OptimalControlProblem(
        LinearDynamics([[1.0]], [[1.0]], sampling_time=step),
        horizon,
        QuadraticCost(R=1.0),
        Box(0, 1),
        initial_state=[0],
        terminal_state=[1],
        control_spectrum=[ResidualVibration(band, modes.damping, limit, relative=True) for band in modes.bands],
        name="shaper",
    )


def _shortest_on_grid(modes: Modes, limit: float, step: float) -> MinimumTime:
    """Return the least number of samples; InfeasibleError if the longest duration is too short."""
    low, periods = 2, FIRST_PERIODS
    while True:
        high = int(np.ceil(periods / modes.bands[0][0] / step)) + 2
        try:
            return minimum_time(_impulse_problem(modes, limit, step, high), (low, high))
        except InfeasibleError:
            low, periods = high, 2 * periods
            if periods > MOST_PERIODS:
                raise


def _shortest_at_any_times(modes: Modes, limit: float, step: float, horizon: int) -> float | None:
    """Return a duration up to which no impulses at any times keep the limit, proven; None if it was interrupted.

    Samples keep it from a horizon on.
    """
    wider, near = limit + (modes.highest * step) ** 2 / 8, SAMPLES_BELOW
    while True:
        low = max(horizon - near, 1)
        found = minimum_time(_impulse_problem(modes, wider, step, horizon), (low, horizon))
        if found.interrupted:
            return None
        if found.horizon is not None and found.horizon > low and found.proven:
            return (found.horizon - 2) * step  # so long are the samples of one horizon less
        if low == 1:
            return 0.0
        near *= 4
