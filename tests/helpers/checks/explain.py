"""An infeasible problem is explained: the family can spare no block, each cure helps, and less than it does not.

What can be satisfied is asked of CVXPY and Clarabel on a program written by ``to_cvxpy``, never of what explains.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np

import lin_freq_ocp as lfo
from helpers.random.infeasible import random_infeasible
from lin_freq_ocp.transform import Limit, constraints, drop_limits, stated_sizes

LESS = 0.95  # part of a cure that must not help
FARTHEST = 1e4  # sizes in the data up to which a trajectory counts


@dataclass(frozen=True)
class Outcome:
    """What became of one problem: what is wrong, if anything, what was not decided, and the blocks of the cures."""

    seed: int
    kind: str
    family: tuple[str, ...]
    cures: tuple[str, ...]
    wrong: tuple[str, ...]
    unsure: int

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def feasible(problem: lfo.OptimalControlProblem) -> bool | None:
    """Return what Clarabel says of the constraints alone; None where it is not sure, or the trajectory is far."""
    for cost in (lfo.QuadraticCost(), lfo.QuadraticCost(R=1.0)):  # some solver's trouble goes away with a cost
        oracle = lfo.to_cvxpy(replace(problem, cost=cost))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            try:
                oracle.solve(solver="CLARABEL")
            except cp.SolverError:
                continue
        if oracle.status in ("optimal", "infeasible"):
            break
    if oracle.status == "optimal":
        signals = {one.name(): np.abs(np.asarray(one.value)).max(0) for one in oracle.variables()}
        x, u = stated_sizes(problem)
        near = (signals["x"] <= FARTHEST * x).all() and (signals["u"] <= FARTHEST * u).all()
        return True if near else None
    return False if oracle.status == "infeasible" else None


def check(seed: int) -> Outcome:
    """Explain one problem, and try everything that is said."""
    kind, problem = random_infeasible(seed)
    explanation = lfo.explain(problem)
    named = {block.name: block for block in constraints(problem)}
    family = [named[name] for name in explanation.family]
    others = [block for block in named.values() if block not in family]
    wrong, answers = [] if explanation.irreducible else ["not shown to be irreducible"], list[bool | None]()

    def expect(answer: bool | None, expected: bool, what: str) -> None:
        answers.append(answer)
        if answer is not None and answer != expected:
            wrong.append(what)

    expect(feasible(drop_limits(problem, others)), False, "the family can hold together")
    for block in family:
        expect(feasible(drop_limits(problem, [*others, block])), True, f"the family can spare the {block.name}")
    for cure in explanation.cures:
        enough, less = amounts(named[cure.block], cure.amount)
        expect(feasible(named[cure.block].relaxed(problem, enough)), True, f"no cure: {cure}")
        expect(feasible(named[cure.block].relaxed(problem, less)), False, f"less would do: {cure}")
    cures = tuple(type(named[cure.block]).__name__ for cure in explanation.cures)
    return Outcome(seed, kind, explanation.family, cures, tuple(wrong), answers.count(None))


def amounts(block: Limit, amount: float) -> tuple[float, float]:
    """Return a little more than a cure, and less than it."""
    components = 1 if block.end is None else len(block.box.lower)  # the amount of an end is the sum over components
    return (amount, amount - 1) if block.whole else (1.0001 * amount + 1e-9, LESS * amount / components)
