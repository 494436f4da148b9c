"""A cost as a function of the controls alone, in balls: linear dynamics, and formulas of one combination each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

import lin_freq_ocp as lfo

Balls = list[arb]
BITS = 400  # of the balls: far more than 50 digits are left where 16 cancel


class Term(NamedTuple):
    """weight f(s_t) at some times, s = c'x + e'u."""

    formula: str  # of s
    weight: float
    c: np.ndarray  # (n,)
    e: np.ndarray  # (m,)
    times: Sequence[int]


class ReducedCost:
    """The sum of terms along x+ = A x + B u from a state; controls are (T m,), those of time 0 first."""

    def __init__(self, A: np.ndarray, B: np.ndarray, start: np.ndarray, horizon: int, terms: Sequence[Term]):
        ctx.prec = BITS
        n, m = B.shape
        ball_A, ball_B = arb_mat(A.tolist()), arb_mat(B.tolist())
        free, forced = arb_mat([[value] for value in start.tolist()]), arb_mat(n, horizon * m)
        states = [(free, forced)]
        for t in range(horizon):
            free, forced = ball_A * free, ball_A * forced
            for i in range(n):
                for j in range(m):
                    forced[i, t * m + j] = ball_B[i, j]
            states.append((free, forced))
        self.size = horizon * m
        self.rows = list[tuple[str, float, Balls, arb]]()  # formula, weight, row, offset
        for formula, weight, c, e, times in terms:
            for t in times:
                of_x = arb_mat([c.tolist()])
                row = (of_x * states[t][1]).tolist()[0]
                for j in range(m):
                    if e[j]:
                        row[t * m + j] += float(e[j])
                self.rows.append((formula, weight, row, (of_x * states[t][0])[0, 0]))

    def combinations(self, u: Sequence[Any]) -> Balls:
        """Return s of every term and time."""
        return [sum((a * value for a, value in zip(row, u, strict=True)), offset) for *_, row, offset in self.rows]

    def values(self, u: Sequence[Any]) -> Balls:
        """Return the value of every term and time."""
        found = zip(self.rows, self.combinations(u), strict=True)
        return [series_of(formula, s)[0] * weight for (formula, weight, *_), s in found]

    def value(self, u: Sequence[Any]) -> arb:
        """Return the cost."""
        return sum(self.values(u), arb(0))

    def derivatives(self, u: Sequence[Any]) -> tuple[arb_mat, arb_mat]:
        """Return the gradient and the Hessian."""
        gradient, hessian = arb_mat(self.size, 1), arb_mat(self.size, self.size)
        for (formula, weight, row, _), s in zip(self.rows, self.combinations(u), strict=True):
            series, column = series_of(formula, s), arb_mat([[a] for a in row])
            gradient += column * (series[1] * weight)
            hessian += column * column.transpose() * (2 * series[2] * weight)
        return gradient, hessian


class FormulaTrial:
    """A problem with x+ = A x + B u from a state, and costs f(s_t) + price/2 |u_t|^2, s = c'x."""

    A: np.ndarray
    B: np.ndarray
    start: np.ndarray
    c: np.ndarray
    T: int
    formula: str  # f
    price: float

    @property
    def terms(self) -> list[Term]:
        """Return the terms of the cost."""
        n, m = self.B.shape
        squares = [Term("s**2/2", self.price, np.zeros(n), unit, range(self.T)) for unit in np.eye(m)]
        return [Term(self.formula, 1.0, self.c, np.zeros(m), range(self.T)), *squares]

    @property
    def let(self) -> dict[str, str]:
        """Return the definition of s."""
        return {"s": " + ".join(f"{value!r}*x_{i}" for i, value in enumerate(self.c.tolist()))}

    @property
    def formula_cost(self) -> lfo.costs.SmoothCost:
        """Return the cost f(s_t)."""
        return lfo.costs.SmoothCost(stage=self.formula, let=self.let)

    def problem_of(self, cost: Any, control: float, state: float, **fields: Any) -> lfo.OptimalControlProblem:
        """Return the problem with a cost and bounds of every control and state."""
        n, m = self.B.shape
        bounds = lfo.Box(np.full(m, -control), np.full(m, control)), lfo.Box(np.full(n, -state), np.full(n, state))
        return lfo.OptimalControlProblem(
            lfo.LinearDynamics(self.A, self.B), self.T, cost, *bounds, self.start, **fields
        )

    def reduced(self, *terms: Term) -> ReducedCost:
        """Return terms, by default those of the cost, as a function of the controls in balls."""
        return ReducedCost(self.A, self.B, self.start, self.T, terms or self.terms)


def series_of(formula: str, s: arb) -> arb_series:
    """Return the value of a formula of s, its slope and half of its curvature."""
    given = arb_series([s, 1], prec=3)
    functions = {name: getattr(arb_series, name) for name in ("exp", "log", "sqrt", "sin", "cos")}
    functions["cosh"] = lambda z: (z.exp() + (-z).exp()) / 2
    functions["tanh"] = lambda z: 1 - 2 / ((2 * z).exp() + 1)
    return eval(formula, {"__builtins__": {}, **functions}, {"s": given})
