"""Mehrotra's predictor-corrector step for l >= 0, z >= 0, l'z = 0 with linear equations, for both interior points.

Mehrotra (1992), On the implementation of a primal-dual interior point method.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from lin_freq_ocp.arrays import Array

TO_BOUNDARY = 0.995
"""Part of the way to the boundary that a step goes: the usual value."""

TINY = 1e-300
"""Keeps the step to a boundary that is never reached finite."""


class Step(NamedTuple):
    """A step of other unknowns, the new weights and slacks, and its length."""

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
    """Return the step from weights l and slacks z.

    Parameters
    ----------
    newton : callable
        Returns the steps of other unknowns and of l, from Newton equations the last of which is z dl + l dz = target.
    weights, z : (count,)
        l and z, above zero.
    mu : float
        l'z / count.
    to_boundary : float, optional
        Part of the way to the boundary that the step goes at most.
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
    return 1 / max(TINY, float((-dv / v).max()))
