"""Smooth dynamics against CasADi and IPOPT in one run: the same problems from the same starts.

    OMP_NUM_THREADS=1 python scripts/benchmark.py nonlinear [--cases NAME ...] [--repeats N] [--plain] [--write]

From each of two trajectories of constant controls, processor seconds of one local optimum: ours, the model's set-up
included, and IPOPT's, its own set-up and the construction of its program left out. Each is the least of N. Beside them:
steps, costs, and the worst condition of our certificate; and the whole ``lfo.solve(problem, global_bound=False)``, all
starts and the judge included. IPOPT has exact derivatives by CasADi and the linear solver MUMPS.

A second table has published problems (tests/helpers/published.py): the whole of ``lfo.solve`` and the whole of IPOPT,
its set-up by CasADi included, from our first start, or from the next one where it fails there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.ipopt import solved_by_ipopt
from benchmark.record import Record, build_parser
from helpers.published import PUBLISHED
from lin_freq_ocp.methods.hybrid.smooth.interior_point import Barrier
from lin_freq_ocp.methods.hybrid.smooth.local_search import LocalSearch
from lin_freq_ocp.methods.hybrid.smooth.model import SmoothModel
from lin_freq_ocp.methods.structured.kkt.recursions import loops

Value = TypeVar("Value")

SHARES = (0.5, 0.1)  # constant controls to start from, between lower and upper bound
FINE, FINER = {"horizon": 400, "sampling_time": 0.01}, {"horizon": 400, "sampling_time": 0.005}
CASES: dict[str, tuple[Callable[..., lfo.OptimalControlProblem], dict[str, float]]] = {
    "pendulum": (lfo.library.pendulum_swing_up, {}),
    "pendulum, 3 Hz": (lfo.library.pendulum_swing_up, {"cutoff_hz": 3.0}),
    "pendulum, T = 400, 3 Hz": (lfo.library.pendulum_swing_up, FINE | {"cutoff_hz": 3.0}),
    "cart-pole": (lfo.library.cart_pole, {}),
    "cart-pole, 8 Hz": (lfo.library.cart_pole, {"cutoff_hz": 8.0}),
    "cart-pole, T = 400": (lfo.library.cart_pole, FINER),
    "quadrotor": (lfo.library.planar_quadrotor, {}),
    "quadrotor, 5 Hz": (lfo.library.planar_quadrotor, {"cutoff_hz": 5.0}),
    "quadrotor, T = 400, 5 Hz": (lfo.library.planar_quadrotor, FINER | {"cutoff_hz": 5.0}),
}


def held(problem: lfo.OptimalControlProblem, share: float) -> lfo.Trajectory:
    """Return the trajectory of a constant control."""
    tube = problem.control_tube
    return lfo.simulate(problem, tube.lower + share * (tube.upper - tube.lower))


def ours(problem: lfo.OptimalControlProblem, start: lfo.Trajectory, compiled: bool) -> tuple[float, str, int]:
    """Return cost, end and steps of the barrier method."""
    model = SmoothModel.at(problem, start)
    answer = Barrier(model, loops(compiled)).run(model.assembly.point(start))
    found = model.trajectory(answer.point.y)
    return problem.value(found.x, found.u), answer.end.value, answer.steps


def timed(runs: dict[str, Callable[[], Value]], repeats: int) -> dict[str, tuple[float, Value]]:
    """Return the least time of each run, and its answer."""
    best: dict[str, tuple[float, Value]] = {}
    for _ in range(repeats):
        for name, run in runs.items():
            begun = time.process_time()
            value = run()
            seconds = time.process_time() - begun
            if name not in best or seconds < best[name][0]:
                best[name] = seconds, value
    return best


def rows(name: str, repeats: int, compiled: bool) -> Iterator[list[str]]:
    """Yield the cells of one problem, a row for each start."""
    build, given = CASES[name]
    problem = build(**given)
    seconds, result = timed({"solve": partial(lfo.solve, problem, global_bound=False, throw=False)}, repeats)["solve"]
    worst = "" if result.certificate is None else f"{result.certificate.worst.relative:.0e}"
    for share in SHARES:
        start = held(problem, share)
        claim = min((solved_by_ipopt(problem, start) for _ in range(repeats)), key=lambda one: one.seconds)
        spent, (cost, end, steps) = timed({"ours": partial(ours, problem, start, compiled)}, repeats)["ours"]
        yield [
            name,
            f"{share:g}",
            f"{spent:.3f}" + ("" if end == "optimal" else f" ({end})"),
            str(steps),
            f"{claim.seconds:.3f}" + ("" if claim.status == "Solve_Succeeded" else f" ({claim.status})"),
            str(claim.steps),
            f"{cost:.8g}",
            f"{claim.cost / cost - 1:.0e}",
            worst,
            f"{seconds:.2f}",
        ]


def published_row(name: str, repeats: int) -> list[str]:
    """Return the cells of one published problem."""
    case = PUBLISHED[name]
    problem = case.build(case.horizon)
    solve = partial(lfo.solve, problem, global_bound=False, throw=False)
    seconds, result = timed({"solve": solve}, repeats)["solve"]
    starts = [start for start, _ in LocalSearch(problem).starts()]
    for start in (starts[0], starts[-1]):
        spent, claim = timed({"ipopt": partial(solved_by_ipopt, problem, start)}, repeats)["ipopt"]
        if claim.status == "Solve_Succeeded":
            break
    succeeded = claim.status == "Solve_Succeeded"
    cost = np.nan if result.certificate is None else result.certificate.cost
    return [
        name,
        str(result.status),
        f"{cost:.8g}",
        f"{claim.cost / cost - 1:.0e}" if succeeded else claim.status,
        f"{seconds:.3f}",
        f"{spent:.3f}",
        f"{seconds / spent:.1f}",
    ]


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--published", nargs="*", default=list(PUBLISHED), choices=list(PUBLISHED))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--plain", action="store_true", help="The loops by NumPy and LAPACK.")
    options = parser.parse_args(arguments)
    table = Table("problem", "start", title="processor seconds of one local optimum")
    compiled = not options.plain
    for heading in ("ours", "steps", "IPOPT", "steps", "cost", "IPOPT's, relative", "worst", "solve"):
        table.add_column(heading, justify="right")
    loops(compiled)  # compiled before anything is timed
    with Record(options.write) as record:
        for name in options.cases:
            for cells in rows(name, options.repeats, compiled):
                table.add_row(*cells)
        record.show(table)
        table = Table("problem", "status", title="processor seconds of published problems")
        for heading in ("cost", "IPOPT's, relative", "solve", "IPOPT", "ratio"):
            table.add_column(heading, justify="right")
        for name in options.published:
            table.add_row(*published_row(name, options.repeats))
        record.show(table)
