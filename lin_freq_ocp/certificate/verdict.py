"""The judgement of a trajectory: every condition of the theorem, and the global bound."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import html_table, term_rows
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.conditions import Condition, all_conditions, cost_of_residuals
from lin_freq_ocp.certificate.hamiltonian import Extremal, extremal_at
from lin_freq_ocp.certificate.rays import Direction
from lin_freq_ocp.certificate.response_bound import best_bound
from lin_freq_ocp.certificate.sizes import cost_scale, floors, trajectory_sizes
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, GAP_TOLERANCE, MAX_DECIMALS, MIN_ROUNDED
from lin_freq_ocp.problem.dynamics.base import entry_for
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

FEASIBILITY_LABELS = ("state equation", "C-vi", "C-vii", "S-x", "S-u", "S-z", "S-yhat", "S-ends", "S-f")


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
    """Return how many decimals the states and controls have, or None where they have more than MAX_DECIMALS."""
    values = np.concatenate([trajectory.x.ravel(), trajectory.u.ravel()])
    values = values[values != 0]
    if len(values) < MIN_ROUNDED:
        return None
    return next((count for count in range(MAX_DECIMALS + 1) if (np.round(values, count) == values).all()), None)


class Facts(ABC):
    """Facts about a trajectory of nonsmooth dynamics that the conditions do not say."""

    @property
    @abstractmethod
    def applicable(self) -> bool:
        """Whether the theorem applies at all."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """What a judge returns, for any dynamics; ``extremal`` if a global bound follows from the multipliers.

    ``cost_scale`` is S of the trajectory, if it was computed, ``bound`` a bound of another kind than the extremal's.
    """

    conditions: tuple[Condition, ...]
    borders: Facts | None
    cost_of_residuals: float
    extremal: Extremal | None = None
    cost_scale: float | None = None
    bound: Bound | None = None


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proven of a trajectory with multipliers.

    Attributes
    ----------
    pmp : str
        "satisfied", "violated" or "not_applicable" (the map jumps across a switching facet: see ``borders``).
    normal : bool or None
        Whether eta_C = 1.
    conditions : tuple of Condition
        All that was checked, in the paper's order.
    cost : float
        J of the trajectory.
    cost_scale : float
        S, the sum of the absolute values of the terms of the cost: what the gap is relative to.
    worth_of_residuals : float
        Residuals of constraints times their multipliers: to first order, by how much they lower the cost. Infinite
        where all multipliers are zero and residuals are more than rounding: such multipliers price nothing.
    bound : Bound or None
        The global lower bound; None if the cost is not convex, eta_C is not 1, or the dynamics have modes: then a
        search over modes may add its own, ``dataclasses.replace(certificate, bound=Bound(value, kind, sets=...))``.
    descent : Direction or None
        A verified direction of descent. Of a linear problem, it shows that no normal multipliers exist; where modes
        meet, it leads into the flip of ``borders`` that improves, and the trajectory is no local minimum.
    borders : SwitchingFacts or None
        The conditions where modes meet; None for linear dynamics.
    rounded : Rounded or None
        If the maximum principle is violated and rounding of the trajectory explains it: to how much it is satisfied.

    Examples
    --------
    >>> certificate = lfo.solve(lfo.library.double_integrator()).certificate
    >>> certificate.pmp, certificate.normal, certificate.globally_optimal
    ('satisfied', True, True)
    """

    pmp: str
    normal: bool | None
    conditions: tuple[Condition, ...]
    cost: float
    cost_scale: float
    worth_of_residuals: float
    bound: Bound | None
    descent: Direction | None = None
    borders: Facts | None = None
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
        return not any(_of_feasibility(condition) for condition in self.failed)

    @property
    def violation(self) -> float:
        """Return the largest residual of a constraint relative to its scale."""
        return max(condition.relative for condition in self.conditions if _of_feasibility(condition))

    @property
    def globally_optimal(self) -> bool:
        """Whether the trajectory is feasible and its gap to a rigorous bound is within GAP_TOLERANCE."""
        return self.proven_within(GAP_TOLERANCE)

    def proven_within(self, gap: float) -> bool:
        """Whether the trajectory is feasible and its cost proven to be within ``gap`` of the least, relative to S.

        A numerical bound proves nothing outside its box. The cost of residuals must not be more than the gap, nor may
        the cost be below the bound by more: then residuals lower it.
        """
        if self.bound is None or self.gap is None or self.bound.kind != RIGOROUS or not self.feasible:
            return False
        return abs(self.gap) <= gap and self.worth_of_residuals <= gap * self.cost_scale

    def within(self, tolerance: float) -> Certificate:
        """Return the certificate with another tolerance of its conditions; facts about ``borders`` stay."""
        conditions = tuple(condition.within(tolerance) for condition in self.conditions)
        pmp = self.pmp if self.pmp == "not_applicable" else _principle(conditions)
        return replace(self, conditions=conditions, pmp=pmp)

    def raised(self, constant: float) -> Certificate:
        """Return the certificate of the same trajectory for a cost that is higher by a constant."""
        bound = None if self.bound is None else replace(self.bound, value=self.bound.value + constant)
        return replace(self, cost=self.cost + constant, bound=bound)

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
        lines += [f"mask      {condition.peak}: {condition.name}" for condition in self.conditions if condition.peak]
        lines += [] if self.rounded is None else [f"rounding  {self.rounded}"]
        return "\n".join([*lines, *([] if self.borders is None else [f"borders   {self.borders}"])])

    def __repr__(self) -> str:
        verdict = "globally optimal" if self.globally_optimal else "feasible" if self.feasible else "not feasible"
        return f"Certificate({verdict}, theorem {self.pmp}, {self.figures})"

    def _repr_html_(self) -> str:
        rows = term_rows(str(self).splitlines())
        rows += [(failed.label, f"fails: {failed.name}, {failed.relative:.1e} relative") for failed in self.failed]
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
        Residuals over scales up to which conditions hold. Facts about switching facets keep theirs.

    With piecewise-affine dynamics, the state equation is that of an active mode, and all other conditions are those of
    the linear dynamics averaged by ``multipliers.weights``, if None by the weights that fit best (docs/borders.md).

    Raises
    ------
    ProblemError
        If shapes do not fit the problem, or a free bin or row has a multiplier.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a condition that overflows does not pass
        found = entry_for(JUDGES, problem.dynamics)(problem, trajectory, multipliers)
        scale = cost_scale(problem, trajectory) if found.cost_scale is None else found.cost_scale
        bound = found.bound
        if found.extremal is not None and multipliers.eta_C == 1:
            bound = best_bound(found.extremal, max(GAP_TOLERANCE, tolerance) * scale)
        applicable = found.borders is None or found.borders.applicable
        certificate = Certificate(
            pmp=_principle(found.conditions) if applicable else "not_applicable",
            normal=multipliers.eta_C == 1,
            conditions=found.conditions,
            cost=problem.value(trajectory.x, trajectory.u),
            cost_scale=scale,
            worth_of_residuals=np.inf if _no_price(problem, multipliers, found.conditions) else found.cost_of_residuals,
            bound=bound,
            borders=found.borders,
        )
        return certificate if tolerance == CONDITION_TOLERANCE else certificate.within(tolerance)


