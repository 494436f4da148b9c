"""Random feasible problems of mixed features, solved here and by CVXPY on a model written as a user would write it.

Every optimum must be proven, cost what CVXPY's does, and no longer be accepted by the judge when a constraint that
matters is made tighter or a multiplier changes its sign.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import cvxpy as cp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import lin_freq_ocp as lfo

AGREEMENT = 1e-6
"""Difference of the two costs, relative to max(1, |J|)."""

TIGHTER = 0.98
"""Factor on a limit that must make the judge refuse the optimum."""

NOTHING = 1e-6
"""Multipliers that are all smaller than this, relative to the cost, are none."""

LONGEST = 40


@dataclass
class Model:
    """A random problem as it grows: arguments of ours, and the CVXPY model beside it."""

    rng: np.random.Generator
    dynamics: lfo.LinearDynamics
    x_near: np.ndarray
    u_near: np.ndarray
    x: cp.Variable
    u: cp.Variable
    ours: dict[str, Any] = field(default_factory=dict)
    cost: Any = 0.0
    costs: list[Any] = field(default_factory=list)
    constraints: list[Any] = field(default_factory=list)
    features: list[str] = field(default_factory=list)
    tightened: list[tuple[str, Callable[[], dict[str, Any]]]] = field(default_factory=list)

    @property
    def horizon(self) -> int:
        """Return T."""
        return len(self.u_near)

    def room(self) -> float:
        """Return a factor by which a limit is wider than what the trajectory that is known to exist needs."""
        return float(self.rng.uniform(1.0, 1.3))

    def add(self, key: str, value: Any) -> None:
        """Add one entry to a list of ours."""
        self.ours.setdefault(key, []).append(value)


def random_model(seed: int) -> Model:
    """Return a problem with two to five random features around a random trajectory, which satisfies it."""
    rng = np.random.default_rng(seed)
    n, m, T = int(rng.integers(1, 5)), int(rng.integers(1, 3)), int(rng.integers(5, LONGEST))
    A = rng.standard_normal((n, n))
    A *= rng.choice([0.8, 1.0, 1.03]) / np.abs(np.linalg.eigvals(A)).max()
    B, offset = rng.standard_normal((n, m)), 0.1 * rng.standard_normal(n)
    if rng.random() < 0.3:
        A, B = A * rng.uniform(0.9, 1.0, (T, 1, 1)), B * rng.uniform(0.8, 1.2, (T, 1, 1))
    dynamics = lfo.LinearDynamics(A, B, offset, sampling_time=0.1)
    free = lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost())
    near = lfo.simulate(free, rng.standard_normal((T, m)), rng.standard_normal(n))
    model = Model(rng, dynamics, near.x, near.u, cp.Variable((T + 1, n)), cp.Variable((T, m)))
    for t in range(T):
        A_t, B_t, d_t = dynamics.at(t)
        model.constraints.append(model.x[t + 1] == A_t @ model.x[t] + B_t @ model.u[t] + d_t)
    model.constraints.append(model.x[0] == near.x[0])
    model.ours |= {"dynamics": dynamics, "horizon": T, "initial_state": near.x[0]}
    _quadratic_cost(model)
    chosen = rng.choice(len(FEATURES), size=int(rng.integers(2, 6)), replace=False)
    for i in chosen:
        FEATURES[i](model)
        model.features.append(FEATURES[i].__name__.strip("_").replace("_", " "))
    if "terminal_state" not in model.ours and rng.random() < 0.5:
        model.ours["terminal_state"] = near.x[-1]
        model.constraints.append(model.x[T] == near.x[-1])
    return model


def problem_of(model: Model, **changed: Any) -> lfo.OptimalControlProblem:
    """Return our problem."""
    cost = model.costs[0]
    for other in model.costs[1:]:
        cost = cost + other
    return lfo.OptimalControlProblem(**{**model.ours, "cost": cost, "name": "mixed", **changed})


def _quadratic_cost(model: Model) -> None:
    rng, T, (n, m) = model.rng, model.horizon, (model.x_near.shape[1], model.u_near.shape[1])
    Q, R, reference = rng.uniform(0, 1, n) * (rng.random() < 0.6), rng.uniform(0.1, 1, m), rng.standard_normal(n)
    model.costs.append(lfo.QuadraticCost(Q=np.diag(Q), R=np.diag(R), P=np.diag(Q), x_ref=reference))
    for t in range(T):
        model.cost += 0.5 * cp.sum(cp.multiply(R, model.u[t] ** 2))
        model.cost += 0.5 * cp.sum(cp.multiply(Q, (model.x[t] - reference) ** 2))
    model.cost += 0.5 * cp.sum(cp.multiply(Q, (model.x[T] - reference) ** 2))


def _control_polyhedron(model: Model) -> None:
    if "control_set" in model.ours:
        return
    F = model.rng.standard_normal((3, model.u_near.shape[1]))
    g = (model.u_near @ F.T).max(0) + 0.1
    model.ours["control_set"] = lfo.Polyhedron(F, g)
    model.constraints += [F @ model.u[t] <= g for t in range(model.horizon)]


def _control_ball(model: Model) -> None:
    if "control_set" in model.ours:
        return
    radius = model.room() * float(np.linalg.norm(model.u_near, axis=1).max())
    model.ours["control_set"] = lfo.Ball(radius)
    model.constraints += [cp.norm(model.u[t]) <= radius for t in range(model.horizon)]


def _control_box(model: Model) -> None:
    if "control_set" in model.ours:
        return
    bound = model.room() * np.abs(model.u_near).max(0)
    model.ours["control_set"] = lfo.Box(-bound, bound)
    model.constraints += [cp.abs(model.u) <= np.tile(bound, (model.horizon, 1))]


def _sets_one_per_time(model: Model) -> None:
    if "control_set" in model.ours:
        return
    radii = model.room() * np.linalg.norm(model.u_near, axis=1) + 0.1
    model.ours["control_set"] = [lfo.Ball(float(radius)) for radius in radii]
    model.constraints += [cp.norm(model.u[t]) <= radii[t] for t in range(model.horizon)]


def _state_ellipsoid(model: Model) -> None:
    if "state_set" in model.ours:
        return
    n = model.x_near.shape[1]
    W, centre = model.rng.standard_normal((n, n)) + 2 * np.eye(n), model.rng.standard_normal(n)
    radius = model.room() * float(np.linalg.norm((model.x_near - centre) @ W.T, axis=1).max())
    model.ours["state_set"] = lfo.Ellipsoid(W, radius, centre)
    model.constraints += [cp.norm(W @ (model.x[t] - centre)) <= radius for t in range(model.horizon + 1)]


def _state_box_and_cone(model: Model) -> None:
    if "state_set" in model.ours:
        return
    n = model.x_near.shape[1]
    F, h = model.rng.standard_normal((2, n)), 0.3 * model.rng.standard_normal(n)
    d = float((np.linalg.norm(model.x_near @ F.T, axis=1) - model.x_near @ h).max()) + 0.1
    top = model.x_near.max(0) + 0.1
    model.ours["state_set"] = lfo.Box(None, top) & lfo.SecondOrderCone(F, np.zeros(2), h, d)
    for t in range(model.horizon + 1):
        model.constraints += [cp.norm(F @ model.x[t]) <= h @ model.x[t] + d]
        model.constraints += [model.x[t] <= top] if t else []


def _terminal_ball(model: Model) -> None:
    if "terminal_state" in model.ours:
        return
    end = model.x_near[-1]
    model.ours["terminal_state"] = lfo.Ball(0.3, end)
    model.constraints.append(cp.norm(model.x[model.horizon] - end) <= 0.3)


def _soft_terminal_set(model: Model) -> None:
    if "terminal_state" in model.ours:
        return
    target = model.rng.standard_normal(model.x_near.shape[1])
    penalty = float(model.rng.uniform(0.1, 3.0))
    model.ours["terminal_state"] = lfo.Soft(lfo.Box(target - 0.1, target + 0.1), penalty)
    end = model.x[model.horizon]
    model.cost += penalty * (cp.sum(cp.pos(end - target - 0.1)) + cp.sum(cp.pos(target - 0.1 - end)))


def _soft_rows(model: Model) -> None:
    C, D = model.rng.standard_normal((2, model.x_near.shape[1])), model.rng.standard_normal((2, model.u_near.shape[1]))
    e, penalty = model.rng.uniform(0.1, 0.5, 2), float(model.rng.uniform(0.1, 3.0))
    model.add("stage_rows", lfo.StageRows(C, D, e, name="soft rows", penalty=penalty))
    for t in range(model.horizon):
        model.cost += penalty * cp.sum(cp.pos(C @ model.x[t] + D @ model.u[t] - e))


def _rows(model: Model) -> None:
    C, D = model.rng.standard_normal((2, model.x_near.shape[1])), model.rng.standard_normal((2, model.u_near.shape[1]))
    e = (model.x_near[:-1] @ C.T + model.u_near @ D.T).max(0) + 0.1
    model.add("stage_rows", lfo.StageRows(C, D, e, name="rows"))
    model.constraints += [C @ model.x[t] + D @ model.u[t] <= e for t in range(model.horizon)]


def _sparse_control(model: Model) -> None:
    weights = model.rng.uniform(0.05, 1.0, model.u_near.shape[1])
    model.costs.append(lfo.L1Cost(u=weights))
    model.cost += sum(cp.sum(cp.multiply(weights, cp.abs(model.u[t]))) for t in range(model.horizon))


def _largest_deviation(model: Model) -> None:
    n = model.x_near.shape[1]
    weights, end = model.rng.uniform(0.05, 0.5, n), model.rng.uniform(0.1, 1.0, n)
    reference = model.rng.standard_normal((model.horizon + 1, n))
    model.costs.append(lfo.LInfCost(x=weights, terminal=end, x_ref=reference))
    for t in range(model.horizon):
        model.cost += cp.norm(cp.multiply(weights, model.x[t] - reference[t]), "inf")
    model.cost += cp.norm(cp.multiply(end, model.x[model.horizon] - reference[-1]), "inf")


def _dft_rows(samples: int, bins: np.ndarray, points: int, window: np.ndarray) -> np.ndarray:
    return np.exp(-2j * np.pi * np.outer(bins, np.arange(samples)) / points) * window


def _mask(model: Model, penalty: float | None = None) -> None:
    rng, T, j = model.rng, model.horizon, int(model.rng.integers(model.u_near.shape[1]))
    q, name = int(rng.choice([1, 4])), rng.choice([None, "hann"])
    window = np.ones(T) if name is None else np.hanning(T)
    first = int(rng.integers(q * T // 2))
    bins = np.arange(first, q * T // 2 + 1)
    values = _dft_rows(T, bins, q * T, window)
    level = model.room() * np.abs(values @ model.u_near[:, j]) + 0.05
    if penalty is not None:
        level = 0.3 * level
    cutoff = 2 * np.pi * (first - 0.5) / (q * T)
    where = {"band": lfo.low_pass(cutoff)} if first else {"band": lfo.high_pass(np.pi)}
    if not first:  # what a high pass at Nyquist removes is everything else
        keep = bins < q * T / 2
        bins, values, level = bins[keep], values[keep], level[keep]
    bound = lfo.MagnitudeBound(level, **where, component=j, window=name, oversampling=q, penalty=penalty)
    model.add("control_spectrum", bound)
    for row, limit in zip(values, level, strict=True):
        size = cp.norm(cp.hstack([row.real @ model.u[:, j], row.imag @ model.u[:, j]]))
        if penalty is None:
            model.constraints.append(size <= limit)
        else:
            model.cost += penalty * cp.pos(size - limit)


def _soft_mask(model: Model) -> None:
    _mask(model, float(model.rng.uniform(0.05, 0.5)))


def _state_energy(model: Model) -> None:
    samples, i = model.horizon + 1, int(model.rng.integers(model.x_near.shape[1]))
    bins = np.arange(1, samples // 2 + 1)
    values = _dft_rows(samples, bins, samples, np.ones(samples))
    energy = model.room() * float((np.abs(values @ model.x_near[:, i]) ** 2).sum())
    model.add("state_spectrum", lfo.EnergyBound(energy, bins=bins.tolist(), component=i))
    parts = [values.real @ model.x[:, i], values.imag @ model.x[:, i]]
    model.constraints.append(cp.norm(cp.hstack(parts)) <= np.sqrt(energy))


def _soft_energy(model: Model) -> None:
    bins, penalty = np.arange(0, model.horizon // 2 + 1), float(model.rng.uniform(0.1, 1.0))
    values = _dft_rows(model.horizon, bins, model.horizon, np.ones(model.horizon))
    model.add("control_spectrum", lfo.EnergyBound(1.0, bins=bins.tolist(), component=0, penalty=penalty))
    parts = [values.real @ model.u[:, 0], values.imag @ model.u[:, 0]]
    model.cost += penalty * cp.pos(cp.norm(cp.hstack(parts)) - 1.0)


def _linear_constraint(model: Model) -> None:
    rows = model.rng.standard_normal((model.horizon, 2, model.u_near.shape[1]))
    constant = -np.einsum("tij,tj->i", rows, model.u_near)
    model.add("control_spectrum", lfo.LinearConstraint(rows, constant))
    model.constraints.append(sum(rows[t] @ model.u[t] for t in range(model.horizon)) + constant == 0)


def _output_mask(model: Model) -> None:
    c, d = model.rng.standard_normal((1, model.x_near.shape[1])), model.rng.standard_normal((1, model.u_near.shape[1]))
    T = model.horizon
    bins = np.arange(T // 4, T // 2 + 1)
    values, near = _dft_rows(T, bins, T, np.ones(T)), model.x_near[:-1] @ c[0] + model.u_near @ d[0]
    limit = model.room() * float(np.abs(values @ near).max())
    model.ours["output_spectrum"] = lfo.OutputSpectrum(c, d, lfo.MagnitudeBound(limit, bins=bins.tolist()))
    y = model.x[:-1] @ c[0] + model.u @ d[0]
    model.constraints += [cp.norm(cp.hstack([row.real @ y, row.imag @ y])) <= limit for row in values]


def _output_band(model: Model) -> None:
    if "output_spectrum" in model.ours:
        return
    c, samples = model.rng.standard_normal((1, model.x_near.shape[1])), model.horizon + 1
    k = int(model.rng.integers(1, samples // 2 + 1))
    row = _dft_rows(samples, np.array([k]), samples, np.ones(samples))[0]
    reach = complex(row @ (model.x_near @ c[0]))
    y = model.x @ c[0]
    size = cp.norm(cp.hstack([row.real @ y, row.imag @ y]))
    limit = abs(reach) * model.room()
    model.ours["output_spectrum"] = lfo.OutputSpectrum(c, constraints=lfo.EnergyBound(limit**2, bins=[k]))
    model.constraints.append(size <= limit)


FEATURES = (
    *(_control_polyhedron, _control_ball, _control_box, _sets_one_per_time, _state_ellipsoid, _state_box_and_cone),
    *(_terminal_ball, _soft_terminal_set, _soft_rows, _rows, _sparse_control, _largest_deviation),
    *(_mask, _soft_mask, _state_energy, _soft_energy, _linear_constraint, _output_mask, _output_band),
)


@dataclass(frozen=True)
class Outcome:
    """What became of one problem."""

    seed: int
    features: tuple[str, ...]
    status: str
    difference: float
    gap: float
    worst: float
    wrong: tuple[str, ...]
    tried: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def check(seed: int) -> Outcome:
    """Solve one problem twice, compare, and see that the judge refuses what it should."""
    model = random_model(seed)
    problem = problem_of(model)
    result = lfo.solve(problem, throw=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of CVXPY, on the accuracy of its own solver
        oracle = float(cp.Problem(cp.Minimize(model.cost), model.constraints).solve(solver=cp.CLARABEL))
    features = tuple(model.features)
    certificate = result.certificate
    if certificate is None or result.multipliers is None:
        return Outcome(seed, features, result.status, np.nan, np.nan, np.nan, ("no solution",), ())
    difference = abs(certificate.cost - oracle) / max(1.0, abs(oracle))
    gap = np.inf if certificate.gap is None else certificate.gap
    wrong = [
        what
        for what, bad in (
            ("not optimal", result.status != "optimal"),
            ("costs differ", not difference <= AGREEMENT),
            ("not satisfied", certificate.pmp != "satisfied"),
            ("gap", not gap <= AGREEMENT),
        )
        if bad
    ]
    tried = []
    for what, accepted in _spoiled(problem, result):
        tried.append(what)
        if accepted:
            wrong.append(f"accepted: {what}")
    worst = certificate.worst.relative
    return Outcome(seed, features, result.status, difference, gap, worst, tuple(wrong), tuple(tried))


def _spoiled(problem: lfo.OptimalControlProblem, result: lfo.Result) -> list[tuple[str, bool]]:
    """Return what was spoiled in the judge's input, and whether the judge accepted it all the same."""
    multipliers, trajectory = result.multipliers, result.trajectory
    tried: list[tuple[str, bool]] = []
    if np.abs(multipliers.eta).max() < NOTHING * max(1.0, abs(result.cost)):  # nothing pulls: nothing to spoil
        return tried
    parts = {"eta": multipliers.eta, "mu": multipliers.mu, "nu": multipliers.nu}
    for name, values in parts.items():
        if np.abs(values).max() > 1e-3 * np.abs(multipliers.eta).max() > 0:
            tried.append((f"-{name}", _accepted(problem, trajectory, _changed(multipliers, **{name: -values}))))
    for name, values in multipliers.stage.items():
        if np.abs(values).max() > 1e-2 * max(1.0, np.abs(multipliers.eta).max()):
            stage = {**multipliers.stage, name: -values}
            tried.append((f"-{name}", _accepted(problem, trajectory, _changed(multipliers, stage=stage))))
    for field_name in ("control_set", "state_set", "terminal_state"):
        tighter = _tighter(getattr(problem, field_name))
        of_set = [one for one in multipliers.stage if one.startswith(field_name.replace("_", " "))]
        if tighter is not None and any(np.abs(multipliers.stage[one]).max() > 1e-2 for one in of_set):
            try:
                changed = replace(problem, **{field_name: tighter})
            except lfo.ProblemError:  # the fixed initial state is outside: noticed earlier
                continue
            tried.append((f"tighter {field_name}", _accepted(changed, trajectory, multipliers)))
    return tried


