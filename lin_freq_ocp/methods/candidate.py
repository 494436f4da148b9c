"""What every method returns: a point with multipliers, measured but never judged."""

from __future__ import annotations

from dataclasses import dataclass, field

from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transcription.program import Residuals


@dataclass(frozen=True, eq=False)
class Candidate:
    """What a method found, measured but not judged.

    Attributes
    ----------
    status : str
        "optimal", "infeasible" (claimed: ``ray`` is to be proven), "unbounded", "limit" or "numerical_error".
    trajectory, multipliers : or None
        The point, where there is one, however inaccurate.
    ray : Multipliers or None
        A claimed Farkas ray.
    residuals : Residuals or None
        In scaled units, computed by us.
    words : str
        The backend's own status, or why the method stopped.
    seconds : dict
        Wall time of "setup" (what precedes iterations) and "solve".
    interrupted : bool
        Whether the limit was Ctrl-C.
    descent : Trajectory or None
        If unbounded: a claimed direction (dx, du) along which the cost falls for ever.
    """

    status: str
    trajectory: Trajectory | None
    multipliers: Multipliers | None
    ray: Multipliers | None
    residuals: Residuals | None
    words: str
    seconds: dict[str, float] = field(default_factory=dict[str, float])
    interrupted: bool = False
    descent: Trajectory | None = None
