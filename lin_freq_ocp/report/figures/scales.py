"""Units of the time and frequency axes, chosen so that their numbers are easy to read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.problem.ocp import OptimalControlProblem


@dataclass(frozen=True)
class Scale:
    """What to multiply by (steps, or rad/sample) to get the unit; ``label`` names the axis."""

    factor: float
    unit: str
    label: str


def time_scale(problem: OptimalControlProblem) -> Scale:
    """Return the scale from steps to seconds, or steps themselves without a sampling time."""
    step = problem.sampling_time
    if step is None:
        return Scale(1.0, "steps", "step t")
    total = step * problem.horizon
    factor, unit = (1e6, "\N{MICRO SIGN}s") if total < 1e-3 else (1e3, "ms") if total < 1 else (1.0, "s")
    return Scale(factor * step, unit, f"time [{unit}]")


def frequency_scale(problem: OptimalControlProblem) -> Scale:
    """Return the scale from rad/sample to Hz, as cut-offs are given, or rad/sample itself without a sampling time."""
    step = problem.sampling_time
    if step is None:
        return Scale(1.0, "rad/sample", "frequency [rad/sample]")
    return Scale(1 / (2 * np.pi * step), "Hz", "frequency [Hz]")
