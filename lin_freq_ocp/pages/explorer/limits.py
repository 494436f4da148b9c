"""What can be moved of limits at every time: bounds of controls and states, and limits of joint rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.phrases import AT_MOST, split_unit
from lin_freq_ocp.pages.explorer.slider import LARGEST_PART, LEAST_PART, NOTCHES, Movable, Slider, Values, notches
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.sizes import stated_sizes

AT_LEAST = "\N{GREATER-THAN OR EQUAL TO}"


@dataclass(frozen=True)
class Bounded:
    """A signal whose bounds can be moved: its field of the problem, the group and first word of its sliders."""

    field: str
    group: str
    word: str  # before "bound.0", "lower.0", "upper.0"
    most: int  # components; of problems with more, bounds have no sliders


SIGNALS = Bounded("control_set", "bounds", "", 4), Bounded("state_set", "state_bounds", "state_", 12)


def _bounds(problem: OptimalControlProblem) -> Iterator[Slider]:
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
                yield from _of_component(signal, j, name, float(low[0]), float(high[0]), float(sizes[j]))


def _of_component(signal: Bounded, j: int, name: str, low: float, high: float, size: float) -> Iterator[Slider]:
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
            _put(lower, j, moved.get(f"{keys['lower']}{j}") if bound is None else -bound)
            _put(upper, j, moved.get(f"{keys['upper']}{j}") if bound is None else bound)
        box = Box(lower, upper)
        sets[signal.field] = Intersection([box, *given.members]) if given.members else box
    return sets


def _put(bounds: Array, j: int, value: float | None) -> None:
    if value is not None:
        bounds[..., j] = value


def _rows(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the limit of every family of joint rows: a number where all are the same, else a part of the own."""
    for i, rows in enumerate(problem.stage_rows):
        limits = rows.e[np.isfinite(rows.e)]
        if not limits.size or limits.min() < 0 or not limits.any():
            continue
        same = bool((limits == limits[0]).all())
        value, unit = (float(limits[0]), _unit(problem, rows)) if same else (100.0, "%")
        first, last, notch = notches(LEAST_PART * value, value, LARGEST_PART * value)
        label = f"{rows.name} {AT_MOST}" if same else f"limits of {rows.name}"
        yield Slider(f"rows.{i}", "rows", label, unit, first, last, notch, value, last)


def _unit(problem: OptimalControlProblem, rows: StageRows) -> str:
    """Return the unit of the rows' values: of sums of components in the same unit; else empty."""
    parts = [matrix.reshape(-1, matrix.shape[-1]) for matrix in (rows.C, rows.D)]
    used = np.concatenate([np.abs(part).max(axis=0) > 0 for part in parts])
    names = zip((*problem.state_names, *problem.control_names), used, strict=True)
    units = {split_unit(name)[1] for name, in_rows in names if in_rows}
    sums = all(np.isin(part, (-1, 0, 1)).all() for part in parts)
    return units.pop() if len(units) == 1 and sums else ""


def _stage_rows(problem: OptimalControlProblem, moved: Values) -> dict[str, object]:
    """Return the joint rows, if the limits of some are moved."""
    factors = {one.key: moved[one.key] / one.value for one in _rows(problem) if one.key in moved}
    scaled = [
        StageRows(one.C, one.D, one.e * factors.get(f"rows.{i}", 1.0), one.name, one.penalty)
        for i, one in enumerate(problem.stage_rows)
    ]
    return {"stage_rows": scaled} if factors else {}


BOUNDS, ROWS = Movable(_bounds, sets_at), Movable(_rows, _stage_rows)
