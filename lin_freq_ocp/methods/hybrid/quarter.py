"""What the bounds over angles know of a problem with a pulse train: levels, dwells, amplitudes and their limits.

A pulse train (problem/hybrid/pulse_train.py) that starts at level 0 is given by its steps s_i = +-step and
the angles 0 <= a_1 <= .. <= a_d <= pi/2 at which they are taken. With c_i = pi/2 - a_i, and I(pi/2) = 0, it has
I(theta) = -sum_i s_i min(pi/2 - theta, c_i) over the quarter, so that for odd k

    E = 4/pi sum_ij s_i s_j K(c_i, c_j),    K(a, b) = ab pi/2 - a^3/6 - a b^2/2  for a <= b,
    b_k = 4/(pi k) sum_i s_i cos k a_i.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.hybrid.pulse_train import ANGLE, CURRENT, DWELL, ENERGY, LEVEL, QUARTER, PulseTrain
from lin_freq_ocp.problem.ocp import OptimalControlProblem

ANGLE_ROUNDING = 1e-12  # of angles of a quarter: the rounding of their sums with dwells is smaller
RANGE_ROUNDING = 1e-9  # of a step of a lattice, by which ranges of angles are wider: their rounding is smaller
LEVEL_ROUNDING = 1e-9  # of a level's limit over the step: limits that are whole multiples of it are met


@dataclass(frozen=True, eq=False)
class Quarter:
    """A train's d steps, the least and the highest level in steps, least dwells (d + 1,), and l <= b_k <= h of orders.

    The unit of levels is a power of two near the step, so that rounding does not depend on the unit of the problem. The
    cost is ``price`` (E + ``offset``).
    """

    step: float
    lowest: int
    highest: int
    dwells: Array
    orders: tuple[int, ...]
    low: Array
    high: Array
    price: float
    offset: float

    @staticmethod
    def of_problem(problem: OptimalControlProblem, dynamics: PulseTrain) -> Quarter:
        """Return it; UnsupportedError for a problem of another form than that of docs/levels.md."""
        _require_form(problem)
        (start, end), levels, step = problem.ends, problem.state_boxes, dynamics.step
        unit = float(2.0 ** np.floor(np.log2(step)))  # division by it is exact
        return Quarter(
            step=step / unit,
            lowest=int(np.ceil(levels.lower[1, LEVEL] / step - LEVEL_ROUNDING)),
            highest=int(np.floor(levels.upper[1, LEVEL] / step + LEVEL_ROUNDING)),
            dwells=np.broadcast_to(problem.control_tube.lower[:, DWELL], problem.horizon).copy(),
            orders=dynamics.orders,
            low=(end.lower[4:] - start.upper[4:]) / unit,
            high=(end.upper[4:] - start.lower[4:]) / unit,
            price=float(problem.quadratic.p[ENERGY]) * unit**2,
            offset=float(start.lower[ENERGY]) / unit**2,
        )

    def energy(self, steps: Array, angles: Array) -> tuple[float, Array]:
        """Return E and its slopes (d,) of one train."""
        c = QUARTER - angles
        first, second = c[:, None], c
        low, high = np.minimum(first, second), np.maximum(first, second)
        kernel = low * high * QUARTER - low**3 / 6 - low * high**2 / 2
        of_first = np.where(first <= second, second * QUARTER - (first**2 + second**2) / 2, second * (QUARTER - first))
        return float(4 / np.pi * steps @ kernel @ steps), -8 / np.pi * steps * (of_first @ steps)

    def amplitudes(self, steps: Array, angles: Array) -> tuple[Array, Array]:
        """Return the amplitudes b_k and their slopes (k, d) of one train."""
        k, weight = np.array(self.orders, dtype=float)[:, None], (4 / np.pi) * steps
        return (weight * np.cos(k * angles) / k).sum(1), -weight * np.sin(k * angles)

    def apart(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Return bounds of angles (d,) that those before and after leave: dwells are no less than the least."""
        after = np.cumsum(self.dwells)
        low = np.maximum.accumulate(np.maximum(low - after[:-1], 0.0)) + after[:-1]
        high = np.minimum.accumulate(np.minimum(high - after[:-1], QUARTER - after[-1])[::-1])[::-1] + after[:-1]
        return low - ANGLE_ROUNDING, high + ANGLE_ROUNDING

    @property
    def least_cost(self) -> float:
        """The least squares of the amplitudes, which bound the cost by Parseval's equation, rounded down."""
        least = zip(np.maximum(np.maximum(self.low, -self.high), 0.0), self.orders, strict=True)
        exact = Fraction(self.price) * sum(((Fraction(b) / k) ** 2 for b, k in least), Fraction(self.offset))
        return float(np.nextafter(float(exact), -np.inf))

    def shift(self, r: Array) -> float:
        """Return -sum r_k^2 + 2 sum min(r_k l_k, r_k h_k) / k, of a bound on the energy by L_r."""
        with np.errstate(invalid="ignore"):  # there may be no limit where there is no price
            ends = np.minimum(*(np.where(r == 0, 0.0, r * limit) for limit in (self.low, self.high)))
        return float(2 * (ends / np.array(self.orders)).sum() - r @ r)


def _require_form(problem: OptimalControlProblem) -> None:
    """Raise UnsupportedError unless the problem is that of docs/levels.md."""
    cost, (start, end), boxes = problem.quadratic, problem.ends, problem.state_boxes
    price = np.zeros(problem.state_dim)
    price[ENERGY] = cost.p[ENERGY]
    linear = not (cost.Q.any() or cost.R.any() or cost.S.any() or cost.P.any() or cost.q.any() or cost.r.any())
    named = {
        "a horizon of 1": problem.horizon > 1,
        "a cost other than that of the energy at the end": linear and (cost.p == price).all() and price[ENERGY] > 0,
        "terms beyond boxes": not problem.terms and not problem.control_stop.any() and not problem.state_stop.any(),
        "another start than theta = 0 at level 0 with known energy": _is_fixed(start.lower, start.upper, ANGLE, 0.0)
        and _is_fixed(start.lower, start.upper, LEVEL, 0.0)
        and start.lower[ENERGY] == start.upper[ENERGY],
        "another end than theta = pi/2 with I = 0": _is_fixed(end.lower, end.upper, ANGLE, QUARTER)
        and _is_fixed(end.lower, end.upper, CURRENT, 0.0),
        # the first level is fixed, and a loop leaves its bounds out
        "levels whose bounds depend on time": bool((boxes.lower[1:, LEVEL] == boxes.lower[-1, LEVEL]).all())
        and bool((boxes.upper[1:, LEVEL] == boxes.upper[-1, LEVEL]).all()),
        "dwells that may be below zero": bool((problem.control_tube.lower[:, DWELL] >= 0).all()),
    }
    unmet = [words for words, holds in named.items() if not holds]
    if unmet:
        text = f"the bound over angles does not support {unmet[0]}; expected the form in docs/levels.md."
        raise UnsupportedError(text)


def _is_fixed(lower: Array, upper: Array, place: int, value: float) -> bool:
    return bool(lower[place] == value == upper[place])
