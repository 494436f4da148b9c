"""The judge: every condition of the maximum principle at a trajectory, and the global bound."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, first_largest
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import html_table, term_rows
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.between_samples import BetweenSamples, bounds_between_samples
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.conditions import OF_RESIDUALS, Condition, all_conditions
from lin_freq_ocp.certificate.hamiltonian import Extremal, extremal_at
from lin_freq_ocp.certificate.rays import Direction
from lin_freq_ocp.certificate.response_bound import best_bound
from lin_freq_ocp.certificate.sizes import cost_scale, floors, scales_of
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, GAP_TOLERANCE, MAX_DECIMALS, MIN_ROUNDED
from lin_freq_ocp.problem.dynamics.base import entry_for
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


@dataclass(frozen=True)
class Rounded:
    """The rounding of a trajectory, as of printed numbers, that explains its residuals.

    Attributes
    ----------
    decimals : int
        All states and controls are whole multiples of 10^-decimals.
    satisfied_to : float
        The least of the tolerances 1e-5, 1e-4, 1e-3, 1e-2 at which the maximum principle is satisfied.
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
    """Return the number of decimals of the states and controls, or None if some have more than MAX_DECIMALS."""
    values = np.concatenate([trajectory.x.ravel(), trajectory.u.ravel()])
    values = values[values != 0]
    if len(values) < MIN_ROUNDED:
        return None
    return next((count for count in range(MAX_DECIMALS + 1) if (np.round(values, count) == values).all()), None)


class Facts(ABC):
    """Facts about a trajectory of nonsmooth dynamics in addition to the conditions."""

    @property
    @abstractmethod
    def applicable(self) -> bool:
        """Whether the theorem applies at all."""

    @property
    @abstractmethod
    def stationary_on_rims(self) -> bool:
        """Whether only touched rims prevent the theorem, and the trajectory is stationary within the regions."""


@dataclass(frozen=True, eq=False)
class SecondOrder:
    """Whether a direction lowers the cost to second order along smooth dynamics.

    Attributes
    ----------
    passed : bool or None
        True: none does. None: the test does not apply or decides nothing, for the ``reason``.
    curvature : float
        Of the Lagrangian along the direction, whose largest entry is 1 in the sizes of the data.
    direction : Trajectory or None
        If one was found: the change of states (T+1, n) and controls (T, m), in the units of the problem. It keeps
        dynamics and active constraints to first order.
    """

    passed: bool | None
    reason: str
    curvature: float = 0.0
    direction: Trajectory | None = None

    def __str__(self) -> str:
        if self.direction is not None:
            (t,) = first_largest(np.abs(self.direction.u).max(1))
            return f"no minimum: the cost falls to second order along a direction, most of u at t = {t}"
        return "no direction lowers the cost to second order" if self.passed else f"not decided: {self.reason}"


@dataclass(frozen=True, eq=False)
class Judgement:
    """The result of the judge of one kind of dynamics.

    ``extremal`` is None if no global bound follows from the multipliers; ``cost_scale`` is S, and ``cost`` is J, None
    if not computed; ``bound`` is of another kind than that of the extremal; ``slopes`` (T, n + m) are the scales of
    the adjoint equation and of stationarity in u, of dynamics with modes.
    """

    conditions: tuple[Condition, ...]
    borders: Facts | None
    cost_of_residuals: float
    extremal: Extremal | None = None
    cost_scale: float | None = None
    cost: float | None = None
    second_order: SecondOrder | None = None
    bound: Bound | None = None
    slopes: Array | None = None


