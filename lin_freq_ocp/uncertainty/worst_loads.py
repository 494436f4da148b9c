"""What the worst loads do to a plan: for each limit the time at which it is closest, the loads, and a simulation.

The judge reads the limits as they were given and the plan, never tightened limits: it judges plans of other tools
as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, times_vectors
from lin_freq_ocp.base.phrases import NOTHING, html_table, matrix, number, plural, short_name, vector
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.uncertainty.error_loop import ErrorLoop
from lin_freq_ocp.uncertainty.leakage import leakage

HOLDS_WITHIN = 1e-8  # of the terms of a limit: solvers satisfy limits to 1e-9 or better
LINE = "{:28} {:>8} {:>11} {:>11} {:>11} {:>11}"


@dataclass(frozen=True, eq=False)
class Worst:
    """The worst case of a limit: planned + margin is the largest value of all cases, or planned - margin the smallest.

    Attributes
    ----------
    name : str
        Of the limit, such as "position, upper".
    index : int
        The time, or the bin of a spectrum, at which the worst case is closest to the limit.
    planned, margin, limit : float
        The value of the plan, what the uncertainty adds or takes at most, and the given limit; NaN, where a leakage has
        no limit.
    attained : float
        The value of a simulation with ``loads``, or of ``plant``; NaN without (Gaussian loads).
    size : float
        The sum of the absolute terms of the limit, to which rounding is relative.
    start : (n,) or None
        The error x_0 - z_0 of the start.
    loads : (T, k) or None
    plant : int or None
        The number of the plant, from 1.
    in_spectrum : bool
        Whether the index is a bin.
    sign : {1, -1}
        -1 for a lower limit.

    Examples
    --------
    >>> one = lfo.uncertainty.Worst("speed, upper", 4, planned=1.5, margin=0.4, limit=2.0, size=3.9)
    >>> one.holds, round(one.violation, 9)
    (True, -0.1)
    """

    name: str
    index: int
    planned: float
    margin: float
    limit: float
    size: float
    attained: float = np.nan
    start: Array | None = None
    loads: Array | None = None
    plant: int | None = None
    in_spectrum: bool = False
    sign: int = 1

    @property
    def violation(self) -> float:
        """Return by how much the worst case exceeds the limit; negative inside."""
        return self.sign * (self.planned - self.limit) + self.margin

    @property
    def holds(self) -> bool:
        """Whether the limit holds in the worst case, up to rounding of solvers."""
        return self.violation <= HOLDS_WITHIN * self.size

    def __str__(self) -> str:
        at = f"{'bin' if self.in_spectrum else 't ='} {self.index}"
        values = (self.planned, self.margin, self.limit, self.attained)
        shown = (NOTHING if np.isnan(value) else f"{value:.5g}" for value in values)
        plant = "" if self.plant is None else f"  plant {self.plant}"
        return LINE.format(self.name, at, *shown) + plant + ("" if self.holds or np.isnan(self.limit) else "  violated")


@dataclass(frozen=True, eq=False)
class WorstCase:
    """What the worst of an uncertainty does to a plan; ``worst["position, upper"]`` is one of its limits.

    Attributes
    ----------
    words : str
        The uncertainty in words.
    limits : tuple of Worst
        Hard bounds, rows, polyhedra, and masks at bins; soft limits are not judged.
    leakage : tuple of Worst
        The largest magnitudes in stop bands and energy bounds, which hold for the plan only.
    end : (n,) or None
        How far loads move the end of the plan.
    price : float or None
        The derivative of the optimal cost by the size of the loads, at 1 of it; with a plan of ``lfo.solve`` only.

    Examples
    --------
    >>> problem, load = lfo.library.double_integrator(), lfo.Disturbance(lfo.Box(-1e-6, 1e-6), gain=None)
    >>> worst = lfo.worst_case(problem, load, lfo.solve(problem))
    >>> worst["acceleration, upper"].margin, worst.closest.name  # the plan is at its limit of speed
    (0.0, 'speed, upper')
    """

    words: str
    limits: tuple[Worst, ...]
    leakage: tuple[Worst, ...] = ()
    end: Array | None = None
    price: float | None = None
    cost: float | None = None

    @property
    def holds(self) -> bool:
        """Whether every limit holds in its worst case."""
        return all(one.holds for one in self.limits)

    def __bool__(self) -> bool:
        return self.holds

    def __getitem__(self, name: str) -> Worst:
        return {one.name: one for one in (*self.limits, *self.leakage)}[name]

    @property
    def closest(self) -> Worst | None:
        """Return the limit that the worst case violates most, or comes closest to, relative to its terms."""
        return max(self.limits, key=lambda one: one.violation / (one.size or 1.0), default=None)

    @property
    def verdict(self) -> str:
        """Return what is proven, in a sentence."""
        broken = [one for one in self.limits if not one.holds]
        if broken:
            worst = max(broken, key=lambda one: one.violation)
            return f"Violated: {plural(len(broken), 'limit')}, {worst.name} by up to {number(worst.violation)}."
        return f"No case violates one of these limits: proven, to {HOLDS_WITHIN:g} of their terms."

    def __str__(self) -> str:
        lines = [self.words, LINE.format("limit", "at", "plan", "margin", "limit", "attained"), *map(str, self.limits)]
        lines += [f"for the plan only: {one}" for one in self.leakage]
        if self.end is not None and self.end.any():
            lines.append(f"end of the plan: loads move it by up to {vector(self.end)}")
        lines.append(self.verdict)
        if self.price is not None and self.cost:
            lines.append(f"1 % larger loads cost {number(100 * 0.01 * self.price / abs(self.cost), 3)} %.")
        return "\n".join(line.rstrip() for line in lines)

    def __repr__(self) -> str:
        return f"WorstCase({self.words}: {self.verdict})"

    def _repr_html_(self) -> str:
        return html_table(self.words, [(one.name, str(one)[len(one.name) :]) for one in (*self.limits, *self.leakage)])


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Limits C x_t + D u_t <= limits of all times; infinite where there is none."""

    names: Sequence[str]
    C: Array  # (rows, n), or (T+1, rows, n)
    D: Array
    limits: Array  # (T+1, rows)
    term: str = ""  # whose multipliers they have
    sign: int = 1  # -1: lower limits, multiplied by -1


