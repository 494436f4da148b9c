"""The least by which one block must give way for a problem to have a solution.

For bounds, joint rows and ends the problem is extended by a state delta, constant in time, by which the block's rows
give way; least delta is then a problem of the same kind as every other one here.
For a stop band it is a search over its bins, passed one after the other from its edges inwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lin_freq_ocp.analysis.measures import stated_sizes
from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.explanation.blocks import ENDS, Block, kept_stopped, widened
from lin_freq_ocp.explanation.wider import hard_only
from lin_freq_ocp.problem.augmented import FurtherStates, extended
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.stage_rows import StageRows
from lin_freq_ocp.solving.explanation import Cure
from lin_freq_ocp.solving.solve import solve_judged

MARGINS = (1e-6, 1e-4, 1e-2)
"""Parts of the least amount by which more is given: the first that cures counts, so that rounding does not decide."""

FIRST_AMOUNT, GROWTH, PRECISION = 1e-3, 8.0, 1e-4
"""Of the search for the least rise of a limit, relative to it: where it begins, how it grows, when it is enough."""

TINY = 1e-9
"""No smaller part of a cure is looked for."""

CLOSE = 1.05
"""A cure by bounds or rows is the least one to this factor."""

CONTROL_PRICE = 1e-6
"""Cost of controls of their stated sizes, relative to that of a delta as large: a flat program is hard on solvers."""

LARGEST = 1e6
"""An amount beyond this many times the sizes in the data is no cure."""


def least_cure(
    problem: OptimalControlProblem,
    block: Block,
    feasible: Callable[[OptimalControlProblem], bool | None],
    time_limit: float | None = None,
) -> Cure | None:
    """Return the least relaxation of a block that cures the problem, tried on it; None if none of it alone does."""
    if block.kind.endswith("stop band"):
        return _least_narrowing(problem, block, feasible)
    if block.kind == "term":
        return _least_widening(problem, block, feasible)
    result = solve_judged(_elastic(problem, block), "convex", time_limit=time_limit)
    if result.trajectory is None:  # however inaccurate: what it says is tried
        return None
    least, sizes = max(float(result.trajectory.x[-1, -1]), 0.0), stated_sizes(problem)
    if least > LARGEST * max(map(np.max, sizes)):
        return None
    end = result.trajectory.x[0 if block.kind == ENDS[0] else -1, :-1]

    def given(amount: float) -> OptimalControlProblem:
        return widened(problem, block, amount * sizes[0] if block.kind in ENDS else amount)

    for margin in MARGINS:
        amount = least * (1 + margin)
        if feasible(given(amount)):
            if block.kind not in ENDS:
                amount = _less(amount, lambda less: bool(feasible(given(less))))
            return Cure(block.name, amount, _words(problem, given(amount), block, amount, end))
    return None


def _less(amount: float, suffices: Callable[[float], bool]) -> float:
    """Return a smaller amount, to 5 %, if less suffices: small ones are lost in the price of the controls."""
    if not suffices(amount / CLOSE):
        return amount
    least, most = amount / GROWTH, amount / CLOSE
    while least > TINY * amount and suffices(least):
        least, most = least / GROWTH, least
    while most > CLOSE * least:
        middle = float(np.sqrt(least * most))
        least, most = (least, middle) if suffices(middle) else (middle, most)
    return most


def _least_widening(
    problem: OptimalControlProblem, block: Block, feasible: Callable[[OptimalControlProblem], bool | None]
) -> Cure | None:
    """Return the least amount by which the limits of a term must rise, by bisection: it need not be a row."""
    terms = [term for term in problem.terms if term.source == (block.family, block.index)]
    limit = max(float(np.max(term.penalty.sizes())) for term in terms)
    unit = limit if limit > 0 else 1.0
    most = unit * FIRST_AMOUNT
    while not feasible(widened(problem, block, most)):
        most *= GROWTH
        if most > LARGEST * unit:
            return None
    least = most / GROWTH if most > unit * FIRST_AMOUNT else 0.0
    while most - least > PRECISION * (unit + most):
        middle = (least + most) / 2
        least, most = (least, middle) if feasible(widened(problem, block, middle)) else (middle, most)
    if limit == 0:
        return Cure(block.name, most, f"wider by {most:.6g}")
    power = 2 if all(term.name.startswith("energy bound") for term in terms) else 1  # energies are given as squares
    return Cure(block.name, most, f"limit {limit**power:.6g} -> {(limit + most) ** power:.6g}")


def _elastic(problem: OptimalControlProblem, block: Block) -> OptimalControlProblem:
    """Return the problem of the least delta >= 0, its last state, by which the block must give way."""
    m, T = problem.control_dim, problem.horizon
    delta = FurtherStates(np.eye(1), np.zeros((1, m)), Box([0.0], [np.inf]), np.zeros(1), ["relaxation"])
    held = replace(
        hard_only(widened(problem, block, np.inf)), cost=QuadraticCost(), name=f"least change of the {block.name}"
    )
    elastic = extended(held, delta)
    price = np.diag(np.append(np.zeros(problem.state_dim), _unit(problem, block) ** -2))
    cost = QuadraticCost(R=np.diag(CONTROL_PRICE / T / stated_sizes(problem)[1] ** 2), P=price)
    return replace(elastic, cost=cost, stage_rows=[*elastic.stage_rows, _giving_way(problem, block)])


def _unit(problem: OptimalControlProblem, block: Block) -> float:
    """Return the size of what the block bounds."""
    x, u = stated_sizes(problem)
    if block.kind == "row":
        rows = next(one for one in problem.stage_rows if one.name == block.family)
        return float(rows.sizes(x, u)[..., block.index].max())
    return {"state bound": x, "control bound": u}.get(block.kind, np.ones(1 + block.index))[block.index]


def _giving_way(problem: OptimalControlProblem, block: Block) -> StageRows:
    """Return the block's rows, each less delta times its size; those on x_T as rows on A x + B u of the step before."""
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    x, u = np.eye(n), np.eye(m)
    A, B, d = problem.linear.at(T - 1)
    parts: list[tuple[Array, Array, Array, float]] = []  # C, D, limits (T, 1), how much of delta

    def add(C: Array, D: Array, upper: Array, lower: Array, size: float = 1.0) -> None:
        parts.append((C, D, upper, size))
        parts.append((-C, -D, -lower, size))

    def at(t: int, value: float, absent: float) -> Array:
        limits = np.full((T, 1), absent)
        limits[t] = value
        return limits

    i = block.index
    if block.kind == "control bound":
        tube = problem.control_tube
        add(np.zeros(n), u[i], tube.upper[:, [i]], tube.lower[:, [i]])
    elif block.kind == "state bound":
        tube = problem.state_boxes
        add(x[i], np.zeros(m), tube.upper[:T, [i]], tube.lower[:T, [i]])
        add(A[i], B[i], at(T - 1, tube.upper[T, i] - d[i], np.inf), at(T - 1, tube.lower[T, i] - d[i], -np.inf))
    elif block.kind == "row":
        rows = next(one for one in problem.stage_rows if one.name == block.family)
        C, D = (np.broadcast_to(part, (T, *part.shape[-2:]))[:, i] for part in (rows.C, rows.D))
        limits = np.broadcast_to(rows.e, (T, rows.rows))[:, [i]]
        matrix = np.concatenate([C, np.full((T, 1), -1.0)], axis=1)[:, None]
        return StageRows(matrix, D[:, None], limits, "giving way")
    else:
        sizes, first = stated_sizes(problem)[0], block.kind == ENDS[0]
        end = problem.initial_box if first else problem.terminal_box
        for j in range(n):
            if first:
                add(x[j], np.zeros(m), at(0, end.upper[j], np.inf), at(0, end.lower[j], -np.inf), sizes[j])
            else:
                upper, lower = at(T - 1, end.upper[j] - d[j], np.inf), at(T - 1, end.lower[j] - d[j], -np.inf)
                add(A[j], B[j], upper, lower, sizes[j])
    C = np.array([np.append(C, -size) for C, _, _, size in parts])
    limits = np.hstack([limits for _, _, limits, _ in parts])
    return StageRows(C, np.array([D for _, D, _, _ in parts]), limits, "giving way")


