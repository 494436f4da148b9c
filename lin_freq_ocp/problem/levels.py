"""Control sets of finitely many points, which make dynamics with a mode for each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.dynamics.base import Dynamics, entry_for
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import SetOrSets

LEVELS: dict[type, Callable[[LinearDynamics, ConvexSet], Dynamics]] = {}
"""Of dynamics and a control set of finitely many points: the dynamics with a mode for each point."""


def with_levels(dynamics: Dynamics, control_set: SetOrSets) -> tuple[Dynamics, SetOrSets]:
    """Return dynamics and convex control set of a problem; points of a finite control set become modes."""
    if not isinstance(control_set, ConvexSet):
        sets = control_set if isinstance(control_set, Iterable) else ()  # others are refused with the sets
        if any(isinstance(member, ConvexSet) and _finite(member, dynamics) for member in sets):
            raise ProblemError("control_set", "levels at single times", "one FiniteSet for all times")
        return dynamics, control_set
    if control_set.points(dynamics.control_dim) is None:
        if any(_finite(member, dynamics) for member in control_set.members):
            advice = "State other constraints as stage_rows, or take duty_cycles=True."
            raise ProblemError("control_set", "levels in an intersection", "a FiniteSet alone", advice)
        return dynamics, control_set
    linear = dynamics.given[0].standard_form
    if not isinstance(linear, LinearDynamics):
        advice = "Write the levels into the regions of the modes, or take duty_cycles=True."
        raise ProblemError("control_set", f"levels with {dynamics.words}", "LinearDynamics", advice)
    return entry_for(LEVELS, linear)(linear, control_set), control_set.hull


def _finite(convex_set: ConvexSet, dynamics: Dynamics) -> bool:
    return any(member.points(dynamics.control_dim) is not None for member in convex_set.members)
