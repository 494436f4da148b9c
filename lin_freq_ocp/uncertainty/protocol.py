"""Plans that hold for every load and every plant of a set: the tightened problem, and the worst case of a plan."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import ClassVar, Literal

import numpy as np

from lin_freq_ocp.base.activity import activity
from lin_freq_ocp.base.archives import FileValue
from lin_freq_ocp.base.arrays import Array, assign, brief
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.uncertainty.worst_loads import WorstCase

SPECTRA = "state_spectrum", "control_spectrum", "output_spectrum"
LIMITED = "state_set", "control_set", "terminal_state", "stage_rows", *SPECTRA


class Uncertainty(ABC):
    """What is uncertain about a problem."""

    table: ClassVar[str] = ""  # of problem files, which holds it; empty if none can

    @abstractmethod
    def plan_limits(self, problem: OptimalControlProblem, end: Literal["invariant"] | None) -> Mapping[str, object]:
        """Return the fields in which the problem whose plans hold for all cases differs from a given one."""

    @abstractmethod
    def worst(self, problem: OptimalControlProblem, plan: Trajectory, solved: Outcome | None) -> WorstCase:
        """Return what the worst case does to a plan, by the given limits; with the outcome that it is of, if any."""

    @property
    def stated(self) -> dict[str, object]:
        """Return what problem files say of it, by their keys; empty if they cannot hold it."""
        return {self.table: self} if self.table else {}

    def require_plain(self, problem: OptimalControlProblem, end: object) -> None:
        """Raise UnsupportedError unless cost and rows are quadratic and linear, and no invariant end is asked for."""
        if end is not None:
            name = type(self).__name__
            raise UnsupportedError(f"end: got 'invariant' with {name}; expected None, or a Disturbance.")
        if problem.cost.norms or problem.cost.has_formulas or problem.path_constraints:
            got = "cost, stage_rows: got norms or formulas"
            raise UnsupportedError(f"{got}; expected a quadratic cost and linear rows.")


@dataclass(frozen=True, eq=False, init=False, repr=False)
class RobustProblem(OptimalControlProblem):
    """An ordinary problem with the limits of ``robust``, and what it is made of, which ``replace`` keeps.

    Attributes
    ----------
    given : OptimalControlProblem
        With the limits as they were given, which ``worst_case`` judges.
    uncertainty : Disturbance, Plants or Discs
    end : "invariant" or None

    Examples
    --------
    >>> problem = lfo.library.double_integrator(cutoff_hz=None, terminal_state=None)
    >>> plans = lfo.robust(problem, lfo.Disturbance(lfo.Box(-1e-3, 1e-3), input=[[0.0], [1.0]]))
    >>> plans.given is problem
    True
    """

    given: OptimalControlProblem
    uncertainty: Uncertainty
    end: Literal["invariant"] | None
    limits: Mapping[str, object]  # the fields as ``robust`` made them

    def __init__(
        self,
        given: OptimalControlProblem,
        uncertainty: Uncertainty,
        end: Literal["invariant"] | None,
        limits: Mapping[str, object] | None = None,
        **of_problem: FileValue,
    ):
        super().__init__(**of_problem)
        made = {field.name: getattr(self, field.name) for field in fields(OptimalControlProblem)}
        assign(self, given=given, uncertainty=uncertainty, end=end, limits=limits or made)

    @property
    def as_made(self) -> bool:
        """Return whether all fields are those that ``robust`` made, and none was replaced."""
        return all(getattr(self, name) is value for name, value in self.limits.items())

    def margin_at(self, block: str, times: Sequence[int]) -> float:
        """Return by how much ``robust`` has tightened a limit at some times at most; 0 if limits were replaced."""
        if any(getattr(self, name) is not value for name, value in self.limits.items() if name in LIMITED):
            return 0.0
        given, tight = (_limits_at(problem, block, list(times)) for problem in (self.given, self))
        with np.errstate(invalid="ignore"):
            less = given - tight if given.shape == tight.shape else np.zeros(0)
        return float(less[np.isfinite(less)].max(initial=0.0))


def _limits_at(problem: OptimalControlProblem, block: str, times: list[int]) -> Array:
    """Return the limits of a block of a conflict at some times, or bins, lower ones multiplied by -1."""
    of_end, found = problem.terminal_box, dict[str, Array]()
    found["terminal state"] = np.concatenate([of_end.upper, -of_end.lower])
    states, controls = (problem.state_names, problem.state_boxes), (problem.control_names, problem.control_tube)
    for kind, (names, box) in (("state", states), ("control", controls)):
        for name, lower, upper in zip(names, box.lower.T, box.upper.T, strict=True):
            if block == f"{kind} bound on {name}":
                found[block] = np.concatenate([upper[times], -lower[times]])
    for rows in problem.stage_rows:
        e = np.broadcast_to(rows.e, (problem.horizon, rows.rows))
        found |= {
            f"row {i} of {rows.name}": e[times, i] for i in range(rows.rows) if f"row {i} of {rows.name}" == block
        }
    for term in problem.terms:
        if term.name == block and not term.kind.is_rows:
            limits, acting = term.penalty.bounds(term.shape)[1], np.isin(term.map.positions, times)
            found[block] = limits[acting] if len(limits) == len(acting) else limits
    return found.get(block, np.zeros(0))


@activity("computing margins")
@one_blas_thread
def robust(
    problem: OptimalControlProblem, uncertainty: Uncertainty, end: Literal["invariant"] | None = None
) -> RobustProblem:
    """Return an ordinary problem whose plans satisfy all limits of the given one, whatever the loads or the plant.

    The problem keeps its size; bounds, joint rows, polyhedra and masks at bins are tightened by margins. Solvers, loops
    and generated C take it as any other.

    Parameters
    ----------
    problem : OptimalControlProblem
        Of linear dynamics without modes, formulas or levels.
    uncertainty : Disturbance, Plants or Discs
    end : "invariant", optional
        Plans of a ``Disturbance`` end in a set of rows from which they continue for ever, whatever the loads: then
        every step of a receding horizon has a plan. The terminal state must be free, and all limits constant.

    Returns
    -------
    RobustProblem
        An OptimalControlProblem that knows what it is made of.

    Raises
    ------
    ProblemError
        If the problem has margins already, the uncertainty does not fit it, or its margins exceed the range of a limit.
    UnsupportedError
        If the problem has modes, formulas, levels, or balls or cones of uncertain signals.

    Warns
    -----
    ClosedLoopWarning
        Where a limit holds for the plan only: fixed and linked ends, stop bands of signals that loads change.

    Examples
    --------
    >>> problem = lfo.library.double_integrator(cutoff_hz=None, terminal_state=None)
    >>> load = lfo.Disturbance(lfo.Box(-1e-3, 1e-3), input=[[0.0], [1.0]])
    >>> plan = lfo.solve(lfo.robust(problem, load))
    >>> bool(lfo.worst_case(problem, load, plan))
    True
    """
    require_problem(problem)
    if end not in (None, "invariant"):
        raise ProblemError("end", brief(end), "'invariant' or None")
    if problem.uncertainty is not None:
        advice = "problem.given has the limits without margins."
        raise ProblemError("problem", "one of robust, with margins", "one without", advice)
    changes = _require_uncertainty(uncertainty).plan_limits(problem, end)
    given = {field.name: getattr(problem, field.name) for field in fields(OptimalControlProblem)}
    return RobustProblem(problem, uncertainty, end, None, **{**given, **changes})


@activity("looking for the worst case")
@one_blas_thread
def worst_case(problem: OptimalControlProblem, uncertainty: Uncertainty, plan: Trajectory | Outcome) -> WorstCase:
    """Return what the worst load or plant does to a plan, limit by limit, with a proof and a simulation.

    Parameters
    ----------
    problem : OptimalControlProblem
        As it was given to ``robust``, not the tightened problem.
    uncertainty : Disturbance, Plants or Discs
    plan : Trajectory or Result
        From any tool.

    Returns
    -------
    WorstCase
        Print it for a table.

    Raises
    ------
    ProblemError
        If the plan or the uncertainty does not fit the problem.

    Examples
    --------
    >>> problem = lfo.library.double_integrator(terminal_state=None)
    >>> load = lfo.Disturbance(lfo.Box(-1e-3, 1e-3), input=[[0.0], [1.0]], gain=[[-1.0, -1.8]])
    >>> worst = lfo.worst_case(problem, load, lfo.solve(problem))
    >>> worst["acceleration, upper"].index, round(worst["acceleration, upper"].attained, 4)
    (199, 0.0625)
    """
    require_problem(problem)
    trajectory = getattr(plan, "trajectory", plan)
    if not isinstance(trajectory, Trajectory):
        raise ProblemError("plan", brief(plan), "a Trajectory, or a result with one")
    return _require_uncertainty(uncertainty).worst(problem, trajectory, plan if isinstance(plan, Outcome) else None)


def _require_uncertainty(given: object) -> Uncertainty:
    if not isinstance(given, Uncertainty):
        advice = "Loads in a box are lfo.Disturbance(lfo.Box(lower, upper))."
        raise ProblemError("uncertainty", brief(given), "a Disturbance, Plants or Discs", advice)
    return given
