# ruff: noqa: D102
"""Equations on the first and the last state together: E_0 x_0 + E_T x_T = e, and x_T = x_0.

Methods without a docstring are described by ``ConvexSet``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, require_rows_hold, row_matrix, to_shape, with_columns, with_products
from lin_freq_ocp.base.phrases import datum, plural
from lin_freq_ocp.problem.sets.base import ConvexSet, Part
from lin_freq_ocp.problem.terms.maps import StageMap, SumMap
from lin_freq_ocp.problem.terms.penalties import Within
from lin_freq_ocp.problem.terms.term import Link


@dataclass(frozen=True, eq=False, init=False)
class LinkedEnds(ConvexSet):
    """E_0 x_0 + E_T x_T = e: equations on both ends together, a ``terminal_state``.

    It can be combined with an initial set, and with a terminal set, as in ``LinkedEnds(...) & Box(...)``.

    Parameters
    ----------
    E_0, E_T : (rows, n)
        Coefficients of the first and of the last state.
    e : (rows,), optional
        Right-hand sides, in the units of the rows; default zero.

    Raises
    ------
    ProblemError
        If shapes do not match, entries are not finite, or a row of zeros has a right-hand side that is not zero.

    References
    ----------
    docs/periodic_ends.md has the conditions of the maximum principle and the bound.

    Examples
    --------
    >>> dynamics, cost = lfo.LinearDynamics([[0.5]], [[1.0]]), lfo.QuadraticCost(R=1.0)
    >>> rise = lfo.sets.LinkedEnds([[-1.0]], [[1.0]], [1.0])  # x_T = x_0 + 1
    >>> problem = lfo.OptimalControlProblem(dynamics, 4, cost, initial_state=[0], terminal_state=rise)
    >>> round(float(lfo.solve(problem).trajectory.x[-1, 0]), 9)
    1.0
    """

    E_0: Array
    E_T: Array
    e: Array
    reach: float  # largest distance of the rows from e: above 0 only in explanations of conflicts
    repeats: bool  # whether x_T repeats x_0, so that spectra of states have T samples
    may_be_soft: ClassVar[bool] = False
    name: ClassVar[str] = "linked ends"
    periodic: ClassVar[bool] = False

    def __init__(self, E_0: ArrayLike, E_T: ArrayLike, e: ArrayLike | None = None):
        first = row_matrix("LinkedEnds.E_0", E_0)
        last = to_shape("LinkedEnds.E_T", E_T, first.shape)
        right = to_shape("LinkedEnds.e", np.zeros(len(first)) if e is None else e, first.shape[:1])
        require_rows_hold("LinkedEnds.e", ~(first.any(axis=1) | last.any(axis=1)) & (right != 0), right)
        assign(self, E_0=first, E_T=last, e=right, reach=0.0, repeats=False)

    @property
    def dimension(self) -> int | None:
        return self.E_0.shape[1]

    def parts(self, dimension: int) -> tuple[Part, ...]:
        return ()  # no constraint on x_T alone

    def matrices(self, dimension: int) -> tuple[Array, Array, Array]:
        """Return E_0 and E_T, (rows, dimension), and e."""
        return self.E_0, self.E_T, self.e

    def links(self, dimension: int, horizon: int) -> tuple[Link, ...]:
        E_0, E_T, e = self.matrices(dimension)
        ends = StageMap(np.array([0, horizon]), np.stack([E_0, E_T]), None, np.zeros(len(e)))
        return (Link(self.name, SumMap((ends,), -e), Within(self.reach), self.periodic, self.repeats),)

    def augmented(self, n: int, k: int) -> ConvexSet:
        E_0, E_T, e = self.matrices(n)
        return self._restate(with_columns(E_0, k), with_columns(E_T, k), e)

    def relaxed(self, amount: float, dimension: int) -> ConvexSet:
        return self._restate(*self.matrices(dimension), amount)

    def translated(self, origin: Array) -> ConvexSet:
        E_0, E_T, e = self.matrices(len(origin))
        return self._restate(E_0, E_T, with_products(e, (-E_0, origin), (-E_T, origin)))

    def _restate(self, E_0: Array, E_T: Array, e: Array, farther: float = 0.0) -> LinkedEnds:
        links = LinkedEnds(E_0, E_T, e)
        assign(links, reach=self.reach + farther, repeats=self.repeats, name=self.name)  # names of multipliers stay
        return links

    def describe(self, names: Sequence[str], signal: str) -> str:
        equations = plural(len(self.e), "equation")
        return f"{equations} on both ends, E_0 x_0 + E_T x_T = e{', ' + datum('e', self.e, 1) if self.e.any() else ''}"


class Periodic(LinkedEnds):
    """x_T = x_0: the trajectory is one period, and both ends are free.

    It can be combined with a ``state_set``, an initial set, or a terminal set, as in ``Periodic() & Box(...)``. Spectra
    of states have T samples, x_0 .. x_{T-1}, as x_T repeats x_0.

    References
    ----------
    docs/periodic_ends.md has the conditions of the maximum principle and the bound.

    Examples
    --------
    >>> dynamics = lfo.LinearDynamics([[0.5]], [[1.0]])
    >>> cost = lfo.QuadraticCost(Q=1.0, R=1.0, x_ref=[[1.0], [0.0], [1.0], [0.0], [1.0]])
    >>> problem = lfo.OptimalControlProblem(dynamics, 4, cost, terminal_state=lfo.Periodic())
    >>> x = lfo.solve(problem).trajectory.x
    >>> bool(abs(x[0] - x[-1]) < 1e-9)
    True
    """

    name: ClassVar[str] = "periodic ends"
    periodic: ClassVar[bool] = True

    def __init__(self):
        assign(self, E_0=np.asarray(-1.0), E_T=np.asarray(1.0), e=np.asarray(0.0), reach=0.0, repeats=True)

    @property
    def dimension(self) -> None:
        return None

    def matrices(self, dimension: int) -> tuple[Array, Array, Array]:
        return -np.eye(dimension), np.eye(dimension), np.zeros(dimension)

    def translated(self, origin: Array) -> Periodic:
        return self

    def describe(self, names: Sequence[str], signal: str) -> str:
        return "x_T = x_0: the trajectory is one period"
