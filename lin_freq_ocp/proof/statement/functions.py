"""The functions h of the format, weight max(gauge(v) - limit, 0), from the penalties of a problem.

A function is of each group of values or, for half-spaces, of each single value.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.terms.penalties import HalfSpaces, NormBall, StandardCone, Within
from lin_freq_ocp.problem.terms.penalty import Penalty

NORMS = {1: "1", 2: "2", np.inf: "inf"}


@dataclass(frozen=True, eq=False)
class Function:
    """Its gauge, with limits and weights of groups, (groups, 1), or values, (groups, dim); a limit may be inf."""

    gauge: str
    limits: Array
    weights: Array

    @property
    def by_value(self) -> bool:
        """Whether each value has a line of its own."""
        return self.gauge == "max"


@singledispatch
def function_of(penalty: Penalty, shape: tuple[int, int]) -> Function:
    """Return the function of values (groups, dim); UnsupportedError if the format has none."""
    raise UnsupportedError(f"a {type(penalty).__name__}")


@function_of.register
def _half_spaces(penalty: HalfSpaces, shape: tuple[int, int]) -> Function:
    return Function("max", np.broadcast_to(penalty.limit, shape), np.broadcast_to(penalty.weight, shape))


@function_of.register
def _ball(penalty: NormBall, shape: tuple[int, int]) -> Function:
    limit, weight = (np.broadcast_to(part, shape[:1])[:, None] for part in (penalty.radius, penalty.weight))
    return Function(NORMS[penalty.order], limit, weight)


@function_of.register
def _within(penalty: Within, shape: tuple[int, int]) -> Function:
    return Function("inf", np.full((shape[0], 1), penalty.reach), np.full((shape[0], 1), np.inf))


@function_of.register
def _cone(penalty: StandardCone, shape: tuple[int, int]) -> Function:
    return Function("cone", np.zeros((shape[0], 1)), np.full((shape[0], 1), np.inf))
