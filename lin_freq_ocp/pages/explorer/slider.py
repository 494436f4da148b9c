"""A slider: a value that can be moved, and its notches.

A slider has notches low, low + step, ..., high, of which one is the problem's own value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from math import floor, log10

from lin_freq_ocp.problem.ocp import OptimalControlProblem

NOTCHES = 100  # of a slider, about
LEAST_PART, LARGEST_PART = 0.1, 3.0  # of the problem's own bounds and limits
ROUNDING = 1e-9  # of a notch, by which a limit may be missed

Values = Mapping[str, float]  # the value of each slider, by its key


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
