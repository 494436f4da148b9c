"""The judgement of a trajectory: every condition of the theorem, and the global bound."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.analysis.sizes import GAP_TOLERANCE, cost_scale
from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.bound import Bound, lower_bound
from lin_freq_ocp.certificate.conditions import CONDITION_TOLERANCE, Condition, all_conditions, worth_of_residuals
from lin_freq_ocp.certificate.directions import Direction
from lin_freq_ocp.certificate.hamiltonian import lift
from lin_freq_ocp.certificate.modes.clarke import BorderFacts
from lin_freq_ocp.certificate.modes.conditions import judge_modes
from lin_freq_ocp.certificate.modes.smooth import judge_smooth
from lin_freq_ocp.certificate.rounded import Rounded
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.html import html_table
from lin_freq_ocp.problem.dynamics.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.status import Status

FEASIBILITY_LABELS = ("state equation", "C-vi", "C-vii", "S-x", "S-u", "S-z", "S-yhat", "S-f")


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proven of a trajectory with multipliers.

    Attributes
    ----------
    pmp : str
        "satisfied", "violated" or "not_applicable" (the map jumps across a border of modes: see ``borders``).
    normal : bool or None
        Whether eta_C = 1.
    conditions : tuple of Condition
        All that was checked, in the paper's order.
    cost : float
        J of the trajectory.
    cost_scale : float
        S, what the terms of the cost add up to in absolute value: what the gap is relative to.
    worth_of_residuals : float
        What residuals of constraints are worth, at their multipliers: to first order, what the cost owes to them.
    bound : Bound or None
        The global lower bound; None if the cost is not convex, eta_C is not 1, or the dynamics have modes: then a
        search over modes may add one, ``dataclasses.replace(certificate, bound=Bound(value, kind, sets=...))``.
    descent : Direction or None
        A verified direction of descent. Of a linear problem, it shows that no normal multipliers exist; where modes
        meet, it leads into the flip of ``borders`` that improves, and the trajectory is no local minimum.
    borders : BorderFacts or None
        What holds where modes meet; None for linear dynamics.
    rounded : Rounded or None
        If the maximum principle is violated and rounding of the trajectory explains it: to how much it is satisfied.
    """

    pmp: str
    normal: bool | None
    conditions: tuple[Condition, ...]
    cost: float
    cost_scale: float
    worth_of_residuals: float
    bound: Bound | None
    descent: Direction | None = None
    borders: BorderFacts | None = None
    rounded: Rounded | None = None

    @property
    def lower_bound(self) -> float | None:
        """Return D, a lower bound on the cost of every feasible trajectory (numerical: of those in its box)."""
        return None if self.bound is None or not np.isfinite(self.bound.value) else self.bound.value

    @property
    def gap(self) -> float | None:
        """Return (J - D) / S; 0 where both J - D and S are zero."""
        if self.lower_bound is None:
            return None
        difference = self.cost - self.lower_bound
        return 0.0 if difference == 0 else difference / self.cost_scale if self.cost_scale > 0 else np.inf

    @property
    def allowed_gap(self) -> float:
        """Return the largest J - D of a trajectory that counts as globally optimal."""
        return GAP_TOLERANCE * self.cost_scale

    @property
    def stage_gaps(self) -> Array | None:
        """Return what each stage adds to J - D, shape (T+1,)."""
        return None if self.bound is None else self.bound.stage_gaps

    @property
    def feasible(self) -> bool:
        """Whether every constraint of the problem holds within tolerance."""
        return all(
            condition.passed
            for condition in self.conditions
            if condition.label in FEASIBILITY_LABELS or condition.name in FEASIBILITY_LABELS
        )

    @property
    def globally_optimal(self) -> bool:
        """Whether the trajectory is feasible and its gap to a rigorous bound is within GAP_TOLERANCE."""
        return self.proven_within(GAP_TOLERANCE)

    def proven_within(self, gap: float) -> bool:
        """Whether the trajectory is feasible and its cost proven to be within ``gap`` of the least, relative to S.

        A numerical bound says nothing of what lies outside its box, and proves nothing. Residuals must not be worth
        more than the gap, either, nor the cost be below the bound by more: then residuals pay for it.
        """
        if self.bound is None or self.gap is None or self.bound.kind != "rigorous" or not self.feasible:
            return False
        return abs(self.gap) <= gap and self.worth_of_residuals <= gap * self.cost_scale

    def within(self, tolerance: float) -> Certificate:
        """Return the certificate with another tolerance of its conditions; what is said of borders stays."""
        conditions = tuple(one.within(tolerance) for one in self.conditions)
        pmp = self.pmp if self.pmp == "not_applicable" else _principle(conditions)
        return replace(self, conditions=conditions, pmp=pmp)

    def status_within(self, gap: float) -> Status:
        """Return OPTIMAL, as ``proven_within`` says, else LOCALLY_OPTIMAL or NUMERICAL_ERROR.

        Locally optimal means that the maximum principle is satisfied with normal multipliers: where the dynamics are
        linear, no feasible direction lowers the cost to first order; where they have modes, it is necessary only.
        """
        if self.proven_within(gap):
            return Status.OPTIMAL
        extremal = self.pmp == "satisfied" and self.normal
        return Status.LOCALLY_OPTIMAL if extremal else Status.NUMERICAL_ERROR

    @property
    def failed(self) -> tuple[Condition, ...]:
        """Return the conditions that do not hold."""
        return tuple(condition for condition in self.conditions if not condition.passed)

    @property
    def worst(self) -> Condition:
        """Return the condition with the largest residual relative to its scale."""
        return max(self.conditions, key=lambda condition: condition.relative)

    def __str__(self) -> str:
        kind = "" if self.bound is None else f" ({self.bound.kind})"
        worst, normal = self.worst, "normal" if self.normal else "abnormal"
        lines = [
            f"cost      {self.cost:.12g}",
            f"bound     {_number(self.lower_bound)}{kind}",
            f"gap       {_number(self.gap, '.2e')}" + (" (global optimum)" if self.globally_optimal else ""),
            f"theorem   {self.pmp}, {normal}",
            f"worst     {worst.relative:.1e} relative, {worst.label} {worst.name}",
        ]
        lines += [] if self.rounded is None else [f"rounding  {self.rounded}"]
        return "\n".join([*lines, *([] if self.borders is None else [f"borders   {self.borders}"])])

    def __repr__(self) -> str:
        verdict = "globally optimal" if self.globally_optimal else "feasible" if self.feasible else "not feasible"
        return f"Certificate({verdict}, theorem {self.pmp}, {self.figures})"

    def _repr_html_(self) -> str:
        lines = [line.partition(" ")[::2] for line in str(self).splitlines()]
        rows = [(term, text.strip()) for term, text in lines]
        rows += [(one.label, f"fails: {one.name}, {one.relative:.1e} relative") for one in self.failed]
        return html_table("Certificate", rows)

    @property
    def figures(self) -> str:
        """Return cost, bound and gap on one line."""
        return f"cost {self.cost:.12g}, bound {_number(self.lower_bound)}, gap {_number(self.gap, '.2e')}"


