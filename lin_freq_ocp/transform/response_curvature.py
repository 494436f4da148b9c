"""Curvature of a cost in the controls where a frequency response gives the states: one Hermitian matrix for each bin.

With a constant stage Hessian, the quadratic part of the cost of all controls that the bands allow is, by Parseval,

    1/2 sum_t (a'Q a + 2 a'S b + b'R b)  =  1/(2N) sum_k weight_k b_k^* H_k b_k,   H_k = G^*Q G + G^*S + S'G + R,

so that it is convex iff H_k >= 0 at every bin, on the controls that may use it: the power sum y_t u_t of one output
and one control iff Re G_k >= 0. Of a zero-padded record, whose outputs go on after the horizon, Q is left out, and no
bin is removed by a band: H_k >= 0 is sufficient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, first_largest
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import first_few
from lin_freq_ocp.problem.costs.quadratic import CONVEXITY_TOLERANCE
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.ocp import OptimalControlProblem


@dataclass(frozen=True, eq=False)
class BinCurvature:
    """H_k (bins, m, m), and the controls that may use bin k, (bins, m)."""

    hessians: ComplexArray
    passed: Mask

    @cached_property
    def within(self) -> ComplexArray:
        """H_k on the controls that may use bin k, zero elsewhere."""
        return self.hessians * (self.passed[:, :, None] & self.passed[:, None, :])

    @cached_property
    def smallest(self) -> Array:
        """The smallest eigenvalue at each bin, (bins,); 0 if it is rounding, or if no control may use the bin."""
        eigenvalues = np.linalg.eigvalsh(self.within)
        rounding = CONVEXITY_TOLERANCE * np.abs(eigenvalues).max(initial=0.0)
        return np.where(eigenvalues[:, 0] < -rounding, eigenvalues[:, 0], np.maximum(eigenvalues[:, 0], 0.0))

    @property
    def failing(self) -> Indices:
        """Return the bins at which it is not positive semidefinite."""
        return np.flatnonzero(self.smallest < 0)


def bin_curvature(problem: OptimalControlProblem, response: Response) -> BinCurvature | None:
    """Return the curvature per bin; None if Q, R or S depends on time."""
    cost, G = problem.quadratic, response.G
    if any(part.ndim == 3 for part in (cost.Q, cost.R, cost.S)):
        return None
    adjoint = np.swapaxes(G, 1, 2).conj()
    crossed = adjoint @ cost.S
    hessians = crossed + np.swapaxes(crossed, 1, 2).conj() + cost.R
    if not response.closed:
        return BinCurvature(hessians, np.ones(hessians.shape[:2], dtype=bool))
    return BinCurvature(hessians + adjoint @ cost.Q @ G, ~problem.control_stop)


def require_convex_bins(problem: OptimalControlProblem, response: Response) -> None:
    """Raise UnsupportedError, with the bins, unless the cost is convex in the controls that the bands allow."""
    if problem.quadratic.nonconvexity() is None:
        return
    curvature, P = bin_curvature(problem, response), np.linalg.eigvalsh(problem.quadratic.P)
    if P[0] < -CONVEXITY_TOLERANCE * np.abs(P).max():
        raise UnsupportedError(f"cost: P has the eigenvalue {P[0]:g}; a convex method needs it positive semidefinite.")
    if curvature is None:
        raise UnsupportedError(
            "cost: [[Q, S], [S', R]] depends on time and is not positive semidefinite at all times; with a "
            "FrequencyResponse, a constant one is enough if it is convex at every bin."
        )
    if not response.closed:
        Q = np.linalg.eigvalsh(problem.quadratic.Q)
        if Q[0] < -CONVEXITY_TOLERANCE * np.abs(Q).max():
            raise UnsupportedError(f"cost: Q has the eigenvalue {Q[0]:g}; zero-padded, it must not be below zero.")
    k = curvature.failing
    if not len(k):
        return
    step = problem.sampling_time
    unit = "Hz" if step is not None else "cycles/sample"
    frequencies = k / (response.record * (step or 1.0))
    listed = first_few([f"{i} ({f:.6g} {unit})" for i, f in zip(k, frequencies, strict=True)], 8)
    (worst,) = first_largest(-curvature.smallest)
    noun = "bin" if len(k) == 1 else "bins"
    stopped = "remove these bins by a stop band of the controls, " if response.closed else ""
    raise UnsupportedError(
        f"cost: not convex in the controls at {len(k)} {noun} of the frequency response: {listed}. "
        f"G^*Q G + G^*S + S'G + R has the eigenvalue {curvature.smallest[worst]:g} at bin {worst}; a convex method "
        "needs it positive semidefinite. "
        f"What helps: {stopped}raise the real part of G there (for instance, a floor for a measured damping), or R."
    )
