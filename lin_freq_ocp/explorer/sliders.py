"""Which values of a linear problem can be moved, between which limits, and the problem at other values.

A slider has notches low, low + step, ..., high, of which one is the problem's own value. One bin of the DFT is a notch
of the cut-off, the last of which, at or above Nyquist, stands for no low pass.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from math import ceil, floor, isfinite, log10, pi

import numpy as np

from lin_freq_ocp.analysis.sizes import stated_sizes
from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import BandWarning, LinFreqOCPError, ProblemError, suggestion
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import Band, low_pass
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.text.phrases import split_unit

CUTOFF, HORIZON = "cutoff", "horizon"
NOTCHES = 100  # of a slider, about
CUTOFF_NOTCHES = 200  # of the cut-off: one bin each up to horizons of 400
LEAST_BOUND, LARGEST_BOUND = 0.1, 3.0  # of the problem's own
MOST_CONTROLS, MOST_STATES = 4, 12  # of problems with more, bounds and ends have no sliders
ENDS = {"initial_state": "initial", "terminal_state": "terminal"}

Values = Mapping[str, float]  # the value of each slider, by its key
Rebuild = Callable[[int], OptimalControlProblem]  # the same problem over another horizon


@dataclass(frozen=True)
class Slider:
    """A value that can be moved from ``low`` to ``high`` in ``unit``; towards ``relaxed`` the problem gets easier."""

    key: str
    group: str
    label: str
    unit: str
    low: float
    high: float
    step: float
    value: float  # the problem's own
    relaxed: float

    @property
    def data(self) -> dict[str, object]:
        """Return it as plain data."""
        return asdict(self)

    def notch(self, n: int) -> float:
        """Return the value n notches from the problem's own."""
        return min(max(self.value + n * self.step, self.low), self.high)


def sliders_of(problem: OptimalControlProblem, rebuild: Rebuild | None) -> tuple[Slider, ...]:
    """Return the sliders of a problem: cut-off, control bounds, horizon, ends."""
    return (*_cutoff(problem), *_bounds(problem), *_horizon(problem, rebuild), *_ends(problem))


def checked(sliders: tuple[Slider, ...], given: object) -> dict[str, float]:
    """Return the value of every slider, the problem's own where none is given; raise ProblemError if one is wrong."""
    if not isinstance(given, Mapping):
        raise ProblemError("values", brief(given), "an object with the values of sliders")
    known = {slider.key: slider for slider in sliders}
    for key, value in given.items():
        if key not in known:
            raise ProblemError(
                f"values.{key}", "no slider of that name", f"some of {', '.join(known)}", suggestion(key, known)
            )
        slider = known[key]
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not slider.low <= value <= slider.high:
            expected = f"a number from {slider.low:.6g} to {slider.high:.6g} {slider.unit}".rstrip()
            raise ProblemError(f"values.{key}", brief(value), expected)
    return {key: float(given.get(key, slider.value)) for key, slider in known.items()}


def changed(sliders: tuple[Slider, ...], values: Values) -> dict[str, float]:
    """Return the values that are not the problem's own."""
    return {slider.key: values[slider.key] for slider in sliders if values[slider.key] != slider.value}


def problem_at(
    problem: OptimalControlProblem, rebuild: Rebuild | None, sliders: tuple[Slider, ...], moved: Values
) -> OptimalControlProblem:
    """Return the problem with these values, but for its bounds and ends."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)  # the page shows which bins are stopped
        if HORIZON in moved and rebuild is not None:
            problem = rebuild(int(moved[HORIZON]))
        if CUTOFF in moved:
            high = next(slider.high for slider in sliders if slider.key == CUTOFF)
            problem = replace(problem, control_spectrum=_low_pass(problem, moved[CUTOFF], moved[CUTOFF] >= high))
    return problem


def bounds_at(problem: OptimalControlProblem, moved: Values) -> ConvexSet | None:
    """Return the set of the controls with these bounds; None where all are the problem's own."""
    box = Box(problem.control_tube.lower[0], problem.control_tube.upper[0])
    lower, upper = np.array(box.lower), np.array(box.upper)
    for key, value in moved.items():
        kind, _, index = key.partition(".")
        if kind in ("bound", "lower"):
            lower[int(index)] = -value if kind == "bound" else value
        if kind in ("bound", "upper"):
            upper[int(index)] = value
    if (lower == box.lower).all() and (upper == box.upper).all():
        return None
    members = () if problem.control_set is None else _members(problem)
    return Intersection([Box(lower, upper), *members]) if members else Box(lower, upper)


def ends_at(problem: OptimalControlProblem, moved: Values) -> dict[str, np.ndarray]:
    """Return the ends of which a component is moved, (n,)."""
    ends = dict[str, np.ndarray]()
    for field, box in _fixed_ends(problem):
        components = {int(key.partition(".")[2]): value for key, value in moved.items() if key.startswith(f"{field}.")}
        if components:
            ends[field] = np.array([components.get(i, value) for i, value in enumerate(box.lower)])
    return ends


