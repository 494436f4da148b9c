"""The filter of a line search (Waechter and Biegler, 2006): pairs of infeasibility theta and objective phi."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

IMPROVED = 1e-5  # share of the infeasibility by which either is to fall
ARMIJO = 1e-4  # share of the predicted decrease of the objective
FEASIBLE, FAR = 1e-4, 1e4  # infeasibilities, relative to the first, of steps for the objective, and never exceeded
SLOPE_POWER, INFEASIBILITY_POWER = 2.3, 1.1  # of the switching condition
ROUNDING = 1e-13  # of the objective


@dataclass(frozen=True)
class Measure:
    """Infeasibility and objective of a point."""

    theta: float
    phi: float


@dataclass(eq=False)
class Filter:
    """What trial points are compared with; ``first`` is the infeasibility of the first point."""

    first: float
    entries: list[Measure] = field(default_factory=list[Measure])

    def accepts(self, trial: Measure) -> bool:
        """Whether a point improves on every point of the filter."""
        near = trial.theta <= FAR * max(1.0, self.first) and bool(np.isfinite(trial.phi))
        return near and all(trial.theta < one.theta or trial.phi < one.phi for one in self.entries)

    def takes(self, here: Measure, trial: Measure, slope: float, length: float) -> bool:
        """Whether a step of a length leads to an acceptable point; then the filter knows where it began.

        ``slope`` is the predicted change of the objective by a full step.
        """
        rounding = ROUNDING * abs(here.phi)
        if not self.accepts(Measure(trial.theta, trial.phi - rounding)):
            return False
        if self._for_objective(here, slope, length):
            return trial.phi <= here.phi + ARMIJO * length * slope + rounding
        less = trial.theta <= (1 - IMPROVED) * here.theta
        if not less and trial.phi > here.phi - IMPROVED * here.theta + rounding:
            return False
        self.add(here)
        return True

    def add(self, here: Measure) -> None:
        """Exclude what does not improve on a point."""
        self.entries.append(Measure((1 - IMPROVED) * here.theta, here.phi - IMPROVED * here.theta))

    def _for_objective(self, here: Measure, slope: float, length: float) -> bool:
        """Whether the predicted decrease of the objective outweighs the infeasibility."""
        if slope >= 0 or here.theta > FEASIBLE * max(1.0, self.first):
            return False
        return length * (-slope) ** SLOPE_POWER > here.theta**INFEASIBILITY_POWER
