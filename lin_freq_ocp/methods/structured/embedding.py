"""The homogeneous self-dual embedding with a quadratic cost (Goulart and Chen, 2024), for any structure of the rows.

    f_y = P y + A'z + h tau,  f_z = A y + s - b tau,  f_tau = h'y + b'z + kappa + y'P y/tau      (all to zero)
    s, z in the cone,  s o z = 0,  tau kappa = 0;  rows without a cone are equations, s = 0

Newton, K = [P A'; A -W^2], xi = y/tau:
    K (y1, z1) = (-(1 - sigma) f_y, -(1 - sigma) f_z + W (d_s / lam)),   K (y2, z2) = (-h, b)
    dtau [(h + 2 P xi)'y2 + b'z2 - xi'P xi - kappa/tau] = -(1 - sigma) f_tau + d_kappa/tau - (h + 2 P xi)'y1 - b'z1
    dy = y1 + dtau y2,  dz = z1 + dtau z2,  ds = b dtau - (1 - sigma) f_z - A dy,  dkappa = -(d_kappa + kappa dtau)/tau

After predictor and corrector, Gondzio's (1996) correctors move outlying products of s and z towards the others, as long
as the step becomes longer: they save a tenth of the steps, and the last digits of the gap near the edges of cones.

ds is computed from the rows, not from the scaling, so that rounding errors affect complementarity and not feasibility.
The iteration ends with an optimal y/tau, or with tau -> 0: then z with b'z < 0 is an infeasibility certificate, and y
with h'y < 0 a direction of descent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import count
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.cones import Cone
from lin_freq_ocp.methods.structured.kkt.system import StepSystem, System, Values, largest

FRACTION = 0.99  # of the way to the boundary
MOST_FRACTION = 0.999  # of it where a whole step is nearly possible
FRACTION_SLOPE = 10.0  # by which the square of (1 - length) keeps a step from the boundary
CORRECTORS = 2  # at most; a third gains nothing
LONG_STEP = 0.95  # length of a step from which no corrector pays
AHEAD, LEAST_AHEAD = 1.5, 0.1  # the longer step that a corrector aims at: a factor, and at least so much more
OUTLYING = 5.0  # ratio to the aim from which a product of s and z is an outlier
GAIN = 0.01  # of length, for which a corrector is taken
MOST_STEPS = 80  # seldom more than 25 are taken
STALLED = 8  # steps without progress after which no other helps
PROGRESS = 0.5  # factor by which mu falls in a step that counts as progress, whatever the errors are
INTERIOR = 1e-2  # distance of the first point to the boundary, relative to its size, below which it is moved
MOVED = 0.1  # of the size, the distance to which it is moved; at least 1
RAY = 1e-9  # residual of a ray, relative to b'z or h'y, below which there is only rounding
ROUGH_RAY = 1e-5  # the same where the iteration stalled
EXPECTED = 3.0  # residual after a step, relative to that of exact Newton steps, from which systems are refined
LEAST_TERMS = 1e-4  # of the absolute terms of the objective at y = 1: the gap is relative to as much at least
VANISHED = 1e-3  # tau, relative to kappa, below which a ray is accepted at ``RAY``
LEAST_TAU = 1e-100  # below which a ray no longer improves; the square of a much smaller tau is zero


class End(Enum):
    """How the iteration ended."""

    OPTIMAL = "optimal"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    STALLED = "stalled"
    TIME = "time limit"
    INTERRUPTED = "interrupted"
    UNDEFINED = "undefined"  # the smooth dynamics have no value at the first point
    DEARER = "dearer"  # a bound of the cost has reached what is known


@dataclass(frozen=True)
class Targets:
    """Relative residuals and gap to reach, and the time when to stop, by clock.now."""

    residual: float = 1e-10
    gap: float = 1e-9
    end: float = np.inf


class Errors(NamedTuple):
    """Relative residuals of y/tau, and the gap relative to the objective's absolute terms."""

    primal: float
    dual: float
    gap: float

    def merit(self, targets: Targets) -> float:
        """Return the largest in units of its target."""
        return max(self.primal / targets.residual, self.dual / targets.residual, self.gap / targets.gap)


@dataclass(frozen=True, eq=False)
class Answer:
    """The best point (divided by tau), or a ray (scaled to b'z = -1) or direction (h'y = -1)."""

    end: End
    y: Array
    z: Values
    errors: Errors
    steps: int


