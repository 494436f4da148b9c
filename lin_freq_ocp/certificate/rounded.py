"""Whether a trajectory was printed with a few decimals: then rounding is what its residuals come from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.trajectory import Trajectory

MOST_DECIMALS = 8
"""Numbers with more are as computed."""

LEAST_SAMPLES = 4
"""Values that are not zero, below which few decimals are chance."""


@dataclass(frozen=True)
class Rounded:
    """What the rounding of a trajectory explains.

    Attributes
    ----------
    decimals : int
        All states and controls are whole multiples of 10^-decimals.
    satisfied_to : float
        The least of 1e-5, 1e-4, 1e-3, 1e-2 that all conditions of the maximum principle are satisfied to.
    """

    decimals: int
    satisfied_to: float

    def __str__(self) -> str:
        level = round(-np.log10(self.satisfied_to))
        return (
            f"satisfied to 1e-{level}: the trajectory has {self.decimals} decimals, "
            "and rounding is the likely reason for the rest"
        )


def decimals_of(trajectory: Trajectory) -> int | None:
    """Return how many decimals the states and controls have, or None where they have more than MOST_DECIMALS."""
    values = np.concatenate([trajectory.x.ravel(), trajectory.u.ravel()])
    values = values[values != 0]
    if len(values) < LEAST_SAMPLES:
        return None
    return next((count for count in range(MOST_DECIMALS + 1) if _has_decimals(values, count)), None)


def _has_decimals(values: Array, count: int) -> bool:
    return bool((np.round(values, count) == values).all())