def hard_rows(problem: OptimalControlProblem, bounded_start: bool, moved: Mask) -> Iterator[LimitRows]:
    """Yield the hard bounds, rows and polyhedra of a problem.

    Bounds of states count at time 0 if the start is uncertain; fixed ends only where they are not ``moved`` (n,).
    """
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    first, none = np.zeros((T + 1, 1)), np.full((1, m), np.inf)
    first[0] = 0.0 if bounded_start else np.inf
    ends, states, controls = problem.terminal_box, problem.state_boxes, problem.control_tube
    lasting = np.full((2, T + 1, n), np.inf)
    for side, bound in enumerate((ends.upper, -ends.lower)):
        lasting[side, T] = np.where(ends.fixed & moved, np.inf, bound)
    for side, sign in enumerate((1, -1)):
        word, of_x, of_u = ("upper", "lower")[side], sign * np.eye(n), sign * np.eye(m)
        bound_x, bound_u = (states.upper, controls.upper) if sign > 0 else (-states.lower, -controls.lower)
        x_names, u_names = (
            [f"{short_name(name)}, {word}" for name in names] for names in (problem.state_names, problem.control_names)
        )
        ends_of = [f"end of {name}" for name in x_names]
        yield LimitRows(x_names, of_x, np.zeros((n, m)), bound_x + first, sign=sign)
        yield LimitRows(u_names, np.zeros((m, n)), of_u, np.vstack([bound_u, none]), sign=sign)
        yield LimitRows(ends_of, of_x, np.zeros((n, m)), lasting[side], sign=sign)
    for term in problem.terms:
        found = term.polyhedron(n, m)
        if found is None or term.kind.is_link:
            continue
        limits, count = np.full((T + 1, found.e.shape[1]), np.inf), found.e.shape[1]
        limits[found.times] = found.e
        both = found.C[0]
        if len(found.C) > 1:
            both = np.zeros((T + 1, *found.C.shape[1:]))
            both[found.times] = found.C
        names = [term.name] if count == 1 else [f"row {i} of {term.name}" for i in range(count)]
        yield LimitRows(names, both[..., :n], both[..., n:], limits, term.name)


