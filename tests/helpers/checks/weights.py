"""Weights of 1e4 to 1e10 on one component, one time or one control: nothing is called optimal that balls refute.

The other costs are of order one. Descent in balls starts at the answer: if a step within the bounds costs less, the
point is not stationary, and a direction of negative curvature along which no bound is active is a saddle's. Spoiled
trajectories, which keep what the large weight wants, must not satisfy the maximum principle either.
"""

from __future__ import annotations

from itertools import product

import numpy as np

import lin_freq_ocp as lfo
from helpers.checks.outcome import Outcome
from helpers.exact.reduced import FormulaTrial, ReducedCost, Term
from lin_freq_ocp.base import Array

PLACES = ("component", "time", "control")
FORMULAS = ("s**2/2", "-s**2", "s**4 - s**2", "cos(2*s)", "sqrt(1 + s**2)", "exp(s) + exp(-s)")
BOUND, REACH = 1.0, 30.0  # of controls and of states
PARTS = (1.0, 0.3, 0.1, 0.01)  # of a step that are tried
STATIONARY = 1e-6  # part of the scale of the light costs by which a step from a stationary point may lower the cost
CURVED = 1e-3  # negative curvature that a second-order test must see, relative to the price of controls
ACTIVE = 1e-6  # distance from a bound


