"""The statuses of a solve; proven and claimed answers never share one."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """How a solve ended.

    Every value equals its text, ``result.status == "optimal"``, which files and ``--json`` also hold.

    Attributes
    ----------
    OPTIMAL
        Feasible, and globally optimal: proven by a rigorous lower bound.
    LOCALLY_OPTIMAL
        The maximum principle is satisfied with normal multipliers, and no direction lowers the cost to second order;
        no global bound proves more. Where modes meet, at kinks and in a few other cases the test of second order does
        not apply, which the certificate states.
    EXTREMAL
        The maximum principle is satisfied with normal multipliers, but a direction of second order lowers the cost: a
        saddle or a maximum. Problems with linear dynamics never have it.
    INFEASIBLE
        No trajectory satisfies all constraints: proven by a rigorous ray or by a search tree.
    INFEASIBLE_CLAIMED
        A solver says that there is no trajectory, without a proof. Where its ray excludes trajectories up to a size,
        ``result.bound`` is "numerical", and the message says the size.
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
    EXTREMAL = "extremal"
    INFEASIBLE = "infeasible"
    INFEASIBLE_CLAIMED = "infeasible_claimed"
    UNBOUNDED = "unbounded"
    LIMIT = "limit"
    NUMERICAL_ERROR = "numerical_error"

    @property
    def solved(self) -> bool:
        """Whether there is a trajectory that satisfies the maximum principle."""
        return self in (Status.OPTIMAL, Status.LOCALLY_OPTIMAL, Status.EXTREMAL)

    def __repr__(self) -> str:
        return repr(self.value)
