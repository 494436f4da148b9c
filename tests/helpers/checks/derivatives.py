"""Derivatives of random optima against differences of problems solved again, their kinks, and other units.

Differences are those of exact optima: gaps of answers are of second order, and those of controls are not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.derivatives import SolutionDerivatives

TIGHT = 1e-11
LINEAR = ("offset", "q", "r", "p", "x_ref", "u_ref", "initial_state", "state_upper", "state_lower")
LINEAR = (*LINEAR, "control_upper", "control_lower", "sum")
MATRICES = ("A", "B", "Q", "R", "S", "P", "sum.C", "sum.D")
STEPS = (1e-1, 1e-2, 1e-3, 1e-4)


def random_problem(seed: int, T: int = 24, n: int = 3, m: int = 2) -> lfo.OptimalControlProblem:
    """Return bounds on all signals, joint rows, stop bands, offset, ends, S and references; a third is time-varying."""
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, m))
    A *= rng.uniform(0.6, 1.02) / np.abs(np.linalg.eigvals(A)).max()
    if seed % 3 == 0:
        A = A + 0.05 * rng.standard_normal((T, n, n))
        B = B + 0.05 * rng.standard_normal((T, n, m))
    root = rng.standard_normal((n, n)) / n
    calm = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B, offset=0.05 * rng.standard_normal((T, n))),
        T,
        lfo.QuadraticCost(R=1.0),
        initial_state=rng.standard_normal(n),
        control_spectrum=[lfo.stop_band(bins=[4, 5], component=0), lfo.stop_band(bins=[8], component=1)],
    )
    times = 2 * np.pi * np.arange(T) / T
    reached = lfo.simulate(calm, 0.5 * np.stack([np.cos(2 * times), np.sin(3 * times)], axis=1))
    weights = {"Q": 0.1 * np.eye(n) + root @ root.T, "R": np.diag([1.0, 2.0]), "P": 0.3 * np.eye(n)}
    weights |= {"S": 0.05 * rng.standard_normal((n, m)), "x_ref": 0.3 * rng.standard_normal((T + 1, n))}
    weights |= {"u_ref": 2.0 * rng.standard_normal((T, m)), "q": 0.1 * rng.standard_normal(n)}
    weights |= {"r": 0.1 * rng.standard_normal(m), "p": 0.1 * rng.standard_normal(n)}
    low, high = np.tile(reached.x.min(0) - 0.05, (T + 1, 1)), np.tile(reached.x.max(0) + 0.05, (T + 1, 1))
    return replace(
        calm,
        cost=lfo.QuadraticCost(**weights),
        terminal_state=reached.x[-1] if seed % 2 else None,
        control_set=lfo.Box(np.tile([-0.7, -0.9], (T, 1)), np.tile([0.9, 0.8], (T, 1))),
        state_set=lfo.Box(low, high),
        stage_rows=lfo.StageRows([[0.2, 0.0, 0.0]], [[1.0, 1.0]], np.full((T, 1), 0.8), name="sum"),
        state_spectrum=lfo.stop_band(bins=[9], component=0) if seed % 4 == 1 else None,
    )


def moved(problem: lfo.OptimalControlProblem, change: dict[str, np.ndarray], step: float) -> lfo.OptimalControlProblem:
    """Return the problem with ``step`` times a change added to its data."""
    fields: dict[str, object] = {}
    groups: dict[str, dict[str, np.ndarray]] = {"cost": {}, "dynamics": {}}
    sides = {"state": problem.state_boxes, "control": problem.control_tube}
    bounds = {signal: {"lower": box.lower, "upper": box.upper} for signal, box in sides.items()}
    rows = {one.name: {"C": one.C, "D": one.D, "e": one.e, "penalty": one.penalty} for one in problem.stage_rows}
    for name, d in change.items():
        family, _, part = name.partition(".")
        if name in ("initial_state", "terminal_state"):
            fields[name] = getattr(problem, name).lower + step * d
        elif family in rows:
            rows[family][part or "e"] = rows[family][part or "e"] + step * d
            fields["stage_rows"] = [lfo.StageRows(**one, name=label) for label, one in rows.items()]
        elif name.split("_")[0] in bounds and name.endswith(("upper", "lower")):
            signal, side = name.split("_")
            bounds[signal][side] = bounds[signal][side] + step * d
            fields[f"{signal}_set"] = lfo.Box(**bounds[signal])
        elif name in ("A", "B", "offset", "response"):
            place = "G" if name == "response" else name
            groups["dynamics"][place] = getattr(problem.dynamics, place) + step * d
        else:
            groups["cost"][name] = getattr(problem.quadratic, name) + step * d
    if groups["cost"]:
        quadratic = replace(problem.quadratic, **groups["cost"])
        fields["cost"] = sum(problem.cost.norms, quadratic)
    if groups["dynamics"]:
        fields["dynamics"] = replace(problem.dynamics, **groups["dynamics"])
    return replace(problem, **fields)


def random_change(
    found: SolutionDerivatives, names: tuple[str, ...], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Return a change of data, 0.01 of order 1, bounds less, with the shapes of the slopes."""
    shapes, change = found.vjp(), {}
    for name in names:
        d = 0.01 * rng.standard_normal(shapes[name].shape)
        if np.iscomplexobj(shapes[name]):
            d = d + 0.01j * rng.standard_normal(d.shape)
        if name in ("Q", "R", "P"):
            d = 0.1 * (d + np.swapaxes(d, -1, -2))
        change[name] = 0.1 * d if name.endswith(("upper", "lower")) else d
    return change