class Trial(FormulaTrial):
    """The numbers of a problem with light costs of order one, and a large weight."""

    def __init__(self, seed: int):
        rng = np.random.default_rng([seed, 47])
        self.place, self.formula = PLACES[seed % len(PLACES)], FORMULAS[seed // len(PLACES) % len(FORMULAS)]
        self.n = self.m = 2 if self.place != "time" else int(rng.integers(1, 3))
        self.T = int(rng.integers(2, 4)) if self.n == 2 else int(rng.integers(2, 6))
        self.A = np.diag(rng.choice([1.0, 0.9, 0.5], self.n)) + np.triu(rng.choice([0.0, 0.3], (self.n, self.n)), 1)
        self.B = np.eye(self.n) + 0.2 * rng.integers(-1, 2, (self.n, self.n))
        self.start = rng.uniform(-0.5, 0.5, self.n) * rng.choice([0.0, 1.0])
        if self.place == "component":  # what it costs at a fixed start is a part of S, to which gaps are relative
            self.start[-1] = 0.0
        self.c, self.price = np.append(1.0, rng.uniform(-0.5, 0.5, self.n - 1)), float(rng.choice([0.2, 1.0]))
        self.weight, self.time = float(10.0 ** rng.uniform(4, 10)), int(rng.integers(1, self.T + 1))
        self.noise = rng.uniform(-BOUND, BOUND, (self.T, self.m))

    @property
    def heavy(self) -> Term:
        """Return the cost with the large weight."""
        of_x, of_u = np.zeros(self.n), np.zeros(self.m)
        (of_u if self.place == "control" else of_x)[-1] = 1.0
        times = {"component": range(self.T + 1), "time": (self.time,), "control": range(self.T)}[self.place]
        return Term("s**2/2", self.weight, of_x, of_u, times)

    def problem(self) -> lfo.OptimalControlProblem:
        """Return the problem."""
        n, m, T = self.n, self.m, self.T
        Q, R, P = np.zeros((T, n, n)), np.broadcast_to(self.price * np.eye(m), (T, m, m)).copy(), np.zeros((n, n))
        for t in self.heavy.times:
            if self.place == "control":
                R[t, -1, -1] += self.weight
            else:
                (P if t == T else Q[t])[-1, -1] += self.weight
        cost = lfo.QuadraticCost(Q=Q, R=R, P=P)
        if self.formula == "s**2/2":
            cost = lfo.QuadraticCost(Q=Q + np.outer(self.c, self.c), R=R, P=P)
        else:
            cost = cost + self.formula_cost
        return self.problem_of(cost, BOUND, REACH)


def descent(cost: ReducedCost, u: Array) -> float:
    """Return by how much a step of Newton's method within the bounds, with a convex model, lowers the cost."""
    g, H = _derivatives(cost, u)
    values, vectors = np.linalg.eigh(H)
    step = _least_in_box(g, (vectors * np.abs(values)) @ vectors.T, -BOUND - u, BOUND - u)
    first, found = cost.value(u.tolist()), 0.0
    for part in PARTS:
        there = np.clip(u + part * step, -BOUND, BOUND)
        found = max(found, float(first - cost.value(there.tolist())))
    return found


def _derivatives(cost: ReducedCost, u: Array) -> tuple[Array, Array]:
    g, H = cost.derivatives(u.tolist())
    return np.array([[float(value) for value in row] for row in g.tolist()])[:, 0], np.array(
        [[float(value) for value in row] for row in H.tolist()]
    )


def _least_in_box(g: Array, H: Array, lower: Array, upper: Array) -> Array:
    """Return the minimum of g'd + d'Hd/2 within a box: the best of all sets of active bounds."""
    best, least = np.zeros_like(g), 0.0
    for sides in product((0, -1, 1), repeat=len(g)):
        side = np.array(sides)
        free, d = side == 0, np.where(side < 0, lower, np.where(side > 0, upper, 0.0))
        if free.any():
            d[free] = np.linalg.solve(H[np.ix_(free, free)], -(g + H @ d)[free])
        d = np.clip(d, lower, upper)
        value = float(g @ d + 0.5 * d @ H @ d)
        best, least = (d, value) if value < least else (best, least)
    return best


def least_curvature(cost: ReducedCost, u: Array) -> float:
    """Return the least eigenvalue of the Hessian on controls away from their bounds."""
    free = np.abs(u) < BOUND - ACTIVE
    H = _derivatives(cost, u)[1][np.ix_(free, free)]
    return float(np.linalg.eigvalsh(H)[0]) if free.any() else 0.0


def check(seed: int) -> Outcome:
    """Solve a problem with a large weight, and certify spoiled controls that keep what the weight wants."""
    trial = Trial(seed)
    problem, exact = trial.problem(), trial.reduced(trial.heavy, *trial.terms)
    result = lfo.solve(problem, throw=False, **({} if trial.formula == "s**2/2" else {"global_bound": False}))
    if result.trajectory is None:
        return Outcome(seed, trial.place, (str(result.status),), (f"no answer: {result.message}",))
    points = {f"the answer, {result.status}": (result.certificate, result.control.ravel())}
    spoiled = keep_heavy(trial, result.control.ravel() + 0.3 * trial.noise.ravel())
    points["spoiled controls"] = lfo.certify(problem, spoiled.reshape(trial.T, trial.m)), spoiled
    wrong, light = list[str](), trial.reduced(*trial.terms)
    for name, (certificate, u) in points.items():
        scale = sum(abs(float(value)) for value in light.values(u.tolist())) + 1.0
        lower = descent(exact, u)
        if certificate.pmp == "satisfied" and lower > STATIONARY * scale:
            wrong.append(f"{name}: satisfied, but a step lowers the cost by {lower:.1e}")
        test = certificate.second_order
        if certificate.pmp == "satisfied" and test is not None and test.passed:
            curved = least_curvature(exact, u)
            if curved < -CURVED * trial.price:
                wrong.append(f"{name}: passes the second-order test with a curvature of {curved:.1e}")
        if certificate.globally_optimal and lower > STATIONARY * scale:
            wrong.append(f"{name}: globally optimal, but a step lowers the cost by {lower:.1e}")
    return Outcome(seed, trial.place, (str(result.status),), tuple(wrong))


def keep_heavy(trial: Trial, u: Array) -> Array:
    """Return controls near the given ones for which the large weight costs as little as it can within the bounds."""
    g, H = _derivatives(trial.reduced(trial.heavy), u)
    near = 1e-9 * trial.weight * np.eye(len(u))
    return u + _least_in_box(g, H + near, -BOUND - u, BOUND - u)