@dataclass(eq=False)
class EmbeddedPoint:
    """Variables, duals of all rows, and slacks of the rows in cones; divided by tau, they are the answer."""

    y: Array
    z: Values
    s: dict[int, Array]
    tau: float = 1.0
    kappa: float = 1.0

    def moved(self, step: _Direction, length: float) -> EmbeddedPoint:
        """Return the point after a step of some length."""
        return EmbeddedPoint(
            self.y + length * step.y,
            [a + length * b for a, b in zip(self.z, step.z, strict=True)],
            {i: s + length * step.s[i] for i, s in self.s.items()},
            self.tau + length * step.tau,
            self.kappa + length * step.kappa,
        )


class _Direction(NamedTuple):
    y: Array
    z: Values
    s: dict[int, Array]
    scaled_s: dict[int, Array]  # W^-1 ds
    scaled_z: dict[int, Array]  # W dz
    tau: float
    kappa: float


class _Aim(NamedTuple):
    """The reduction of lam o lam and of tau kappa by a direction, which reduces the residuals to sigma of them."""

    sigma: float
    of_s: dict[int, Array]
    of_kappa: float


@dataclass(eq=False)
class _Measures:
    """The residuals of a point, and the quantities that steps and tests need."""

    f_y: Array
    f_z: Values
    f_tau: float
    Py: Array
    yPy: float
    hy: float
    bz: float
    mu: float
    errors: Errors
    left: float  # the largest residual
    ray: float  # |A'z| relative to -b'z; inf if that is not above zero
    descent: float  # |A y + s|, P y relative to -h'y


