"""Convex functions h of random data, of every class, with their definitions, points inside and normals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from helpers.own_kinds import WeightedMax
from lin_freq_ocp.problem import HARD, HalfSpaces, LargestExcess, NormBall, NormRows, Penalty, StandardCone, Within

GROUPS, DIM, ROWS = 7, 4, 5
Points = np.ndarray  # (GROUPS, DIM)


@dataclass(frozen=True)
class Kind:
    """A convex function of random data, hard or soft."""

    make: Callable[[np.random.Generator], Penalty]
    hard: bool
    shape: tuple[int, int] = (GROUPS, DIM)


def limits(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Return limits of which some are infinite."""
    return np.where(rng.random(shape) < 0.2, np.inf, rng.uniform(0.2, 2.0, shape))


def norm(order: float, hard: bool) -> Kind:
    def make(rng: np.random.Generator) -> NormBall:
        radius = np.zeros(()) if order == 1 or rng.random() < 0.3 else limits(rng, GROUPS)
        return NormBall(order, radius, HARD if hard else rng.uniform(0.1, 2.0, GROUPS))

    return Kind(make, hard)


def norm_rows(rng: np.random.Generator) -> NormRows:
    share = np.where(rng.random((2, 3)) < 0.3, 0.0, rng.uniform(0.1, 1.0, (2, 3)))
    return NormRows(rng.uniform(-1.0, 3.0, ROWS), share, rng.integers(0, 2, ROWS))


KINDS = {
    "hard half-spaces": Kind(lambda rng: HalfSpaces(limits(rng, GROUPS, DIM), HARD), hard=True),
    "soft half-spaces": Kind(lambda rng: HalfSpaces(limits(rng, DIM) - 1, rng.uniform(0.1, 2.0, (GROUPS, 1))), False),
    "interval": Kind(lambda rng: Within(rng.uniform(0.2, 2.0)), hard=True),
    "cone": Kind(lambda rng: StandardCone(), hard=True),
    "rows with norms": Kind(norm_rows, hard=True, shape=(1, ROWS + 6)),
    **{f"hard norm {order}": norm(order, True) for order in (2, np.inf)},
    **{f"soft norm {order}": norm(order, False) for order in (1, 2, np.inf)},
    "largest excess": Kind(lambda rng: LargestExcess(limits(rng, GROUPS), np.asarray(rng.uniform(0.1, 2.0))), False),
    "of a user": Kind(lambda rng: WeightedMax(rng.uniform(0.5, 2.0, DIM), rng.uniform(0.1, 2.0)), False),
}
OF_ONE_GROUP: dict[str, Callable[[np.random.Generator], Penalty]] = {  # as a set has them at one time
    "hard half-spaces": lambda rng: HalfSpaces(limits(rng, DIM), HARD),
    "soft half-spaces": lambda rng: HalfSpaces(limits(rng, DIM), np.asarray(rng.uniform(0.1, 2.0))),
    "cone": lambda rng: StandardCone(),
    "hard norm": lambda rng: NormBall(2, np.asarray(rng.uniform(0.2, 2.0)), HARD),
    "soft norm": lambda rng: NormBall(2, np.asarray(rng.uniform(0.2, 2.0)), np.asarray(rng.uniform(0.1, 2.0))),
    "interval": KINDS["interval"].make,
    "of a user": KINDS["of a user"].make,
}
HARD_KINDS = [name for name, kind in KINDS.items() if kind.hard]
SOFT_KINDS = [name for name, kind in KINDS.items() if not kind.hard]


@singledispatch
def excess(penalty: Penalty, v: Points) -> np.ndarray:
    """Return the excess over each limit by its definition, negative inside."""
    raise NotImplementedError(type(penalty))


@singledispatch
def inside(penalty: Penalty, v: Points) -> Points:
    """Return values as near zero as it takes for the hard part to hold; values of a soft one do not change."""
    return v


@singledispatch
def normal(penalty: Penalty, v: Points, rng: np.random.Generator) -> tuple[Points, Points]:
    """Return points on the boundary of a hard one, near the given ones, and a normal at each."""
    raise NotImplementedError(type(penalty))


def h(penalty: Penalty, v: Points) -> float:
    """Return the value by the definition: infinity where a hard limit does not hold."""
    violation = np.maximum(excess(penalty, v), 0.0)
    if isinstance(penalty, LargestExcess):
        return float(penalty.weight * violation.max())
    violated = violation > 1e-12
    return float(np.where(violated, np.where(violated, violation, 1.0) * penalty.weights, 0.0).sum())


@excess.register
def _(penalty: HalfSpaces, v: Points) -> np.ndarray:
    return v - penalty.limit


