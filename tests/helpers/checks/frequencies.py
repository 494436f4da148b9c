"""Checks of masks at every frequency: a random problem between two bounds, the proven maximum of a random signal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal.windows import chebwin

import lin_freq_ocp as lfo
from lin_freq_ocp.certificate import certified_peak
from lin_freq_ocp.problem import Limits, MagnitudeMask, limits_on

GRID = 64  # points of CVXPY's masks for each sample
DENSE = 1024  # points for each sample at which an upper bound is feasible
BRACKET = 1e-6  # of the cost, by which the bounds, from Clarabel, may be wrong
ATTEMPTS = 8  # to lower the limit
SEARCHED = 10  # peaks of a signal, the highest by parabolas
KINDS = (
    "low pass",
    "high pass",
    "notch",
    "points",
    "state",
    "period",
    "state of a period",
    "response over a period",
    "held",
    "held points",
    "soft",
)


@dataclass(frozen=True)
class Findings:
    """A problem: our verdict and cost, and the bounds of the independent model."""

    seed: int
    kind: str
    status: str
    cost: float
    lower: float
    upper: float
    excess: float  # of the proven maximum over the limit
    theirs: str

    @property
    def passed(self) -> bool:
        """Whether the cost lies between the bounds and the theorem holds, or both say infeasible, if without proof."""
        if self.status != "optimal":
            return self.status in ("infeasible", "infeasible_claimed") and self.theirs != "optimal"
        slack = BRACKET * max(abs(self.cost), 1e-9)
        return self.lower - slack <= self.cost <= self.upper + slack and self.excess < 5e-7


def problem_of(seed: int) -> lfo.OptimalControlProblem:
    """Return a random problem without its mask."""
    rng = np.random.default_rng(seed)
    n, m, T = int(rng.integers(1, 5)), int(rng.integers(1, 3)), int(rng.integers(8, 25))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.6, 1.02) / max(abs(np.linalg.eigvals(A)))
    cost = lfo.QuadraticCost(Q=np.eye(n), R=np.eye(m) * 10.0 ** rng.uniform(-2, 1), P=10 * np.eye(n))
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, rng.standard_normal((n, m))),
        T,
        cost,
        control_set=lfo.Box(-(u_max := rng.uniform(1, 5)), u_max) if seed % 2 else None,
        initial_state=3 * rng.standard_normal(n),
        terminal_state=np.zeros(n) if seed % 3 == 0 else None,
    )


def case_of(seed: int) -> tuple[str, lfo.OptimalControlProblem]:
    """Return the kind and the problem of a seed: its mask is a part of what the optimum without it has in the band."""
    rng, problem, kind = np.random.default_rng(seed + 10**6), problem_of(seed), KINDS[seed % len(KINDS)]
    if "period" in kind:
        reference = rng.standard_normal((problem.horizon + 1, problem.state_dim))
        cost = replace(problem.quadratic, x_ref=reference)
        problem = replace(problem, cost=cost, initial_state=None, terminal_state=lfo.Periodic())
    if kind.startswith("response"):
        problem = replace(problem, dynamics=response_of(problem), terminal_state=None)
    free = lfo.solve(problem, throw=False).trajectory
    if free is None:
        return kind, problem
    if kind.startswith("held"):
        return kind, with_held_mask(problem, kind, rng)
    of_state = kind.startswith("state")
    signal = free.x[: problem.state_samples, 0] if of_state else free.u[:, 0]
    w0, level = rng.uniform(0.3, 2.0), 10.0 ** rng.uniform(-1.5, 0)
    bands = {"high pass": lfo.spectrum.high_pass(w0), "notch": lfo.spectrum.notch(w0, rng.uniform(0.1, 0.5))}
    band = bands.get(kind, lfo.low_pass(w0))
    w = np.linspace(0, np.pi, 4001)
    inside = w <= w0 if kind == "high pass" else abs(w - w0) < 0.3 if kind == "notch" else w >= w0
    limit = level * float(np.abs(np.polyval(signal[::-1], np.exp(-1j * w[inside]))).max())
    given = (
        [[w0, limit], [(w0 + np.pi) / 2, limit * rng.uniform(0.2, 2)], [np.pi, limit]] if kind == "points" else limit
    )
    price = 10.0 ** rng.uniform(-3, 1) * lfo.solve(problem).cost if kind == "soft" else None
    mask = lfo.MagnitudeBound(given, band=band, component=0, every_frequency=True, penalty=price)
    return kind, replace(problem, **{"state_spectrum" if of_state else "control_spectrum": mask})


def response_of(problem: lfo.OptimalControlProblem) -> lfo.FrequencyResponse:
    """Return the linear dynamics of a problem as a table of responses of its states: (z_k I - A)^{-1} B."""
    n, z = problem.state_dim, np.exp(2j * np.pi * np.arange(problem.horizon // 2 + 1) / problem.horizon)
    B = np.broadcast_to(problem.linear.B, (len(z), *problem.linear.B.shape)).astype(complex)
    return lfo.FrequencyResponse(np.linalg.solve(z[:, None, None] * np.eye(n) - problem.linear.A, B), 1.0)


def with_held_mask(
    problem: lfo.OptimalControlProblem, kind: str, rng: np.random.Generator
) -> lfo.OptimalControlProblem:
    """Return the problem, whose samples are 1 s apart, with a limit on its first control as it is held."""
    dynamics = lfo.LinearDynamics(problem.linear.A, problem.linear.B, sampling_time=1.0)
    problem, first = replace(problem, dynamics=dynamics), rng.uniform(0.05, 1.5)
    signal = lfo.solve(problem).trajectory.u[:, 0]
    f = np.linspace(first, first + 1, 4001)
    values = np.sinc(f) * np.polyval(signal[::-1], np.exp(-2j * np.pi * f))
    limit = 10.0 ** rng.uniform(-1.5, 0) * float(np.abs(values).max())
    points = [[first, limit], [first + 0.4, limit * rng.uniform(0.2, 2)], [first + 1.3, limit * rng.uniform(0.2, 2)]]
    given, band = points if kind == "held points" else limit, lfo.low_pass(cutoff_hz=first)
    mask = lfo.MagnitudeBound(given, band=band, component=0, every_frequency=True, hold=True)
    return replace(problem, control_spectrum=mask)


def independent(
    problem: lfo.OptimalControlProblem, linear: lfo.LinearDynamics, kind: str, share: float
) -> tuple[str, float, np.ndarray]:
    """Return status, cost and masked signal of the model with ``share`` of the limit on a grid."""
    T, cost = problem.horizon, problem.quadratic
    x, u = cp.Variable((T + 1, problem.state_dim)), cp.Variable((T, problem.control_dim))
    a, period = x - np.broadcast_to(cost.x_ref, x.shape), "period" in kind
    J = sum(cp.quad_form(a[t], cost.Q) + cp.quad_form(u[t], cost.R) for t in range(T)) + cp.quad_form(a[T], cost.P)
    rows = [x[0] == (x[T] if period else problem.initial_box.lower), x[1:].T == linear.A @ x[:-1].T + linear.B @ u.T]
    if problem.terminal_box.fixed.all():
        rows.append(x[T] == problem.terminal_box.lower)
    if problem.control_set is not None:
        rows += [u <= problem.control_tube.upper[0], u >= problem.control_tube.lower[0]]
    signal = x[: T + (not period), 0] if kind.startswith("state") else u[:, 0]
    everywhere = mask_of(problem)
    w = frequencies(everywhere.limits, GRID * signal.shape[0])
    waves, factor = np.outer(w, np.arange(signal.shape[0])), factors(w, kind)[:, None]
    values = cp.vstack([(factor * np.cos(waves)) @ signal, (-factor * np.sin(waves)) @ signal])
    raised = cp.Variable(nonneg=True)
    rows.append(cp.norm(values, axis=0) <= share * everywhere.limits.at(w) * (1 + raised if kind == "soft" else 1))
    program = cp.Problem(cp.Minimize(J / 2 + (everywhere.price * raised if kind == "soft" else 0)), rows)
    program.solve(solver=cp.CLARABEL, canon_backend=cp.SCIPY_CANON_BACKEND)
    return program.status, float(program.value), np.zeros(0) if signal.value is None else np.asarray(signal.value)


def factors(w: np.ndarray, kind: str) -> np.ndarray:
    """Return what the spectrum is multiplied by."""
    return np.sinc(w / (2 * np.pi)) if kind.startswith("held") else np.ones(len(w))


def mask_of(problem: lfo.OptimalControlProblem) -> MagnitudeMask | None:
    """Return the mask at every frequency; None without one."""
    return next((one.semi_infinite for one in problem.terms if one.semi_infinite is not None), None)


def frequencies(limits: Limits, points: int) -> np.ndarray:
    """Return a grid of so many points for 2 pi within the intervals, with their ends."""
    w = 2 * np.pi * np.arange(int(points * limits.high.max() / (2 * np.pi)) + 1) / points
    return np.unique(np.concatenate([w[np.isfinite(limits.at(w))], limits.low, limits.high]))


def largest(signal: np.ndarray, everywhere: MagnitudeMask, kind: str, points: int) -> float:
    """Return the largest |V|/l on a grid of so many points for each sample."""
    w = frequencies(everywhere.limits, points * len(signal))
    spectrum = factors(w, kind) * np.polyval(signal[::-1], np.exp(-1j * w))
    return float((np.abs(spectrum) / everywhere.limits.at(w)).max())


def check(seed: int) -> Findings:
    """Solve the problem of a seed, and bound its optimum."""
    kind, problem = case_of(seed)
    everywhere = mask_of(problem)
    if everywhere is None:
        return Findings(seed, kind, "infeasible", np.nan, np.nan, np.nan, 0.0, "infeasible without a mask")
    result, linear = lfo.solve(problem, throw=False), problem_of(seed).linear
    theirs, lower, _ = independent(problem, linear, kind, 1.0)
    share, upper = 1.0, np.inf
    for _ in range(ATTEMPTS):
        status, value, signal = independent(problem, linear, kind, share)
        if "optimal" not in status:
            break
        ratio, there = (largest(signal, everywhere, kind, points) for points in (DENSE, GRID))
        if kind == "soft":  # what the spectrum between the points of the grid costs
            upper = value + everywhere.price * (max(ratio, 1.0) - max(there, 1.0))
            break
        if ratio <= 1:
            upper = value
            break
        share /= ratio * (1 + 1e-7)
    excess = max((one.peak.ratio - 1 for one in conditions(result) if one.peak), default=np.nan)
    excess = 0.0 if kind == "soft" and result.certificate and result.certificate.pmp == "satisfied" else excess
    cost = np.nan if result.cost is None else result.cost
    return Findings(seed, kind, str(result.status), cost, lower, upper, excess, theirs)


def conditions(result: lfo.results.Result) -> tuple[lfo.results.Condition, ...]:
    """Return the conditions of a result; none without a trajectory."""
    return () if result.certificate is None else result.certificate.conditions


def peak_errors(seed: int) -> tuple[float, float]:
    """Return by how much the proven maximum of a random signal is below a search, and above the value where it is."""
    rng = np.random.default_rng(seed)
    N, depth = int(10 ** rng.uniform(1, 5)), rng.uniform(0, 100)
    samples = rng.standard_normal(N)
    if seed % 2:
        samples = chebwin(N, max(depth, 45)) * np.cos(rng.uniform(0.1, 0.5) * np.arange(N))
    low = rng.uniform(0.8, 2.0)
    limit = np.abs(np.fft.rfft(samples, 8 * N)).max() * 10 ** (-depth / 20)
    limits = limits_on([(low, np.pi)], np.zeros(1), np.array([limit]))
    peak, exact = certified_peak(samples, limits), samples.astype(np.longdouble)
    attained = magnitude(exact, peak.frequency) / limit
    found = max(searched(exact, low) / limit, attained)
    return float(max(found / peak.ratio - 1, 0)), float(max(peak.ratio / attained - 1, 0))


def searched(samples: np.ndarray, low: float) -> float:
    """Return the largest |V(w)| of w >= low: a search around the best parabolas through points of an FFT."""
    points = 16 * len(samples)
    grid = 2 * np.pi * np.arange(points // 2 + 1) / points
    values = np.abs(np.fft.rfft(samples, points)) ** 2
    k = np.flatnonzero((grid >= low) & (grid < np.pi))[1:-1]
    k = k[(values[k] >= values[k - 1]) & (values[k] >= values[k + 1])]
    bend = np.maximum(2 * values[k] - values[k - 1] - values[k + 1], np.finfo(float).tiny)
    top = values[k] + (values[k + 1] - values[k - 1]) ** 2 / (8 * bend)
    found, options = [magnitude(samples, low), magnitude(samples, np.pi)], {"xatol": 1e-9 / len(samples)}
    for w in [low, *grid[k[np.argsort(top)[-SEARCHED:]]]]:
        ends = max(w - np.pi / points, low), min(w + np.pi / points, np.pi)
        best = minimize_scalar(lambda w: -magnitude(samples, w), bounds=ends, method="bounded", options=options)
        found.append(-best.fun)
    return max(found)


def magnitude(samples: np.ndarray, w: float) -> float:
    """Return |V(w)| of samples in extended precision."""
    return float(np.abs((samples * np.exp(-1j * np.longdouble(w) * np.arange(len(samples)))).sum()))
