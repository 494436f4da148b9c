"""Random robust plans under all sequences of extreme loads: none violates a limit, and worst_case says what they do."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import product

import numpy as np

import lin_freq_ocp as lfo
from helpers.tubes import simulate

SEQUENCES = 5000
"""At most; of more, as many are drawn."""

ROUNDING = 1e-8  # of the terms of a limit


@dataclass(frozen=True)
class Outcome:
    """What was found of a plan."""

    seed: int
    status: str
    faults: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.faults


def random_case(seed: int) -> tuple[lfo.OptimalControlProblem, lfo.Disturbance, np.ndarray, np.ndarray]:
    """Return a problem in random units, loads, their extreme points, and the input of all states."""
    rng = np.random.default_rng(seed)
    n, m, k, T = (int(rng.integers(1, most)) for most in (4, 3, 3, 6))
    x, u, w = (10.0 ** rng.uniform(-6, 6, size) for size in (n, m, k))
    A = rng.standard_normal((n, n))
    A = A * (rng.uniform(0.4, 1.2) / np.abs(np.linalg.eigvals(A)).max()) * x[:, None] / x
    B, E = rng.standard_normal((n, m)) * x[:, None] / u, rng.standard_normal((n, k)) * x[:, None] / w
    box = lfo.Box(-rng.uniform(2, 5, n) * x, rng.uniform(2, 5, n) * x)
    half_spaces = lfo.sets.Polyhedron(rng.standard_normal((2, n)) / x, [3.0, 4.0])
    sets = [None, box, lfo.Box(-6 * x, 6 * x) & half_spaces, lfo.sets.Soft(box, 0.7 / x.max())]
    C, D = rng.standard_normal((2, n)) / x, rng.standard_normal((2, m)) / u
    rows = [lfo.StageRows(C, D, [4.0, 5.0], name="joint"), lfo.StageRows(C[:1], D[:1], [0.5], "soft", penalty=0.4)]
    mask = lfo.MagnitudeBound(float(3 * u[0]), bins=[1], component=0) if T > 2 and seed % 2 else None
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B, 0.05 * rng.standard_normal(n) * x),
        T,
        lfo.QuadraticCost(Q=np.diag(1 / x**2), R=np.diag(1 / u**2)),
        lfo.Box(-2 * u, 3 * u),
        sets[seed % 4],
        rng.uniform(-1.5, 1.5, n) * x,
        lfo.Box(-2 * x, 2 * x) if seed % 3 == 0 else None,
        control_spectrum=mask,
        stage_rows=rows[: seed % 3],
    )
    if seed % 5 == 0:
        problem = lfo.rate_limited(problem, 2 * u, previous=np.zeros(m))
    lower, upper = -rng.uniform(0, 0.15, k) * w, rng.uniform(0, 0.15, k) * w
    points = np.array(list(product(*zip(lower, upper, strict=True))))
    kinds = lfo.Box(lower, upper), points
    load = lfo.Disturbance(kinds[seed // 4 % 2], E, "auto" if seed % 3 else None)
    return problem, load, points, np.pad(E, ((0, problem.state_dim - n), (0, 0)))


def check(seed: int, share: float = 1.0) -> Outcome:
    """Compare the worst case of a plan, for bounds, ends, rows and masks, with all sequences of extreme points.

    What acts is a share of these; above 1, limits should be exceeded.
    """
    problem, load, points, E = random_case(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.ClosedLoopWarning)
        try:
            found = lfo.solve(lfo.robust(problem, load), throw=False)
        except lfo.errors.ProblemError:
            return Outcome(seed, "margins above a range")
    if found.status != "optimal":
        return Outcome(seed, str(found.status))
    worst, T, rng = lfo.worst_case(problem, load, found), problem.horizon, np.random.default_rng(seed)
    every = len(points) ** T <= SEQUENCES
    chosen = (
        np.array(list(product(range(len(points)), repeat=T)))
        if every
        else rng.integers(len(points), size=(SEQUENCES, T))
    )
    x, u = simulate(problem, load.feedback(problem), found.trajectory, E, share * points[chosen])
    values = dict[str, np.ndarray]()  # by how much each limit is exceeded, for each sequence
    sides = (("upper", 1.0), ("lower", -1.0))
    signals = (
        (problem.state_names, x[:, 1:], problem.state_boxes, slice(1, None)),
        (problem.control_names, u, problem.control_tube, slice(None)),
    )
    for names, signal, box, times in signals:
        for (i, name), (side, sign) in product(enumerate(names), sides):
            over = sign * (signal[..., i] - getattr(box, side)[times, i])
            values[f"{name}, {side}"] = over.max(axis=1)
    for (i, name), (side, sign) in product(enumerate(problem.state_names), sides):
        values[f"end of {name}, {side}"] = sign * (x[:, T, i] - getattr(problem.terminal_box, side)[i])
    for rows in problem.stage_rows:
        over = x[:, :T] @ rows.C.T + u @ rows.D.T - rows.e
        for i in range(rows.rows):
            name = rows.name if rows.rows == 1 else f"row {i} of {rows.name}"
            values[name] = over[..., i].max(axis=1)
    if problem.control_spectrum is not None:
        values["mask on u_0"] = np.abs(np.fft.rfft(u[..., 0], axis=1))[:, 1] - problem.control_spectrum.limit
    faults = [] if worst else [worst.verdict]
    for one in (*worst.limits, *worst.soft):
        most = values[one.name].max() if one.name in values else None
        exact = isinstance(load.set, lfo.Box) or not one.in_spectrum  # other leakage has a bound
        apart = abs(one.sign * (one.attained - one.limit) - one.violation)
        if exact and not apart <= ROUNDING * one.size:
            faults.append(f"{one.name}: not attained")
        if most is not None and not most <= one.violation + 1e-9 * one.size:
            faults.append(f"{one.name}: exceeded")
        if exact and every and most is not None and most < one.violation - ROUNDING * one.size:
            faults.append(f"{one.name}: no load does this")
    return Outcome(seed, "optimal", tuple(faults))
