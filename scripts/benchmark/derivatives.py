"""Derivatives of optima: their time in solves, and 128 regulators with bounded controls.

    OMP_NUM_THREADS=1 python scripts/benchmark.py derivatives [--repeats 9] [--write]

CPU time, the least of the repeats, on one thread. The 128 regulators have the data of the table of differentiable model
predictive control (T = 20, 8 states, 4 controls); the loss is the sum of the first controls.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec

import numpy as np
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from lin_freq_ocp.derivatives import derivatives_of

STEP = 1e-5  # of central differences


def least(work: Callable[[], object], repeats: int) -> float:
    """Return the least CPU time of some runs, in ms."""
    times = list[float]()
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return 1e3 * min(times)


def regulators(limit: float) -> tuple[lfo.OptimalControlProblem, np.ndarray]:
    """Return a regulator with bounded controls, and 128 initial states."""
    rng = np.random.RandomState(42)
    A = np.eye(8) + 0.2 * rng.randn(8, 8)
    B, b = rng.randn(8, 4), rng.randn(8)
    dynamics, cost = lfo.LinearDynamics(A, B, offset=b), lfo.QuadraticCost(Q=1.0, R=1.0, P=1.0)
    box = lfo.Box(-limit, limit)
    return lfo.OptimalControlProblem(dynamics, 20, cost, box, initial_state=np.zeros(8)), rng.randn(128, 8)


def many(limit: float, repeats: int) -> list[str]:
    """Return a row on the regulators with this bound: times, and the largest error against differences by A."""
    problem, starts = regulators(limit)
    solutions = lfo.solve_many(problem, starts)
    weights = np.zeros_like(solutions.controls)
    weights[:, 0] = 1.0
    solve = least(lambda: lfo.solve_many(problem, starts), repeats)
    adjoint = least(lambda: solutions.vjp(u=weights), repeats)
    found, change = solutions.vjp(u=weights), np.random.default_rng(0).standard_normal((8, 8))
    sums = [
        lfo.solve_many(
            lfo.OptimalControlProblem(
                lfo.LinearDynamics(problem.dynamics.A + step * change, problem.dynamics.B, problem.dynamics.offset),
                20,
                problem.cost,
                problem.control_set,
                initial_state=np.zeros(8),
            ),
            starts,
        )
        .controls[:, 0]
        .sum()
        for step in (STEP, -STEP)
    ]
    wanted = (sums[0] - sums[1]) / (2 * STEP)
    error = abs(float((found["A"] * change).sum()) - wanted) / abs(wanted)
    bounded = float(np.mean(np.abs(solutions.controls) >= limit))
    return [f"{limit:g}", f"{bounded:.0%}", f"{solve:.1f}", f"{adjoint:.1f}", str(found.exists.sum()), f"{error:.0e}"]


def beside(limit: float, mode: str) -> list[str]:
    """Return a row on 16 regulators by cvxpylayers: time of solves and gradient in ours, and the largest difference."""
    import cvxpy as cp
    import torch
    from cvxpylayers.torch import CvxpyLayer

    problem, starts = regulators(limit)
    starts, (n, m), T = starts[:16], problem.linear.B.shape, problem.horizon
    x, u, first = cp.Variable((T + 1, n)), cp.Variable((T, m)), cp.Parameter(n)
    A, B, b = cp.Parameter((n, n)), cp.Parameter((n, m)), cp.Parameter(n)
    rows = [x[0] == first, cp.abs(u) <= limit, *(x[t + 1] == A @ x[t] + B @ u[t] + b for t in range(T))]
    layer = CvxpyLayer(
        cp.Problem(cp.Minimize(0.5 * (cp.sum_squares(x) + cp.sum_squares(u))), rows), [A, B, b, first], [u]
    )
    given = {"A": problem.linear.A, "B": problem.linear.B, "offset": problem.linear.offset}
    data = {name: torch.tensor(np.array(one), requires_grad=True) for name, one in given.items()}

    def ours() -> dict[str, np.ndarray]:
        solutions = lfo.solve_many(problem, starts)
        weights = np.zeros_like(solutions.controls)
        weights[:, 0] = 1.0
        found = solutions.vjp(u=weights)
        return {"A": found["A"], "B": found["B"], "offset": found["offset"].sum(0)}

    def theirs() -> dict[str, np.ndarray]:
        for one in data.values():
            one.grad = None
        arguments = {"solve_method": "Clarabel", "mode": mode}
        found = (layer(*data.values(), torch.tensor(start), solver_args=arguments)[0] for start in starts)
        sum(control[0].sum() for control in found).backward()
        return {name: one.grad.numpy() for name, one in data.items()}

    known, found = ours(), theirs()
    apart = max(float(np.abs(found[name] - known[name]).max() / np.abs(known[name]).max()) for name in known)
    return [f"{limit:g}", mode, f"{least(theirs, 1) / least(ours, 3):.0f}", f"{apart:.0e}"]


def single(problem: lfo.OptimalControlProblem, repeats: int) -> list[str]:
    """Return a row on one problem: its solve, the set-up of derivatives and a further gradient, in solves."""
    result = lfo.solve(problem)
    weights = np.ones((problem.horizon, problem.control_dim))
    made = derivatives_of(problem, result.trajectory, result.multipliers)
    solve = least(lambda: lfo.solve(problem), repeats)
    first = least(lambda: derivatives_of(problem, result.trajectory, result.multipliers).vjp(u=weights), repeats)
    further = least(lambda: made.vjp(u=weights), repeats)
    name = problem.name or str(problem.horizon)
    return [name, str(problem.horizon), f"{solve:.1f}", f"{first / solve:.2f}", f"{further / solve:.3f}"]


def main(arguments: Sequence[str]) -> None:
    """Print all figures."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--repeats", type=int, default=9)
    given = parser.parse_args(arguments)
    of_many = Table("bound", "at it", "solve [ms]", "vjp [ms]", "exist", "error", title="128 regulators")
    others = Table("bound", "mode", "time [of ours]", "apart", title="16 of them by cvxpylayers")
    of_one = Table("problem", "T", "solve [ms]", "first vjp [solves]", "further vjp [solves]", title="one problem")
    with Record(given.write) as record, threadpool_limits(1):
        for limit in (1e4, 1.0):
            of_many.add_row(*many(limit, given.repeats))
        record.show(of_many)
        if find_spec("cvxpylayers"):
            for limit in (1e4, 1.0):
                for mode in ("lsqr", "lsmr", "dense"):
                    others.add_row(*beside(limit, mode))
            record.show(others)
        for build, horizons in (
            (lfo.library.pendulum, (240, 4800)),
            (lfo.library.double_integrator, (200, 20_000, 100_000)),
        ):
            for horizon in horizons:  # the longer ones by adjoint problems
                of_one.add_row(*single(build(horizon=horizon), given.repeats))
        record.show(of_one)
