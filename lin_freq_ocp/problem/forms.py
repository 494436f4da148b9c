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
    m, has_formulas = dynamics.control_dim, cost.has_formulas or constrained
    if isinstance(control_set, ConvexSet) and control_set.points(m) is not None:
        dynamics = entry_for(FORMS, dynamics.standard_form)(dynamics, control_set, None)
    elif isinstance(control_set, ConvexSet) and _any_has_points(control_set.members, m):
        advice = "State other constraints as stage_rows, or take duty_cycles=True."
        raise ProblemError("control_set", "levels in an intersection", "a FiniteSet alone", advice)
    elif isinstance(control_set, Iterable) and _any_has_points(control_set, m):
        raise ProblemError("control_set", "levels at single times", "one FiniteSet for all times")
    return entry_for(FORMS, dynamics.standard_form)(dynamics, None, cost.formulas[0]) if has_formulas else dynamics


def _any_has_points(sets: Iterable[object], m: int) -> bool:
    """Whether a set of controls, (m,), is finite or has a finite part; what is no set is refused elsewhere."""
    parts = [part for one in sets if isinstance(one, ConvexSet) for part in one.members]
    return any(part.points(m) is not None for part in parts)
