"""What can be moved of the ends: their components that are fixed, within the bounds of the states."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

import numpy as np

from lin_freq_ocp.base.phrases import split_unit
from lin_freq_ocp.pages.explorer.slider import Movable, Slider, Values, notches
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sizes import stated_sizes

MOST_STATES = 12  # of problems with more, ends have no sliders
WORDS = {"initial_state": "initial", "terminal_state": "terminal"}


def _sliders(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the fixed components of ends."""
    if problem.state_dim > MOST_STATES:
        return
    boxes, sizes = problem.state_boxes, stated_sizes(problem)[0]
    for field, end in _boxes(problem):
        for i, name in enumerate(problem.state_names):
            (label, unit), value = split_unit(name), float(end.lower[i])
            low, high = (float(bound[0 if field == "initial_state" else -1, i]) for bound in (boxes.lower, boxes.upper))
            reach = max(2 * abs(value), float(sizes[i]))
            low, high = (low if isfinite(low) else -reach), (high if isfinite(high) else reach)
            if end.fixed[i] and low <= value <= high and low < high:
                first, last, notch = notches(low, value, high)
                yield Slider(f"{field}.{i}", field, f"{WORDS[field]} {label}", unit, first, last, notch, value, value)


def ends_at(problem: OptimalControlProblem, moved: Values) -> dict[str, Box]:
    """Return the ends of which a component is moved."""
    ends = dict[str, Box]()
    for field, end in _boxes(problem):
        values = {i: moved[key] for i in range(problem.state_dim) if (key := f"{field}.{i}") in moved}
        if values:
            lower, upper = np.array(end.lower), np.array(end.upper)
            lower[list(values)] = upper[list(values)] = list(values.values())
            ends[field] = Box(lower, upper)
    return ends


def _boxes(problem: OptimalControlProblem) -> Iterator[tuple[str, Box]]:
    """Yield the ends that are boxes."""
    for field, end in zip(WORDS, (problem.initial_box, problem.terminal_box), strict=True):
        if not getattr(problem, field).members:
            yield field, end


ENDS = Movable(_sliders, ends_at)
