"""Classes of a user's own: a set, convex functions, an affine map, costs, a frequency constraint, dynamics, a method.

Nothing in the package knows them. The conformance suites run on them as on the classes of the package.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

import lin_freq_ocp as lfo
from lin_freq_ocp.base import assign
from lin_freq_ocp.problem import (
    HARD,
    ConicForm,
    ConvexSet,
    Dynamics,
    FrequencyConstraint,
    HalfSpaces,
    MatrixMap,
    NonsmoothCost,
    NormBall,
    Part,
    Penalty,
    StageMap,
    StandardCone,
    SumMap,
    Term,
    TermKind,
    signal_labels,
)
from lin_freq_ocp.solvers import Nonsmooth


@dataclass(frozen=True, eq=False)
class RoundedSimplex(ConvexSet):
    """{v >= 0 : sum v <= total, |W v| <= sum v + 0.1}: bounds, a half-space and an ellipsoidal cone."""

    W: np.ndarray
    total: float

    may_be_soft: ClassVar[bool] = False  # a cone has no price

    @property
    def dimension(self) -> int:
        return self.W.shape[1]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(self.dimension), np.full(self.dimension, np.inf)

    def parts(self, dimension: int) -> tuple[Part, ...]:
        ones = np.ones((1, dimension))
        simplex = Part(ones, np.zeros(1), HalfSpaces(np.array([self.total]), HARD))
        cone = Part(np.vstack([ones, self.W]), np.append(0.1, np.zeros(len(self.W))), StandardCone())
        return simplex, cone

    def describe(self, names, signal) -> str:
        return f"{signal} in a rounded simplex"


@dataclass(frozen=True, eq=False)
class WeightedMax(Penalty):
    """h(v) = price * max(0, scale_1 v_1, scale_2 v_2, ...), group by group."""

    scale: np.ndarray
    price: float

    @property
    def weights(self):
        return np.asarray(self.price)

    def excess(self, v):
        return (self.scale * v).max(1, keepdims=True)

    def excess_slope(self, v, change, near):
        scaled = self.scale * v
        largest = scaled >= scaled.max(1, keepdims=True) - near
        return np.where(largest, self.scale * change, -np.inf).max(1, keepdims=True)

    def recession(self, change):
        return self.excess(change)

    def subgradient(self, multipliers, eta_C):
        fitting = np.maximum(multipliers, 0.0)  # of price times the hull of 0 and scale_i e_i
        total, most = (fitting / self.scale).sum(1, keepdims=True), eta_C * self.price
        return fitting * np.where(total > most, most / np.where(total > 0, total, 1.0), 1.0)

    def gap(self, v, multipliers, eta_C):
        return (eta_C * self.cost(v) - (multipliers * v).sum(1))[:, None]

    def least_slacks(self, v):
        return np.maximum(self.excess(v), 0.0).ravel()

    def conic(self, groups, dim):
        """Return v_i - s / scale_i <= 0 and s >= 0, a slack for each group."""
        entries, identity = np.arange(groups * dim), sp.eye_array(groups)
        columns = sp.kron(identity, -1 / self.scale[:, None])
        return ConicForm(
            np.append(entries, np.full(groups, -1)),
            np.append(np.full(groups * dim, -np.inf), np.zeros(groups)),
            np.append(np.zeros(groups * dim), np.full(groups, np.inf)),
            sp.csr_array(sp.vstack([columns, identity])),
            np.full(groups, self.price),
            entries.reshape(groups, dim),
        )


class WorstThrust(NonsmoothCost):
    """price * sum_t max(0, scale_j u_t,j): one-sided, as of thrusters."""

    label = "worst thrust"

    def __init__(self, scale, price: float):
        self.penalty = WeightedMax(np.asarray(scale, dtype=float), price)

    def own_terms(self, n, m, horizon, field, name):
        thrust = StageMap(np.arange(horizon), None, np.eye(m), np.zeros(m))
        return [Term(name, TermKind.STAGE_COST, thrust, self.penalty)]

    def describe(self):
        return "the largest weighted thrust"

    def augmented(self, n, k):
        return self


@dataclass(frozen=True, eq=False)
class Changes(MatrixMap):
    """v_t = size (u_{t+1} - u_t)."""

    steps: int
    size: np.ndarray
    sign: float = -1.0

    @property
    def shape(self):
        return self.steps - 1, len(self.size)

    @property
    def positions(self):
        return np.arange(self.steps - 1)

    @property
    def additions(self):
        return 2.0

    def values(self, x, u):
        return self.size * (u[1:] + self.sign * u[:-1])

    def pull_back(self, weights, shapes):
        of_x, of_u = (np.zeros(shape, dtype=weights.dtype) for shape in shapes)
        of_u[1:] += self.size * weights
        of_u[:-1] += self.sign * self.size * weights
        return of_x, of_u

    def rows(self, horizon, n, m):
        later = sp.eye_array(horizon - 1, horizon, k=1) + self.sign * sp.eye_array(horizon - 1, horizon)
        of_u = sp.kron(later, np.diag(self.size))
        return sp.csr_array(sp.hstack([sp.csr_array((of_u.shape[0], (horizon + 1) * n)), of_u])), np.zeros(
            of_u.shape[0]
        )

    def magnitudes(self):
        return Changes(self.steps, np.abs(self.size), 1.0)


class Variation(NonsmoothCost):
    """The total variation of the controls, or the sum of the norms of their changes."""

    label = "variation"

    def __init__(self, order: float):
        self.order = order

    def own_terms(self, n, m, horizon, field, name):
        norm = NormBall(self.order, np.zeros(()), np.ones(()))
        return [Term(name, TermKind.STAGE_COST, Changes(horizon, np.array([0.1, 0.05])), norm)]

    def describe(self):
        return "the variation of the controls"

    def augmented(self, n, k):
        return self


class SteadyGain(FrequencyConstraint):
    """|sum_t v_t| <= limit: a bound on bin 0 of a single signal."""

    label = "steady gain"

    def __init__(self, limit: float):
        self.limit = limit

    def describe(self, names):
        return f"the sum of {names[0]} is at most {self.limit:g}"

    def terms(self, signal, field, source):
        ones = np.ones((signal.length, 1, 1))
        parts = (ones, None) if signal.D is None else (None, ones)
        ball = NormBall(2, np.asarray(self.limit), HARD)
        sum_of = SumMap((StageMap(np.arange(signal.length), *parts, np.zeros(1)),), np.zeros(1))
        yield Term(f"steady gain of {signal.names[0]}", signal.kind, sum_of, ball, source)

    def augmented(self, n, k):
        return [self]

    @property
    def levels(self):
        return np.asarray(self.limit)

    def at_levels(self, levels):
        return type(self)(float(levels))


@dataclass(frozen=True, eq=False, init=False)
class DelayedInput(Dynamics):
    """x_{t+1} = A x_t + B u_{t-1}, in the states (x_t, u_{t-1}): the methods are those of linear dynamics."""

    A: np.ndarray
    B: np.ndarray

    def __init__(self, A, B, sampling_time=None):
        A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
        n, m = B.shape
        assign(self, A=A, B=B, **signal_labels(n + m, m, sampling_time, None, None))

    @cached_property
    def standard_form(self):
        n, m = self.B.shape
        A = np.block([[self.A, self.B], [np.zeros((m, n + m))]])
        B = np.vstack([np.zeros((n, m)), np.eye(m)])
        return lfo.LinearDynamics(A, B, None, self.sampling_time, self.state_names, self.control_names)


@dataclass(frozen=True, eq=False, init=False)
class Bilinear(Dynamics):
    """x_{t+1} = A x_t + u_t N x_t + B u_t, with a single control."""

    A: np.ndarray
    N: np.ndarray
    B: np.ndarray

    def __init__(self, A, N, B):
        A, N, B = (np.asarray(part, dtype=float) for part in (A, N, B))
        assign(self, A=A, N=N, B=B, **signal_labels(len(B), 1, None, None, None))

    @cached_property
    def standard_form(self):
        def f(x, u):
            return [
                sum((a + c * u[0]) * one for a, c, one in zip(row, slope, x, strict=True)) + b * u[0]
                for row, slope, b in zip(self.A, self.N, self.B, strict=True)
            ]

        return lfo.PiecewiseSmoothDynamics.from_formulas(f, self.state_dim, 1)

    def facts(self, labels):
        return [("dynamics", "bilinear: (A + u N) x + B u")]

    def stepper(self, horizon):
        return lambda t, x, u: (self.A + u[0] * self.N) @ x + self.B * u[0]


@dataclass(frozen=True)
class FromRest:
    """A method for bilinear dynamics that leaves the work to the search over smooth pieces."""

    global_bound: bool = False

    shorthand: ClassVar[str] = "from_rest"
    takes_start: ClassVar[bool] = False

    def solve(self, problem, request):
        return replace(Nonsmooth(global_bound=self.global_bound).solve(problem, request), method="from_rest")
