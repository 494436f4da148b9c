"""The options and the answers of methods, the checks before one begins, and the order of answers.

A candidate is a point with multipliers, or a ray: the method measures it, and the judge decides.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum, auto

import numpy as np

from lin_freq_ocp.base.arrays import NO_BOUND
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.program import Residuals
from lin_freq_ocp.transform.response_curvature import require_convex_bins

SOLVED_TOLERANCE = 1e-6  # relative residuals up to which a method's "solved" is accepted, in units of the answer


@dataclass(frozen=True)
class Progress:
    """The progress of a search, which long solves report.

    Attributes
    ----------
    cost, lower_bound : float
        Of the best trajectory found, and of all; infinite as long as there is none.
    """

    cost: float
    lower_bound: float


@dataclass(frozen=True)
class SolveOptions:
    """The options of a method for linear dynamics.

    Attributes
    ----------
    tolerance : float or None
        Relative residuals to stop at; None for those of the method.
    time_limit : float or None
        Seconds from the call on.
    compiled : bool
        Whether loops run in C, where there is a compiler.
    """

    tolerance: float | None = None
    time_limit: float | None = None
    compiled: bool = True


DEFAULTS = SolveOptions()


@dataclass(frozen=True, eq=False)
class Candidate:
    """The answer of a method, measured but not judged: its status is a claim, which the judge verifies."""

    status: Status
    trajectory: Trajectory | None = None
    multipliers: Multipliers | None = None
    ray: Multipliers | None = None  # claimed Farkas ray
    residuals: Residuals | None = None  # in scaled units
    message: str = ""  # the backend's own status, or why the method stopped
    seconds: dict[str, float] = field(default_factory=dict[str, float])  # wall times of "setup" and "solve"
    interrupted: bool = False  # by Ctrl-C
    descent: Trajectory | None = None  # if unbounded: the claimed direction (dx, du) of descent


class Reason(IntEnum):
    """Why another answer is asked for after one, or none; the larger one is preferred.

    Attributes
    ----------
    REFUSED
        The method does not take the problem.
    STOPPED
        A limit of time or steps, or Ctrl-C; no other answer follows.
    FAILED
        There is no trajectory that satisfies every constraint; of two such answers, the less violation is preferred.
    CLAIMED
        A ray claims that there is no trajectory. It excludes those up to a size, and a feasible one refutes it.
    FEASIBLE
        There is a trajectory that satisfies every constraint, but no local optimum.
    LOCALLY_OPTIMAL
        No bound proves the local optimum.
    UNBOUNDED
        The cost decreases without bound, if there is a trajectory; none is known.
    NEARLY_FEASIBLE
        Rounding of the data may explain the proof that there is no trajectory.
    MULTIPLIERS
        The optimum is proven, but its multipliers fail a condition that others satisfy.
    PROVEN
        The answer is proven; no other one follows.

    Examples
    --------
    >>> lfo.results.Reason.PROVEN > lfo.results.Reason.LOCALLY_OPTIMAL
    True
    """

    REFUSED = auto()
    STOPPED = auto()
    FAILED = auto()
    CLAIMED = auto()
    FEASIBLE = auto()
    LOCALLY_OPTIMAL = auto()
    UNBOUNDED = auto()
    NEARLY_FEASIBLE = auto()
    MULTIPLIERS = auto()
    PROVEN = auto()

    def __str__(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class Attempt:
    """One answer that was tried, or one method that refused the problem.

    Attributes
    ----------
    method : str
        The shorthand of the method, with its backend if it has one.
    status : Status or None
        How it ended; None if there was nothing to judge, or the best of several local searches is judged.
    reason : Reason
        Why another answer followed, or none.
    message : str
        What the answer says about its end.

    Examples
    --------
    >>> print(*lfo.solve(lfo.library.double_integrator()).attempts)
    spectral: optimal (proven)
    """

    method: str
    status: Status | None
    reason: Reason
    message: str = ""

    def __str__(self) -> str:
        ending = str(self.reason) if self.status is None else f"{self.status} ({self.reason})"
        return f"{self.method}: {ending}" + (f", {self.message}" if self.message else "")


def require_convex(problem: OptimalControlProblem) -> None:
    """Raise UnsupportedError, with the time or the bins and the eigenvalue, unless the cost is convex."""
    if problem.response is not None:
        require_convex_bins(problem, problem.response)
        return
    worst = problem.quadratic.nonconvexity()
    if worst is not None:
        where = "P" if worst[0] < 0 else f"[[Q, S], [S', R]] at t = {worst[0]}"
        raise UnsupportedError(
            f"cost: {where} has the eigenvalue {worst[1]:g}; expected a positive semidefinite matrix. "
            "lfo.costs.SmoothCost takes nonconvex costs, and certify() judges trajectories of them."
        )


def contradiction_at_ends(problem: OptimalControlProblem) -> Multipliers | None:
    """Return a Farkas ray of one hard row on x_0 or x_T that no point of that end satisfies, or None."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    for t, end in zip((0, T), problem.ends, strict=True):
        for term in problem.terms:
            rows = term.polyhedron(n, m)
            if rows is None or t not in rows.times or rows.C[..., n:].any():
                continue
            k = int(np.flatnonzero(rows.times == t)[0])
            C = rows.matrix(k)[:, :n]
            nearest = np.clip(np.where(C > 0, end.lower, end.upper), -NO_BOUND, NO_BOUND)
            violation = np.where(C == 0, 0.0, C * nearest).sum(1) - rows.e[k]
            row = int(np.argmax(violation))
            if violation[row] <= 0:
                continue
            weights = {term.name: np.zeros(term.shape) for term in problem.terms}
            weights[term.name][k, row] = 1.0
            mu = np.zeros((T + 1, n))
            mu[t] = -C[row]
            return replace(zero_multipliers(problem, 0.0), mu=mu, stage=weights)
    return None


def zero_multipliers(problem: OptimalControlProblem, eta_C: float) -> Multipliers:
    """Return multipliers that are zero but for eta_C."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    rho_u, rho_x = (np.zeros(stop.shape) for stop in (problem.control_stop, problem.state_stop))
    return Multipliers(eta_C, np.zeros((T, n)), np.zeros((T + 1, n)), np.zeros((T, m)), rho_u, rho_x)
