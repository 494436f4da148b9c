"""Sliders: the numbers of a problem that the page moves, in notches.

A slider has notches low, low + step, ..., high; one of them is the problem's value.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from math import floor, inf, log10

from lin_freq_ocp.problem.numbers import NOTCHES, Number
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transform.limits import numbers

ROUNDING = 1e-9  # of a notch: a limit closer than this to a notch counts as that notch

# The group of the sliders of each field, in the order of the page.
GROUP_OF = {
    "control_spectrum": "frequency",
    "state_spectrum": "frequency",
    "output_spectrum": "frequency",
    "control_set": "bounds",
    "stage_rows": "rows",
    "state_set": "state_bounds",
    "initial_state": "initial_state",
    "terminal_state": "terminal_state",
}
# A field has no sliders if its signal has more components than this.
MOST_COMPONENTS = {"control_set": 4, "state_set": 12, "initial_state": 12, "terminal_state": 12}


@dataclass(frozen=True)
class Slider:
    """A value between ``low`` and ``high`` in ``unit``; ``relaxed`` is the end at which the problem is easiest."""

    key: str
    group: str
    label: str
    unit: str
    low: float
    high: float
    step: float
    value: float  # that of the problem
    relaxed: float

    def notch(self, n: int) -> float:
        """Return the value n notches from that of the problem."""
        return min(max(self.value + n * self.step, self.low), self.high)

    def samples(self, count: int) -> list[tuple[str, float]]:
        """Return the key with each of ``count`` values from end to end, on notches, and with the problem's value."""
        first, last = (round((end - self.value) / self.step) for end in (self.low, self.high))
        notches = {round(first + (last - first) * i / (count - 1)) for i in range(count)} | {0}
        return [(self.key, self.notch(n)) for n in sorted(notches)]


def sliders_of_limits(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the sliders of a problem; labels of frequency sliders are unique."""
    labels, order = Counter[str](), list(GROUP_OF)
    for number in sorted(numbers(problem).values(), key=lambda number: order.index(number.field)):
        components = problem.control_dim if number.field == "control_set" else problem.state_dim
        first, last, step = notches(number)
        if components > MOST_COMPONENTS.get(number.field, inf) or not first < last:
            continue
        labels[number.label] += 1
        count, group = labels[number.label], GROUP_OF[number.field]
        label = f"{number.label} ({count})" if count > 1 and group == "frequency" else number.label
        relaxed = {-1: first, 0: number.value, 1: last}[number.direction]
        yield Slider(number.key, group, label, number.unit, first, last, step, number.value, relaxed)


def notches(number: Number) -> tuple[float, float, float]:
    """Return the first and the last notch of a number and the step, by default a round one; its value is a notch."""
    step = number.step
    if not step:
        size = (number.high - number.low) / NOTCHES
        power = 10.0 ** floor(log10(size))
        step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= size * (1 - ROUNDING))
    below, above = (
        floor(distance / step + ROUNDING) for distance in (number.value - number.low, number.high - number.value)
    )
    return number.value - below * step, number.value + above * step, step
