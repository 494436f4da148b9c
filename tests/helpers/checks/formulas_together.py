"""Random formulas of dynamics, costs and path constraints in one small problem with other features.

A formula is a text, which NumPy and CVXPY evaluate as well as the library. An answer that counts holds every
constraint by NumPy, costs what NumPy says, and has the certificate that certify finds again. Where everything is
convex, CVXPY finds the same cost; elsewhere no rigorous bound lies above the cost of a trajectory that another solve
finds, and no problem is infeasible that another solve answers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

import lin_freq_ocp as lfo
from helpers.checks import pairs
from helpers.checks.outcome import Outcome
from lin_freq_ocp.base import Array

NUMBERS: dict[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in ("sin", "cos", "tanh", "exp", "log", "sqrt", "abs")},
    "max": lambda *parts: np.max(parts, axis=0),
    "norm": lambda *parts: np.sqrt(sum(part**2 for part in parts)),
}
CONES: dict[str, Callable[..., Any]] = {
    "abs": cp.abs,
    "exp": cp.exp,
    "log": cp.log,
    "max": cp.maximum,
    "norm": lambda *parts: cp.norm(cp.hstack(parts)),
}
D = "({a}*x_0 + {b}*x_1 + {c}*u_0)"
STAGES = {  # of cost: whether a text is convex
    True: [
        "exp(0.5*" + D + ")",
        "{w}*" + D + "**4",
        "abs(" + D + " - {a})",
        "max({w}*u_0, {b}*x_0, 0.1)",
        "norm(x_1, {w}*u_0)",
        "-log(4 + u_0)*{w}",
        "{w}*u_0**2 + 0.3*abs(x_1)",
        "{w}*(x_0 - 0.6)**2",
        "norm(x_0, x_1 - u_0) + 1e3",
    ],
    False: [
        "0.3*sin(" + D + ")",
        "{w}*(x_0**2 - 1)**2",
        "tanh(" + D + ")**2",
        "{w}*sqrt(1 + u_0**2)*cos(x_1)",
        "-0.2*abs(x_0)",
        "log(1 + " + D + "**2)",
        "0.2*x_0*u_0",
        "abs(x_0 - {a})*(1 + u_0**2)",
        "1e6 + {w}*(1 - cos(u_0))",
    ],
}
ENDS = {
    True: ["exp(0.5*x_0)", "{w}*x_1**4", "(x_0 + {a}*x_1)**2", ""],
    False: ["cos(x_1)", "x_0**4 - x_0**2", "sin(x_0*x_1)", ""],
}
PATHS = {
    True: [
        "x_1**2 + {w}*u_0**2 - 1.2",
        "abs(u_0) + abs(x_1) - 1.5",
        "exp(u_0) - 2.2",
        "norm(x_0, x_1) - 2",
        "max(x_0 - 1.8, -u_0 - 0.8)",
        "(x_0 - 0.5)**2 + x_1**2 - 2.5",
    ],
    False: [
        "-x_1 - 0.05*x_0**2 - 0.3",
        "sin(x_0) - 0.2*x_1 - 1.1",
        "0.3 - (x_0 - 0.9)**2 - (x_1 + 0.4)**2",
        "x_0*u_0 - 0.5",
        "x_0 - {w}*cos(x_1) - 1.4",
        "-abs(x_0 + u_0) + 0.05",
    ],
}
MAPS = [
    ["x_0 + x_1 + 0.5*u_0", "x_1 + u_0 - {k}*sin(x_0)"],
    ["x_0 + x_1 + 0.5*u_0", "x_1 + u_0 - {k}*abs(x_1)"],
    ["x_0 + x_1 + 0.5*tanh(u_0)", "x_1*(1 - {k}*x_1) + tanh(u_0)"],
    ["x_0 + x_1 + 0.5*u_0", "x_1 + u_0 + {k}*max(0, -x_0)"],
    ["x_0 + sin(x_1) + 0.5*u_0", "x_1 + u_0*(1 + {k}*x_0)"],
    ["x_0 + x_1 + 0.5*u_0", "x_1 + u_0"],
]
LINEAR = ["x_0 + x_1 + 0.5*u_0", "x_1 + u_0"]
NO_COMPANION = {  # dynamics of their own, or formulas
    *("periodic frequency response", "zero-padded frequency response", "piecewise-affine dynamics"),
    *("smooth dynamics", "piecewise-smooth dynamics", "dynamics by functions", "time-varying dynamics"),
    *("cost by formulas", "cost by formulas with a kink", "soft path constraint", "path constraint"),
    *("convex path constraint", "linear dynamics"),
}
LEVELS = {"levels", "duty cycles"}
COMPANIONS = [name for name in pairs.FEATURES if name not in NO_COMPANION]
WITHIN = 2e-6  # violation of a constraint, and difference of costs, relative to 1 or the cost
SEARCHED_GAP = 1e-4  # at which a search for a global bound ends
PRICE = 0.4  # of a soft path constraint
STATUSES = {str(status) for status in lfo.results.Status}
TIME_LIMIT = 4.0  # seconds of a search for a global bound


@dataclass(frozen=True)
class Drawn:
    """The texts of a random problem, the names of its other features, and the method."""

    maps: tuple[str, ...]
    stage: str
    terminal: str
    path: str
    soft: bool
    convex: bool
    companions: tuple[str, ...]
    method: str

    @property
    def kind(self) -> str:
        """Return what is convex, and the method."""
        return f"{'convex' if self.convex else 'others'}, {self.method}"


def draw(seed: int) -> Drawn:
    """Return a random problem; some third of them is convex."""
    rng = np.random.default_rng([seed, 50])
    numbers = {name: f"{value:.3g}" for name, value in zip("abcwk", rng.uniform(-1, 1, 5), strict=True)}
    numbers["w"], numbers["k"] = (f"{value:.3g}" for value in rng.uniform((0.05, 0.02), (1.0, 0.15)))
    convex = bool(rng.random() < 0.4)

    def pick(texts: Mapping[bool, list[str]]) -> str:
        of_kind = texts[convex or bool(rng.random() < 0.5)]
        return of_kind[int(rng.integers(len(of_kind)))].format(**numbers)

    parts = rng.random(4) < (0.0 if convex else 0.5, 0.6, 0.4, 0.5)
    if not parts.any():
        parts[1] = True
    maps = LINEAR if not parts[0] else [one.format(**numbers) for one in MAPS[int(rng.integers(len(MAPS)))]]
    while True:
        count = int(rng.integers(0, 4))
        names = tuple(str(name) for name in sorted(rng.choice(COMPANIONS, count, replace=False)))
        if not any(pairs.exclude_each_other(one, other) for one in names for other in names if one < other):
            break
    kinds = zip((STAGES, ENDS, PATHS), parts[1:], strict=True)
    stage, terminal, path = (pick(texts) if there else "" for texts, there in kinds)
    convex &= not LEVELS & set(names) and "indefinite cost" not in names
    method = "nonsmooth" if rng.random() < 0.7 else "auto"
    return Drawn(tuple(maps), stage, terminal, path, bool(rng.random() < 0.3), convex, names, method)


def parts_of(drawn: Drawn) -> list[pairs.Fields]:
    """Return the fields of the formulas."""
    fields: list[pairs.Fields] = []
    if list(drawn.maps) != LINEAR:
        dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(list(drawn.maps), 2, 1, sampling_time=1.0)
        fields.append({"dynamics": dynamics})
    if drawn.stage or drawn.terminal:
        cost = {key: text for key, text in (("stage", drawn.stage), ("terminal", drawn.terminal)) if text}
        fields.append({"cost": lfo.costs.SmoothCost(**cost)})
    if drawn.path:
        soft = {"price": PRICE} if drawn.soft else {}
        fields.append({"stage_rows": [lfo.sets.PathConstraint(drawn.path, "drawn path", **soft)]})
    return fields


def by_text(text: str, names: Mapping[str, Any], x: Any, u: Any) -> Any:
    """Return the value of a text at states and a control."""
    signals = {f"x_{i}": x[i] for i in range(2)} | {"u_0": u[0]}
    return eval(text, {"__builtins__": {}}, {**names, **signals})  # texts of this file


def path_times(drawn: Drawn) -> range:
    """Return the times of the path constraint: one of states alone holds at T, too."""
    return range(pairs.T + (0 if "u_0" in drawn.path else 1))


def twin(drawn: Drawn) -> tuple[Any, list[Any], Any, Any] | None:
    """Return cost and constraints of the other features in CVXPY, and its x and u; None where it takes them not."""
    names = [name for name in drawn.companions if name not in LEVELS]
    try:
        model = lfo.to_cvxpy(pairs.problem_of(*names))
    except lfo.errors.LinFreqOCPError:
        return None
    x, u = model.var_dict["x"], model.var_dict["u"]
    return model.objective.expr, model.constraints, x, u


def own_parts(drawn: Drawn, names: Mapping[str, Any], x: Any, u: Any) -> tuple[Any, list[Any]]:
    """Return the cost of the formulas at signals, but for soft ones, and the values of path constraints."""
    cost = sum((by_text(drawn.stage, names, x[t], u[t]) for t in range(pairs.T)), 0.0) if drawn.stage else 0.0
    cost = cost + (by_text(drawn.terminal, names, x[pairs.T], u[0]) if drawn.terminal else 0.0)
    times = path_times(drawn) if drawn.path else ()
    return cost, [by_text(drawn.path, names, x[t], u[min(t, pairs.T - 1)]) for t in times]


def violation(drawn: Drawn, problem: lfo.OptimalControlProblem, x: Array, u: Array) -> tuple[float, float]:
    """Return the largest violation of any constraint by NumPy, and the cost; not a number where CVXPY has none."""
    cost, values = own_parts(drawn, NUMBERS, x, u)
    after = np.array([[by_text(text, NUMBERS, x[t], u[t]) for text in drawn.maps] for t in range(pairs.T)])
    worst = float(np.abs(after - x[1:, :2]).max())
    if x.shape[1] > 2:  # the control before, of a limit on its changes
        worst = max(worst, float(np.abs(x[1:, 2] - u[:, 0]).max()))
    prices = [PRICE * max(float(value), 0.0) for value in values]
    if not drawn.soft and values:
        worst = max(worst, float(np.max(values)))
    if "levels" in drawn.companions:
        worst = max(worst, float(np.abs(u[:, :1] - [-1, 0, 1]).min(axis=1).max()))
    model = twin(drawn)
    if model is None:
        return worst, np.nan
    theirs, rows, of_x, of_u = model
    of_x.value, of_u.value = x, u
    slacks = {v.id for v in cp.Problem(cp.Minimize(theirs), rows).variables()} - {of_x.id, of_u.id}
    rows = [row for row in rows if row.label != "dynamics"]
    if slacks:
        fixed = [of_x == x, of_u == u]
        inner = [row for row in rows if slacks & {v.id for v in row.variables()}]
        cp.Problem(cp.Minimize(theirs), [*inner, *fixed]).solve(solver=cp.CLARABEL)
        of_x.value, of_u.value = x, u
    with np.errstate(divide="ignore", invalid="ignore"):  # cones at zero
        worst = max([worst, *(float(np.max(row.violation(), initial=0.0)) for row in rows)])
    total = float(np.asarray(theirs.value)) + float(cost) + (sum(prices) if drawn.soft else 0.0)
    if LEVELS & set(drawn.companions):
        total += 0.1 * float(np.abs(u[:, 0]).sum())
    return worst, total


def convex_cost(drawn: Drawn) -> float:
    """Return the optimal cost by CVXPY."""
    model = twin(drawn)
    assert model is not None
    theirs, rows, x, u = model
    cost, values = own_parts(drawn, CONES, x, u)
    if drawn.soft and values:
        cost = cost + PRICE * sum(cp.pos(value) for value in values)
    elif values:
        rows = [*rows, *(value <= 0 for value in values)]
    return float(cp.Problem(cp.Minimize(theirs + cost), rows).solve(solver=cp.CLARABEL))


def faults(drawn: Drawn, statuses: list[str]) -> list[str]:
    """Return what is wrong with the answer."""
    problem = pairs.problem_with([*map(pairs.fields_of, drawn.companions), *parts_of(drawn)], str(drawn))
    options = {"time_limit": TIME_LIMIT} if drawn.method == "auto" else {}
    method = drawn.method if pairs.quick_method(problem) == "nonsmooth" else "auto"
    result = lfo.solve(problem, method, throw=False, **options)
    statuses.append(str(result.status))
    wrong = [] if result.status in STATUSES else [f"status {result.status}"]
    theirs = convex_cost(drawn) if drawn.convex and twin(drawn) is not None else np.nan
    found = result.trajectory
    if result.status in pairs.ANSWERS:
        missed, cost = violation(drawn, problem, found.x, found.u)
        size = max(1.0, abs(result.cost))
        wrong += [f"violated by {missed:.2e}"] if missed > WITHIN else []
        wrong += [f"cost {result.cost:.9g}, {cost:.9g} by NumPy"] if abs(cost - result.cost) > WITHIN * size else []
        again = lfo.certify(problem, found, result.multipliers)
        wrong += [f"{again.pmp} by certify, {result.certificate.pmp}"] if again.pmp != result.certificate.pmp else []
        wrong += [f"bound {result.lower_bound} above"] if (result.gap or 0.0) < -WITHIN else []
        proven = result.gap is not None and abs(result.gap) <= SEARCHED_GAP and result.bound == "rigorous"
        wrong += ["optimal without a bound"] if result.status == "optimal" and not proven else []
        if np.isinf(theirs) or abs(theirs - result.cost) > pairs.AGREEMENT * size:
            every = any(term.semi_infinite is not None for term in problem.terms)
            wrong += [] if every and result.cost > theirs else [f"cost {result.cost:.9g}, {theirs:.9g} by CVXPY"]
    elif result.status == "infeasible" and np.isfinite(theirs):
        wrong.append(f"infeasible, and {theirs:.9g} by CVXPY")
    elif np.isfinite(theirs):
        wrong.append(f"{result.status}, and {theirs:.9g} by CVXPY: {result.message}")
    if np.isnan(theirs):
        wrong += contradictions(problem, drawn, result)
    return wrong


def contradictions(problem: lfo.OptimalControlProblem, drawn: Drawn, result: lfo.results.Result) -> list[str]:
    """Return what another solve, from other starts, says against an answer to a problem that is not convex."""
    other = [solve_from(problem, start) for start in ((0.3,) if result.status in pairs.ANSWERS else (0.0, 0.3, -0.4))]
    costs = []
    for one in other:
        if one is not None and one.trajectory is not None and one.certificate is not None and one.certificate.feasible:
            missed, cost = violation(drawn, problem, one.trajectory.x, one.trajectory.u)
            costs += [cost if np.isfinite(cost) else one.cost] if missed <= WITHIN else []
    if not costs:
        return []
    best = min(costs)
    if result.status in ("infeasible", "infeasible_claimed", "numerical_error"):
        return [f"{result.status}, and {best:.9g} by another start: {result.message}"]
    bound = result.lower_bound if result.bound == "rigorous" else None
    if bound is not None and bound > best + pairs.AGREEMENT * max(1.0, abs(best)):
        return [f"bound {bound:.9g} above the cost {best:.9g} of another start"]
    return []


def solve_from(problem: lfo.OptimalControlProblem, start: float) -> lfo.results.Result | None:
    """Return the answer from one control at all times; None where the method takes no start."""
    try:
        return lfo.solve(problem, "nonsmooth", throw=False, start=np.full((pairs.T, problem.control_dim), start))
    except lfo.errors.LinFreqOCPError:
        return None


def check(seed: int) -> Outcome:
    """Return what became of a random problem."""
    drawn, statuses = draw(seed), list[str]()
    outcome = pairs.outcome_of((str(drawn),), lambda: "; ".join(faults(drawn, statuses)))
    wrong = (f"{drawn}: {outcome.words}",) if outcome.verdict == "wrong" else ()
    return Outcome(seed, drawn.kind, tuple(statuses) or (outcome.verdict,), wrong)
