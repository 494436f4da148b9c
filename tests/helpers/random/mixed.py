"""Random feasible problems of mixed features, with a CVXPY model of each as a user would write it.

``random_model(seed)`` has both; ``problem_of(model)`` returns ours, and ``model.optimal_cost()`` what CVXPY finds.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import cvxpy as cp
import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.base import ComplexArray
from lin_freq_ocp.problem import Cost

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
    cost: float | cp.Expression = 0.0
    costs: list[Cost] = field(default_factory=list[Cost])
    constraints: list[cp.Constraint] = field(default_factory=list[cp.Constraint])
    features: list[str] = field(default_factory=list)

    @property
    def horizon(self) -> int:
        """Return T."""
        return len(self.u_near)

    def room(self) -> float:
        """Return a factor by which a limit is wider than what the trajectory that is known to exist needs."""
        return float(self.rng.uniform(1.0, 1.3))

    def optimal_cost(self) -> float:
        """Return what CVXPY and Clarabel find for the model."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of CVXPY, on the accuracy of its own solver
            problem = cp.Problem(cp.Minimize(self.cost), self.constraints)
            return float(str(problem.solve(solver=cp.CLARABEL)))

    def add(self, key: str, value: object) -> None:
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


def problem_of(model: Model, **changed: object) -> lfo.OptimalControlProblem:
    """Return our problem; ``changed`` replace its fields."""
    cost = model.costs[0]
    for other in model.costs[1:]:
        cost = cost + other
    return replace(lfo.OptimalControlProblem(cost=cost, name="mixed", **model.ours), **changed)


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
    model.ours["control_set"] = lfo.sets.Polyhedron(F, g)
    model.constraints += [F @ model.u[t] <= g for t in range(model.horizon)]


def _control_ball(model: Model) -> None:
    if "control_set" in model.ours:
        return
    radius = model.room() * float(np.linalg.norm(model.u_near, axis=1).max())
    model.ours["control_set"] = lfo.sets.Ball(radius)
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
    model.ours["control_set"] = [lfo.sets.Ball(float(radius)) for radius in radii]
    model.constraints += [cp.norm(model.u[t]) <= radii[t] for t in range(model.horizon)]


def _state_ellipsoid(model: Model) -> None:
    if "state_set" in model.ours:
        return
    n = model.x_near.shape[1]
    W, centre = model.rng.standard_normal((n, n)) + 2 * np.eye(n), model.rng.standard_normal(n)
    radius = model.room() * float(np.linalg.norm((model.x_near - centre) @ W.T, axis=1).max())
    model.ours["state_set"] = lfo.sets.Ellipsoid(W, radius, centre)
    model.constraints += [cp.norm(W @ (model.x[t] - centre)) <= radius for t in range(model.horizon + 1)]


def _state_box_and_cone(model: Model) -> None:
    if "state_set" in model.ours:
        return
    n = model.x_near.shape[1]
    F, h = model.rng.standard_normal((2, n)), 0.3 * model.rng.standard_normal(n)
    d = float((np.linalg.norm(model.x_near @ F.T, axis=1) - model.x_near @ h).max()) + 0.1
    top = model.x_near.max(0) + 0.1
    model.ours["state_set"] = lfo.Box(None, top) & lfo.sets.SecondOrderCone(F, np.zeros(2), h, d)
    for t in range(model.horizon + 1):
        model.constraints += [cp.norm(F @ model.x[t]) <= h @ model.x[t] + d]
        model.constraints += [model.x[t] <= top] if t else []


def _terminal_ball(model: Model) -> None:
    if "terminal_state" in model.ours:
        return
    end = model.x_near[-1]
    model.ours["terminal_state"] = lfo.sets.Ball(0.3, end)
    model.constraints.append(cp.norm(model.x[model.horizon] - end) <= 0.3)


def _soft_terminal_set(model: Model) -> None:
    if "terminal_state" in model.ours:
        return
    target = model.rng.standard_normal(model.x_near.shape[1])
    penalty = float(model.rng.uniform(0.1, 3.0))
    model.ours["terminal_state"] = lfo.sets.Soft(lfo.Box(target - 0.1, target + 0.1), penalty)
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
    model.costs.append(lfo.costs.L1Cost(u=weights))
    model.cost += sum(cp.sum(cp.multiply(weights, cp.abs(model.u[t]))) for t in range(model.horizon))


