"""Loops of robust problems for very long: every step has a plan, and no limit is violated, whatever the loads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

import lin_freq_ocp as lfo
from helpers.tubes import tube

EXCESS = 1e-9
"""Of a limit, relative to its range."""

KINDS = "random corners", "the same corner for 20 steps", "away from the middle", "anywhere in the set"


@dataclass(frozen=True)
class Outcome:
    """What a loop did: steps with a plan, the largest excess over a limit, and whether its plans are proven."""

    seed: int
    kind: str
    steps: int
    planned: int
    excess: float
    proven: bool

    @property
    def passed(self) -> bool:
        """Whether each step has a plan, and each limit holds."""
        return self.planned == self.steps and self.excess <= EXCESS and self.proven


def random_loop(seed: int) -> tuple[lfo.OptimalControlProblem, lfo.Disturbance, np.ndarray, np.ndarray]:
    """Return a problem with a free end, its loads, their extreme points, and a state in whose direction it starts."""
    rng = np.random.default_rng(seed)
    if seed % 3 < 2:
        size, start = ((0.15, [-7.0, -2.0]), (0.2, [-5.0, -2.0]))[seed % 3]
        points = size * np.array(list(product([-1.0, 1.0], repeat=2)))
        return tube(initial_state=None), lfo.Disturbance(lfo.Box(-size, size)), points, np.array(start)
    n, m, k = int(rng.integers(1, 4)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    A, B, E = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((n, k))
    A *= rng.uniform(0.5, 1.1) / np.abs(np.linalg.eigvals(A)).max()
    u, x = rng.uniform(0.5, 2.0, (2, m)), rng.uniform(1.0, 4.0, (2, n))
    sizes = 10.0 ** rng.uniform(-6, 6, n)  # units of states
    A, B, E, x = A * sizes[:, None] / sizes, B * sizes[:, None], E * sizes[:, None], x * sizes
    rows = lfo.StageRows(np.abs(rng.standard_normal((1, n))) / sizes, rng.standard_normal((1, m)), [4.0], name="joint")
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B),
        int(rng.integers(4, 12)),
        lfo.QuadraticCost(Q=np.diag(1 / sizes**2), R=0.1 * np.eye(m)),
        lfo.Box(-u[0], u[1]),
        lfo.Box(-x[0], x[1]),
        stage_rows=[rows] if seed % 2 else None,
    )
    shape, samples = rng.uniform(0.2, 1.0, (2, k)) * [[-1.0], [1.0]], seed % 5 == 0
    points = np.array(list(product(*shape.T)))

    def load(size: float) -> lfo.Disturbance:
        return lfo.Disturbance(size * points if samples else lfo.Box(*(size * shape)), E)

    bears, most = 0.0, 1e3  # the loads that leave a plan that continues
    while bears == 0.0 or most > 1.6 * bears:
        size = (bears + most) / 2 if bears else most / 2
        try:
            lfo.robust(problem, load(size), end="invariant")
        except lfo.errors.ProblemError:
            most = size
        else:
            bears = size
    return problem, load(bears), bears * points, rng.standard_normal(n) * x.max(axis=0)


def check(seed: int, steps: int = 1000, share: float = 1.0) -> Outcome:
    """Run a loop of a seed under one kind of loads, from the farthest start in a direction that has a plan.

    What acts is a share of the loads of which the loop knows; above 1, it should fail.
    """
    problem, load, points, start = random_loop(seed)
    rng, kind = np.random.default_rng(seed), KINDS[seed // 3 % len(KINDS)]
    plan = lfo.robust(problem, load, end="invariant")
    while lfo.solve(replace(plan, initial_state=start), throw=False).status != "optimal":
        start = 0.8 * start
    controller = lfo.RecedingHorizon(plan, certify="later")
    A, B, _ = problem.linear.at(0)
    E = np.eye(len(start)) if load.input is None else load.input
    (low, high), (least, most) = problem.state_boxes.at(1).bounds, problem.control_tube.at(0).bounds
    x, over = start, []
    for k in range(steps):
        try:
            u = controller.step(x)
        except lfo.errors.InfeasibleError:
            break
        if kind == KINDS[0]:
            w = points[rng.integers(len(points))]
        elif kind == KINDS[1]:
            w = points[k // 20 % len(points)]
        elif kind == KINDS[2]:
            w = points[np.argmax(points @ E.T @ (x / (high - low) ** 2))]
        else:
            w = rng.dirichlet(np.ones(len(points))) @ points
        over += [((u - most) / (most - least)).max(), ((least - u) / (most - least)).max()]
        over += [float((one.values(x[None], u[None]) / one.e).max() - 1) for one in problem.stage_rows if k]
        x = A @ x + B @ u + share * E @ w
        over += [((x - high) / (high - low)).max(), ((low - x) / (high - low)).max()]
    log = controller.certify()
    planned = sum(source == "plan" for source in log.sources)
    return Outcome(seed, kind, steps, planned, float(max(over)), bool(log.satisfied.all()))
