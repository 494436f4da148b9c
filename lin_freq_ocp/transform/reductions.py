"""Changes of a problem, and reductions, which replace a problem by another and convert the answers back.

As in CVXPY, a reduction accepts some problems. A starting trajectory and a ``Change`` are mapped to the new problem;
trajectory, multipliers, rays, directions of descent and the cost are mapped back. A method has a tuple of reductions:
those that accept the problem are applied from left to right, and recovered from right to left. The judge
checks the recovered answer, a claim about the given problem, on that problem.

Masks, origins and own states are replaced in ``reformulations``, few controls between levels in ``level_rows``, costs
by formulas in ``hybrid/cost_state``; what one method needs stands with it: ``methods/absorbed_cost``,
``methods/spectral/reductions``, ``solving/hybrid/fixed_modes``. ``problem.form`` is the only other replacement that
every solve makes.

A new reduction is a subclass of ``Reduced`` that overrides some methods, and a function from a problem to this class.
Its cases are in the table of ``tests/helpers/reductions.py``.

References: Agrawal, Verschueren, Diamond and Boyd, Journal of Control and Decision 5, 2018 (a rewriting system for
convex optimization problems).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, dataclass, replace
from typing import ClassVar, Protocol, TypeVar

from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import known_entries, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import SetOrSets
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


@dataclass(frozen=True, eq=False)
class Change:
    """New ends, references and bounds ("state_set", "control_set") of a problem; None leaves those that it has.

    A disturbance, (n,) or (T, n), is added to the coming states.
    """

    initial_state: ConvexSet | ArrayLike | None = None
    terminal_state: ConvexSet | ArrayLike | None = None
    references: Mapping[str, ArrayLike] | None = None
    bounds: Mapping[str, SetOrSets] | None = None
    disturbance: ArrayLike | None = None

    @property
    def starts_elsewhere(self) -> bool:
        """Whether at most the initial state changes."""
        others = self.terminal_state, self.references, self.disturbance
        return not self.bounds and all(other is None for other in others)

    def apply(self, problem: OptimalControlProblem) -> OptimalControlProblem:
        """Return the changed problem."""
        n = problem.state_dim
        if self.bounds:
            bounds = known_entries("bounds", self.bounds, ("state_set", "control_set"))
            if problem.form.choices is not None:  # the levels stay, within the new bounds
                bounds = {"dynamics": problem.form, "control_set": problem.control_hull} | bounds
            problem = problem.derived(**bounds)
        if self.references is not None:
            problem = problem.with_references(self.references)
        if self.disturbance is not None:
            disturbance, shapes = real_array("disturbance", self.disturbance), ((n,), (problem.horizon, n))
            if disturbance.shape not in shapes:
                raise ProblemError("disturbance", f"shape {disturbance.shape}", f"shape {shapes[0]} or {shapes[1]}")
            problem = replace_fields(problem, dynamics=problem.form.disturbed(disturbance))
        if self.initial_state is None and self.terminal_state is None:
            return problem
        return problem.with_ends(self.initial_state, self.terminal_state)


class _Answer(Protocol):
    """A point with multipliers, a ray, or a direction (dx, du) of descent, as a dataclass; absent parts are None."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]

    @property
    def trajectory(self) -> Trajectory | None: ...
    @property
    def multipliers(self) -> Multipliers | None: ...
    @property
    def ray(self) -> Multipliers | None: ...
    @property
    def descent(self) -> Trajectory | None: ...


AnyAnswer = TypeVar("AnyAnswer", bound=_Answer)


@dataclass(frozen=True, eq=False)
class Reduced:
    """A ``problem`` that takes the place of the ``given`` one, and the ways between them. The default is no change."""

    given: OptimalControlProblem
    problem: OptimalControlProblem

    @property
    def cost(self) -> float:
        """Return the cost of the given problem less that of the reduced one, a constant."""
        return 0.0

    def start(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory of the given problem as one of the reduced problem."""
        return trajectory

    def change(self, change: Change, changed: OptimalControlProblem) -> Change:
        """Return a change of the given problem as one of the reduced problem; ``changed`` is the given one after it."""
        return change

    def trajectory(self, reduced: Trajectory) -> Trajectory:
        """Return a trajectory of the given problem from one of the reduced problem."""
        return reduced

    def multipliers(self, reduced: Multipliers, at: Trajectory | None = None) -> Multipliers:
        """Return multipliers at a recovered trajectory; without one, those of a ray or of a bound.

        UnsupportedError if the answer of the reduced problem has no counterpart in the given problem.
        """
        return reduced

    def direction(self, reduced: Trajectory) -> Trajectory:
        """Return a direction of descent (dx, du) of the given problem."""
        return reduced

    def judged_at(self, trajectory: Trajectory) -> tuple[OptimalControlProblem, Trajectory]:
        """Return the problem, and the trajectory in it, at which a recovered trajectory is judged."""
        return self.given, trajectory

    def recover(self, answer: AnyAnswer) -> AnyAnswer:
        """Return an answer of the reduced problem as one of the given problem."""
        at = answer.trajectory and self.trajectory(answer.trajectory)
        return replace(
            answer,
            trajectory=at,
            multipliers=answer.multipliers and self.multipliers(answer.multipliers, at),
            ray=answer.ray and self.multipliers(answer.ray),
            descent=answer.descent and self.direction(answer.descent),
        )


Reduction = Callable[[OptimalControlProblem], Reduced | None]
"""A function from a problem to the one that takes its place; None without change."""


@dataclass(frozen=True, eq=False)
class Chain:
    """A problem after several reductions, in the order in which they were applied."""

    given: OptimalControlProblem
    problem: OptimalControlProblem
    links: tuple[Reduced, ...]

    def recover(self, answer: AnyAnswer) -> AnyAnswer:
        """Return an answer of the reduced problem as one of the given problem."""
        for link in reversed(self.links):
            answer = link.recover(answer)
        return answer


def reduce_problem(problem: OptimalControlProblem, reductions: Sequence[Reduction]) -> Chain:
    """Return the problem after all reductions that accept it, one after the other, and the way back."""
    last, links = problem, list[Reduced]()
    for reduction in reductions:
        reduced = reduction(last)
        if reduced is not None:
            last = reduced.problem
            links.append(reduced)
    return Chain(problem, last, tuple(links))
