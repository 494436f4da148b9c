"""Sliders, and the values in the time domain that they move: fixed components of ends, bounds, limits of joint rows.

A slider has notches low, low + step, ..., high, of which one is the problem's own value. Only bounds and limits that
are the same at all times can be moved, and of the ends the components that are fixed, within the bounds of the states.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from math import floor, isfinite, log10

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.phrases import AT_MOST, split_unit
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.sizes import stated_sizes

NOTCHES = 100  # of a slider, about
LEAST_PART, LARGEST_PART = 0.1, 3.0  # of the problem's own bounds and limits
ROUNDING = 1e-9  # of a notch, by which a limit may be missed

Values = Mapping[str, float]  # the value of each slider, by its key

MOST_STATES = 12  # of problems with more, ends have no sliders
WORDS = {"initial_state": "initial", "terminal_state": "terminal"}

AT_LEAST = "\N{GREATER-THAN OR EQUAL TO}"


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


@dataclass(frozen=True)
class Movable:
    """A kind of values that can be moved: its sliders, and the fields of the problem at other values of them."""

    sliders: Callable[[OptimalControlProblem], Iterator[Slider]]
    fields: Callable[[OptimalControlProblem, Values], Mapping[str, object]]


def notches(low: float, value: float, high: float, step: float = 0.0) -> tuple[float, float, float]:
    """Return the first and the last notch within limits, and the step (else a round one), with a notch at the value."""
    step = step or _round_step((high - low) / NOTCHES)
    below, above = (floor(distance / step + ROUNDING) for distance in (value - low, high - value))
    return value - below * step, value + above * step, step


def _round_step(size: float) -> float:
    """Return the least of 1, 2, 5 times a power of ten that is no less."""
    power = 10.0 ** floor(log10(size))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= size * (1 - ROUNDING))


def ends_at(problem: OptimalControlProblem, moved: Values) -> dict[str, Box]:
    """Return the ends of which a component is moved."""
    ends = dict[str, Box]()
    for field, end in _end_boxes(problem):
        values = {i: moved[key] for i in range(problem.state_dim) if (key := f"{field}.{i}") in moved}
        if values:
            lower, upper = np.array(end.lower), np.array(end.upper)
            lower[list(values)] = upper[list(values)] = list(values.values())
            ends[field] = Box(lower, upper)
    return ends


def _end_boxes(problem: OptimalControlProblem) -> Iterator[tuple[str, Box]]:
    """Yield the ends that are boxes."""
    for field, end in zip(WORDS, (problem.initial_box, problem.terminal_box), strict=True):
        if not getattr(problem, field).members:
            yield field, end


def _end_sliders(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the fixed components of ends."""
    if problem.state_dim > MOST_STATES:
        return
    boxes, sizes = problem.state_boxes, stated_sizes(problem)[0]
    for field, end in _end_boxes(problem):
        for i, name in enumerate(problem.state_names):
            (label, unit), value = split_unit(name), float(end.lower[i])
            low, high = (float(bound[0 if field == "initial_state" else -1, i]) for bound in (boxes.lower, boxes.upper))
            reach = max(2 * abs(value), float(sizes[i]))
            low, high = (low if isfinite(low) else -reach), (high if isfinite(high) else reach)
            if end.fixed[i] and low <= value <= high and low < high:
                first, last, notch = notches(low, value, high)
                yield Slider(f"{field}.{i}", field, f"{WORDS[field]} {label}", unit, first, last, notch, value, value)


ENDS = Movable(_end_sliders, ends_at)


@dataclass(frozen=True)
class Bounded:
    """A signal whose bounds can be moved: its field of the problem, the group and first word of its sliders."""

    field: str
    group: str
    word: str  # before "bound.0", "lower.0", "upper.0"
    most: int  # components; of problems with more, bounds have no sliders


SIGNALS = Bounded("control_set", "bounds", "", 4), Bounded("state_set", "state_bounds", "state_", 12)


def sets_at(problem: OptimalControlProblem, moved: Values) -> dict[str, ConvexSet]:
    """Return the sets of which a bound is moved."""
    sets = dict[str, ConvexSet]()
    for signal, n in zip(SIGNALS, (problem.control_dim, problem.state_dim), strict=True):
        keys = {kind: f"{signal.word}{kind}." for kind in ("bound", "lower", "upper")}
        given = getattr(problem, signal.field)
        if not isinstance(given, ConvexSet) or not any(key.startswith(tuple(keys.values())) for key in moved):
            continue
        lower, upper = (np.broadcast_to(one, (*one.shape[:-1], n)).copy() for one in given.bounds)
        for j in range(n):
            bound = moved.get(f"{keys['bound']}{j}")
            _set_bound(lower, j, moved.get(f"{keys['lower']}{j}") if bound is None else -bound)
            _set_bound(upper, j, moved.get(f"{keys['upper']}{j}") if bound is None else bound)
        box = Box(lower, upper)
        sets[signal.field] = Intersection([box, *given.members]) if given.members else box
    return sets