@dataclass(frozen=True, eq=False)
class Certificate:
    """The facts proven about a trajectory with multipliers.

    Attributes
    ----------
    applicable : bool
        Whether the theorem applies; it does not where the map jumps across a switching facet (see ``borders``).
    normal : bool or None
        Whether eta_C = 1.
    conditions : tuple of Condition
        All checked conditions, in the order of the paper.
    cost : float
        J of the trajectory.
    cost_scale : float
        S, the sum of the sizes of the terms of the cost, each at most what it can vary by. The gap is relative to S.
    worth_of_residuals : float
        Residuals of constraints times their multipliers: the amount by which they lower the cost, to first order.
        Infinite if all multipliers are zero and residuals exceed rounding: such multipliers price nothing. Of an answer
        of ``solve``: the price of a trajectory nearby that satisfies every constraint; infinite if none is known.
    data_rounding : float
        The change of the optimal cost by rounding of the data, if that decides; else 0. Gaps below it do not count.
    bound : Bound or None
        The global lower bound; None if the cost is not convex, eta_C is not 1, or the dynamics have modes: then a
        search over modes may add its own, ``dataclasses.replace(certificate, bound=Bound(value, kind, sets=...))``.
    descent : Direction or None
        A verified direction of descent. It shows that a linear problem has no normal multipliers. At a switching
        boundary it leads into the mode of a flip of ``borders``: the trajectory is not a local minimum.
    borders : SwitchingFacts or None
        The conditions at switching boundaries; None for linear dynamics.
    second_order : SecondOrder or None
        The test of second order along smooth dynamics; None for others, and where the maximum principle is violated.
    rounded : Rounded or None
        If rounding of the trajectory explains a violation of the maximum principle: the tolerance that it satisfies.
    subject : (problem, trajectory) or None
        Of ``certify``: the problem and the trajectory, for ``between_samples``.

    Examples
    --------
    >>> certificate = lfo.solve(lfo.library.double_integrator()).certificate
    >>> certificate.pmp, certificate.normal, certificate.globally_optimal
    ('satisfied', True, True)
    """

    applicable: bool
    normal: bool | None
    conditions: tuple[Condition, ...]
    cost: float
    cost_scale: float
    worth_of_residuals: float
    bound: Bound | None
    data_rounding: float = 0.0
    descent: Direction | None = None
    borders: Facts | None = None
    rounded: Rounded | None = None
    second_order: SecondOrder | None = None
    subject: tuple[OptimalControlProblem, Trajectory] | None = None

    @cached_property
    def between_samples(self) -> BetweenSamples | None:
        """The state bounds between the samples, by ``certify``; None without a continuous plant or state bounds."""
        return None if self.subject is None else bounds_between_samples(*self.subject)

    @property
    def lower_bound(self) -> float | None:
        """Return D, a lower bound on the cost of every feasible trajectory (if numerical, of those in its box)."""
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
        return max(GAP_TOLERANCE * self.cost_scale, self.data_rounding)

    @property
    def stage_gaps(self) -> Array | None:
        """Return the part of J - D of each stage, shape (T+1,)."""
        return None if self.bound is None else self.bound.stage_gaps

    @property
    def feasible(self) -> bool:
        """Whether every constraint of the problem holds within tolerance."""
        return not any(condition.on_feasibility for condition in self.failed)

    @property
    def violation(self) -> float:
        """Return the largest residual of a constraint relative to its scale."""
        return max(condition.relative for condition in self.conditions if condition.on_feasibility)

    @property
    def globally_optimal(self) -> bool:
        """Whether the trajectory is feasible and its gap to a rigorous bound is within GAP_TOLERANCE."""
        return self.proven_within(GAP_TOLERANCE)

    def proven_within(self, gap: float) -> bool:
        """Whether the trajectory is feasible and its cost proven to be within ``gap`` of the least, relative to S.

        The least cost is between D and the cost with the worth of the residuals. A numerical bound proves nothing
        outside its box. The cost must not be below the bound by more than the gap: residuals would explain such a cost.
        """
        if self.bound is None or self.gap is None or self.bound.kind != RIGOROUS or not self.feasible:
            return False
        allowed, above = max(gap * self.cost_scale, self.data_rounding), self.cost - self.bound.value
        return above >= -allowed and above + self.worth_of_residuals <= allowed

    def within(self, tolerance: float) -> Certificate:
        """Return the certificate with another tolerance of its conditions; ``borders`` keeps its own."""
        return replace(self, conditions=tuple(condition.within(tolerance) for condition in self.conditions))

    def raised(self, constant: float) -> Certificate:
        """Return the certificate of the same trajectory for a cost that is higher by a constant."""
        bound = None if self.bound is None else replace(self.bound, value=self.bound.value + constant)
        return replace(self, cost=self.cost + constant, bound=bound)

    def status_within(self, gap: float) -> Status:
        """Return OPTIMAL if ``proven_within(gap)``, else LOCALLY_OPTIMAL, EXTREMAL or NUMERICAL_ERROR.

        Locally optimal and extremal mean that the maximum principle is satisfied with normal multipliers. With linear
        dynamics, no feasible direction then lowers the cost to first order. With smooth dynamics, the test of second
        order decides between the two. With modes, the principle is a necessary condition only.
        """
        if self.proven_within(gap):
            return Status.OPTIMAL
        if self.extremal and self.second_order is not None and self.second_order.passed is False:
            return Status.EXTREMAL
        return Status.LOCALLY_OPTIMAL if self.extremal else Status.NUMERICAL_ERROR

    @property
    def extremal(self) -> bool:
        """Whether the principle is satisfied with normal multipliers; at rims, with the regions as constraints."""
        return bool(self.normal and (self.pmp == "satisfied" or (self.borders and self.borders.stationary_on_rims)))

    @property
    def pmp(self) -> str:
        """Return "satisfied", "violated", or "not_applicable": whether all conditions of the theorem hold."""
        return "not_applicable" if not self.applicable else "violated" if self.failed else "satisfied"

    @cached_property
    def failed(self) -> tuple[Condition, ...]:
        """Return the conditions that fail."""
        return tuple(condition for condition in self.conditions if not condition.passed)

    @property
    def worst(self) -> Condition:
        """Return the condition with the largest residual relative to its scale."""
        return self.conditions[first_largest(np.array([condition.relative for condition in self.conditions]))[0]]

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
        lines += [] if self.second_order is None else [f"second    {self.second_order}"]
        lines += [] if self.rounded is None else [f"rounding  {self.rounded}"]
        lines += [] if self.between_samples is None else [f"between   {self.between_samples}"]
        facts = "" if self.borders is None else str(self.borders)  # empty where there is a single mode
        return "\n".join([*lines, *([f"borders   {facts}"] if facts else [])])

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


