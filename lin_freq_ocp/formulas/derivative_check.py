"""Given derivatives, checked against central differences.

``scipy.differentiate`` fails where a function is undefined within its first step, and loses digits on noisy or rapidly
changing functions unless their scale is known. Here steps of all sizes are compared.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief
from lin_freq_ocp.base.errors import ProblemError

# Steps of central differences, relative to the size of an argument. Of the neighbours that agree best the smaller is
# taken, so that no scale of the function need be known.
STEPS = 10.0 ** -np.arange(1, 11)
# Relative error up to which a derivative is right: tables and iterations in a function cost digits, and a wrong sign,
# index or factor is far larger.
TOLERANCE = 1e-6
# The best difference is off by up to so many times the distance of its neighbour and rounding.
DOUBT = 10.0
ROUNDING = 4 * float(np.finfo(np.float64).eps)  # error of values, relative to their largest


def require_derivative(
    title: str, of: str, what: str, evaluate: Callable[[str, Array], Array], y: Array, states: int, sizes: Array
) -> None:
    """Raise ProblemError unless differences of ``of`` agree with the derivative ``what`` at y (arguments,).

    ``evaluate`` takes the name of either and points (points, arguments), of which the first arguments are ``states``.
    """
    labels = [f"x[{i}]" for i in range(states)] + [f"u[{i}]" for i in range(len(y) - states)]
    where = f"x = {brief(y[:states].tolist())}, u = {brief(y[states:].tolist())}"
    given = evaluate(what, y[None])[0]
    if not np.isfinite(evaluate(of, y[None])).all():
        advice = "Choose a point in its domain."
        raise ProblemError(f"{title}.{of}", f"no finite number at {where}", "finite numbers", advice)
    for j, label in enumerate(labels):
        found, doubt = _differences(lambda points: evaluate(of, points), y, j, float(max(abs(y[j]), sizes[j])))
        if not np.isfinite(found).all():
            got = f"nothing finite on one of the sides of {label} = {y[j]:g}, at {where}"
            advice = "Choose a point inside its domain."
            raise ProblemError(f"{title}.{of}", got, "a function that is defined around", advice)
        own = given[..., j]
        allowed = DOUBT * doubt + TOLERANCE * np.maximum(np.abs(own), np.abs(found))
        for index in np.argwhere(~(np.abs(own - found) <= allowed)):  # not a number is wrong, too
            at = tuple(map(int, index))
            by = " and ".join([*(labels[i] for i in at[1:]), label])
            expected = f"{found[at]:.8g}, as differences of {of} say"
            name = "derivative" if what == "jacobian" else "second derivative"
            advice = f"It is the {name} of output {at[0]} by {by}."
            entry = f"{title}.{what}[{', '.join(map(str, (*at, j)))}]"
            raise ProblemError(entry, f"{own[at]:.8g}, at {where}", expected, advice)


def _differences(evaluate: Callable[[Array], Array], y: Array, j: int, size: float) -> tuple[Array, Array]:
    """Return the derivative by argument j, (...), and how far neighbouring steps are apart; not a number if none is."""
    points = np.tile(y, (2 * len(STEPS), 1))
    points[:, j] += np.concatenate([STEPS, -STEPS]) * size
    above, below = np.split(evaluate(points), 2)
    steps = (points[: len(STEPS), j] - points[len(STEPS) :, j]).reshape(-1, *(1,) * (above.ndim - 1))
    with np.errstate(invalid="ignore"):
        quotients = (above - below) / steps
        rounding = ROUNDING * np.maximum(np.abs(above), np.abs(below)) / np.abs(steps)
        apart = np.abs(np.diff(quotients, axis=0)) + rounding[1:]
    apart = np.where(np.isfinite(apart), apart, np.inf)
    best = np.argmin(apart, axis=0)[None]
    doubt = np.take_along_axis(apart, best, axis=0)[0]
    found = np.take_along_axis(quotients[1:], best, axis=0)[0]
    return np.where(np.isfinite(doubt), found, np.nan), doubt
