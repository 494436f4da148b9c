"""Time of a step of a control loop, compared with what users would write: CVXPY with a parameter for the state.

    python scripts/benchmark.py loop [--horizons 60 240] [--problems free "low pass" "soft bounds"] [--steps 30]
                                     [--write]

One thread, all contenders on the same measured states in turns; times are medians. The certificate, which the others do
not have, is timed apart. "agreement" is the largest difference of a control from ours, relative to its bound.

    python scripts/benchmark.py loop --modes

A cart-pole between soft walls instead: each step from the tree of the step before ("warm"), and each alone ("cold").
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

import cvxpy as cp
import numpy as np
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.loop_cases import cart_pole, pendulum, soft_pendulum
from benchmark.record import Record, build_parser

NOISE = 1e-3
"""Standard deviation of the disturbance of every state."""

CART_POLE_NOISE = 3e-3
"""The same, of the cart-pole (Marcucci and Tedrake 2021)."""

CASES = {"free": pendulum, "low pass": partial(pendulum, low_pass=True), "soft bounds": soft_pendulum}

Step = Callable[[np.ndarray], np.ndarray]


def parametric(problem: lfo.OptimalControlProblem, solver: str) -> Step:
    """Return a step of the same problem in CVXPY, compiled once, with the state as a parameter."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    x, u, start = cp.Variable((T + 1, n)), cp.Variable((T, m)), cp.Parameter(n)
    cost, dynamics = problem.quadratic, problem.linear
    roots = {name: np.linalg.cholesky(getattr(cost, name)) for name in ("Q", "R", "P")}
    objective = cp.sum_squares(x[:T] @ roots["Q"]) + cp.sum_squares(u @ roots["R"]) + cp.sum_squares(x[T] @ roots["P"])
    bounds, states, soft = problem.control_tube, problem.state_boxes, problem.state_set
    if isinstance(soft, lfo.sets.Soft):
        excess = cp.pos(x[1:] - soft.soft_set.bounds[1]) + cp.pos(soft.soft_set.bounds[0] - x[1:])
        objective += 2 * soft.penalty * cp.sum(excess)
    constraints = [x[0] == start, x[1:] == x[:T] @ dynamics.A.T + u @ dynamics.B.T]
    constraints += [u >= bounds.lower, u <= bounds.upper]
    for i in range(n):
        if np.isfinite(states.upper[1:, i]).all():
            constraints += [x[1:, i] <= states.upper[1:, i], x[1:, i] >= states.lower[1:, i]]
    stopped = np.flatnonzero(problem.control_stop[:, 0])
    if len(stopped):
        angle = 2 * np.pi * np.outer(stopped, np.arange(T)) / T
        constraints += [np.cos(angle) @ u[:, 0] == 0, np.sin(angle[stopped != T / 2]) @ u[:, 0] == 0]
    program = cp.Problem(cp.Minimize(objective / 2), constraints)

    def step(state: np.ndarray) -> np.ndarray:
        start.value = state
        program.solve(solver=solver, warm_start=True)
        return np.zeros(m) if u.value is None else u.value[0]

    return step


def contenders(problem: lfo.OptimalControlProblem) -> dict[str, Step]:
    """Return a step of each contender, by its name."""
    ours = {name: lfo.RecedingHorizon(problem, name) for name in ("spectral", "structured", "convex")}
    return {name: controller.step for name, controller in ours.items()} | {
        f"CVXPY, {solver}": parametric(problem, solver) for solver in ("CLARABEL", "OSQP")
    }


def measured(problem: lfo.OptimalControlProblem, steps: int, seed: int) -> list[list[str]]:
    """Return a row of text for each contender."""
    rng, found = np.random.default_rng(seed), contenders(problem)
    x, step = problem.initial_box.lower, problem.dynamics.stepper(1)
    times = {name: list[float]() for name in found}
    controls = {name: list[np.ndarray]() for name in found}
    for _ in range(steps):
        for name, one in found.items():
            began = time.perf_counter()
            controls[name].append(one(x))
            times[name].append(1e3 * (time.perf_counter() - began))
        x = step(0, x, controls["spectral"][-1]) + NOISE * rng.standard_normal(len(x))
    rows: list[list[str]] = []
    for name, one in found.items():
        controller = getattr(one, "__self__", None)
        certify = 0.0 if controller is None else 1e3 * float(np.median(controller.log.certify_seconds[1:]))
        own = float(np.median(times[name][1:])) - certify
        apart = np.abs(np.array(controls[name]) - controls["spectral"]).max() / problem.control_tube.upper.max()
        gap = "" if controller is None else f"{controller.log.gaps.max():.0e}"
        rows.append([name, f"{own:.2f}", f"{certify:.2f}" if controller else "", gap, f"{apart:.0e}"])
    return rows


def with_modes(steps: int, seed: int) -> Table:
    """Return a table of relaxations and times of steps with modes, after the first, warm and cold in turns."""
    rng, problem = np.random.default_rng(seed), cart_pole()
    warm, x, step = lfo.RecedingHorizon(problem), problem.initial_box.lower, problem.dynamics.stepper(1)
    found: dict[str, list[tuple[float, ...]]] = {"warm": [], "cold": []}
    for _ in range(steps):
        controls: dict[str, np.ndarray] = {}
        for name, one in (("warm", warm), ("cold", lfo.RecedingHorizon(problem))):
            began = time.process_time()
            controls[name] = one.step(x)
            spent, last = time.process_time() - began, one.log.steps[-1]
            found[name].append(
                (last.nodes, 1e3 * last.solve_seconds, 1e3 * last.certify_seconds, 1e3 * spent, last.gap)
            )
        x = step(0, x, controls["warm"]) + CART_POLE_NOISE * rng.standard_normal(len(x))
    table = Table("cart-pole between walls, T = 20", title="a step of a control loop with modes")
    for column in ("nodes, median", "worst", "ms, median", "worst", "certificate, ms", "CPU in all, ms", "largest gap"):
        table.add_column(column, justify="right")
    for name, rows in found.items():
        array = np.array(rows[1:])
        middle, worst = np.median(array, axis=0), array.max(axis=0)
        numbers = [middle[0], worst[0], middle[1], worst[1], middle[2], middle[3]]
        table.add_row(name, *(f"{number:.0f}" for number in numbers), f"{worst[4]:.0e}")
    return table


def linear(horizons: Sequence[int], problems: Sequence[str], steps: int, seed: int) -> Table:
    """Return a table of the times of all contenders."""
    table = Table("problem", "contender", title="a step of a control loop, warm")
    for column in ("ms", "certificate, ms", "gap", "agreement"):
        table.add_column(column, justify="right")
    for horizon in horizons:
        for name in problems:
            what = f"pendulum, T = {horizon}, {name}"
            for row in measured(CASES[name](horizon), steps, seed):
                table.add_row(what, *row)
                what = ""
    return table


def main(arguments: Sequence[str]) -> None:
    """Measure the steps and print a table."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--horizons", type=int, nargs="+", default=[60, 240])
    parser.add_argument("--problems", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--steps", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--modes", action="store_true")
    options = parser.parse_args(arguments)
    with Record(options.write) as record, threadpool_limits(1):
        if options.modes:
            record.show(with_modes(options.steps, options.seed))
        else:
            record.show(linear(options.horizons, options.problems, options.steps, options.seed))
