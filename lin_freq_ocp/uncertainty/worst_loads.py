"""What the worst loads do to a plan: for each limit the time at which it is closest, the loads, and a simulation.

The judge reads the limits as they were given and the plan, never tightened limits: it judges plans of other tools
as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import cast

import numpy as np

from lin_freq_ocp.base.arrays import SAME, Array, ComplexArray, Indices, Mask, times_vectors
from lin_freq_ocp.base.errors import entry_named
from lin_freq_ocp.base.phrases import NOTHING, html_table, matrix, number, plural, short_name, vector
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.reformulations import Translation, translation_of
from lin_freq_ocp.uncertainty.error_loop import ErrorLoop
from lin_freq_ocp.uncertainty.leakage import bin_values, leakage

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
        The sum of the absolute terms of the limit, to which rounding is relative; states that are far from zero
        count from the middle of what is known of them.
    start : (n,) or None
        The error x_0 - z_0 of the start.
    loads : (T, k) or None
    trajectory : Trajectory or None
        The states and controls of the simulation.
    plant : int, (bins, p, m), or None
        The number of the plant, from 1, or its response.
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
    trajectory: Trajectory | None = None
    plant: int | ComplexArray | None = None
    in_spectrum: bool = False
    sign: int = 1

    def of_given(self, translation: Translation, c: Array) -> Worst:
        """Return this worst case of a translated problem as one of the given problem; c (n,) is its row of states."""
        moved, under = self.sign * float(c @ translation.origin), self.trajectory
        places = {name: getattr(self, name) + moved for name in ("planned", "limit", "attained")}
        return replace(self, trajectory=under and translation.trajectory(under), **places)

    def under(self, case: tuple[Array, Array] | None, trajectory: Trajectory, value: float) -> Worst:
        """Return this worst case with the start and the loads that attain it, and the value of their simulation."""
        if case is None:
            return replace(self, attained=np.nan)
        return replace(self, attained=self.sign * value, start=case[0], loads=case[1], trajectory=trajectory)

    @property
    def violation(self) -> float:
        """Return by how much the worst case exceeds the limit; negative inside."""
        return self.sign * (self.planned - self.limit) + self.margin

    @property
    def holds(self) -> bool:
        """Whether the limit holds in the worst case, up to rounding of solvers."""
        return self.violation <= HOLDS_WITHIN * self.size

    @property
    def cells(self) -> list[str]:
        """Return the cells of a table: name, place, value of the plan, margin, limit and attained value."""
        at = f"{'bin' if self.in_spectrum else 't ='} {self.index}"
        values = (self.planned, self.margin, self.limit, self.attained)
        return [self.name, at, *(NOTHING if np.isnan(value) else f"{value + 0.0:.5g}" for value in values)]

    def remark(self, soft: bool = False) -> str:
        """Return in words whether the limit holds, and by how much the worst case exceeds it; empty without a limit."""
        if np.isnan(self.limit):
            return ""
        kind, beyond = ("soft, ", "exceeded") if soft else ("", "violated")
        return kind + ("holds" if self.holds else f"{beyond} by {number(self.violation)}")

    def line(self, soft: bool = False) -> str:
        """Return the line of a table, with the case and, if it is soft or does not hold, a remark."""
        case = f"  plant {self.plant}" if isinstance(self.plant, int) else ""
        acting = None if self.loads is None else self.loads if self.in_spectrum else self.loads[: self.index]
        if acting is not None and acting.any():
            case = f"  {number(float(np.abs(acting).max()))} at t = 0 .. {len(acting) - 1}"
        remark = self.remark(soft)
        return LINE.format(*self.cells) + case + (f"  {remark}" if remark not in ("", "holds") else "")

    def __str__(self) -> str:
        return self.line()


@dataclass(frozen=True, eq=False)
class WorstCase:
    """What the worst of an uncertainty does to a plan; ``worst["position, upper"]`` is one of its limits.

    Attributes
    ----------
    words : str
        The uncertainty in words.
    limits : tuple of Worst
        Hard bounds, rows, polyhedra, and masks at bins.
    leakage : tuple of Worst
        The largest magnitudes in stop bands and energy bounds, which hold for the plan only.
    soft : tuple of Worst
        Soft bounds, rows and polyhedra, which may be violated at a price.
    end : (n,) or None
        How far loads move the end of the plan.
    price : float or None
        The derivative of the optimal cost by the size of the loads, at 1 of it; with a plan of ``lfo.solve`` only.
    cost, nominal : float or None
        The costs of the plan, and of that without margins.

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
    nominal: float | None = None
    soft: tuple[Worst, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether every limit holds in its worst case."""
        return all(one.holds for one in self.limits)

    def __bool__(self) -> bool:
        return self.holds

    def __getitem__(self, name: str) -> Worst:
        return entry_named("worst case", name, {one.name: one for one in (*self.limits, *self.soft, *self.leakage)})

    @property
    def closest(self) -> Worst | None:
        """Return the limit that the worst case violates most, or comes closest to, relative to its terms; the first."""
        violations = [one.violation / (one.size or 1.0) for one in self.limits]
        largest = max(violations, default=0.0) - SAME
        return next((one for one, violation in zip(self.limits, violations, strict=True) if violation >= largest), None)

    @property
    def verdict(self) -> str:
        """Return what is proven, in a sentence."""
        broken = [one for one in self.limits if not one.holds]
        if broken:
            worst = max(broken, key=lambda one: one.violation)
            return f"Violated: {plural(len(broken), 'limit')}, {worst.name} by up to {number(worst.violation)}."
        limits = "the hard limits" if self.soft else "these limits"
        return f"No case violates one of {limits}: proven, to {HOLDS_WITHIN:g} of their terms."

    def __str__(self) -> str:
        head = LINE.format("limit", "at", "plan", "margin", "limit", "attained") + "  largest load"
        lines = [self.words, head, *map(str, self.limits)]
        lines += [one.line(soft=True) for one in self.soft]
        lines += [f"for the plan only: {one}" for one in self.leakage]
        if self.end is not None and self.end.any():
            lines.append(f"end of the plan: loads move it by up to {vector(self.end)}")
        lines.append(self.verdict)
        if self.price is not None and self.cost:
            lines.append(f"1 % larger loads cost {number(100 * 0.01 * self.price / abs(self.cost), 3)} %.")
        if self.nominal and self.cost is not None:
            share = (self.cost - self.nominal) / abs(self.nominal)
            more = number(100 * share if abs(share) > SAME else 0.0, 3)
            costs = f"The cost is {number(self.cost)}; that of the plan without margins {number(self.nominal)}"
            lines.append(f"{costs}: {more} % more.")
        return "\n".join(line.rstrip() for line in lines)

    def __repr__(self) -> str:
        return f"WorstCase({self.words}: {self.verdict})"

    def _repr_html_(self) -> str:
        found = [(one, one in self.soft) for one in (*self.limits, *self.soft, *self.leakage)]
        return html_table(self.words, [(one.name, one.line(soft)[len(one.name) :]) for one, soft in found])


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Limits C x_t + D u_t <= limits of all times, hard or ``soft``; infinite where there is none."""

    names: Sequence[str]
    C: Array  # (rows, n), or (T+1, rows, n)
    D: Array
    limits: Array  # (T+1, rows)
    term: str = ""  # whose multipliers they have
    signs: Indices | None = None  # -1: lower limits, multiplied by -1
    soft: bool = False
    others: Array | float = np.inf  # other limits of the same values, without margins: the least one has the multiplier

    def values(self, x: Array, u: Array) -> Array:
        """Return C x_t + D u_t, (T+1, rows), with a control of zero at time T."""
        return times_vectors(self.C, x) + times_vectors(self.D, np.vstack([u, np.zeros((1, u.shape[1]))]))

    def closest(self, x: Array, u: Array, margins: Array) -> Iterator[tuple[Worst, Array, Array]]:
        """Yield each limit at the time at which a trajectory and its margins are closest to it, with its row."""
        sizes = replace(self, C=np.abs(self.C), D=np.abs(self.D)).values(np.abs(x), np.abs(u)) + np.abs(margins)
        planned = self.values(x, u)
        for i in np.flatnonzero(np.isfinite(self.limits).any(axis=0)).tolist():
            violations = (planned + margins - self.limits)[:, i]
            t = int(violations.argmax())
            t = int(np.argmax(violations >= violations[t] - SAME * sizes[t, i]))  # the first: rounding decides no tie
            c, d = (part[i] if part.ndim == 2 else part[t, i] for part in (self.C, self.D))
            sign = 1 if self.signs is None else int(self.signs[i])
            plan, limit = (float(sign * part[t, i]) for part in (planned, self.limits))
            size = float(sizes[t, i]) + abs(limit)
            yield Worst(self.names[i], t, plan, float(margins[t, i]), limit, size, plan, sign=sign), c, d

    def price(self, margins: Array, multipliers: Multipliers) -> float:
        """Return the sum of multipliers times margins: the slope of the cost in the size of the loads."""
        if self.signs is None:
            weights = multipliers.stage.get(self.term)
            return 0.0 if weights is None else float((weights * margins[np.isfinite(self.limits).any(axis=1)]).sum())
        weights = np.maximum(self.signs * np.tile(multipliers.mu if self.C.any() else multipliers.nu, 2), 0.0)
        return float((weights * (margins * (self.limits - margins < self.others))[: len(weights)]).sum())


def limit_rows(problem: OptimalControlProblem, bounded_start: bool, moved: Mask) -> Iterator[LimitRows]:
    """Yield the hard bounds of a problem, then its rows and polyhedra, the soft ones last.

    Bounds of states count at time 0 if the start is uncertain; fixed ends only where they are not ``moved`` (n,).
    """
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    ends, end = problem.terminal_box, np.full((T + 1, 2 * n), np.inf)
    end[T] = np.where(np.tile(ends.fixed & moved, 2), np.inf, np.append(ends.upper, -ends.lower))
    of_x, of_u = (np.hstack([box.upper, -box.lower]) for box in (problem.state_boxes, problem.control_tube))
    at_start, at_end = (np.append(box.upper, -box.lower) for box in (problem.initial_box, ends))
    by_end = at_end <= of_x[T]  # limits of which one of the two at the end has the multipliers
    others = np.vstack([at_start, end[1:T], np.where(by_end, -np.inf, np.inf)])
    of_x = of_x if bounded_start else np.vstack([end[:1], of_x[1:]])
    of_u = np.pad(of_u, ((0, 1), (0, 0)), constant_values=np.inf)
    C, D = (np.vstack([np.eye(k), -np.eye(k)]) for k in (n, m))
    states = [f"{short_name(name)}, {side}" for side in ("upper", "lower") for name in problem.state_names]
    controls = [f"{short_name(name)}, {side}" for side in ("upper", "lower") for name in problem.control_names]
    yield LimitRows(states, C, np.zeros((2 * n, m)), of_x, signs=np.repeat((1, -1), n), others=others)
    yield LimitRows(controls, np.zeros((2 * m, n)), D, of_u, signs=np.repeat((1, -1), m))
    names, others = [f"end of {name}" for name in states], np.where(by_end, np.inf, -np.inf)
    yield LimitRows(names, C, np.zeros((2 * n, m)), end, signs=np.repeat((1, -1), n), others=others)
    for soft, term in product((False, True), problem.terms):
        found = term.polyhedron(n, m, soft)
        if found is None or term.kind.is_link:
            continue
        limits, count = np.full((T + 1, found.e.shape[1]), np.inf), found.e.shape[1]
        limits[found.times] = found.e
        both = found.C[0]
        if len(found.C) > 1:
            both = np.zeros((T + 1, *found.C.shape[1:]))
            both[found.times] = found.C
        names = [term.name] if count == 1 else [f"row {i} of {term.name}" for i in range(count)]
        yield LimitRows(names, both[..., :n], both[..., n:], limits, term.name, soft=soft)


def worst_loads(
    problem: OptimalControlProblem, loop: ErrorLoop, trajectory: Trajectory, multipliers: Multipliers | None = None
) -> WorstCase:
    """Return what the worst loads do to a trajectory; with the multipliers of a plan, also what larger loads cost."""
    problem.require(trajectory)
    cost, translation = problem.value(trajectory.x, trajectory.u), translation_of(problem)
    problem, trajectory = translation.judged_at(trajectory)
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    plan = simulate_loop(problem, loop, trajectory)
    x, u, limits, soft, leaks, price = plan.x, plan.u, list[Worst](), list[Worst](), list[Worst](), 0.0
    end = loop.margins(np.vstack([np.eye(n), -np.eye(n)]), np.zeros((2 * n, m)))[T].reshape(2, n).max(axis=0)
    for rows in limit_rows(problem, loop.start is not None or loop.forever, end > 0):
        margins = loop.margins(rows.C, rows.D)
        price += 0.0 if multipliers is None else rows.price(margins, multipliers)
        for one, c, d in rows.closest(x, u, margins):
            t, case = one.index, loop.worst(c, d, one.index)
            under = simulate_loop(problem, loop, trajectory, case)
            worst = one.under(case, under, float(under.x[t] @ c + under.u[t : t + 1].sum(axis=0) @ d))
            (soft if rows.soft else limits).append(worst.of_given(translation, c))
    for name, spectrum, levels in limited_spectra(problem):
        bins = bin_values(spectrum, plan)
        largest, loads = leakage(loop, spectrum, bins)
        k, one = closest_bin(name, spectrum, levels, np.abs(bins), largest - np.abs(bins))
        case = None if loads is None else (np.zeros(n), loads[k])
        under = simulate_loop(problem, loop, trajectory, case)
        one = one.under(case, under, float(np.abs(bin_values(spectrum, under)[k])))
        (leaks if np.isnan(one.limit) else limits).append(one.of_given(translation, np.zeros(n)))
    K = f"u = v + K (x - z), K = {matrix(loop.K)}" if loop.K.any() else "u = v, without feedback"
    words = f"{loop.loads.words}{', since ever' if loop.forever else ''}; {K}"
    prices = None if multipliers is None else price
    return WorstCase(words, tuple(limits), tuple(leaks), end, prices, cost, soft=tuple(soft))


def limited_spectra(problem: OptimalControlProblem) -> Iterator[tuple[str, SpectrumMap, Array]]:
    """Yield name, map and limits, (groups,), of each spectrum with hard limits at bins; NaN for stop bands."""
    for term in problem.terms:
        spectrum = term.map.spectrum
        if term.hard and term.semi_infinite is None and spectrum is not None:
            yield term.name, cast(SpectrumMap, spectrum), term.penalty.bounds(term.shape)[1][:, 0]
    for map in problem.stop_band_maps:
        name = (problem.control_names if map.C is None else problem.state_names)[map.component]
        yield f"stop band on {short_name(name)}", replace(map, joint=False), np.full(len(map.bins), np.nan)


def closest_bin(name: str, spectrum: SpectrumMap, levels: Array, planned: Array, margins: Array) -> tuple[int, Worst]:
    """Return where a spectrum comes closest to its limits, or has the largest margin without any: position and case.

    The limit of a joint spectrum is none of a single bin. Magnitudes ``planned`` and ``margins`` are (bins,).
    """
    levels = np.full(len(planned), np.nan) if spectrum.joint else levels
    k = int(np.argmax(margins) if np.isnan(levels).any() else np.argmin(levels - planned - margins))
    plan, margin, level = (float(part[k]) for part in (planned, margins, levels))
    size = plan + margin + float(np.nan_to_num(level))
    return k, Worst(name, int(spectrum.bins[k]), plan, margin, level, size, in_spectrum=True)


def simulate_loop(
    problem: OptimalControlProblem, loop: ErrorLoop, plan: Trajectory, case: tuple[Array, Array] | None = None
) -> Trajectory:
    """Return u = v + K (x - z), x_0 = z_0 + start, and its states, for a start (n,) and loads (T, k); None: zeros."""
    T = problem.horizon
    start, w = case or (np.zeros(problem.state_dim), np.zeros((T, loop.E.shape[-1])))
    x, u, forces = [plan.x[0] + start], list[Array](), times_vectors(loop.E, w)
    for t in range(T):
        A, B, d = problem.linear.at(t)
        u.append(plan.u[t] + loop.K @ (x[t] - plan.x[t]))
        x.append(A @ x[t] + B @ u[t] + d + forces[t])
    return Trajectory(x, u)