def _least_narrowing(
    problem: OptimalControlProblem, block: Block, feasible: Callable[[OptimalControlProblem], bool | None]
) -> Cure | None:
    """Return the fewest bins to pass at the edges of a stop band, by bisection."""
    stopped = (problem.state_stop if block.kind == "state stop band" else problem.control_stop)[:, block.index]
    most = len(stopped)
    if not feasible(widened(problem, block, most)):
        return None
    least = 0  # bins that do not suffice
    while most - least > 1:
        middle = (least + most) // 2
        least, most = (least, middle) if feasible(widened(problem, block, middle)) else (middle, most)
    return Cure(block.name, float(most), _band_words(problem, stopped, most, "state" in block.kind))


def _band_words(problem: OptimalControlProblem, stopped: Mask, bins: int, state: bool) -> str:
    length = problem.horizon + state
    passed = [np.flatnonzero(mask == 0) for mask in (stopped, kept_stopped(stopped, bins))]
    if len(passed[0]) and stopped[passed[0].max() + 1 :].all() and not stopped[: passed[0].max()].any():
        Ts = problem.sampling_time
        unit, word = (2 * np.pi, "rad/sample") if Ts is None else (1 / Ts, "Hz")
        first, second = (f"{unit * one.max() / length:.6g}" for one in passed)
        return f"cut-off {first} -> {second} {word}"
    return f"{len(passed[0])} -> {len(passed[1])} passed bins of {len(stopped)}"


def _words(
    problem: OptimalControlProblem, cured: OptimalControlProblem, block: Block, amount: float, end: Array
) -> str:
    if block.kind in ENDS:
        before = problem.initial_box if block.kind == ENDS[0] else problem.terminal_box
        return f"{_point(before)} -> {np.array2string(end, precision=6, separator=', ')}"
    if block.kind == "row":
        limits = next(one for one in problem.stage_rows if one.name == block.family).e[..., block.index]
        if np.ptp(limits) == 0:
            shown = [f"{limit:.6g}" for limit in (np.max(limits), np.max(limits) + amount)]
            return f"<= {shown[0]} -> {shown[1]}" + _if_too_small(shown, amount)
        return f"limits higher by {amount:.6g}"
    tubes = [one.state_boxes if block.kind == "state bound" else one.control_tube for one in (problem, cured)]
    lower, upper = tubes[0].lower[:, block.index], tubes[0].upper[:, block.index]
    if (lower == lower[0]).all() and (upper == upper[0]).all():
        shown = [f"[{one.lower[0, block.index]:.6g}, {one.upper[0, block.index]:.6g}]" for one in tubes]
        return " -> ".join(shown) + _if_too_small(shown, amount)
    return f"bounds wider by {amount:.6g}"


def _if_too_small(shown: list[str], amount: float) -> str:
    """Return the amount where what is shown does not show it: the problem is nearly feasible."""
    return f" (by {amount:.2g}: nearly feasible)" if shown[0] == shown[1] else ""


def _point(end: Box) -> str:
    if end.fixed.all():
        return np.array2string(end.lower, precision=6, separator=", ")
    return " x ".join(f"[{low:.6g}, {high:.6g}]" for low, high in zip(end.lower, end.upper, strict=True))
