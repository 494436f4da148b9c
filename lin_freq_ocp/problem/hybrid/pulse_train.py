"""Pulse trains with quarter-wave symmetry: levels that switch at free angles.

Over a quarter period, 0 <= theta <= pi/2, a level v lasts for a dwell tau >= 0 of the angle and then changes by one
step, up or down. With dI/dtheta = v the recursion is exact:

    theta' = theta + tau,      I' = I + v tau,      v' = v +- step,
    e'     = e + 4/pi (I^2 tau + I v tau^2 + v^2 tau^3 / 3),
    b_k'   = b_k + 4/(pi k) v (cos k theta - cos k (theta + tau)),

so that over the quarter e grows by 1/pi times the integral of I^2 over the period, and b_k, k odd, by the amplitude of
sin k theta in v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from lin_freq_ocp.base.arrays import Array, assign, brief, positive_integer, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.dynamics.base import Dynamics, signal_labels
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode

ANGLE, LEVEL, CURRENT, ENERGY = range(4)  # indices of the state; amplitudes of harmonics follow
DWELL, DIRECTION = range(2)  # indices of the control
QUARTER = np.pi / 2


@dataclass(frozen=True, eq=False, init=False)
class PulseTrain(Dynamics):
    """A level for a dwell, then a step to the next: states theta, v, I, e and the amplitudes b_k.

    The control is (dwell, direction): the step is up if the direction is zero or above, else down.

    Parameters
    ----------
    step : float
        The distance of neighbouring levels, above zero.
    orders : sequence of int
        Odd harmonics k whose amplitudes are states.

    Raises
    ------
    ProblemError
        If the step is not above zero, or an order is not odd.

    References
    ----------
    docs/levels.md: a problem with pulse trains, and its global bound.

    Examples
    --------
    >>> lfo.dynamics.PulseTrain(step=0.5, orders=[1, 3]).state_dim
    6
    """

    step: float
    orders: tuple[int, ...]

    def __init__(self, step: float, orders: Sequence[int]):
        odd = tuple(positive_integer(f"PulseTrain.orders[{i}]", k) for i, k in enumerate(orders))
        if any(k % 2 == 0 for k in odd) or len(set(odd)) < len(odd):
            raise ProblemError("PulseTrain.orders", brief(list(odd)), "odd numbers that all differ")
        names = ["angle [rad]", "level", "integral of the level", "energy", *(f"harmonic {k}" for k in odd)]
        labels = signal_labels(len(names), 2, None, names, ["dwell [rad]", "direction"])
        assign(self, step=positive_number("PulseTrain.step", step), orders=odd, **labels)

    @property
    def standard_form(self) -> PiecewiseSmoothDynamics:
        """Return the two modes, up and down."""
        return self._modes

    def translated(self, origin: Array, horizon: int) -> None:
        """Return None: the zero of angles and levels has a meaning."""
        return None

    @cached_property
    def _modes(self) -> PiecewiseSmoothDynamics:
        up = SmoothMode(partial(self._images, self.step), region=[f"-u_{DIRECTION}"], name="up")
        down = SmoothMode(partial(self._images, -self.step), region=[f"u_{DIRECTION}"], name="down")
        return PiecewiseSmoothDynamics([up, down], self.state_dim, 2, None, self.state_names, self.control_names)

    def _images(self, step: float, x: Sequence[Formula], u: Sequence[Formula]) -> list[Formula]:
        theta, level, current, tau = x[ANGLE], x[LEVEL], x[CURRENT], u[DWELL]
        energy = current**2 * tau + current * level * tau**2 + level**2 * tau**3 / 3
        waves = [(k * theta).cos() - (k * (theta + tau)).cos() for k in self.orders]
        return [
            theta + tau,
            level + step,
            current + level * tau,
            x[ENERGY] + (4 / np.pi) * energy,
            *(x[4 + i] + (4 / (np.pi * k)) * level * waves[i] for i, k in enumerate(self.orders)),
        ]
