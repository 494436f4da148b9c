"""Affine expressions of states and controls with maxima and minima: the formulas that are piecewise affine."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.formulas.nodes import EXTERNAL, MAXIMUM, MINIMUM, POWER, SMOOTH, SUM, VARIABLE, Formula, variables

LONGEST_TEXT = 40
"""Characters of an affine function in the name of a mode."""

NOUNS = {POWER: "product", EXTERNAL: "function"}
"""What errors call operations that have other names."""


class Expression(Formula):
    """An affine function of (x, u) plus multiples of maxima and minima of others; made by ``affine_signals``.

    Sums and differences of expressions, multiples and quotients by numbers, and ``maximum``, ``minimum`` and ``abs`` of
    expressions are expressions; nothing else is.

    Attributes
    ----------
    dimensions : (n, m)
    affine : (n + m + 1,)
        Coefficients of x and of u, and the constant.
    branchings : tuple of (float, Expression)
        What is added: maxima and minima with their factors, each once.
    """

    arguments: tuple[Expression, ...]

    word = "expression"
    __array_ufunc__ = None  # numpy leaves operators to this class

    def node(self, kind: str, arguments: tuple[Formula, ...], data: tuple[float, ...] = ()) -> Self:
        """Return what an operator makes, if that is piecewise affine."""
        if kind not in (SUM, MAXIMUM, MINIMUM):
            what = kind if kind in SMOOTH else f"a {NOUNS.get(kind, kind)}"
            advice = "Formulas of lfo.signals are for PiecewiseSmoothDynamics."
            raise ProblemError("expression", f"{what} of expressions", "sums and multiples by numbers", advice)
        return super().node(kind, arguments, data)

    @property
    def _terms(self) -> list[tuple[float, Expression]]:
        return list(zip(self.data, self.arguments, strict=False)) if self.kind == SUM else [(1.0, self)]

    @cached_property
    def affine(self) -> Array:
        """Coefficients of x and of u, and the constant: shape (n + m + 1,)."""
        row = np.zeros(sum(self.dimensions) + 1)
        row[-1] = self.data[-1] if self.kind == SUM else 0.0
        for factor, one in self._terms:
            if one.kind == VARIABLE:
                row[int(one.data[0])] = factor
        row.flags.writeable = False
        return row

    @cached_property
    def branchings(self) -> tuple[tuple[float, Expression], ...]:
        """Maxima and minima that are added, with their factors."""
        return tuple((factor, one) for factor, one in self._terms if one.kind != VARIABLE)

    def __repr__(self) -> str:
        n, m = self.dimensions
        text = affine_text(self.affine, [*(f"x_{i}" for i in range(n)), *(f"u_{i}" for i in range(m))])
        return f"Expression({text}" + (f", and {len(self.branchings)} maxima or minima)" if self.branchings else ")")


def affine_signals(states: int, controls: int) -> tuple[NDArray[np.object_], NDArray[np.object_]]:
    """Return the components of x and of u as expressions, arrays (n,) and (m,), so that ``A @ x + B @ u`` is one, too.

    Parameters
    ----------
    states, controls : int
        n and m.

    Raises
    ------
    ProblemError
        If they are no whole numbers from 1.
    """
    return variables(Expression, states, controls)


def affine_text(affine: Array, labels: Sequence[str]) -> str:
    """Return an affine function in words, shortened: "-x_0 + 2 u_0 - 1"."""
    terms = [(value, label) for value, label in zip(affine, [*labels, ""], strict=True) if value]
    text = "" if terms else "0"
    for value, label in terms:
        size = "" if label and abs(value) == 1 else f"{abs(value):.4g}"
        sign = (" - " if value < 0 else " + ") if text else ("-" if value < 0 else "")
        text += sign + " ".join(part for part in (size, label) if part)
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 3] + "..."
