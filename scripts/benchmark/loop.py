"""Time of a step of a control loop, compared with QP solvers, and with CVXPY with a parameter for the state.

    python scripts/benchmark.py loop [--horizons 60 240] [--problems free "low pass" "soft bounds"] [--steps 100]
                                     [--write]

CPU times of one thread, all contenders on the same measured states in turns; medians. The certificate, which the
others do not have, is timed apart. "agreement" is the largest difference of a control from the first row, relative to
its bound.
OSQP and PIQP solve the sparse program in states and controls, DAQP the dense program of our condensed method, do-mpc,
where it is installed, a nonlinear program of CasADi by IPOPT; each is set up once and updated at every step.

    python scripts/benchmark.py loop --modes [--repeats 3]

A cart-pole between soft walls and pympc's pendulum at an elastic wall instead: each step from the tree of the step
before ("warm"), and each alone ("cold"). Times are the least of several loops with the same measured states.

    python scripts/benchmark.py loop --pushes

The pendulum with a low pass and its bounds on the states soft, pushed every 40 steps so that no plan keeps them, with
and without a limit on the changes of a step; CPU times of steps after the first. "not settled" are steps that ended at
the limit; "cost" and "excess" are those of the loop: its stage costs, and the sum of the excess over the bounds.

    python scripts/benchmark.py loop --previews

CPU times of steps whose data change by more than the initial state, each judged at once: windows of 16 samples over
applied and planned controls, and previewed references, bounds and disturbances of the pendulum with a low pass.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec

import cvxpy as cp
import numpy as np
import osqp
import scipy.sparse as sp
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.loop_cases import cart_pole, elastic_wall, pendulum, soft_pendulum, windowed
from benchmark.record import Record, build_parser
from helpers.dense_kernel import DenseKernel
from lin_freq_ocp.base.clock import use_clock
from lin_freq_ocp.methods.condensed.tables import condense
from lin_freq_ocp.methods.spectral.model import lti_problem, natural_units
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block

NOISE = 1e-3
"""Standard deviation of the disturbance of every state."""

WITH_MODES = {"cart-pole between walls": (cart_pole, 3e-3), "pendulum at an elastic wall": (elastic_wall, 0.0)}
"""Loops with modes and the same deviation (Marcucci and Tedrake 2021; pympc's example has none)."""

CASES = {"free": pendulum, "low pass": partial(pendulum, low_pass=True), "soft bounds": soft_pendulum}

PUSH = np.array([0.0, 0.0, 0.15, 0.3])
"""Added to the state, as a disturbance, every PUSHED steps."""

PUSHED = 40
LIMITS = (None, 40, 20, 10)  # of the changes of a step

SET_UP = 4  # first steps, in which methods set themselves up

DO_MPC = ("do_mpc", "casadi")  # its packages

RESTART = 25  # steps after which the loop begins again at its initial state

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


def sparse(problem: lfo.OptimalControlProblem, solver: str) -> Step:
    """Return a step of PIQP or OSQP on the sparse program, whose rows of the initial state are updated."""
    linear = LinearProgram(problem)
    program, n, m = linear.sparse, problem.state_dim, problem.control_dim
    lower, upper, first = program.lower.copy(), program.upper.copy(), program.rows[Block.STATE_SET].start
    equal = lower == upper
    if solver == "PIQP":
        piqp = import_module("piqp")
        solve = piqp.SparseSolver()
        solve.settings.eps_abs, solve.settings.eps_rel = 1e-8, 1e-9
        # its binding makes sparse matrices of arrays, which the tests refuse of our code
        P, A, G = (sp.csc_matrix(part) for part in (program.P, program.A[equal], program.A[~equal]))
        solve.setup(P, program.q, A, upper[equal], G, lower[~equal], upper[~equal])
    else:
        solve = osqp.OSQP()
        options = {"verbose": False, "eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 20000}
        # it warns of sparse arrays
        solve.setup(sp.csc_matrix(sp.triu(program.P)), program.q, sp.csc_matrix(program.A), lower, upper, **options)

    def step(state: np.ndarray) -> np.ndarray:
        lower[first : first + n] = upper[first : first + n] = state - linear.origin.x[0]
        if solver == "PIQP":
            solve.update(b=upper[equal])
            solve.solve()
            z = solve.result.x
        else:
            solve.update(l=lower, u=upper)
            z = solve.solve(raise_error=False).x
        return z[linear.states : linear.states + m] + linear.origin.u[0]

    return step


def dense(problem: lfo.OptimalControlProblem, solver: str = "DAQP") -> Step:
    """Return a step of DAQP or PIQP on the dense program of the condensed method; of soft rows it has none."""
    units = natural_units(problem)
    tables = condense(lti_problem(problem, units))
    rows = DenseKernel(tables)
    bounded = np.isfinite(rows.lower) | np.isfinite(rows.upper)
    M, of_start = np.ascontiguousarray(rows.gradients[bounded]), rows.of_start[bounded]
    lower, upper = (np.clip(side[bounded], -1e30, 1e30) for side in (rows.lower, rows.upper))
    r = tables.unknowns
    if solver == "PIQP":
        model = import_module("piqp").DenseSolver()
        model.settings.eps_abs, model.settings.eps_rel = 1e-8, 1e-9
        model.setup(np.eye(r), np.zeros(r), None, None, M, lower, upper)
    else:
        model = import_module("daqp").Model()
        model.setup(np.eye(r), np.zeros(r), M, upper, lower, np.zeros(len(M), dtype=np.int32))
    (_, n, m), K = tables.loop.shape, tables.loop.K

    def step(state: np.ndarray) -> np.ndarray:
        start = np.append(state / units.x, 1.0)
        shift = of_start @ start
        if solver == "PIQP":
            model.update(h_l=lower - shift, h_u=upper - shift)
            model.solve()
            xi = model.result.x
        else:
            model.update(bupper=upper - shift, blower=lower - shift)
            xi = model.solve()[0]
        return (tables.W[:m] @ start + tables.V[:m] @ xi + K @ start[:n]) * units.u

    return step


def do_mpc(problem: lfo.OptimalControlProblem) -> Step:
    """Return a step of do-mpc, whose soft rows and stop bands are constraints of its nonlinear program."""
    with warnings.catch_warnings():  # of features that are not installed
        warnings.simplefilter("ignore")
        controllers, models = import_module("do_mpc.controller"), import_module("do_mpc.model")
    casadi = import_module("casadi")
    T, cost, model = problem.horizon, problem.quadratic, models.Model("discrete")
    A, B, Q, R, P = map(casadi.DM, (problem.linear.A, problem.linear.B, cost.Q, cost.R, cost.P))
    x = model.set_variable("_x", "x", (problem.state_dim, 1))
    u = model.set_variable("_u", "u", (problem.control_dim, 1))
    model.set_rhs("x", A @ x + B @ u)
    model.setup()
    mpc = controllers.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.store_full_solution = T, 1.0, False
    mpc.settings.supress_ipopt_output()
    mpc.set_objective(mterm=x.T @ P @ x / 2, lterm=(x.T @ Q @ x + u.T @ R @ u) / 2)
    mpc.set_rterm(u=0.0)
    (lower, upper), soft = problem.control_tube.bounds, problem.state_set
    mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = lower[0], upper[0]
    if isinstance(soft, lfo.sets.Soft):
        (lower, upper), price = soft.soft_set.bounds, {"soft_constraint": True, "penalty_term_cons": soft.penalty}
        mpc.set_nl_cons("above", x, ub=upper, **price)
        mpc.set_nl_cons("below", -x, ub=-lower, **price)
    else:
        lower, upper = problem.state_boxes.bounds
        mpc.bounds["lower", "_x", "x"], mpc.bounds["upper", "_x", "x"] = lower[1], upper[1]
    mpc.prepare_nlp()
    stopped = np.flatnonzero(problem.control_stop[:, 0])
    if len(stopped):
        angle = 2 * np.pi * np.outer(stopped, np.arange(T)) / T
        rows = np.vstack([np.cos(angle), np.sin(angle[stopped != T / 2])])
        mpc.nlp_cons.append(casadi.DM(rows) @ casadi.vertcat(*(mpc.opt_x["_u", t, 0] for t in range(T))))
        for side in (mpc.nlp_cons_lb, mpc.nlp_cons_ub):
            side.append(np.zeros((len(rows), 1)))
    mpc.create_nlp()
    mpc.x0 = problem.initial_box.lower
    mpc.set_initial_guess()
    return lambda state: mpc.make_step(state[:, None])[:, 0]


def contenders(problem: lfo.OptimalControlProblem) -> dict[str, Step]:
    """Return a step of each contender, by its name."""
    ours = {
        "auto": lfo.RecedingHorizon(problem),
        "auto, certified later": lfo.RecedingHorizon(problem, certify="later"),
    }
    ours |= {name: lfo.RecedingHorizon(problem, name) for name in ("structured", "convex")}
    steps: dict[str, Step] = {name: controller.step for name, controller in ours.items()}
    steps |= {f"{name}, sparse": sparse(problem, name) for name in ("PIQP", "OSQP")}
    if not isinstance(problem.state_set, lfo.sets.Soft):
        steps["DAQP, condensed"] = dense(problem)
    if all(map(find_spec, DO_MPC)):
        steps["do-mpc, IPOPT"] = do_mpc(problem)
    return steps | {f"CVXPY, {solver}": parametric(problem, solver) for solver in ("CLARABEL", "OSQP")}


def measured(problem: lfo.OptimalControlProblem, steps: int, seed: int) -> list[list[str]]:
    """Return a row of text for each contender."""
    rng, found = np.random.default_rng(seed), contenders(problem)
    x, step = problem.initial_box.lower, problem.dynamics.stepper(1)
    times = {name: list[float]() for name in found}
    controls = {name: list[np.ndarray]() for name in found}
    for k in range(steps):
        if k % RESTART == 0:
            x = problem.initial_box.lower
        for name, one in found.items():
            began = time.process_time()
            controls[name].append(one(x))
            times[name].append(1e3 * (time.process_time() - began))
        x = step(0, x, controls["auto"][-1]) + NOISE * rng.standard_normal(len(x))
    rows: list[list[str]] = []
    for name, one in found.items():
        controller = getattr(one, "__self__", None)
        later = controller is not None and any(step.pending is not None for step in controller.log.steps)
        if controller is not None:
            controller.certify()
        certify = 0.0 if controller is None else 1e3 * float(np.median(controller.log.certify_seconds[1:]))
        own = np.array(times[name][SET_UP:]) - (0.0 if later else certify)
        apart = np.abs(np.array(controls[name]) - controls["auto"]).max() / problem.control_tube.upper.max()
        gap = "" if controller is None else f"{controller.log.gaps.max():.0e}"
        rows.append(
            [
                name,
                f"{np.median(own):.3f}",
                f"{own.max():.2f}",
                f"{certify:.2f}" if controller else "",
                gap,
                f"{apart:.0e}",
            ]
        )
    return rows


def with_modes(steps: int, seed: int, repeats: int) -> Table:
    """Return a table of relaxations and times of steps with modes, after the first, warm and cold in turns.

    Each time is the least of ``repeats`` loops with the same measured states.
    """
    table = Table("problem", "start", title="a step of a control loop with modes, T = 20")
    for column in ("nodes, median", "worst", "ms, median", "worst", "certificate, ms", "CPU in all, ms", "worst"):
        table.add_column(column, justify="right")
    table.add_column("largest gap", justify="right")
    for name, (build, noise) in WITH_MODES.items():
        rng, problem = np.random.default_rng(seed), build()
        measured_states, step = [problem.initial_box.lower], problem.dynamics.stepper(1)
        least: dict[tuple[str, int], np.ndarray] = {}
        for _ in range(repeats):
            warm = lfo.RecedingHorizon(problem)
            for k in range(steps):
                for start, one in (("warm", warm), ("cold", lfo.RecedingHorizon(problem))):
                    x, began = measured_states[k], time.process_time()
                    u = one.step(x)
                    spent, last = time.process_time() - began, one.log.steps[-1]
                    seconds = 1e3 * np.array([last.solve_seconds, last.certify_seconds, spent])
                    found = np.concatenate([[last.nodes], seconds, [last.gap]])
                    least[start, k] = np.minimum(found, least.get((start, k), np.inf))
                    if start == "warm" and len(measured_states) == k + 1:
                        measured_states.append(step(0, x, u) + noise * rng.standard_normal(len(x)))
        for start in ("warm", "cold"):
            rows = np.array([least[start, k] for k in range(1, steps)])
            middle, worst = np.median(rows, axis=0), rows.max(axis=0)
            numbers = [middle[0], worst[0], middle[1], worst[1], middle[2], middle[3], worst[3]]
            title = name if start == "warm" else ""
            table.add_row(title, start, *(f"{number:.0f}" for number in numbers), f"{worst[4]:.0e}")
    return table


def with_pushes(horizons: Sequence[int], steps: int, seed: int) -> Table:
    """Return a table of the times of steps without a plan within the bounds, with limits on their changes."""
    table = Table("problem", "max_changes", title="a step of a loop whose bounds give way, certified later")
    for column in ("ms, median", "worst", "changes, worst", "softened", "not settled", "cost", "excess"):
        table.add_column(column, justify="right")
    for horizon in horizons:
        problem = pendulum(horizon, low_pass=True)
        cost, bound, step = problem.quadratic, problem.state_boxes.upper[1], problem.dynamics.stepper(1)
        for limit in LIMITS:
            rng, x, times = np.random.default_rng(seed), np.zeros(problem.state_dim), list[float]()
            controller = lfo.RecedingHorizon(problem, soft={"state_set": 1e3}, certify="later", max_changes=limit)
            for k in range(steps):
                began = time.process_time()
                u = controller.step(x)
                times.append(1e3 * (time.process_time() - began))
                x = step(0, x, u) + NOISE * rng.standard_normal(len(x)) + (k % PUSHED == PUSHED - 1) * PUSH
            log, own = controller.log, np.array(times[1:])
            spent = 0.5 * float((log.states @ cost.Q * log.states).sum() + (log.controls @ cost.R * log.controls).sum())
            excess = float(np.maximum(np.abs(log.states) - bound, 0.0).sum())
            sources = [str(source) for source in log.sources]
            table.add_row(
                f"pendulum, T = {horizon}" if limit is None else "",
                "none" if limit is None else str(limit),
                f"{np.median(own):.2f}",
                f"{own.max():.2f}",
                str(log.changes[1:].max()),
                str(sources.count("softened problem")),
                str(sum(status == "limit" for status in log.statuses)),
                f"{spent:.1f}",
                f"{excess:.1f}",
            )
    return table


def previews_of(problem: lfo.OptimalControlProblem) -> dict[str, Callable[[int], dict[str, object]]]:
    """Return what a step is told beyond the state, by what changes."""
    bound, n, times = problem.state_boxes.upper[1], problem.state_dim, np.arange(problem.horizon + 1)

    def wave(k: int) -> np.ndarray:
        return np.sin(0.1 * (k + times))[:, None]

    def box(k: int) -> lfo.Box:
        sides = (1 + 0.1 * wave(k)) * bound
        return lfo.Box(-sides, sides)

    return {
        "the initial state": lambda k: {},
        "references": lambda k: {"references": {"x_ref": 0.01 * wave(k) * np.eye(1, n)}},
        "bounds": lambda k: {"bounds": {"state_set": box(k)}},
        "disturbances": lambda k: {"disturbance": 1e-4 * wave(k)[:-1] * np.ones(n)},
    }


def with_previews(horizons: Sequence[int], steps: int, seed: int) -> Table:
    """Return a table of the times of steps with windows and with previews."""
    table = Table("horizon", "what changes", "method", title="a step whose data change, judged at once")
    for column in ("ms, median", "worst"):
        table.add_column(column, justify="right")
    for horizon in horizons:
        plain = pendulum(horizon, low_pass=True)
        previews = previews_of(plain)
        cases = [(name, plain, preview) for name, preview in previews.items()]
        cases.append(("windows", windowed(horizon), previews["the initial state"]))
        for name, problem, preview in cases:
            rng, x, step = np.random.default_rng(seed), 0.3 * problem.initial_box.lower, problem.dynamics.stepper(1)
            controller, spent = lfo.RecedingHorizon(problem), list[float]()
            for k in range(steps):
                began = time.process_time()
                u = controller.step(x, **preview(k))
                spent.append(1e3 * (time.process_time() - began))
                x = step(0, x, u) + NOISE * rng.standard_normal(len(x))
            own = np.array(spent[SET_UP:])
            method = controller.log.steps[-1].method
            what = f"T = {horizon}" if name == "the initial state" else ""
            table.add_row(what, name, method, f"{np.median(own):.1f}", f"{own.max():.1f}")
    return table


def linear(horizons: Sequence[int], problems: Sequence[str], steps: int, seed: int) -> Table:
    """Return a table of the times of all contenders."""
    table = Table("problem", "contender", title="a step of a control loop, warm")
    for column in ("ms, median", "worst", "certificate, ms", "gap", "agreement"):
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
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=3, help="loops of --modes, of whose times the least count")
    parser.add_argument("--modes", action="store_true")
    parser.add_argument("--pushes", action="store_true")
    parser.add_argument("--previews", action="store_true")
    options = parser.parse_args(arguments)
    with Record(options.write) as record, threadpool_limits(1), use_clock(time.process_time):
        if options.modes:
            record.show(with_modes(options.steps, options.seed, options.repeats))
        elif options.previews:
            record.show(with_previews(options.horizons, options.steps, options.seed))
        elif options.pushes:
            record.show(with_pushes(options.horizons, options.steps, options.seed))
        else:
            record.show(linear(options.horizons, options.problems, options.steps, options.seed))
            if not all(map(find_spec, DO_MPC)):
                record.show("do-mpc is not in the table: it is not installed (pip install do-mpc).")
