"""Verdicts, controls and costs do not depend on where zero is, however far away.

A random problem is solved as drawn, and again with every state counted from 1e2 .. 1e9 times its range away: linear,
time-varying and piecewise-affine dynamics, nonsmooth costs, and controls of finitely many levels. The statuses must be
the same, and the answer of the second must cost, as a trajectory of the first, what that costs. ``certify``, a step of
a control loop and the least horizon are asked the same question. What a difference may be worth is what double
precision leaves: rounding of the distance, relative to what moves.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from helpers.random.units import Change, drawn, problem

QUESTIONS = ("solve", "certify", "step", "minimum time")
COST_AGREEMENT = 1e-7  # difference of two costs, relative to what the terms of the cost add up to
ROUNDING = 200 * float(np.finfo(float).eps)  # of data and states, times the distance: what may become of it in a cost
CONTROL_AGREEMENT = 1e-3  # difference of two controls, relative to the largest: costs are flat at an optimum
LESS = ("locally_optimal", "numerical_error", "violated", False)  # what is said where nothing is proven
ROUNDED = "measure it from a nearer origin"  # in the message of an answer that rounding has spoilt


@dataclass(frozen=True)
class Outcome:
    """What became of one problem far from zero."""

    seed: int
    kind: str
    question: str
    distance: float
    first: tuple[object, ...]
    second: tuple[object, ...]
    cost_difference: float
    control_difference: float
    says_rounded: bool

    @property
    def passed(self) -> bool:
        """Whether the answers are the same, up to what double precision leaves."""
        rounding = ROUNDING * self.distance
        close = self.cost_difference <= COST_AGREEMENT + rounding
        close &= self.control_difference <= CONTROL_AGREEMENT + np.sqrt(rounding)
        return self.rounded or (self.first == self.second and bool(close))

    @property
    def rounded(self) -> bool:
        """Whether rounding has spoilt the answer, which claims less: it says so, or is one that has no message.

        A certificate has none, and neither has a formula that is evaluated far from zero.
        """
        silent = self.question == "certify" or self.kind == "smooth pieces"
        less = all(after == before or after in LESS for before, after in zip(self.first, self.second, strict=True))
        return self.says_rounded or (silent and less and ROUNDING * self.distance > COST_AGREEMENT)


def check(seed: int, question: str | None = None) -> Outcome:
    """Ask one question of a problem as drawn, and of the same problem far from zero."""
    rng = np.random.default_rng([seed, 2])
    kind, near, at_origin = _problem(rng, seed)
    question = question or str(rng.choice(QUESTIONS, p=[0.55, 0.15, 0.15, 0.15]))
    if question == "minimum time" and kind not in ("linear", "terms"):
        question = "solve"
    distance = 10.0 ** rng.uniform(2, 9)
    origin = distance * rng.choice([-1.0, 1.0], near.state_dim) * rng.uniform(0.5, 1.0, near.state_dim)
    far = at_origin(origin)
    first, u, cost, scale = _asked(near, question, np.zeros(near.state_dim))
    second, other_u, other_cost, _ = _asked(far, question, origin, near)
    differences = 0.0, 0.0
    if u is not None and other_u is not None and u.shape == other_u.shape:
        size = max(float(np.abs(u).max()), 1e-6)
        differences = abs(cost - other_cost) / scale, float(np.abs(u - other_u).max()) / size
    said = any(ROUNDED in str(part) for part in second)
    return Outcome(seed, kind, question, distance, first[:-1], second[:-1], *differences, said)


def kind_of(seed: int) -> str:
    """Return the kind of the problem that is drawn."""
    return _problem(np.random.default_rng([seed, 2]), seed)[0]


def _problem(rng: np.random.Generator, seed: int):
    """Return the kind of a problem, the problem, and a function of the origin that its states are counted from."""
    data = drawn(seed)
    if data.shifts:
        return data.kind, problem(data), lambda origin: problem(data, Change.none(data.n, data.m, x_origin=origin))
    if data.kind == "smooth pieces":
        return data.kind, problem(data), lambda origin: _smooth(problem(data), float(origin[0]))
    n, T = int(rng.integers(1, 3)), int(rng.integers(3, 7))
    A = rng.standard_normal((n, n))
    A *= rng.choice([0.7, 1.0]) / max(np.abs(np.linalg.eigvals(A)).max(), 1e-3)
    B, d, start, reference = (rng.standard_normal(shape) for shape in ((n, 1), n, n, n))
    R = rng.uniform(0.05, 0.5)

    def at(origin: np.ndarray) -> lfo.OptimalControlProblem:
        return lfo.OptimalControlProblem(
            lfo.LinearDynamics(A, B, 0.1 * d + origin - A @ origin),
            T,
            lfo.QuadraticCost(Q=np.eye(n), R=R, P=np.eye(n), x_ref=reference + origin),
            lfo.FiniteSet([[-1.0, 0.0, 1.0]]),
            lfo.Box(origin - 20, origin + 20),
            initial_state=start + origin,
        )

    return "levels", at(np.zeros(n)), at


def _smooth(given: lfo.OptimalControlProblem, origin: float) -> lfo.OptimalControlProblem:
    """Return the problem of smooth pieces with its state counted from elsewhere, as a user would write it down."""

    def moved(x: Any, u: Any) -> list[Any]:
        z = x[0] - origin
        return [origin + 0.8 * z + 0.3 * abs(z) + u[0] * (1 - 0.2 * z)]

    cost = given.quadratic
    return replace(
        given,
        dynamics=lfo.PiecewiseSmoothDynamics.from_formulas(moved, 1, 1, given.sampling_time),
        cost=replace(cost, x_ref=cost.x_ref + origin),
        state_set=_moved(given.state_boxes, origin),
        initial_state=_moved(given.initial_box, origin),
        terminal_state=_moved(given.terminal_box, origin),
    )


def _moved(box: lfo.Box, origin: float) -> lfo.Box:
    return lfo.Box(box.lower + origin, box.upper + origin)


def _asked(
    given: lfo.OptimalControlProblem, question: str, origin: np.ndarray, near: lfo.OptimalControlProblem | None = None
) -> tuple[tuple[object, ...], np.ndarray | None, float, float]:
    """Return what is answered, the control, its cost as one of the problem near zero, and the scale of costs."""
    near = near or given
    if question == "step":
        controller = lfo.RecedingHorizon(given)
        try:
            controller.step(given.initial_box.lower)
        except lfo.errors.SolveError as error:
            return (str(error.result.status), error.result.message), None, 0.0, 1.0
        step = controller.log.steps[-1]
        return (step.status, step.satisfied, ""), controller.log.controls, 0.0, 1.0
    if question == "minimum time":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", lfo.errors.BandWarning)  # short horizons have few bins
            found = lfo.minimum_time(given, (1, given.horizon), throw=False)
        return (found.horizon, *sorted(found.verdicts.items()), ""), None, 0.0, 1.0
    result = lfo.solve(given, throw=False)
    certificate, trajectory = result.certificate, result.trajectory
    if trajectory is None or certificate is None:
        return (result.status, None, None, result.message), None, 0.0, 1.0
    if question == "certify":
        certificate = lfo.certify(given, trajectory)
    moved = lfo.Trajectory(trajectory.x - origin, trajectory.u)
    said = result.status, certificate.pmp, certificate.globally_optimal, result.message
    # rounding moves all of the cost, of which controls may change a small part
    terms = float(np.abs(near.quadratic.stage_values(moved.x, moved.u)).sum())
    return said, moved.u, near.value(moved.x, moved.u), max(terms, certificate.cost_scale)