def judge(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers,
    tolerance: float = CONDITION_TOLERANCE,
) -> Certificate:
    """Judge a trajectory and multipliers from any source against the maximum principle.

    Parameters
    ----------
    problem : OptimalControlProblem
    trajectory : Trajectory
    multipliers : Multipliers
    tolerance : float
        Residuals over scales up to which conditions hold. Facts about borders of modes keep theirs.

    With piecewise-affine dynamics, the state equation is that of a mode that holds, and all else is said of the linear
    dynamics averaged by ``multipliers.weights``, or, where they are None, by those that fit best (docs/borders.md).

    Raises
    ------
    ProblemError
        If shapes do not fit the problem, or a free bin or row has a multiplier.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows does not pass
        if isinstance(problem.dynamics, PiecewiseAffineDynamics):
            bound, (conditions, borders, worth) = None, judge_modes(problem, trajectory, multipliers)
        elif isinstance(problem.dynamics, PiecewiseSmoothDynamics):
            bound, (conditions, borders, worth) = None, judge_smooth(problem, trajectory, multipliers)
        else:
            _require_no_weights(multipliers)
            lifted, borders = lift(problem, trajectory, multipliers), None
            conditions, worth = all_conditions(lifted), worth_of_residuals(lifted)
            allowed = max(GAP_TOLERANCE, tolerance) * cost_scale(problem, trajectory)
            bound = lower_bound(lifted, allowed) if multipliers.eta_C == 1 else None
        pmp = _principle(conditions)
        certificate = Certificate(
            pmp=pmp if borders is None or borders.jumping is None else "not_applicable",
            normal=multipliers.eta_C == 1,
            conditions=conditions,
            cost=problem.value(trajectory.x, trajectory.u),
            cost_scale=cost_scale(problem, trajectory),
            worth_of_residuals=worth,
            bound=bound,
            borders=borders,
        )
        return certificate if tolerance == CONDITION_TOLERANCE else certificate.within(tolerance)


def _principle(conditions: tuple[Condition, ...]) -> str:
    return "satisfied" if all(condition.passed for condition in conditions) else "violated"


def _number(value: float | None, form: str = ".12g") -> str:
    return "none" if value is None else format(value, form)


def _require_no_weights(multipliers: Multipliers) -> None:
    if multipliers.weights is not None:
        raise ProblemError("multipliers.weights", f"shape {multipliers.weights.shape}", "None: the dynamics are linear")
