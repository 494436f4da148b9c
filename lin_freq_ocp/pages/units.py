"""Numbers with units in tables and sentences, and the units of the time and frequency axes."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from lin_freq_ocp.base.phrases import LARGE, SMALL, number, power, split_unit
from lin_freq_ocp.problem.ocp import OptimalControlProblem


def align(value: float | None, digits: int = 4) -> str:
    """Return a number with exactly that many significant digits, for a column of numbers; 0 is "0"."""
    if value is None or value == 0 or not SMALL <= abs(value) < LARGE:
        return number(value)
    return number(value) if abs(value) >= 10 ** (digits - 1) else f"{value:#.{digits}g}"


def rough(value: float) -> str:
    """Return a number with two digits, to show its size."""
    return power(value) if 1e3 <= abs(value) < inf else number(value, 2)


def quantity(value: float, name: str, digits: int = 3) -> str:
    """Return a number with the unit of the component of that name."""
    return f"{number(value, digits)} {split_unit(name)[1]}".rstrip()


@dataclass(frozen=True)
class Scale:
    """The factor from steps, or from rad/sample, to a unit; ``label`` names the axis."""

    factor: float
    unit: str
    label: str


TIMES = {"\N{MICRO SIGN}s": 1e-6, "ms": 1e-3, "s": 1.0, "h": 3600.0, "d": 86400.0}  # seconds of a unit
LONGEST = {"\N{MICRO SIGN}s": 1e-3, "ms": 1.0, "s": 7200.0, "h": 10 * 86400.0, "d": inf}
"""The least duration in seconds that is shown in the next unit: two hours, ten days."""


def time_scale(problem: OptimalControlProblem, steps: int | None = None) -> Scale:
    """Return the scale from steps to a unit of time for the horizon, or for so many steps; "steps" without seconds."""
    step, steps = problem.sampling_time, problem.horizon if steps is None else steps
    if step is None:
        return Scale(1.0, "steps", "step t")
    unit = next(unit for unit, longest in LONGEST.items() if step * steps < longest)
    return Scale(step / TIMES[unit], unit, f"time [{unit}]")


def frequency_scale(problem: OptimalControlProblem) -> Scale:
    """Return the scale from rad/sample to Hz; without a sampling time, the unit is rad/sample."""
    step = problem.sampling_time
    if step is None:
        return Scale(1.0, "rad/sample", "frequency [rad/sample]")
    return Scale(1 / (2 * np.pi * step), "Hz", "frequency [Hz]")
