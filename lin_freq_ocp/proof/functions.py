"""The functions h of the format, from the penalties of a problem."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import singledispatch

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.terms.ends_map import Within
from lin_freq_ocp.problem.terms.largest_excess import LargestExcess
from lin_freq_ocp.problem.terms.penalties import HalfSpaces, NormBall, StandardCone
from lin_freq_ocp.problem.terms.penalty import Penalty

NAMES = {1: "ball 1", 2: "ball 2", np.inf: "ball inf"}


@dataclass(frozen=True, eq=False)
class Function:
    """Its name, which groups are limited, (groups,), the fields of its line, and those of each group."""

    name: str
    kept: Mask
    common: dict[str, float] = field(default_factory=dict[str, float])
    of_groups: dict[str, Array] = field(default_factory=dict[str, Array])  # (groups,) or (groups, dim)

    def of_group(self, group: int) -> dict[str, Array]:
        """Return the fields of a group's line."""
        return {name: values[group] for name, values in self.of_groups.items()}


@singledispatch
def function_of(penalty: Penalty, shape: tuple[int, int]) -> Function:
    """Return the function of values (groups, dim); UnsupportedError if the format has none."""
    raise UnsupportedError(f"a {type(penalty).__name__}")


@function_of.register
def _half_spaces(penalty: HalfSpaces, shape: tuple[int, int]) -> Function:
    limit, weight = (np.broadcast_to(part, shape) for part in (penalty.limit, penalty.weight))
    return Function("halfspaces", _all(shape), of_groups={"limit": limit, "weight": weight})


@function_of.register
def _ball(penalty: NormBall, shape: tuple[int, int]) -> Function:
    limit, weight = (np.broadcast_to(part, shape[:1]) for part in (penalty.radius, penalty.weight))
    return Function(NAMES[penalty.order], np.isfinite(limit), of_groups={"limit": limit, "weight": weight})


@function_of.register
def _within(penalty: Within, shape: tuple[int, int]) -> Function:
    limit, weight = np.full(shape[0], penalty.reach), np.full(shape[0], np.inf)
    return Function("ball inf", _all(shape), of_groups={"limit": limit, "weight": weight})


@function_of.register
def _cone(penalty: StandardCone, shape: tuple[int, int]) -> Function:
    return Function("cone", _all(shape))


@function_of.register
def _largest(penalty: LargestExcess, shape: tuple[int, int]) -> Function:
    common = {"weight": float(penalty.weight)}
    return Function("largest", np.isfinite(penalty.limit), common, {"limit": penalty.limit})


def _all(shape: tuple[int, int]) -> Mask:
    return np.ones(shape[0], dtype=bool)
