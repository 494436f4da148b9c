"""Costs by formulas of states, controls and time (paper, (DTOCPNSD-a)): sums of c_t(x_t, u_t) and c_T(x_T)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, assign
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import join_words
from lin_freq_ocp.formulas.jets import values_of
from lin_freq_ocp.formulas.nodes import Formula, nodes_in_order, require_times, text_of, translate_formulas, with_states
from lin_freq_ocp.formulas.operations import MAXIMUM, MINIMUM, NORM, TABLE, TIME, VARIABLE
from lin_freq_ocp.formulas.text import Formulas, formula_from_text, listed_formulas, read_definitions
from lin_freq_ocp.problem.costs.quadratic import NonsmoothCost
from lin_freq_ocp.problem.terms.term import Term


@dataclass(frozen=True, eq=False, init=False)
class SmoothCost(NonsmoothCost):
    """sum_{t<T} c(t, x_t, u_t) + c_T(x_T), smooth costs by formulas, which need not be convex; other costs are added.

    The stage cost may have kinks: ``abs``, ``lfo.maximum``, ``lfo.minimum`` and ``lfo.norm``, as formulas of dynamics.
    Solvers get the exact first and second derivatives. Dynamics are linear or piecewise smooth.

    Parameters
    ----------
    stage : Formula, str, function or DifferentiableFunction, optional
        c: a formula of signals, its text, or a function of (x, u) or (t, x, u) that returns one when it is called with
        signals.
    terminal : Formula, str, function or DifferentiableFunction, optional
        c_T, without kinks, time and controls: a function of x.
    let : table of str, optional
        Named formulas that the texts of both may use; each may use those before it.

    Raises
    ------
    ProblemError
        If both are missing; in a problem, if a formula is not one number or does not fit the dimensions.

    Examples
    --------
    >>> cost = lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(stage="sin(x_0)**2")
    >>> problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), 9, cost, initial_state=[1.5])
    >>> lfo.solve(problem, "nonsmooth").certificate.pmp
    'satisfied'
    """

    label: ClassVar[str] = "cost by formulas"

    stage: object  # a Formula or None in a problem
    terminal: object
    let: object

    def __init__(
        self,
        stage: Formulas | None = None,
        terminal: Formulas | Callable[[NDArray[np.object_]], object] | None = None,
        let: Mapping[str, str] | None = None,
    ):
        if stage is None and terminal is None:
            advice = 'As in SmoothCost(stage="sin(x_0)**2"), or SmoothCost(stage=lambda t, x, u: np.sin(x[0]) ** 2).'
            raise ProblemError("SmoothCost", "no formula", "a stage cost, a terminal cost, or both", advice)
        assign(self, stage=stage, terminal=terminal, let=let)

    def with_signals(self, n: int, m: int, horizon: int, field: str) -> SmoothCost:
        """Return the cost with formulas of n states and m controls, checked; errors name the field."""
        stage = terminal = None
        known = read_definitions(f"{field}.let", {} if self.let is None else self.let, (n, m))
        if self.stage is not None:
            stage = _one_formula(f"{field}.stage", self.stage, (n, m), known)
            require_times(f"{field}.stage", [stage], horizon)
        if self.terminal is not None:
            given = self.terminal
            states = (lambda x, u: given(x)) if callable(given) else given
            terminal = _one_formula(f"{field}.terminal", states, (n, m), known)
            for node in nodes_in_order([terminal]):
                if node.kind in (MAXIMUM, MINIMUM, NORM):
                    advice = "L1Cost(terminal=...) is a sum of absolute values."
                    raise ProblemError(f"{field}.terminal", f"a kink, {text_of(node)}", "a smooth formula", advice)
                if node.kind in (TIME, TABLE) or (node.kind == VARIABLE and node.data[0] >= n):
                    raise ProblemError(f"{field}.terminal", text_of(node), "a formula of the last state x alone")
        return SmoothCost(stage, terminal)

    @property
    def formulas(self) -> tuple[Formula | None, Formula | None]:
        """Return the formulas of the stage and of the terminal cost, None for none."""
        stage, terminal = (one if isinstance(one, Formula) else None for one in (self.stage, self.terminal))
        return stage, terminal

    @property
    def has_formulas(self) -> bool:
        """Return True."""
        return True

    def own_terms(self, n: int, m: int, horizon: int, field: str, name: str) -> list[Term]:
        """Return none: its formulas are not terms h(L(x, u))."""
        return []

    def describe(self) -> str:
        """Return the formulas as text."""
        parts = [] if self.stage is None else [f"the sum of {_text(self.stage)}"]
        return join_words(parts + ([] if self.terminal is None else [f"{_text(self.terminal)} at the end"]))

    def augmented(self, n: int, k: int) -> SmoothCost:
        """Return the cost of (x, w), w in R^k without cost."""
        stage, terminal = (None if one is None else with_states([one], k)[0] for one in self.formulas)
        return SmoothCost(stage, terminal)

    def translated(self, origin: Array) -> SmoothCost:
        """Return the cost of x - origin, origin (n,)."""
        stage, terminal = (None if one is None else translate_formulas([one], origin)[0] for one in self.formulas)
        return SmoothCost(stage, terminal)

    def formula_values(self, x: Array, u: Array) -> Array:
        """Return the cost of every time, (T+1,), for x (T+1, n) and u (T, m)."""
        (stage, terminal), values = self.formulas, np.zeros(len(x))
        if stage is not None:
            values[:-1] = values_of([stage], np.hstack([x[:-1], u]).astype(np.float64))[:, 0]
        if terminal is not None:
            values[-1] = values_of([terminal], np.append(x[-1], np.zeros(u.shape[1]))[None].astype(np.float64))[0, 0]
        return values


def _one_formula(field: str, given: object, dimensions: tuple[int, int], known: Mapping[str, Formula]) -> Formula:
    if isinstance(given, str):
        return formula_from_text(field, given, dimensions, known)
    found = listed_formulas(field, given, dimensions)
    if len(found) != 1:
        raise ProblemError(field, f"{len(found)} formulas", "one: a cost is one number")
    return found[0]


def _text(given: object) -> str:
    """Return a formula as text; of what is no formula yet, its text for signals that have what it asks for."""
    return text_of(given) if isinstance(given, Formula) else str(given)