def worst_loads(
    problem: OptimalControlProblem, loop: ErrorLoop, trajectory: Trajectory, multipliers: Multipliers | None = None
) -> WorstCase:
    """Return what the worst loads do to a trajectory; with the multipliers of a plan, also what larger loads cost."""
    problem.require(trajectory)
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    none = np.zeros((1, T, loop.E.shape[-1]))
    x, u = (part[0] for part in simulate_loop(problem, loop, trajectory, np.zeros((1, n)), none))
    states = loop.margins(np.vstack([np.eye(n), -np.eye(n)]), np.zeros((2 * n, m)))
    end = np.maximum(states[T, :n], states[T, n:])
    worst, price = list[tuple[Worst, Array, Array]](), 0.0
    for rows in hard_rows(problem, loop.start is not None or loop.forever, end > 0):
        if not np.isfinite(rows.limits).any():
            continue
        M, last = loop.margins(rows.C, rows.D), np.vstack([u, np.zeros((1, m))])
        planned = times_vectors(rows.C, x) + times_vectors(rows.D, last)
        sizes = times_vectors(np.abs(rows.C), np.abs(x)) + times_vectors(np.abs(rows.D), np.abs(last))
        sizes = sizes + M + np.where(np.isfinite(rows.limits), np.abs(rows.limits), 0.0)
        slack = rows.limits - planned - M
        price += 0.0 if multipliers is None else _price(rows, M, multipliers, n)
        for i in np.flatnonzero(np.isfinite(slack).any(axis=0)).tolist():
            t = int(np.argmin(slack[:, i]))
            c, d = (part[i] if part.ndim == 2 else part[t, i] for part in (rows.C, rows.D))
            values = rows.sign * planned[t, i], M[t, i], rows.sign * rows.limits[t, i], sizes[t, i]
            plan, margin, limit, size = map(float, values)
            start, w = loop.worst(c, d, t) or (None, None)
            one = Worst(rows.names[i], t, plan, margin, limit, size, start=start, loads=w, sign=rows.sign)
            worst.append((one, c, d))
    known = [i for i, (one, _, _) in enumerate(worst) if one.loads is not None]
    if known:
        starts, loads = (np.array([getattr(worst[i][0], name) for i in known]) for name in ("start", "loads"))
        X, U = simulate_loop(problem, loop, trajectory, starts, loads)
        for k, i in enumerate(known):
            one, c, d = worst[i]
            attained = float(X[k, one.index] @ c + (U[k, one.index] @ d if one.index < T else 0.0))
            worst[i] = replace(one, attained=one.sign * attained), c, d
    masks, leaks = list[Worst](), list[Worst]()
    for one, spectrum, limited in _spectra(problem, loop, x, u):
        if one.loads is not None and one.start is not None:
            X, U = simulate_loop(problem, loop, trajectory, one.start[None], one.loads[None])
            at = replace(spectrum, bins=np.array([one.index]), joint=False)
            one = replace(one, attained=float(np.linalg.norm(at.values(X[0], U[0]))))
        (masks if limited else leaks).append(one)
    K = f"u = v + K (x - z), K = {matrix(loop.K)}" if loop.K.any() else "u = v, without feedback"
    words = f"{loop.loads.describe()}{', since ever' if loop.forever else ''}; {K}"
    limits = (*(one for one, _, _ in worst), *masks)
    return WorstCase(words, limits, tuple(leaks), end, None if multipliers is None else price)


