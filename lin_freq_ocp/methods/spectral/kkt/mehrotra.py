"""Mehrotra's predictor-corrector step for l >= 0, z >= 0, l'z = 0 with linear equations, for both interior points.

Mehrotra (1992), On the implementation of a primal-dual interior point method.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.spectral import tolerances as tol

TO_BOUNDARY = 0.995  # fraction of the step to the boundary


class Step(NamedTuple):
    """The step of other unknowns, the new weights and slacks, and the step length."""

    other: Array
    weights: Array
    z: Array
    length: float


def predictor_corrector(
    newton: Callable[[Array], tuple[Array, Array]],
    weights: Array,
    z: Array,
    mu: float,
    to_boundary: float = TO_BOUNDARY,
) -> Step:
    """Return the step from weights l > 0 and slacks z > 0 with mu = l'z / count.

    ``newton`` returns the steps of other unknowns and of l for the target of the equations z dl + l dz = target.
    """
    _, dw = newton(-weights * z)
    dz = (-weights * z - z * dw) / weights
    length = min(1.0, _reach(weights, dw), _reach(z, dz))
    after = float((weights + length * dw) @ (z + length * dz)) / float(weights @ z)
    target = after**3 * mu - weights * z - dw * dz
    other, dw = newton(target)
    dz = (target - z * dw) / weights
    length = min(1.0, to_boundary * min(_reach(weights, dw), _reach(z, dz)))
    return Step(length * other, weights + length * dw, z + length * dz, length)


def _reach(v: Array, dv: Array) -> float:
    """Return the step at which the first entry of v + step dv becomes zero."""
    return 1 / max(tol.TINY, float((-dv / v).max()))