@dataclass(eq=False)
class Embedding:
    """One solve of a system; ``run`` it once."""

    system: System
    step: StepSystem
    targets: Targets = field(default_factory=Targets)
    accept_ray: Callable[[Values], bool] = lambda z: False  # whether a ray, however rough, proves infeasibility

    def __post_init__(self):
        self._h, self._b, self._cones = self.system.stages.h, self.system.b, self.system.cones
        self._sizes = 1 + float(np.abs(self._h).max(initial=0.0)), 1 + largest(self._b)
        self._degree = 1 + sum(cone.degree for cone in self._cones.values())
        self._refined, self._expected = False, np.inf
        typical = np.ones(self._h.shape)
        self._least_terms = LEAST_TERMS * self._terms(typical, _dot(typical, self.system.curvature(typical))) or 1.0

    def _terms(self, y: Array, yPy: float) -> float:
        """Return the sum of the absolute terms of the objective."""
        return abs(self.system.stages.constant) + 0.5 * yPy + _dot(np.abs(self._h), np.abs(y))

    @np.errstate(over="ignore", invalid="ignore")  # divergence is seen by numbers that are not finite
    def run(self) -> Answer:
        """Iterate until the targets, a ray, a stall, or the time limit."""
        best: Answer | None = None
        least, progress = np.inf, 0
        try:
            clock = now()
            point = self._first_point()
            last = now() - clock  # a step takes about as long
            for step in count():
                clock = now()
                measures = self.measure(point)
                self._refined |= measures.left > EXPECTED * self._expected + self.targets.residual * point.tau
                if best is None or measures.errors.merit(self.targets) < best.errors.merit(self.targets):
                    best, progress = _answer(End.STALLED, point, measures, step, point.tau), step
                if measures.mu <= PROGRESS * least:
                    least, progress = measures.mu, step
                ended = self._conclude(point, measures, step)
                if ended is not None:
                    return ended
                stalled = step - progress > STALLED and not self._tau_vanishes(point)
                if stalled or step == MOST_STEPS or point.tau < LEAST_TAU or not np.isfinite(measures.errors.primal):
                    return self._rough_ray(point, measures, step) or best
                if clock + last > self.targets.end:
                    return replace(best, end=End.TIME)
                point = self._next(point, measures)
                last = now() - clock
        except (KeyboardInterrupt, np.linalg.LinAlgError) as error:  # numbers vanish, and a stage is singular
            if best is None:
                raise
            return replace(best, end=End.INTERRUPTED) if isinstance(error, KeyboardInterrupt) else best
        raise AssertionError  # count() does not end

    def _first_point(self) -> EmbeddedPoint:
        for cone in self._cones.values():
            cone.reset()
        self.step.factor()
        y, z = self.step.solve(-self._h, self._b)
        s = _move_inside(self._cones, {i: -z[i] for i in self._cones})
        for i, part in _move_inside(self._cones, {i: z[i] for i in self._cones}).items():
            z[i] = part
        return EmbeddedPoint(y, z, s)

    def measure(self, point: EmbeddedPoint) -> _Measures:
        """Return the residuals of a point."""
        system, tau, kappa, h, b = self.system, point.tau, point.kappa, self._h, self._b
        Py, Atz, Ay = system.curvature(point.y), system.adjoint(point.z), system.rows(point.y)
        for i, s in point.s.items():
            Ay[i] = Ay[i] + s
        yPy, hy, bz = _dot(point.y, Py), _dot(h, point.y), sum(map(_dot, b, point.z))
        f_y, f_z = Py + Atz + h * tau, [rows - right * tau for rows, right in zip(Ay, b, strict=True)]
        f_tau = hy + bz + kappa + yPy / tau
        mu = (sum(_dot(s, point.z[i]) for i, s in point.s.items()) + tau * kappa) / self._degree
        primal, dual = 0.5 * yPy / tau**2 + hy / tau, -0.5 * yPy / tau**2 - bz / tau
        of_h, of_b = self._sizes
        curved, of_z, of_y = largest([Py]), largest(f_z), largest([f_y])
        errors = Errors(
            of_z / tau / (of_b + largest([point.y]) / tau),
            of_y / tau / (of_h + max(curved, largest(point.z)) / tau),
            abs(primal - dual) / max(self._least_terms, self._terms(point.y / tau, yPy / tau**2)),
        )
        ray = largest([Atz]) / -bz if bz < 0 else np.inf
        descent = max(largest(Ay), curved) / -hy if hy < 0 else np.inf
        return _Measures(f_y, f_z, f_tau, Py, yPy, hy, bz, mu, errors, max(of_y, of_z), ray, descent)

    def _conclude(self, point: EmbeddedPoint, measures: _Measures, step: int) -> Answer | None:
        """Return the answer if the point is accurate enough, or a ray."""
        if measures.errors.merit(self.targets) <= 1:
            return _answer(End.OPTIMAL, point, measures, step, point.tau)
        vanishing = self._tau_vanishes(point)
        if (measures.ray <= RAY and vanishing) or (measures.bz < 0 and vanishing and self.accept_ray(point.z)):
            return _answer(End.INFEASIBLE, point, measures, step, -measures.bz)
        if measures.descent <= RAY and vanishing:
            return _answer(End.UNBOUNDED, point, measures, step, -measures.hy)
        return None

    def _rough_ray(self, point: EmbeddedPoint, measures: _Measures, steps: int) -> Answer | None:
        """Return the ray or direction of a stalled iteration, if it is one, for the judge to verify."""
        if self._tau_vanishes(point) and measures.ray <= ROUGH_RAY:
            return _answer(End.INFEASIBLE, point, measures, steps, -measures.bz)
        if point.tau < VANISHED and measures.descent <= ROUGH_RAY:
            return _answer(End.UNBOUNDED, point, measures, steps, -measures.hy)
        return None

    @staticmethod
    def _tau_vanishes(point: EmbeddedPoint) -> bool:
        return point.tau < VANISHED * min(1.0, point.kappa)

    def _next(self, point: EmbeddedPoint, measures: _Measures) -> EmbeddedPoint:
        """Return the point after a step of predictor and correctors."""
        cones, tau, kappa = self._cones, point.tau, point.kappa
        for i, cone in cones.items():
            cone.scale(point.s[i], point.z[i])
        self.step.factor()
        constant = self.step.solve(-self._h, self._b, self._refined)
        squares = {i: cone.product(cone.lam, cone.lam) for i, cone in cones.items()}
        affine = self._direction(point, measures, constant, _Aim(0.0, squares, kappa * tau))
        sigma = (1 - min(self._longest(point, affine), 1.0)) ** 3
        centred = {
            i: squares[i] + cone.product(affine.scaled_s[i], affine.scaled_z[i]) - sigma * measures.mu * cone.identity
            for i, cone in cones.items()
        }
        of_kappa = kappa * tau + affine.kappa * affine.tau - sigma * measures.mu
        step, length = self._correct(point, measures, constant, _Aim(sigma, centred, of_kappa))
        # the closer to a whole step, the closer to the boundary it may end
        fraction = min(MOST_FRACTION, max(FRACTION, 1 - FRACTION_SLOPE * (1 - min(length, 1.0)) ** 2))
        length = min(fraction * length, 1.0)
        self._expected = (1 - length * (1 - sigma)) * measures.left
        return point.moved(step, length)

    def _correct(
        self, point: EmbeddedPoint, measures: _Measures, constant: tuple[Array, Values], aim: _Aim
    ) -> tuple[_Direction, float]:
        """Return the direction after Gondzio's correctors, and the longest step along it."""
        step = self._direction(point, measures, constant, aim)
        length = self._longest(point, step)
        for _ in range(CORRECTORS):
            if length >= LONG_STEP:
                break
            aim = self._recentre(step, min(1.0, max(AHEAD * length, length + LEAST_AHEAD)), aim, measures.mu)
            other = self._direction(point, measures, constant, aim)
            further = self._longest(point, other)
            if further < length + GAIN:
                break
            step, length = other, further
        return step, length

    def _recentre(self, step: _Direction, length: float, aim: _Aim, mu: float) -> _Aim:
        """Return the aim that moves outlying products of s and z after such a step towards sigma mu."""
        low, high = aim.sigma * mu / OUTLYING, aim.sigma * mu * OUTLYING
        of_s = dict(aim.of_s)
        for i, cone in self._cones.items():
            s, z = cone.lam + length * step.scaled_s[i], cone.lam + length * step.scaled_z[i]
            of_s[i] = of_s[i] - cone.clip_change(cone.product(s, z), low, high)
        return aim._replace(of_s=of_s)

    def _direction(
        self, point: EmbeddedPoint, measures: _Measures, constant: tuple[Array, Values], aim: _Aim
    ) -> _Direction:
        cones, tau, kappa, b, rest = self._cones, point.tau, point.kappa, self._b, 1 - aim.sigma
        right = [-rest * part for part in measures.f_z]
        for i, cone in cones.items():
            right[i] = right[i] + cone.scaled(cone.quotient(aim.of_s[i]), 1)
        y, z = self.step.solve(-rest * measures.f_y, right, self._refined)
        slope = self._h + 2 * measures.Py / tau
        steepness = _dot(slope, constant[0]) + sum(map(_dot, b, constant[1])) - measures.yPy / tau**2 - kappa / tau
        missing = -rest * measures.f_tau + aim.of_kappa / tau - _dot(slope, y) - sum(map(_dot, b, z))
        dtau = missing / steepness
        y = y + dtau * constant[0]
        z = [part + dtau * other for part, other in zip(z, constant[1], strict=True)]
        rows = self.system.rows(y)
        s = {i: (b[i] * dtau - rest * measures.f_z[i] - rows[i]) * cone.present for i, cone in cones.items()}
        scaled_s = {i: cone.scaled(s[i], -1) for i, cone in cones.items()}
        scaled_z = {i: cone.scaled(z[i], 1) for i, cone in cones.items()}
        return _Direction(y, z, s, scaled_s, scaled_z, dtau, -(aim.of_kappa + kappa * dtau) / tau)

    def _longest(self, point: EmbeddedPoint, step: _Direction) -> float:
        lengths = [
            cone.longest(part) for i, cone in self._cones.items() for part in (step.scaled_s[i], step.scaled_z[i])
        ]
        ends = [-value / slope for value, slope in ((point.tau, step.tau), (point.kappa, step.kappa)) if slope < 0]
        return min([*lengths, *ends], default=np.inf)


def _answer(end: End, point: EmbeddedPoint, measures: _Measures, steps: int, unit: float) -> Answer:
    return Answer(end, point.y / unit, [part / unit for part in point.z], measures.errors, steps)


def _move_inside(cones: dict[int, Cone], v: dict[int, Array]) -> dict[int, Array]:
    """Return v, moved into the cones if it is not well inside of all.

    All cones move by the same amount: products of s and z of different sizes would allow short steps only.
    """
    margin, size = min((cone.margin(v[i]) for i, cone in cones.items()), default=np.inf), largest(list(v.values()))
    if margin >= INTERIOR * max(1.0, size):
        return v
    return {i: v[i] + (max(1.0, MOVED * size) - margin) * cone.identity for i, cone in cones.items()}


def _dot(a: Array, b: Array) -> float:
    return float(np.vdot(a, b))
