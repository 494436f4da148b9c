"""Numbers that can be moved, and the frequencies on which they lie."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

NOTCHES = 100  # of the range of a number, about
MOST_BINS = 200  # of a range of frequencies that are steps of their own: horizons of up to 400


@dataclass(frozen=True, eq=False)
class Number:
    """A value of a limit, usually from ``low`` to ``high``, in steps if these are given.

    ``put`` returns its owner with another value: a set, rows, a frequency constraint, or, of ``limits.numbers``, the
    field of a problem. In the key of a number of a frequency constraint, {} stands for the position of the constraint.
    """

    key: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    direction: int  # in which the problem gets easier: 1, -1, or 0 for neither
    put: Callable[..., object]
    step: float = 0.0
    field: str = ""  # of the problem


@dataclass(frozen=True)
class Axis:
    """The scale of frequencies: their unit (Hz with a sampling time), the Nyquist frequency, and a step."""

    unit: str
    nyquist: float
    step: float

    @classmethod
    def of(cls, horizon: int, sampling_time: float | None) -> Axis:
        """Return that of signals over a horizon: a step is one bin."""
        nyquist, unit = (pi, "rad/sample") if sampling_time is None else (0.5 / sampling_time, "Hz")
        return cls(unit, nyquist, max(2 * nyquist / horizon, nyquist / MOST_BINS))

    def per_unit(self, unit: str) -> float:
        """Return the factor from the unit of a band to that of the axis."""
        return 1.0 if unit == self.unit else self.nyquist / pi