def inner(slopes: dict[str, np.ndarray], change: dict[str, np.ndarray]) -> float:
    """Return the derivative along a change."""
    return sum(float(np.nansum((np.conj(slopes[name]) * d).real)) for name, d in change.items())


def exact(problem: lfo.OptimalControlProblem, method: str = "auto") -> SolutionDerivatives:
    """Return the exact optimum of a problem; SolveError if there is none."""
    return lfo.solve(problem, method, tolerance=TIGHT if method == "auto" else None).derivatives


def active(found: SolutionDerivatives) -> tuple[np.ndarray, ...]:
    """Return the signs of the multipliers, but for those of equations."""
    m = found.multipliers
    terms = [m.stage[term.name] for term in found.problem.terms if not term.kind.is_link]
    mu = np.where(found.problem.state_tube.fixed, 0.0, m.mu)
    return tuple(np.sign(part) for part in (mu, m.nu, *terms))


def weights_of(problem: lfo.OptimalControlProblem, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return random weights of states and controls."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    return {"x": rng.standard_normal((T + 1, n)), "u": rng.standard_normal((T, m))}


def values(found: SolutionDerivatives, weights: dict[str, np.ndarray]) -> np.ndarray:
    """Return the weighted sum of an optimum and its cost."""
    x, u = found.trajectory.x, found.trajectory.u
    return np.array([(weights["x"] * x).sum() + (weights["u"] * u).sum(), found.problem.value(x, u)])


def differences(
    problem: lfo.OptimalControlProblem, change: dict[str, np.ndarray], weights: dict[str, np.ndarray]
) -> np.ndarray | None:
    """Return the derivatives of ``values`` by Richardson's central differences; None if active rows change nearby."""
    best: tuple[float, np.ndarray] | None = None
    for step in STEPS:
        try:
            found = [exact(moved(problem, change, s)) for s in (step, -step, step / 2, -step / 2)]
        except lfo.errors.LinFreqOCPError:
            continue
        signs = [active(one) for one in found]
        if not all(np.array_equal(a, b) for one in signs[1:] for a, b in zip(one, signs[0], strict=True)):
            continue
        f = [values(one, weights) for one in found]
        wide, near = (f[0] - f[1]) / (2 * step), (f[2] - f[3]) / step
        fourth = (4 * near - wide) / 3
        error = float(np.abs(near - wide).max())
        if best is None or error < best[0]:
            best = error, fourth
        if error < 1e-4 * float(np.abs(fourth).max()):
            break
    return None if best is None else best[1]


@dataclass(frozen=True)
class Check:
    """What a random problem showed: relative errors, nan where there was nothing to compare."""

    seed: int
    outcome: str  # "compared", "unsolved", "no common step", "no derivative"
    reason: str = ""
    vjp: float = np.nan
    cost: float = np.nan
    transposed: float = np.nan
    affine: float = np.nan
    beyond: bool = True  # other rows are active beyond the step that holds


def check(seed: int) -> Check:
    """Compare the derivatives of a random problem with differences, along a change of all its data."""
    problem, rng = random_problem(seed), np.random.default_rng(seed)
    try:
        found = exact(problem)
    except lfo.errors.SolveError:
        return Check(seed, "unsolved")
    weights = weights_of(problem, rng)
    gradient = found.vjp(**weights)
    if not gradient.exists:
        return Check(seed, "no derivative", gradient.reason)
    names = (*LINEAR, *MATRICES, *(("terminal_state",) if seed % 2 else ()))
    change = random_change(found, names, rng)
    step = found.jvp(**change)
    along, ours = float((weights["x"] * step.x).sum() + (weights["u"] * step.u).sum()), inner(gradient, change)
    transposed = abs(along - ours) / max(abs(ours), 1e-5)
    by_steps = differences(problem, change, weights)
    if by_steps is None:
        return Check(seed, "no common step", transposed=transposed)
    scale = np.maximum(np.abs(by_steps), 1e-4)
    errors = np.abs(by_steps - [ours, step.cost]) / scale
    return Check(seed, "compared", "", *map(float, errors), transposed, *_affine(found, change))


def _affine(found: SolutionDerivatives, change: dict[str, np.ndarray]) -> tuple[float, bool]:
    """Return how far the optimum is from affine up to 0.99 of ``holds``, and whether other rows are active beyond."""
    linear = {name: d for name, d in change.items() if name in (*LINEAR, "terminal_state")}
    step = found.jvp(**linear)
    reach = step.holds[1]
    try:
        inside = exact(moved(found.problem, linear, min(0.99 * reach, 1.0)))
        difference = inside.trajectory.u - found.trajectory.u - min(0.99 * reach, 1.0) * step.u
        error = float(np.abs(difference).max() / np.abs(found.trajectory.u).max())
        if not np.isfinite(reach):
            return error, True
        outside = exact(moved(found.problem, linear, 1.01 * reach))
    except lfo.errors.SolveError:
        return np.nan, True
    return error, any(not np.array_equal(a, b) for a, b in zip(active(outside), active(found), strict=True))


@dataclass(frozen=True)
class Kink:
    """What a bound at the value of a free control showed."""

    seed: int
    outcome: str  # "two sides", "dependent", "missed", "unsolved"
    named: bool = False
    error: float = np.nan  # of one-sided differences, the larger of both sides


def kink(seed: int) -> Kink:
    """Put a bound at the value of a free control: it is active with multiplier zero, and there are two sides."""
    problem, rng = random_problem(seed), np.random.default_rng(1000 + seed)
    try:
        point = exact(problem).trajectory
    except lfo.errors.SolveError:
        return Kink(seed, "unsolved")
    tube = problem.control_tube
    free = np.argwhere(np.minimum(tube.upper - point.u, point.u - tube.lower) > 0.1)
    t, j = free[rng.integers(len(free))]
    upper = tube.upper.copy()
    upper[t, j] = point.u[t, j]
    kinked = replace(problem, control_set=lfo.Box(tube.lower, upper))
    result = lfo.solve(kinked, tolerance=TIGHT, throw=False)
    found = SolutionDerivatives(kinked, point, result.multipliers)
    change = random_change(found, ("q", "r", "x_ref", "u_ref", "offset"), rng)
    step = found.jvp(**change)
    if step.exists:
        return Kink(seed, "missed")
    named = any(row == f"control set, t = {t}, component {j}, upper" for row in step.rows)
    if step.left is None or step.right is None or "depend" in step.reason:
        return Kink(seed, "dependent", named)
    worst = 0.0
    for side, sign in ((step.left, -1.0), (step.right, 1.0)):
        errors = [np.inf]
        for h in (1e-1, 1e-2, 1e-3, 1e-4):
            there = exact(moved(kinked, change, sign * h)).trajectory.u
            errors.append(float(np.abs((there - point.u) / (sign * h) - side.u).max() / np.abs(side.u).max()))
            if errors[-1] < 1e-9:
                break
        worst = max(worst, min(errors))
    return Kink(seed, "two sides", named, worst)


@dataclass(frozen=True)
class Units:
    """What other units of states, controls and cost changed."""

    seed: int
    outcome: str  # "compared", "unsolved"
    same: bool = True  # existence and rows
    apart: float = np.nan


def units(seed: int) -> Units:
    """Compare the derivatives of a random problem with those in other units, by factors of 1e-6 to 1e6."""
    problem, rng = random_problem(seed, T=16), np.random.default_rng(seed)
    of_x, of_u, of_cost = 10.0 ** rng.uniform(-6, 6, 3), 10.0 ** rng.uniform(-6, 6, 2), 10.0 ** rng.uniform(-6, 6)
    cost, dynamics, rows = problem.quadratic, problem.dynamics, problem.stage_rows[0]
    per = {"Q": np.outer(of_x, of_x), "R": np.outer(of_u, of_u), "S": np.outer(of_x, of_u), "P": np.outer(of_x, of_x)}
    per |= {"q": of_x, "r": of_u, "p": of_x}
    weights = {name: of_cost * getattr(cost, name) / unit for name, unit in per.items()}
    A, B = of_x[:, None] * dynamics.A / of_x, of_x[:, None] * dynamics.B / of_u
    boxes, tube = problem.state_boxes, problem.control_tube
    scaled = replace(
        problem,
        dynamics=lfo.LinearDynamics(A, B, offset=dynamics.offset * of_x),
        cost=lfo.QuadraticCost(**weights, x_ref=cost.x_ref * of_x, u_ref=cost.u_ref * of_u),
        initial_state=problem.initial_state.lower * of_x,
        terminal_state=problem.terminal_state.lower * of_x if seed % 2 else None,
        control_set=lfo.Box(tube.lower * of_u, tube.upper * of_u),
        state_set=lfo.Box(boxes.lower * of_x, boxes.upper * of_x),
        stage_rows=lfo.StageRows(rows.C / of_x, rows.D / of_u, rows.e, name=rows.name),
    )
    try:
        one, other = exact(problem), exact(scaled)
    except lfo.errors.SolveError:
        return Units(seed, "unsolved")
    weights = weights_of(problem, rng)
    first = one.vjp(**weights)
    second = other.vjp(x=weights["x"] / of_x, u=weights["u"] / of_u)
    signs = zip(active(one), active(other), strict=True)
    same = first.exists == second.exists and all(np.array_equal(a, b) for a, b in signs)
    factors = {"initial_state": of_x, "x_ref": of_x, "u_ref": of_u, "offset": of_x, "control_upper": of_u}
    differences_of = {name: np.abs(second[name] * f - first[name]).max() for name, f in factors.items()}
    apart = max(float(one / np.abs(first[name]).max()) for name, one in differences_of.items() if first[name].any())
    return Units(seed, "compared", same, apart)