def _no_price(problem: OptimalControlProblem, multipliers: Multipliers, conditions: tuple[Condition, ...]) -> bool:
    """Whether multipliers that are all zero say nothing of what residuals beyond rounding are worth."""
    parts = multipliers.eta, multipliers.mu, multipliers.nu, multipliers.rho_u, multipliers.rho_x
    if any(part.any() for part in (*parts, *multipliers.stage.values())):
        return False
    costs_nothing = problem.quadratic.zero and all(term.hard for term in problem.terms)
    costs_nothing &= not problem.cost.has_formulas
    exact = (condition.exact for condition in conditions if _of_feasibility(condition))
    return not costs_nothing and not all(exact)


def _of_feasibility(condition: Condition) -> bool:
    return bool({condition.label, condition.name} & set(FEASIBILITY_LABELS))


def _principle(conditions: tuple[Condition, ...]) -> str:
    return "satisfied" if all(condition.passed for condition in conditions) else "violated"


def _number(value: float | None, form: str = ".12g") -> str:
    return "none" if value is None else format(value, form)


def _judge_linear(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Judgement:
    if multipliers.weights is not None:
        raise ProblemError("multipliers.weights", f"shape {multipliers.weights.shape}", "None: the dynamics are linear")
    extremal = extremal_at(problem, trajectory, multipliers)
    sizes = trajectory_sizes(problem, trajectory)
    scale = cost_scale(problem, trajectory, sizes)
    conditions = all_conditions(extremal, floors(extremal, sizes, scale))
    return Judgement(conditions, None, cost_of_residuals(extremal), extremal, scale)


JUDGES: dict[type, Callable[[OptimalControlProblem, Trajectory, Multipliers], Judgement]] = {
    LinearDynamics: _judge_linear,
    FrequencyResponse: _judge_linear,
}