def _accepted(problem: lfo.OptimalControlProblem, trajectory: lfo.Trajectory, multipliers: lfo.Multipliers) -> bool:
    return lfo.certify(problem, trajectory, multipliers).pmp == "satisfied"


def _changed(multipliers: lfo.Multipliers, **changed: Any) -> lfo.Multipliers:
    names = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x", "stage")
    return lfo.Multipliers(**{**{name: getattr(multipliers, name) for name in names}, **changed})


def _tighter(one: Any) -> Any:
    """Return a set with smaller limits, where that is plain."""
    if isinstance(one, lfo.Ball):
        return lfo.Ball(TIGHTER * one.radius, one.centre)
    if isinstance(one, lfo.Ellipsoid):
        return lfo.Ellipsoid(one.W, TIGHTER * one.radius, one.centre)
    if isinstance(one, lfo.Polyhedron):
        return lfo.Polyhedron(one.F, one.g - (1 - TIGHTER) * np.abs(one.g))
    return None


def verify(console: Console, seeds: range) -> bool:
    """Check the problems of these seeds, show what was found, and return whether all passed."""
    outcomes = [check(seed) for seed in track(seeds, "mixing", console=Console(stderr=True), transient=True)]
    table = Table(title=f"{len(seeds)} random problems of mixed features, against CVXPY")
    for column in ("feature", "problems"):
        table.add_column(column)
    for feature, count in Counter(one for outcome in outcomes for one in outcome.features).most_common():
        table.add_row(feature, str(count))
    console.print(table)
    solved = [outcome for outcome in outcomes if np.isfinite(outcome.difference)]
    console.print(
        f"largest difference of costs {max(o.difference for o in solved):.1e}, gap {max(o.gap for o in solved):.1e}, "
        f"condition {max(o.worst for o in solved):.1e}; "
        f"{sum(len(o.tried) for o in outcomes)} spoiled inputs of the judge"
    )
    failed = [outcome for outcome in outcomes if not outcome.passed]
    for outcome in failed:
        console.print(f"[red]seed {outcome.seed}[/]: {', '.join(outcome.wrong)}; {', '.join(outcome.features)}")
    return not failed
