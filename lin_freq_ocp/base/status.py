"""The statuses of a solve; proven and claimed answers never share one."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """How a solve ended.

    Every value equals its text, ``result.status == "optimal"``, which files and ``--json`` hold, too.

    Attributes
    ----------
    OPTIMAL
        Feasible, and globally optimal: proven by a rigorous lower bound.
    LOCALLY_OPTIMAL
        The maximum principle is satisfied with normal multipliers; no global bound proves more.
    INFEASIBLE
        No trajectory satisfies all constraints: proven; ``result.bound`` is "numerical" where the proof excludes
        trajectories of practical size alone.
    INFEASIBLE_CLAIMED
        A solver says that there is no trajectory; no proof of it holds.
    UNBOUNDED
        The cost has no lower bound: proven by a direction of descent.
    LIMIT
        A limit of time, iterations or nodes was reached, or the solve was interrupted.
    NUMERICAL_ERROR
        The method ended at a point that does not satisfy the maximum principle, or at none.

    Examples
    --------
    >>> lfo.results.Status.OPTIMAL == "optimal", lfo.results.Status("limit").solved
    (True, False)
    """

    OPTIMAL = "optimal"
    LOCALLY_OPTIMAL = "locally_optimal"
    INFEASIBLE = "infeasible"
    INFEASIBLE_CLAIMED = "infeasible_claimed"
    UNBOUNDED = "unbounded"
    LIMIT = "limit"
    NUMERICAL_ERROR = "numerical_error"

    @property
    def solved(self) -> bool:
        """Whether there is a trajectory that satisfies the maximum principle."""
        return self in (Status.OPTIMAL, Status.LOCALLY_OPTIMAL)

    def __repr__(self) -> str:
        return repr(self.value)