def _largest_deviation(model: Model) -> None:
    n = model.x_near.shape[1]
    weights, end = model.rng.uniform(0.05, 0.5, n), model.rng.uniform(0.1, 1.0, n)
    reference = model.rng.standard_normal((model.horizon + 1, n))
    model.costs.append(lfo.costs.LInfCost(x=weights, terminal=end, x_ref=reference))
    for t in range(model.horizon):
        model.cost += cp.norm(cp.multiply(weights, model.x[t] - reference[t]), "inf")
    model.cost += cp.norm(cp.multiply(end, model.x[model.horizon] - reference[-1]), "inf")


def _dft_rows(samples: int, bins: np.ndarray, points: int, window: np.ndarray) -> ComplexArray:
    return np.exp(-2j * np.pi * np.outer(bins, np.arange(samples)) / points) * window


def _mask(model: Model, penalty: float | None = None) -> None:
    rng, T, j = model.rng, model.horizon, int(model.rng.integers(model.u_near.shape[1]))
    q, name = int(rng.choice([1, 4])), (None, "hann")[rng.choice(2)]
    window = np.ones(T) if name is None else np.hanning(T)
    first = int(rng.integers(q * T // 2))
    bins = np.arange(first, q * T // 2 + 1)
    values = _dft_rows(T, bins, q * T, window)
    level = model.room() * np.abs(values @ model.u_near[:, j]) + 0.05
    if penalty is not None:
        level = 0.3 * level
    cutoff = 2 * np.pi * (first - 0.5) / (q * T)
    band = lfo.low_pass(cutoff) if first else lfo.spectrum.high_pass(np.pi)
    if not first:  # what a high pass at Nyquist removes is everything else
        keep = bins < q * T / 2
        bins, values, level = bins[keep], values[keep], level[keep]
    bound = lfo.MagnitudeBound(level, band=band, component=j, window=name, oversampling=q, penalty=penalty)
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
    model.add("state_spectrum", lfo.spectrum.EnergyBound(energy, bins=bins.tolist(), component=i))
    parts = [values.real @ model.x[:, i], values.imag @ model.x[:, i]]
    model.constraints.append(cp.norm(cp.hstack(parts)) <= np.sqrt(energy))


def _soft_energy(model: Model) -> None:
    bins, penalty = np.arange(0, model.horizon // 2 + 1), float(model.rng.uniform(0.1, 1.0))
    values = _dft_rows(model.horizon, bins, model.horizon, np.ones(model.horizon))
    model.add("control_spectrum", lfo.spectrum.EnergyBound(1.0, bins=bins.tolist(), component=0, penalty=penalty))
    parts = [values.real @ model.u[:, 0], values.imag @ model.u[:, 0]]
    model.cost += penalty * cp.pos(cp.norm(cp.hstack(parts)) - 1.0)


def _linear_constraint(model: Model) -> None:
    rows = model.rng.standard_normal((model.horizon, 2, model.u_near.shape[1]))
    constant = -np.einsum("tij,tj->i", rows, model.u_near)
    model.add("control_spectrum", lfo.spectrum.LinearConstraint(rows, constant))
    model.constraints.append(sum(rows[t] @ model.u[t] for t in range(model.horizon)) + constant == 0)


def _output_mask(model: Model) -> None:
    c, d = model.rng.standard_normal((1, model.x_near.shape[1])), model.rng.standard_normal((1, model.u_near.shape[1]))
    T = model.horizon
    bins = np.arange(T // 4, T // 2 + 1)
    values, near = _dft_rows(T, bins, T, np.ones(T)), model.x_near[:-1] @ c[0] + model.u_near @ d[0]
    limit = model.room() * float(np.abs(values @ near).max())
    model.ours["output_spectrum"] = lfo.spectrum.OutputSpectrum(c, d, lfo.MagnitudeBound(limit, bins=bins.tolist()))
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
    model.ours["output_spectrum"] = lfo.spectrum.OutputSpectrum(
        c, constraints=lfo.spectrum.EnergyBound(limit**2, bins=[k])
    )
    model.constraints.append(size <= limit)


FEATURES = (
    *(_control_polyhedron, _control_ball, _control_box, _sets_one_per_time, _state_ellipsoid, _state_box_and_cone),
    *(_terminal_ball, _soft_terminal_set, _soft_rows, _rows, _sparse_control, _largest_deviation),
    *(_mask, _soft_mask, _state_energy, _soft_energy, _linear_constraint, _output_mask, _output_band),
)
