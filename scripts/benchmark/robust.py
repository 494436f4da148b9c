"""Plans for all loads: times as ratios to the nominal solve, and one program with the rows of all vertices.

    python scripts/benchmark.py robust [--write]

The double integrator of robust-tube-mpc (loads in both states, gain "auto"). Times are CPU times, the median of nine
runs; a solve includes its certificate. Beside them: the cost of the plan, the largest difference between the worst case
that is stated and its simulation, and the largest excess of 2000 random sequences of corners over a limit. The program
of all vertices states the rows of each of the 4^T load sequences, by CVXPY and Clarabel, whose set-up is in its time.

Larger loads than those of the plan, which promises nothing for them: the limits that ``worst_case`` calls violated, by
how much, what the loads that it returns do, what 2000 random sequences of corners do, how many steps of a loop of 300
under random corners have a plan, and what becomes of a plan for these loads.

Discs: the wave-energy converter, whose stroke is at most 85 % of what it would be, for responses within 5 % at each
bin; all solves by method "convex", medians of three runs, of long records one run. The last column is the largest
violation of a limit for the worst plant, relative to its terms; ``worst_case`` allows 1e-8.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import product

import cvxpy as cp
import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from helpers.tubes import excess, simulate, tube

CASES = ((10, 0.15), (60, 0.15), (300, 0.15), (1000, 0.15))  # horizon, size of the loads
VERTICES = (3, 4, 5)  # horizons of the program of all vertices
SIZE = 0.1  # of its loads
RUNS = 9
LARGER, LOOP = (1.0, 1.001, 2.0, 3.0, 5.0), 300  # loads, in those of the plan; steps of a loop
LONG = 20_000  # samples
RECORDS = (100, 400, 1000, 4000, 20_000, 100_000)  # samples of a record of 20 s
SHARE, STROKE = 0.05, 0.85  # of |G|, of the free stroke


def seconds(call: Callable[[], object], runs: int = RUNS) -> float:
    """Return the CPU time of a call, the median of some runs after a first one."""
    call()
    times = list[float]()
    for _ in range(runs):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return statistics.median(times)


def all_vertices(T: int, load: lfo.Disturbance) -> float:
    """Return the optimal cost of one program with the rows of all load sequences."""
    problem = tube(T)
    z, v, K = cp.Variable((T + 1, 2)), cp.Variable((T, 1)), load.feedback(problem)
    w = np.array(list(product([-SIZE, SIZE], repeat=2 * T))).reshape(-1, T, 2)
    A, B, _ = problem.linear.at(0)
    parts, e = [z[0] == problem.initial_box.lower], 0 * w[:, 0]
    for t in range(T + 1):
        if t:
            x = np.ones((len(e), 1)) @ cp.reshape(z[t], (1, 2), order="C") + e
            parts += [x <= problem.state_boxes.upper[t][None], x >= problem.state_boxes.lower[t][None]]
        if t < T:
            parts += [z[t + 1] == A @ z[t] + B @ v[t], cp.abs(v[t, 0] * np.ones(len(e)) + e @ K[0]) <= 1]
            e = e @ (A + B @ K).T + w[:, t]
    cost = sum(cp.sum_squares(z[t]) + 0.1 * cp.square(v[t, 0]) for t in range(T)) / 2 + 1.5 * cp.sum_squares(z[T])
    program = cp.Problem(cp.Minimize(cost), parts)
    return float(program.solve(solver="CLARABEL", tol_gap_rel=1e-11, tol_feas=1e-11))


def row(T: int, size: float) -> list[str]:
    """Return the ratios and the accuracy of a horizon."""
    problem, load = tube(T), lfo.Disturbance(lfo.Box(-size, size))
    plan = lfo.robust(problem, load)
    found = lfo.solve(plan)
    nominal = seconds(lambda: lfo.solve(problem))
    parts = [lambda: lfo.robust(problem, load), lambda: lfo.solve(plan), lambda: lfo.worst_case(problem, load, found)]
    ratios = [f"{seconds(part) / nominal:.2f}" for part in parts]
    worst = lfo.worst_case(problem, load, found)
    apart = max(abs(one.attained - one.planned - one.sign * one.margin) for one in worst.limits)
    w = np.random.default_rng(0).choice([-size, size], (2000, T, 2))
    over = excess(problem, *simulate(problem, load.feedback(problem), found.trajectory, np.eye(2), w))
    costs = [f"{lfo.solve(problem).cost:.3f}", f"{found.cost:.3f}"]
    return [str(T), f"{1e3 * nominal:.1f} ms", *ratios, *costs, f"{apart:.1e}", f"{max(over, 0.0):.1e}"]


def row_of_vertices(T: int) -> list[str]:
    """Return the program of all vertices beside the plan of tightened limits."""
    load = lfo.Disturbance(lfo.Box(-SIZE, SIZE))
    ours, cost = seconds(lambda: lfo.solve(lfo.robust(tube(T), load))), lfo.solve(lfo.robust(tube(T), load)).cost
    theirs, known = seconds(lambda: all_vertices(T, load)), all_vertices(T, load)
    times = f"{1e3 * ours:.1f} ms", f"{theirs / ours:.1f}"
    return [str(T), f"{4**T}", *times, f"{cost:.8f}", f"{abs(cost - known) / known:.1e}"]


def row_of_larger_loads(share: float) -> list[str]:
    """Return what loads of a share of those of the plan do to it."""
    (T, size), rng = CASES[0], np.random.default_rng(0)
    problem, load = tube(T), lfo.Disturbance(lfo.Box(-size, size))
    K, plan = load.feedback(problem), lfo.solve(lfo.robust(problem, load)).trajectory
    larger = lfo.Disturbance(lfo.Box(-share * size, share * size), gain=K)
    broken = [one for one in lfo.worst_case(problem, larger, plan).limits if not one.holds]
    largest = max(broken, key=lambda one: one.violation, default=None)
    reached = 0.0 if largest is None else excess(problem, *simulate(problem, K, plan, np.eye(2), largest.loads[None]))
    w = share * rng.choice([-size, size], (2000, T, 2))
    over = max(excess(problem, *simulate(problem, K, plan, np.eye(2), w)), 0.0)
    loop = lfo.RecedingHorizon(lfo.robust(tube(T, initial_state=None), load, end="invariant"), certify="later")
    x, steps, (A, B, _) = problem.initial_box.lower, 0, problem.linear.at(0)
    with suppress(lfo.errors.InfeasibleError):
        while steps < LOOP:
            x = A @ x + B @ loop.step(x) + share * rng.choice([-size, size], 2)
            steps += 1
    try:
        found = lfo.solve(lfo.robust(problem, larger), throw=False).status
    except lfo.errors.ProblemError:
        found = "refused: margins above a range"
    violated = f"{0.0 if largest is None else largest.violation:.6f}"
    return [f"{share:g}", str(len(broken)), violated, f"{reached:.6f}", f"{over:.6f}", str(steps), str(found)]


def row_of_discs(N: int) -> list[str]:
    """Return the times, powers and accuracy of the plans for all plants within discs, beside the nominal plan."""
    free = lfo.solve(lfo.library.wave_energy(horizon=N, stroke=1.0), "convex")
    problem = lfo.library.wave_energy(horizon=N, stroke=STROKE * float(np.abs(free.trajectory.x[:, 1]).max()))
    radius = SHARE * np.abs(problem.dynamics.G)
    plans = [lfo.robust(problem, lfo.Discs(radius)), lfo.robust(problem, lfo.Discs(radius, cost="worst"))]
    runs = 3 if N < LONG else 1
    nominal, *ours = (seconds(lambda one=one: lfo.solve(one, "convex"), runs) for one in (problem, *plans))
    found = [lfo.solve(one, "convex") for one in (problem, *plans)]
    worst = lfo.worst_case(problem, lfo.Discs(radius), found[1])
    apart = max(abs(one.attained - one.planned - one.sign * one.margin) for one in worst.limits)
    over = max(one.violation / one.size for one in worst.limits)
    ratios, powers = [f"{one / nominal:.1f}" for one in ours], [f"{-one.cost:.4f}" for one in found]
    accuracy = [f"{one:.0e}" for one in (max(one.gap for one in found), apart, over)]
    return [str(N), f"{nominal:.2f} s", *ratios, *powers, *accuracy]


def main(arguments: Sequence[str]) -> None:
    """Print both tables."""
    given = build_parser(__name__, __doc__).parse_args(arguments)
    with Record(given.write) as record:
        table = Table(title="times relative to the nominal solve; accuracy of the worst case")
        headings = "T", "nominal", "tighten", "solve", "worst case", "nominal cost", "cost", "attained to", "excess"
        for heading in headings:
            table.add_column(heading, justify="right")
        for case in CASES:
            table.add_row(*row(*case))
        record.show(table)
        table = Table(title="one program with the rows of all load sequences, relative to tightening and solving")
        for heading in ("T", "sequences", "tighten and solve", "one program", "cost", "costs differ by"):
            table.add_column(heading, justify="right")
        for T in VERTICES:
            table.add_row(*row_of_vertices(T))
        record.show(table)
        table = Table(title="loads that are larger than those of the plan")
        for heading in ("times", "violated", "by", "attained", "random", "steps with a plan", "a plan for them"):
            table.add_column(heading, justify="right")
        for share in LARGER:
            table.add_row(*row_of_larger_loads(share))
        record.show(table)
        table = Table(title="every plant within discs, relative to the nominal solve; power in W")
        headings = "samples", "nominal", "discs", "worst power", "nominal power", "with discs", "guaranteed", "gap"
        for heading in (*headings, "attained to", "excess"):
            table.add_column(heading, justify="right")
        for N in RECORDS:
            table.add_row(*row_of_discs(N))
        record.show(table)
