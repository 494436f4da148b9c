"""Linear dynamics whose control takes finitely many points: piecewise-affine dynamics with a mode for each of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, assign
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.problem.dynamics.base import Dynamics, signal_labels
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.affine_mode import AffineMode
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.regions import SwitchingFacet
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import SetOrSets
from lin_freq_ocp.problem.sets.stage_rows import StageSets


@dataclass(frozen=True, eq=False, init=False)
class SwitchedDynamics(Dynamics):
    """x_{t+1} = A x_t + B u_t + d with u_t one of the points of a set: mode i is where u_t is point i.

    Regions need not cover anything, and meet nowhere.
    """

    dynamics: LinearDynamics
    control_set: ConvexSet
    choices: Array  # (modes, m)

    def __init__(self, dynamics: LinearDynamics, control_set: ConvexSet):
        n, m = dynamics.state_dim, dynamics.control_dim
        if control_set.dimension not in (None, m):
            raise ProblemError("control_set", f"levels of {control_set.dimension} components", f"levels of {m}")
        choices = control_set.points(m)
        assert choices is not None
        labels = signal_labels(n, m, dynamics.sampling_time, dynamics.state_names, dynamics.control_names)
        assign(self, dynamics=dynamics, control_set=control_set, choices=choices, **labels)

    @property
    def standard_form(self) -> PiecewiseAffineDynamics:
        """Return the modes, whose regions are u <= point, -u <= -point."""
        return self._modes

    @cached_property
    def _modes(self) -> PiecewiseAffineDynamics:
        A, B, d = self.dynamics.A, self.dynamics.B, self.dynamics.offset
        sides = np.vstack([np.eye(self.control_dim), -np.eye(self.control_dim)])
        modes = [AffineMode(A, B, d, H=sides, h=sides @ point, name=f"u = {_text(point)}") for point in self.choices]
        return PiecewiseAffineDynamics(modes, self.sampling_time, self.state_names, self.control_names)

    @property
    def given(self) -> tuple[Dynamics, ConvexSet | None]:
        """Return the dynamics and the control set that it was made of."""
        return self.dynamics, self.control_set

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return that every point of the control set is a mode."""
        words = f"{self.control_set.describe(self.control_names, 'u')}; {plural(len(self.choices), 'mode')}"
        return [*self.dynamics.facts(labels), ("levels", words)]

    def require_sets(self, sets: StageSets) -> None:
        """Accept all sets: regions are single points."""

    def borders(self, sets: StageSets) -> tuple[SwitchingFacet, ...]:
        """Return none."""
        return ()

    @property
    def level_sizes(self) -> Array:
        """Return the largest absolute level of each control, (m,)."""
        return np.abs(self.choices).max(axis=0)

    def controls_of(self, sequence: Indices) -> Array:
        """Return the controls of a mode sequence, (T, m)."""
        return self.choices[sequence]

    def translated(self, origin: Array) -> SwitchedDynamics:
        """Return the dynamics of x - origin, with the same levels."""
        return SwitchedDynamics(self.dynamics.translated(origin), self.control_set)

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> SwitchedDynamics:
        """Return the dynamics of (x, w) with w_{t+1} = A w_t + B u_t."""
        return SwitchedDynamics(self.dynamics.augmented(A, B, names, horizon), self.control_set)


def with_levels(dynamics: Dynamics, control_set: SetOrSets) -> tuple[Dynamics, SetOrSets]:
    """Return the dynamics and the convex control set of a problem: a set of finitely many points becomes modes."""
    if not isinstance(control_set, ConvexSet):
        several = (
            control_set if isinstance(control_set, Iterable) else ()
        )  # what is no sequence is refused with the sets
        if any(isinstance(one, ConvexSet) and _finite(one, dynamics) for one in several):
            raise ProblemError("control_set", "levels at single times", "one FiniteSet for all times")
        return dynamics, control_set
    if control_set.points(dynamics.control_dim) is None:
        if any(_finite(one, dynamics) for one in control_set.members):
            advice = "State other constraints as stage_rows, or take duty_cycles=True."
            raise ProblemError("control_set", "levels in an intersection", "a FiniteSet alone", advice)
        return dynamics, control_set
    linear = dynamics.given[0].standard_form
    if linear.mode_names or not isinstance(linear, LinearDynamics):
        advice = "Write the levels into the regions of the modes, or take duty_cycles=True."
        raise ProblemError("control_set", f"levels with {type(dynamics).__name__}", "LinearDynamics", advice)
    return SwitchedDynamics(linear, control_set), control_set.hull


def _text(point: Array) -> str:
    """Return "1" or "(1, 0)", different for different points."""
    numbers = ", ".join(f"{value:.17g}" for value in point)
    return numbers if len(point) == 1 else f"({numbers})"


def _finite(one: ConvexSet, dynamics: Dynamics) -> bool:
    return any(member.points(dynamics.control_dim) is not None for member in one.members)