def _set_bound(bounds: Array, j: int, value: float | None) -> None:
    if value is not None:
        bounds[..., j] = value


def _bound_sliders(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the bounds of both signals that are the same at all times."""
    for signal, tube, names, sizes in zip(
        SIGNALS,
        (problem.control_tube, problem.state_boxes),
        (problem.control_names, problem.state_names),
        stated_sizes(problem)[::-1],
        strict=True,
    ):
        given = getattr(problem, signal.field)
        if len(names) > signal.most or not isinstance(given, ConvexSet) or given.levels_of(len(names)):
            continue
        for j, name in enumerate(names):
            low, high = (bound[:, j] for bound in (tube.lower, tube.upper))
            if (low == low[0]).all() and (high == high[0]).all() and low[0] < high[0]:
                yield from _component_sliders(signal, j, name, float(low[0]), float(high[0]), float(sizes[j]))


def _component_sliders(signal: Bounded, j: int, name: str, low: float, high: float, size: float) -> Iterator[Slider]:
    """Yield a slider for bounds that are symmetric, and one for each other bound that is finite."""
    label, unit = split_unit(name)
    if low == -high and np.isfinite(high):
        first, last, notch = notches(LEAST_PART * high, high, LARGEST_PART * high)
        yield Slider(
            f"{signal.word}bound.{j}", signal.group, f"|{label}| {AT_MOST}", unit, first, last, notch, high, last
        )
        return
    both = bool(np.isfinite(high - low))
    middle = (low + high) / 2
    if np.isfinite(low):
        span = high - low if both else max(abs(low), size)
        first, last, notch = notches(low - span, low, middle - span / NOTCHES if both else low + span)
        key = f"{signal.word}lower.{j}"
        yield Slider(key, signal.group, f"{label} {AT_LEAST}", unit, first, last, notch, low, first)
    if np.isfinite(high):
        span = high - low if both else max(abs(high), size)
        first, last, notch = notches(middle + span / NOTCHES if both else high - span, high, high + span)
        key = f"{signal.word}upper.{j}"
        yield Slider(key, signal.group, f"{label} {AT_MOST}", unit, first, last, notch, high, last)


def _row_sliders(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the limit of every family of joint rows: a number where all are the same, else a part of the own."""
    for i, rows in enumerate(problem.stage_rows):
        limits = rows.e[np.isfinite(rows.e)]
        if not limits.size or limits.min() < 0 or not limits.any():
            continue
        same = bool((limits == limits[0]).all())
        value, unit = (float(limits[0]), _rows_unit(problem, rows)) if same else (100.0, "%")
        first, last, notch = notches(LEAST_PART * value, value, LARGEST_PART * value)
        label = f"{rows.name} {AT_MOST}" if same else f"limits of {rows.name}"
        yield Slider(f"rows.{i}", "rows", label, unit, first, last, notch, value, last)


def _rows_unit(problem: OptimalControlProblem, rows: StageRows) -> str:
    """Return the unit of the rows' values: of sums of components in the same unit; else empty."""
    parts = [matrix.reshape(-1, matrix.shape[-1]) for matrix in (rows.C, rows.D)]
    used = np.concatenate([np.abs(part).max(axis=0) > 0 for part in parts])
    names = zip((*problem.state_names, *problem.control_names), used, strict=True)
    units = {split_unit(name)[1] for name, in_rows in names if in_rows}
    sums = all(np.isin(part, (-1, 0, 1)).all() for part in parts)
    return units.pop() if len(units) == 1 and sums else ""


def _moved_rows(problem: OptimalControlProblem, moved: Values) -> dict[str, object]:
    """Return the joint rows, if the limits of some are moved."""
    factors = {one.key: moved[one.key] / one.value for one in _row_sliders(problem) if one.key in moved}
    scaled = [
        StageRows(one.C, one.D, one.e * factors.get(f"rows.{i}", 1.0), one.name, one.penalty)
        for i, one in enumerate(problem.stage_rows)
    ]
    return {"stage_rows": scaled} if factors else {}


BOUNDS, ROWS = Movable(_bound_sliders, sets_at), Movable(_row_sliders, _moved_rows)
