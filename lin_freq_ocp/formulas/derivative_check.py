"""Given derivatives, checked against central differences.

``scipy.differentiate`` fails where a function is undefined within its first step, and loses digits on noisy or rapidly
changing functions unless their scale is known. Here steps of all sizes are compared.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array, brief
from lin_freq_ocp.errors import ProblemError

# Of central differences, relative to the size of an argument. Of neighbours that agree best the smaller is taken: so
# that no scale of the function need be known.
STEPS = 10.0 ** -np.arange(1, 11)
# Relative error of a derivative that is no slip: tables and iterations in a function cost digits, and a wrong sign,
# index or factor is seen from far.
TOLERANCE = 1e-6
# Times what neighbouring differences differ by, and rounding errors: what the best of them may be wrong by.
DOUBT = 10.0
ROUNDING = 4 * float(np.finfo(np.float64).eps)  # error of values, relative to their largest
NAMES = {"jacobian": "derivative", "hessian": "second derivative"}


@dataclass(frozen=True)
class Derivative:
    """What is checked.

    Attributes
    ----------
    title : str
        Of the function.
    of, what : str
        "call" and "jacobian", or "jacobian" and "hessian".
    states : int
        How many of the arguments are x.
    """

    title: str
    of: str
    what: str
    states: int

    def argument(self, i: int) -> str:
        """Return the name of an argument."""
        return f"x[{i}]" if i < self.states else f"u[{i - self.states}]"

    def at(self, y: Array) -> str:
        """Return a point in words."""
        return f"x = {brief(y[: self.states].tolist())}, u = {brief(y[self.states :].tolist())}"


def require_derivative(
    which: Derivative, evaluate: Callable[[Array], Array], given: Array, y: Array, sizes: Array
) -> None:
    """Raise ProblemError unless differences agree with the derivative at y.

    Parameters
    ----------
    evaluate : function
        Of points (points, arguments); returns (points, ...).
    given : (..., arguments)
    y, sizes : (arguments,)
    """
    if not np.isfinite(evaluate(y[None])).all():
        advice = "Choose a point in its domain."
        raise ProblemError(f"{which.title}.{which.of}", f"no finite number at {which.at(y)}", "finite numbers", advice)
    for j in range(len(y)):
        found, doubt = _differences(evaluate, y, j, float(max(abs(y[j]), sizes[j])))
        if not np.isfinite(found).all():
            got = f"nothing finite on one of the sides of {which.argument(j)} = {y[j]:g}, at {which.at(y)}"
            advice = "Choose a point inside its domain."
            raise ProblemError(f"{which.title}.{which.of}", got, "a function that is defined around", advice)
        own = given[..., j]
        allowed = DOUBT * doubt + TOLERANCE * np.maximum(np.abs(own), np.abs(found))
        wrong = ~(np.abs(own - found) <= allowed)  # not a number is wrong, too
        for index in np.argwhere(wrong):
            at = tuple(map(int, index))
            by = " and ".join([*(which.argument(i) for i in at[1:]), which.argument(j)])
            label = f"{which.title}.{which.what}[{', '.join(map(str, (*at, j)))}]"
            expected = f"{found[at]:.8g}, as differences of {which.of} say"
            what = f"the {NAMES[which.what]} of output {at[0]} by {by}"
            raise ProblemError(label, f"{own[at]:.8g}, at {which.at(y)}", expected, f"It is {what}.")


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
