"""A random linear problem in any units, against plain Clarabel on the same quadratic program.

Counted are problems without an answer where Clarabel has one, and costs that differ by more than 1e-6 of what the terms
of the cost add up to in absolute value. Clarabel has no answer if its cost falls for ever along a direction, or if
some state moves so little, far from zero, that double precision loses more than 1e-6 of its motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import lin_freq_ocp as lfo
from helpers.oracle import (
    AGREEMENT,
    NOISE,
    Reference,
    cost_scale,
    fitted,
    moves_by_rounding,
    recedes,
    solved_plainly,
    worth,
)
from helpers.random.linear import random_linear
from lin_freq_ocp.base import Array

ANSWERS = ("optimal", "locally_optimal")

FIT = 0.1  # error of the multipliers of our point, relative to a difference that they are to explain


@dataclass(frozen=True)
class Outcome:
    """What became of one random problem."""

    seed: int
    ours: str
    method: str
    theirs: str
    difference: float | None
    message: str = ""

    @property
    def unanswered(self) -> bool:
        """Whether Clarabel has an answer, and there is none here."""
        return self.theirs == "Solved" and self.ours not in ANSWERS

    @property
    def wrong(self) -> bool:
        """Whether both have an answer, at different costs."""
        return self.theirs == "Solved" and self.difference is not None and self.difference > AGREEMENT


def check(seed: int) -> Outcome:
    """Solve one problem here, in its units, and plainly, in good ones."""
    sample = random_linear(seed)
    reference = solved_plainly(sample.good)
    result = lfo.solve(sample.problem, throw=False)
    outcome = Outcome(seed, result.status, result.method, reference.status, None, result.message)
    if outcome.unanswered and moves_by_rounding(sample.good, reference):
        return replace(outcome, theirs="motion of rounding size")
    if reference.status == "Solved" and result.status == "unbounded" and recedes(sample.good, reference.program):
        return replace(outcome, theirs="not the optimum")
    if reference.status != "Solved" or result.status not in ANSWERS or result.trajectory is None:
        return outcome
    x, u = result.trajectory.x * sample.units.x, result.trajectory.u * sample.units.u
    excess, scale = sample.good.value(x, u) - reference.cost, cost_scale(sample.good, x, u)
    difference = abs(excess) / scale if abs(excess) > NOISE else 0.0
    outcome = replace(outcome, difference=difference)
    return outcome if difference <= AGREEMENT else _arbitrated(outcome, reference, excess, scale, x, u)


def _arbitrated(outcome: Outcome, reference: Reference, excess: float, scale: float, x: Array, u: Array) -> Outcome:
    """Return the outcome of two different costs: Clarabel is wrong where its own rules say so of its point.

    Where ours is cheaper, its violations must be worth less than that, by Clarabel's multipliers. Where Clarabel's is
    cheaper, its violations must be worth that, by multipliers that fit our point far better. Else ours must be another
    optimum: multipliers fit it.
    """
    program, z = reference.program, np.concatenate([x.ravel(), u.ravel()])
    y, error = fitted(program, z)
    ours, theirs = worth(program, reference.y, z), worth(program, y, reference.z)
    message = (
        f"{'dearer' if excess > 0 else 'cheaper'} by {abs(excess):.1e}; violations here are worth {ours:.1e}, "
        f"Clarabel's {theirs:.1e}; multipliers fit here to {error:.1e}, there to {reference.error:.1e}"
    )
    if excess < 0:
        wrong = ours < -excess / 2
    else:
        wrong = theirs > excess / 2 and error < FIT * excess
    if not wrong and error > AGREEMENT * scale:
        return replace(outcome, message=message)
    return replace(outcome, theirs="not the optimum" if wrong else "another optimum", message=message)
