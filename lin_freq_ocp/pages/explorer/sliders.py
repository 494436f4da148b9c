"""Sliders: the numbers of a problem that the page moves, in notches.

A slider has notches low, low + step, ..., high, of which one is the problem's own value.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import floor, inf, log10

from lin_freq_ocp.problem.limits import numbers
from lin_freq_ocp.problem.numbers import NOTCHES, Number
from lin_freq_ocp.problem.ocp import OptimalControlProblem

ROUNDING = 1e-9  # of a notch, by which a limit may be missed

# The groups of sliders, and in which order their fields have them.
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
# Components of a signal with more of which a field has no sliders.
MOST_COMPONENTS = {"control_set": 4, "state_set": 12, "initial_state": 12, "terminal_state": 12}


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


def sliders_of_limits(problem: OptimalControlProblem) -> Iterator[Slider]:
    """Yield the sliders of a problem, those of frequencies under different labels."""
    labels, order = Counter[str](), list(GROUP_OF)
    for number in sorted(numbers(problem).values(), key=lambda one: order.index(one.field)):
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
    """Return the first and the last notch of a number, and the step (else a round one), with a notch at its value."""
    step = number.step or _round_step((number.high - number.low) / NOTCHES)
    below, above = (
        floor(distance / step + ROUNDING) for distance in (number.value - number.low, number.high - number.value)
    )
    return number.value - below * step, number.value + above * step, step


def _round_step(size: float) -> float:
    """Return the least of 1, 2, 5 times a power of ten that is no less."""
    power = 10.0 ** floor(log10(size))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= size * (1 - ROUNDING))
