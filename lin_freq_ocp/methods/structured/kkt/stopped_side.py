"""The side of the rows that couple times: their Schur complement, S = F P F' + C, by sums of squares."""

from __future__ import annotations

from copy import copy
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky
from lin_freq_ocp.methods.structured.kkt.low_rank import FineRows, fine_rows
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.response import Response
from lin_freq_ocp.methods.structured.kkt.side import Compliance, Side, Step
from lin_freq_ocp.methods.structured.model.stages import Stages


def stopped_side(stages: Stages, loops: Loops) -> Side:
    """Return the side: with rows on a fine grid by their low rank, else dense."""
    response = Response(stages, loops)
    fine = fine_rows(response)
    return StoppedSide(response) if fine is None else FineRows(response, fine)


class StoppedSide:
    """The dense Schur complement on all rows that couple times."""

    indefinite: ClassVar[bool] = False

    def __init__(self, response: Response):
        self._response, self._count = response, response.coupling.count
        self._rows = response.rows.gradients

    def exchanged(self, stages: Stages) -> StoppedSide:
        """Return the same for stages with other dynamics and Hessians."""
        other = copy(self)
        other._response = self._response.exchanged(stages)
        return other

    def factor(self, Phi: Array, compliance: Compliance) -> bool:
        """Prepare for Phi (T+1, n+k, n+k) and C."""
        self._response.factor(Phi)
        S = self._response.gram(*self._rows)
        compliance.add_to(S)
        self._schur = Cholesky(S)
        return True

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> Step:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        given = gradient, c, x0, f
        nu = self._schur.solve(self._response.missing(*given)) if self._count else np.zeros(0)
        return self._response.step(*given, nu)
