# ruff: noqa: D102  (a method without a docstring is described by ``FrequencyConstraint``)
"""Linear equations over all times of a signal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, positive_number, real_array, with_columns
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import datum, first_few, price, short_name
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal
from lin_freq_ocp.problem.terms.maps import SumMap
from lin_freq_ocp.problem.terms.penalties import NormBall
from lin_freq_ocp.problem.terms.penalty import weight_of
from lin_freq_ocp.problem.terms.term import Term


@dataclass(frozen=True, eq=False, init=False)
class LinearConstraint(FrequencyConstraint):
    """constant + sum_t coefficients_t v_t = 0 for the signal v it is given for (paper, (SFC) and (CFC)).

    Parameters
    ----------
    coefficients : (times, rows, components)
        One matrix per time: T of them for controls, T+1 for states (T with Periodic()).
    constant : (rows,), optional
        Zero without.
    penalty : float, optional
        Makes it soft: penalty times the Euclidean norm of the left-hand side is added to the cost.

    Raises
    ------
    ProblemError
        If shapes do not match or entries are not finite.

    Examples
    --------
    >>> mean = lfo.spectrum.LinearConstraint([[[0.25]]] * 4)  # of four controls
    >>> mean.coefficients.shape
    (4, 1, 1)
    """

    coefficients: Array
    constant: Array
    penalty: float | None
    on_outputs: ClassVar[bool] = False

    def __init__(self, coefficients: ArrayLike, constant: ArrayLike | None = None, penalty: float | None = None):
        matrices = real_array("LinearConstraint.coefficients", coefficients)
        if matrices.ndim != 3 or 0 in matrices.shape:
            expected = "one matrix (rows, components) per time"
            raise ProblemError("LinearConstraint.coefficients", f"shape {matrices.shape}", expected)
        rows = matrices.shape[1]
        right = np.zeros(rows) if constant is None else real_array("LinearConstraint.constant", constant)
        if right.shape != (rows,):
            raise ProblemError("LinearConstraint.constant", f"shape {right.shape}", f"shape ({rows},)")
        soft = None if penalty is None else positive_number("LinearConstraint.penalty", penalty)
        impossible = ~matrices.any(axis=(0, 2)) & (right != 0)
        if impossible.any() and soft is None:
            row = int(np.argmax(impossible))
            got = f"{right[row]:g} for row {row}, which has no coefficients"
            raise ProblemError("LinearConstraint.constant", got, "a row that can hold")
        assign(self, coefficients=matrices, constant=right, penalty=soft)

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        expected = (signal.length, self.coefficients.shape[1], len(signal.names))
        if self.coefficients.shape != expected:
            raise ProblemError(f"{field}.coefficients", f"shape {self.coefficients.shape}", f"shape {expected}")
        parts = (self.coefficients, None) if signal.D is None else (None, self.coefficients)
        ball = NormBall(2, np.zeros(()), weight_of(self.penalty))
        yield Term(f"linear constraint of {signal.kind}", signal.kind, SumMap(*parts, self.constant), ball, source)

    def extended(self, n: int, k: int) -> Sequence[FrequencyConstraint]:
        return [LinearConstraint(with_columns(self.coefficients, k), self.constant, self.penalty)]

    def softened(self, penalty: float) -> LinearConstraint:
        return self if self.penalty is not None else LinearConstraint(self.coefficients, self.constant, penalty)

    def describe(self, names: Sequence[str]) -> str:
        rows = self.coefficients.shape[1]
        used = [short_name(name) for i, name in enumerate(names) if self.coefficients[:, :, i].any()]
        of = first_few(used) if used else "nothing"
        equations = "linear equation" if rows == 1 else f"{rows} linear equations"
        right = "" if not self.constant.any() else f", {datum('constant', self.constant, 1)}"
        cost = price(self.penalty, "norm")
        return f"{equations} in {of} over all times: constant + sum of coefficients_t v_t = 0{right}{cost}"