def _cutoff(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the cut-off of the one low pass on the controls, or of none."""
    step, T = problem.sampling_time, problem.horizon
    nyquist, unit = (pi, "rad/sample") if step is None else (0.5 / step, "Hz")
    notch = max(2 * nyquist / T, nyquist / CUTOFF_NOTCHES)
    match entries_of(problem.control_spectrum):
        case []:
            value = nyquist
        case [Band(kind="low_pass") as band]:
            value = band.edges[1] * (1.0 if step is None or band.unit == "Hz" else 1 / (2 * pi * step))
        case _:
            return
    low, high = value - floor(value / notch - 1) * notch, value + ceil((nyquist - value) / notch) * notch
    if low < high:
        yield Slider(CUTOFF, "frequency", "cut-off of the controls", unit, low, high, notch, value, high)


def _low_pass(problem: OptimalControlProblem, value: float, none: bool) -> Band | None:
    """Return the low pass of the problem with another cut-off, or none."""
    if none:
        return None
    entries = list(entries_of(problem.control_spectrum))
    component = entries[0].component if entries else None
    return low_pass(**{"cutoff" if problem.sampling_time is None else "cutoff_hz": value}, component=component)


def _bounds(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield a slider for bounds that are symmetric, and two for others; none for those that change with time."""
    tube = problem.control_tube
    constant = not np.diff(tube.lower, axis=0).any() and not np.diff(tube.upper, axis=0).any()
    if problem.control_dim > MOST_CONTROLS or not constant or isinstance(problem.control_set, (list, tuple)):
        return
    for j, name in enumerate(problem.control_names):
        (label, unit), low, high = split_unit(name), float(tube.lower[0, j]), float(tube.upper[0, j])
        if not isfinite(high - low) or high <= low:
            continue
        if low == -high:
            first, last, notch = _notches(LEAST_BOUND * high, high, LARGEST_BOUND * high)
            yield Slider(
                f"bound.{j}", "bounds", f"|{label}| \N{LESS-THAN OR EQUAL TO}", unit, first, last, notch, high, last
            )
            continue
        middle, span = (low + high) / 2, high - low
        first, last, notch = _notches(low - span, low, middle - span / NOTCHES)
        yield Slider(
            f"lower.{j}", "bounds", f"{label} \N{GREATER-THAN OR EQUAL TO}", unit, first, last, notch, low, first
        )
        first, last, notch = _notches(middle + span / NOTCHES, high, high + span)
        yield Slider(f"upper.{j}", "bounds", f"{label} \N{LESS-THAN OR EQUAL TO}", unit, first, last, notch, high, last)


def _horizon(problem: OptimalControlProblem, rebuild: Rebuild | None) -> Iterator[Slider]:
    """Yield the horizon, if the problem can be built over others."""
    T = problem.horizon
    notch = max(1, T // 60)
    low, high = T - (T // 2 // notch) * notch, T + (T // notch) * notch
    if rebuild is not None and _can_be_built(rebuild, low) and _can_be_built(rebuild, high):
        yield Slider(HORIZON, "horizon", "horizon", "steps", low, high, notch, T, high)


def _can_be_built(rebuild: Rebuild, horizon: int) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)
        try:
            return rebuild(horizon).horizon == horizon
        except (LinFreqOCPError, TypeError, ValueError):  # no such parameter, or arrays over this horizon alone
            return False


def _ends(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the components of ends that are points."""
    if problem.state_dim > MOST_STATES:
        return
    boxes, sizes = problem.state_boxes, stated_sizes(problem)[0]
    for field, end in _fixed_ends(problem):
        for i, name in enumerate(problem.state_names):
            (label, unit), value = split_unit(name), float(end.lower[i])
            low, high = (float(bound[0 if field == "initial_state" else -1, i]) for bound in (boxes.lower, boxes.upper))
            reach = max(2 * abs(value), float(sizes[i]))
            low, high = (low if isfinite(low) else -reach), (high if isfinite(high) else reach)
            if low <= value <= high and low < high:
                first, last, notch = _notches(low, value, high)
                yield Slider(f"{field}.{i}", field, f"{ENDS[field]} {label}", unit, first, last, notch, value, value)


def _fixed_ends(problem: OptimalControlProblem) -> Iterator[tuple[str, Box]]:
    for field, end in zip(ENDS, (problem.initial_box, problem.terminal_box), strict=True):
        if end.fixed.all():
            yield field, end


def _members(problem: OptimalControlProblem) -> tuple[ConvexSet, ...]:
    given = problem.control_set
    return given.members if isinstance(given, ConvexSet) else ()


def _notches(low: float, value: float, high: float) -> tuple[float, float, float]:
    """Return the first and the last notch within limits, and a round step, with a notch at the value."""
    step = _round_step((high - low) / NOTCHES)
    return value - floor((value - low) / step + 1e-9) * step, value + floor((high - value) / step + 1e-9) * step, step


def _round_step(size: float) -> float:
    """Return the least of 1, 2, 5 times a power of ten that is no less."""
    power = 10.0 ** floor(log10(size))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= size * (1 - 1e-9))