def _price(rows: LimitRows, margins: Array, multipliers: Multipliers, n: int) -> float:
    """Return the sum of multipliers times margins: the slope of the cost in the size of the loads."""
    if rows.term:
        weights = multipliers.stage.get(rows.term)
        bounded = np.isfinite(rows.limits).any(axis=1)
        return 0.0 if weights is None else float((weights * margins[bounded]).sum())
    weights = np.maximum(rows.sign * (multipliers.mu if rows.C.any() else multipliers.nu), 0.0)
    bounded = np.isfinite(rows.limits[: len(weights)])
    return float((weights * margins[: len(weights)] * bounded).sum())


def _spectra(
    problem: OptimalControlProblem, loop: ErrorLoop, x: Array, u: Array
) -> Iterator[tuple[Worst, SpectrumMap, bool]]:
    """Yield the worst bin of each spectrum that is limited at bins, with its map, and whether its limit is judged.

    Stop bands and energies hold for the plan: of these the bin with the largest leakage is yielded.
    """
    for name, spectrum, limits in limited_spectra(problem):
        pairs = replace(spectrum, joint=False).values(x, u)
        found = leakage(loop, spectrum, pairs[:, 0] + 1j * pairs[:, 1])
        judged = not (spectrum.joint or np.isnan(limits).any())
        k = int(np.argmin(limits - found.largest) if judged else np.argmax(found.added))
        start = None if found.loads is None else np.zeros(problem.state_dim)
        loads = None if found.loads is None else found.loads[k]
        planned, added, limit = (
            float(np.abs(found.planned[k])),
            float(found.added[k]),
            float(limits[k]) if judged else np.nan,
        )
        size = planned + added + (limit if judged else 0.0)
        bin_ = int(spectrum.bins[k])
        yield Worst(name, bin_, planned, added, limit, size, np.nan, start, loads, None, True), spectrum, judged


def limited_spectra(problem: OptimalControlProblem) -> Iterator[tuple[str, SpectrumMap, Array]]:
    """Yield name, map and limits, (groups,), of each spectrum with hard limits at bins; NaN for stop bands."""
    T, N = problem.horizon, problem.state_samples
    for term in problem.terms:
        spectrum = term.map.spectrum
        if term.hard and term.semi_infinite is None and spectrum is not None:
            one, radius = cast(SpectrumMap, spectrum), term.penalty.bounds(term.shape)[1][:, 0]
            yield term.name, one, radius
    stops = (problem.state_names, problem.state_stop, N, True), (problem.control_names, problem.control_stop, T, False)
    for names, stop, samples, of_state in stops:
        for i in np.flatnonzero(stop.any(axis=0)):
            row, bins = np.eye(len(names))[i], np.flatnonzero(stop[:, i])
            parts = (row, None) if of_state else (None, row)
            one = SpectrumMap(*parts, np.ones(samples), samples, bins)
            yield f"stop band on {short_name(names[i])}", one, np.full(len(bins), np.nan)


def simulate_loop(
    problem: OptimalControlProblem, loop: ErrorLoop, plan: Trajectory, start: Array, loads: Array
) -> tuple[Array, Array]:
    """Return states (cases, T+1, n) and controls (cases, T, m) of u = v + K (x - z) under loads (cases, T, k)."""
    dynamics, T = problem.linear, problem.horizon
    x, u = np.empty((len(loads), T + 1, problem.state_dim)), np.empty((len(loads), T, problem.control_dim))
    x[:, 0] = plan.x[0] + start
    for t in range(T):
        (A, B, d), E = dynamics.at(t), loop.E if loop.E.ndim == 2 else loop.E[t]
        u[:, t] = plan.u[t] + (x[:, t] - plan.x[t]) @ loop.K.T
        x[:, t + 1] = x[:, t] @ A.T + u[:, t] @ B.T + d + loads[:, t] @ E.T
    return x, u
