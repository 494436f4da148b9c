"""The side of the rows that couple times: their Schur complement, S = F P F' + C, by columns of the response."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky
from lin_freq_ocp.methods.structured.kkt.low_rank import FineRows, fine_rows
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.response import Response
from lin_freq_ocp.methods.structured.kkt.side import Compliance, Side, Step
from lin_freq_ocp.methods.structured.model.stages import Stages

COLUMNS = 256  # of the response at once: enough for vector instructions, few enough for the memory
CACHED_BYTES = 1e9  # of columns of F that are kept between steps


def stopped_side(stages: Stages, loops: Loops) -> Side:
    """Return the side: with rows on a fine grid by their low rank, else dense."""
    response = Response(stages, loops)
    fine = fine_rows(response)
    return StoppedSide(response) if fine is None else FineRows(response, fine)


class StoppedSide:
    """The dense Schur complement on all rows that couple times."""

    def __init__(self, response: Response):
        self._response, coupling = response, response.coupling
        self._count = coupling.count
        self._blocks = [np.arange(a, min(self._count, a + COLUMNS)) for a in range(0, self._count, COLUMNS)]
        size = 8 * len(response.stages.H) * len(coupling.channels) * self._count
        self._gradients = {i: response.gradients(rows) for i, rows in enumerate(self._blocks) if size <= CACHED_BYTES}

    def factor(self, Phi: Array, compliance: Compliance) -> None:
        """Prepare for Phi (T+1, n+k, n+k) and C."""
        response, S = self._response, np.empty((self._count, self._count))
        response.factor(Phi)
        for i, rows in enumerate(self._blocks):
            gradients = self._gradients[i] if i in self._gradients else response.gradients(rows)
            S[:, rows] = -response.forward(*response.responses(*gradients))
        compliance.add_to(S)
        self._schur = Cholesky(S)

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> Step:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        given = gradient, c, x0, f
        nu = self._schur.solve(self._response.missing(*given)) if self._count else np.zeros(0)
        return self._response.step(*given, nu)
