"""The dynamics of a problem in the form that methods and the judge take.

The points of a finite control set are modes. A cost or a path constraint by formulas makes dynamics smooth modes; the
kinks of the cost separate them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.costs.quadratic import Cost
from lin_freq_ocp.problem.dynamics.base import Dynamics, entry_for
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import SetOrSets

FormBuilder = Callable[[Dynamics, ConvexSet | None, Formula | None], Dynamics]
FORMS: dict[type, FormBuilder] = {}
"""Functions of dynamics, finite control set or None, and stage cost or None; ``transform/hybrid`` registers its own."""


def form_of(dynamics: Dynamics, control_set: SetOrSets, cost: Cost, constrained: bool) -> Dynamics:
    """Return the form of the dynamics of a problem: the dynamics unchanged if there are no levels and formulas.

    ``constrained`` says whether the problem has path constraints by formulas.
    """
    levels, formulas = finite_set(dynamics, control_set), cost.has_formulas or constrained
    if levels is not None:
        dynamics = entry_for(FORMS, dynamics)(dynamics, levels, None)
    return entry_for(FORMS, dynamics)(dynamics, None, cost.formulas[0]) if formulas else dynamics


def finite_set(dynamics: Dynamics, control_set: SetOrSets) -> ConvexSet | None:
    """Return the control set if it is one of finitely many points, else None; ProblemError for levels elsewhere."""
    if not isinstance(control_set, ConvexSet):
        sets = control_set if isinstance(control_set, Iterable) else ()  # others are refused with the sets
        if any(isinstance(member, ConvexSet) and _has_points(member, dynamics) for member in sets):
            raise ProblemError("control_set", "levels at single times", "one FiniteSet for all times")
        return None
    if control_set.points(dynamics.control_dim) is not None:
        return control_set
    if any(_has_points(member, dynamics) for member in control_set.members):
        advice = "State other constraints as stage_rows, or take duty_cycles=True."
        raise ProblemError("control_set", "levels in an intersection", "a FiniteSet alone", advice)
    return None


def _has_points(convex_set: ConvexSet, dynamics: Dynamics) -> bool:
    return any(member.points(dynamics.control_dim) is not None for member in convex_set.members)
