"""What every method returns: a point with multipliers, measured but never judged."""

from __future__ import annotations

from dataclasses import dataclass, field

from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.program import Residuals


@dataclass(frozen=True, eq=False)
class Candidate:
    """What a method found, measured but not judged."""

    status: str  # "optimal", "infeasible" (claimed), "unbounded", "limit" or "numerical_error"
    trajectory: Trajectory | None = None
    multipliers: Multipliers | None = None
    ray: Multipliers | None = None  # claimed Farkas ray
    residuals: Residuals | None = None  # in scaled units
    message: str = ""  # the backend's own status, or why the method stopped
    seconds: dict[str, float] = field(default_factory=dict[str, float])  # wall times of "setup" and "solve"
    interrupted: bool = False  # by Ctrl-C
    descent: Trajectory | None = None  # if unbounded: a claimed direction (dx, du) of unlimited descent
