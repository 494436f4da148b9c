"""Stage costs by formulas that are sums of norms, maxima and squares of affine functions, as convex terms.

With linear dynamics, a problem with such a cost is a convex program, whose global optimum has a proof for any number of
states. max(a, b) is (a + b)/2 + |a - b|/2.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, times_vectors
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.formulas.operations import MAXIMUM, MINIMUM, NORM, POWER, SUM
from lin_freq_ocp.problem.costs.formula_cost import SmoothCost
from lin_freq_ocp.problem.costs.quadratic import CostSum, NonsmoothCost, QuadraticCost
from lin_freq_ocp.problem.hybrid.formula_modes import affine_row
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.maps import StageMap
from lin_freq_ocp.problem.terms.penalties import NormBall
from lin_freq_ocp.problem.terms.term import Term, TermKind


@dataclass(frozen=True, eq=False)
class AffineNorms(NonsmoothCost):
    """sum_{t<T} sum_i |F_i (x_t, u_t) + c_i|; ``rows`` are [F_i, c_i], (components, n + m + 1) each."""

    rows: tuple[Array, ...]
    label: ClassVar[str] = "norms of formulas"

    def own_terms(self, n: int, m: int, horizon: int, field: str, name: str) -> list[Term]:
        """Return a term for each norm."""
        times, length = np.arange(horizon), NormBall(2.0, np.zeros(()), np.ones(()))
        maps = [StageMap(times, rows[:, :n], rows[:, n:-1], rows[:, -1]) for rows in self.rows]
        return [Term(f"{name} {i}", TermKind.STAGE_COST, values, length) for i, values in enumerate(maps)]

    def describe(self) -> str:
        """Return how many norms there are."""
        return f"the sum of {len(self.rows)} norms of affine functions at each time"

    def augmented(self, n: int, k: int) -> AffineNorms:
        """Return the cost of (x, w), w in R^k without cost."""
        return AffineNorms(tuple(np.insert(rows, [n] * k, 0.0, axis=1) for rows in self.rows))


@dataclass(eq=False)
class _Summands:
    """The summands of a formula found so far, by their rows (..., n + m + 1); with ``only_norms``, others stay."""

    affine: Array
    only_norms: bool = False
    norms: list[Array] = field(default_factory=list[Array])
    squares: list[Array] = field(default_factory=list[Array])
    others: list[Formula] = field(default_factory=list[Formula])

    def add(self, node: Formula, factor: float) -> None:
        """Add a multiple of a formula."""
        own, rows = affine_row(node), [row for row in map(affine_row, node.arguments) if row is not None]
        if own is not None and not self.only_norms:
            self.affine += factor * own
        elif own is None and node.kind == SUM:
            self.affine[-1] += factor * node.data[-1]
            for part, own_factor in zip(node.arguments, node.data[:-1], strict=True):
                self.add(part, factor * own_factor)
        elif len(rows) < len(node.arguments) or (self.only_norms and node.kind != NORM):
            self.others.append(factor * node)
        elif node.kind == NORM and factor > 0:
            self.norms.append(factor * np.array(rows))
        elif len(rows) == 2 and ((node.kind == MAXIMUM and factor > 0) or (node.kind == MINIMUM and factor < 0)):
            self.affine += factor / 2 * (rows[0] + rows[1])
            self.norms.append(factor / 2 * (rows[0] - rows[1])[None])
        elif node.kind == POWER and node.data[0] == 2 and factor > 0:
            self.squares.append(np.sqrt(factor) * rows[0])
        else:
            self.others.append(factor * node)


def with_norms_as_terms(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem with norms in its stage cost as terms, which have multipliers where they are zero.

    Its cost differs by a constant. Other summands stay formulas; without a norm, it is the problem itself.
    """
    stage, terminal = problem.cost.formulas
    if stage is None:
        return problem
    found, cost = _Summands(np.zeros(sum(stage.dimensions) + 1), only_norms=True), problem.cost.without_formulas
    found.add(stage, 1.0)
    if not found.norms:
        return problem
    formulas = SmoothCost(stage=sum(found.others, 0.0 * stage), terminal=terminal)
    return problem.derived(cost=CostSum([cost.quadratic, *cost.norms, AffineNorms(tuple(found.norms)), formulas]))


def with_convex_terms(problem: OptimalControlProblem) -> OptimalControlProblem | None:
    """Return the problem with its stage cost by a formula as convex terms; its cost differs by a constant.

    None if the cost has another form or no kinks.
    """
    stage, terminal = problem.cost.formulas
    if stage is None or terminal is not None:
        return None
    found, width = _Summands(np.zeros(sum(stage.dimensions) + 1)), sum(stage.dimensions)
    found.add(stage, 1.0)
    if found.others or not found.norms:
        return None
    squares = np.array(found.squares).reshape(-1, width + 1)
    M, slope = 2 * squares[:, :-1].T @ squares[:, :-1], found.affine[:-1] + 2 * squares[:, -1] @ squares[:, :-1]
    steps = np.arange(problem.horizon + 1)[:, None] < problem.horizon
    quadratic = with_parabola(problem.quadratic, np.zeros((len(steps), width)), steps * slope, steps[..., None] * M)
    norms = [*problem.cost.without_formulas.norms, AffineNorms(tuple(found.norms))]
    return problem.derived(cost=CostSum([quadratic, *norms]))


def with_parabola(cost: QuadraticCost, points: Array, slopes: Array, hessians: Array) -> QuadraticCost:
    """Return a cost plus slope'd + 1/2 d'H d, d the deviation from points of (x_t, u_t), t = 0 .. T."""
    n, T, H = cost.S.shape[-2], len(points) - 1, 0.5 * (hessians + hessians.swapaxes(1, 2))
    slopes = slopes - times_vectors(H, cost.deviations_of(points))  # the quadratic cost counts from its references
    return replace(
        cost,
        Q=cost.Q + H[:T, :n, :n],
        R=cost.R + H[:T, n:, n:],
        S=cost.S + H[:T, :n, n:],
        q=cost.q + slopes[:T, :n],
        r=cost.r + slopes[:T, n:],
        P=cost.P + H[T, :n, :n],
        p=cost.p + slopes[T, :n],
    )
