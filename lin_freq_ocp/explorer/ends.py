"""What can be moved of the ends: the components of those that are points, within the bounds of the states."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

import numpy as np

from lin_freq_ocp.analysis.sizes import stated_sizes
from lin_freq_ocp.arrays import Array
from lin_freq_ocp.explorer.slider import Movable, Slider, Values, notches
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.text.phrases import split_unit

MOST_STATES = 12  # of problems with more, ends have no sliders
WORDS = {"initial_state": "initial", "terminal_state": "terminal"}


def _sliders(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the components of ends that are points."""
    if problem.state_dim > MOST_STATES:
        return
    boxes, sizes = problem.state_boxes, stated_sizes(problem)[0]
    for field, end in _points(problem):
        for i, name in enumerate(problem.state_names):
            (label, unit), value = split_unit(name), float(end.lower[i])
            low, high = (float(bound[0 if field == "initial_state" else -1, i]) for bound in (boxes.lower, boxes.upper))
            reach = max(2 * abs(value), float(sizes[i]))
            low, high = (low if isfinite(low) else -reach), (high if isfinite(high) else reach)
            if low <= value <= high and low < high:
                first, last, notch = notches(low, value, high)
                yield Slider(f"{field}.{i}", field, f"{WORDS[field]} {label}", unit, first, last, notch, value, value)


def ends_at(problem: OptimalControlProblem, moved: Values) -> dict[str, Array]:
    """Return the ends of which a component is moved, (n,)."""
    ends = dict[str, Array]()
    for field, end in _points(problem):
        if any(key.startswith(f"{field}.") for key in moved):
            ends[field] = np.array([moved.get(f"{field}.{i}", value) for i, value in enumerate(end.lower)])
    return ends


def _points(problem: OptimalControlProblem) -> Iterator[tuple[str, Box]]:
    for field, end in zip(WORDS, (problem.initial_box, problem.terminal_box), strict=True):
        if end.fixed.all():
            yield field, end


ENDS = Movable(_sliders, ends_at)