@one_blas_thread
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
        The largest residual over scale of a condition that holds. Facts about switching boundaries keep their own.

    With piecewise-affine dynamics, the state equation is that of an active mode. All other conditions are those of the
    linear dynamics averaged with ``multipliers.weights``, by default the weights that fit best (docs/borders.md).

    Raises
    ------
    ProblemError
        If shapes do not fit the problem, or a free bin or row has a multiplier.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a condition that overflows does not pass
        judgement = entry_for(JUDGES, problem.form)(problem, trajectory, multipliers)
        scale = cost_scale(problem, trajectory) if judgement.cost_scale is None else judgement.cost_scale
        bound, conditions, worth = judgement.bound, judgement.conditions, judgement.cost_of_residuals
        normal = multipliers.eta_C == 1
        if judgement.extremal is not None and normal:
            bound = best_bound(judgement.extremal, max(GAP_TOLERANCE, tolerance) * scale)
        parts = multipliers.eta, multipliers.mu, multipliers.nu, multipliers.rho_u, multipliers.rho_x
        if not any(part.any() for part in (*parts, *multipliers.stage.values())):
            # multipliers that are all zero do not price residuals: these must be rounding, or the cost zero
            if not problem.costs_nothing and not all(one.exact for one in conditions if one.on_feasibility):
                worth = np.inf
                conditions = tuple(replace(c, residual=worth) if c.label == OF_RESIDUALS else c for c in conditions)
        certificate = Certificate(
            applicable=judgement.borders is None or judgement.borders.applicable,
            normal=normal,
            conditions=conditions,
            cost=problem.value(trajectory.x, trajectory.u) if judgement.cost is None else judgement.cost,
            cost_scale=scale,
            worth_of_residuals=worth,
            bound=bound,
            borders=judgement.borders,
            second_order=judgement.second_order,
        )
        return certificate if tolerance == CONDITION_TOLERANCE else certificate.within(tolerance)


def _number(value: float | None, form: str = ".12g") -> str:
    return "none" if value is None else format(value, form)


def _judge_linear(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Judgement:
    if multipliers.weights is not None:
        raise ProblemError("multipliers.weights", f"shape {multipliers.weights.shape}", "None: the dynamics are linear")
    extremal = extremal_at(problem, trajectory, multipliers)
    cost, size = map(float, extremal.cost_and_size)
    scales = scales_of(problem, trajectory, (cost, size))
    conditions = all_conditions(extremal, floors(extremal, scales))
    return Judgement(conditions, None, float(extremal.cost_of_residuals), extremal, scales.cost, cost)


JUDGES: dict[type, Callable[[OptimalControlProblem, Trajectory, Multipliers], Judgement]] = {
    LinearDynamics: _judge_linear,
    FrequencyResponse: _judge_linear,
}
