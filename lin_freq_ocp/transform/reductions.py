"""Reductions: a problem is replaced by another one, and an inverse recovers answers of the given problem.

As in CVXPY, a reduction accepts some problems, and ``apply`` returns another problem with the inverse, which recovers
trajectory, multipliers, rays and directions of descent. A method has a tuple of reductions: those that accept the
problem are applied from left to right, and recovered from right to left. The judge checks the recovered answer, a claim
about the given problem, on that problem.

A new reduction is a subclass of ``Inverse`` that overrides some methods, and a function from a problem to this class.
Its cases are in the table of ``tests/helpers/reductions.py``.

References: Agrawal, Verschueren, Diamond and Boyd, Journal of Control and Decision 5, 2018 (a rewriting system for
convex optimization problems).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import Field, dataclass, replace
from typing import ClassVar, Protocol, TypeVar

from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


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
class Inverse:
    """The way from answers of the reduced ``problem`` to answers of the ``given`` one; by default they are the same."""

    given: OptimalControlProblem
    problem: OptimalControlProblem

    @property
    def cost(self) -> float:
        """Return the cost of the given problem less that of the reduced one, a constant."""
        return 0.0

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


@dataclass(frozen=True)
class Reduction:
    """A way to state a problem as another one: ``inverse`` returns that and the way back, or None."""

    inverse: Callable[[OptimalControlProblem], Inverse | None]

    def accepts(self, problem: OptimalControlProblem) -> bool:
        """Whether the reduction changes a problem."""
        return self.inverse(problem) is not None

    def apply(self, problem: OptimalControlProblem) -> tuple[OptimalControlProblem, Inverse]:
        """Return the reduced problem and the way back; without change if the problem is not accepted."""
        inverse = self.inverse(problem) or Inverse(problem, problem)
        return inverse.problem, inverse


@dataclass(frozen=True, eq=False)
class Chain(Inverse):
    """The inverses of several reductions, in the order in which these were applied."""

    inverses: tuple[Inverse, ...]

    def recover(self, answer: AnyAnswer) -> AnyAnswer:
        """Return an answer of the reduced problem as one of the given problem."""
        for inverse in reversed(self.inverses):
            answer = inverse.recover(answer)
        return answer


def reduce_problem(problem: OptimalControlProblem, reductions: Sequence[Reduction]) -> Chain:
    """Return the problem after all reductions that accept it, one after the other, and the way back."""
    reduced, inverses = problem, list[Inverse]()
    for reduction in reductions:
        inverse = reduction.inverse(reduced)
        if inverse is not None:
            reduced = inverse.problem
            inverses.append(inverse)
    return Chain(problem, reduced, tuple(inverses))