@excess.register
def _(penalty: Within, v: Points) -> np.ndarray:
    return np.maximum(v, -v) - penalty.reach


@excess.register
def _(penalty: StandardCone, v: Points) -> np.ndarray:
    return np.linalg.norm(v[:, 1:], axis=1, keepdims=True) - v[:, :1]


@excess.register
def _(penalty: NormBall, v: Points) -> np.ndarray:
    return (np.linalg.norm(v, penalty.order, axis=1) - penalty.radius)[:, None]


@excess.register
def _(penalty: NormRows, v: Points) -> np.ndarray:
    sizes = [np.linalg.norm(pair) for pair in v[0, ROWS:].reshape(-1, 2)]
    return np.array([[v[0, i] + penalty.share[k] @ sizes - penalty.limit[i] for i, k in enumerate(penalty.kind)]])


@excess.register
def _(penalty: LargestExcess, v: Points) -> np.ndarray:
    return np.array([[np.linalg.norm(row) / limit - 1] for row, limit in zip(v, penalty.limit, strict=True)])


@excess.register
def _(penalty: WeightedMax, v: Points) -> np.ndarray:
    return np.array([[max(penalty.scale * row)] for row in v])


@inside.register
def _(penalty: HalfSpaces, v: Points) -> Points:
    return np.minimum(v, np.where(np.isinf(penalty.weight), penalty.limit, np.inf))


@inside.register
def _(penalty: Within, v: Points) -> Points:
    return np.clip(v, -penalty.reach, penalty.reach)


@inside.register
def _(penalty: StandardCone, v: Points) -> Points:
    return np.column_stack([np.linalg.norm(v[:, 1:], axis=1) * (1 + np.abs(v[:, 0])), v[:, 1:]])


@inside.register
def _(penalty: NormRows, v: Points) -> Points:
    return np.hstack([v[:, :ROWS] - np.maximum(excess(penalty, v), 0.0), v[:, ROWS:]])


@inside.register
def _(penalty: NormBall, v: Points) -> Points:
    allowed = np.where(np.isinf(penalty.weight), penalty.radius, np.inf)
    return v * np.minimum(1.0, allowed / np.linalg.norm(v, penalty.order, axis=1))[:, None]


@normal.register
def _(penalty: HalfSpaces, v: Points, rng: np.random.Generator) -> tuple[Points, Points]:
    active = np.isfinite(penalty.limit) & (rng.random(v.shape) < 0.5)
    size = rng.uniform(0.1, 3.0, v.shape)
    return np.where(active, penalty.limit, np.minimum(v, penalty.limit)), np.where(active, size, 0.0)


@normal.register
def _(penalty: Within, v: Points, rng: np.random.Generator) -> tuple[Points, Points]:
    return penalty.reach * np.sign(v), rng.uniform(0.1, 3.0, v.shape) * np.sign(v)


@normal.register
def _(penalty: StandardCone, v: Points, rng: np.random.Generator) -> tuple[Points, Points]:
    length = np.linalg.norm(v[:, 1:], axis=1)
    size = rng.uniform(0.1, 3.0, (len(v), 1))
    return np.column_stack([length, v[:, 1:]]), size * np.column_stack([-length, v[:, 1:]])


@normal.register
def _(penalty: NormBall, v: Points, rng: np.random.Generator) -> tuple[Points, Points]:
    limited = np.isfinite(np.broadcast_to(penalty.radius, len(v)))
    v = v * np.where(limited, penalty.radius / np.linalg.norm(v, penalty.order, axis=1), 1.0)[:, None]
    direction = v if penalty.order == 2 else np.sign(v) * (np.abs(v) == np.abs(v).max(1, keepdims=True))
    return v, rng.uniform(0.1, 3.0, (len(v), 1)) * np.where(limited[:, None], direction, 0.0)


@normal.register
def _(penalty: NormRows, v: Points, rng: np.random.Generator) -> tuple[Points, Points]:
    active, pairs = rng.random(ROWS) < 0.5, v[0, ROWS:].reshape(-1, 2)
    weights = np.where(active, rng.uniform(0.1, 3.0, ROWS), 0.0)
    over = excess(penalty, v)
    rows = v[:, :ROWS] - np.where(active, over, np.maximum(over, 0.0))
    lengths = sum(weight * penalty.share[k] for weight, k in zip(weights, penalty.kind, strict=True))
    of_pairs = (lengths / np.linalg.norm(pairs, axis=1))[:, None] * pairs
    return np.hstack([rows, v[:, ROWS:]]), np.concatenate([weights, of_pairs.ravel()])[None]
