"""The problem in words: horizon, cost, bounds, ends and bands."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.report.entries import state_bounds
from lin_freq_ocp.report.mode_words import dynamics_facts
from lin_freq_ocp.report.numbers import listed, number, plural


def problem_facts(problem: OptimalControlProblem) -> list[tuple[str, str]]:
    """Return the problem in words, as pairs of a term and what it is."""
    step = problem.sampling_time
    horizon = plural(problem.horizon, "step")
    if step is not None:
        horizon += f" of {number(step)} s ({number(step * problem.horizon)} s)"
    facts = [("horizon", horizon), ("minimise", cost_in_words(problem))]
    facts += dynamics_facts(problem)
    bounds, tube = state_bounds(problem), problem.control_tube
    for i, name in enumerate(problem.control_names):
        facts.append((f"control: {name}", _interval(tube.lower[:, i], tube.upper[:, i])))
    for i, name in enumerate(problem.state_names):
        words = [_interval(bounds.lower[:, i], bounds.upper[:, i])]
        for verb, end in (("starts", problem.initial_box), ("ends", problem.terminal_box)):
            words.append(f"{verb} {_end(float(end.lower[i]), float(end.upper[i]))}")
        facts.append((f"state: {name}", "; ".join(words)))
    for rows in problem.stage_rows:
        varying = ", which depend on time" if rows.time_varying or rows.e.ndim == 2 else ""
        facts.append(
            (f"rows: {rows.name}", f"{plural(rows.rows, 'row')} C x + D u \N{LESS-THAN OR EQUAL TO} e{varying}")
        )
    for what, given in (("control", problem.control_spectrum), ("state", problem.state_spectrum)):
        bands = () if given is None else given if isinstance(given, (list, tuple)) else (given,)
        facts += [(f"{what} band", str(band)) for band in bands]
    return facts


def cost_in_words(problem: OptimalControlProblem) -> str:
    """Return the terms of the cost that are there."""
    cost = problem.quadratic
    x = "(x - x_ref)" if cost.x_ref.any() else "x"
    u = "(u - u_ref)" if cost.u_ref.any() else "u"
    stage = [
        (cost.Q, f"\N{VULGAR FRACTION ONE HALF} {x}' Q {x}"),
        (cost.R, f"\N{VULGAR FRACTION ONE HALF} {u}' R {u}"),
        (cost.S, f"{x}' S {u}"),
        (cost.q, "q' x"),
        (cost.r, "r' u"),
    ]
    terminal = [(cost.P, f"\N{VULGAR FRACTION ONE HALF} {x}' P {x} at the end"), (cost.p, "p' x at the end")]
    summed = [words for matrix, words in stage if matrix.any()]
    parts = [f"the sum of {' + '.join(summed)}"] if summed else []
    words = " + ".join([*parts, *(words for matrix, words in terminal if matrix.any())])
    if not words:
        return "nothing: any feasible point will do"
    values = [f"{name} = {value}" for name in "QRP" if (value := _multiple_of_identity(getattr(cost, name)))]
    return words + (f", with {listed(values)}" if values else "")


def _multiple_of_identity(matrix: Array) -> str:
    """Return "2" or "2 I" for such a matrix, and nothing for any other."""
    if matrix.ndim != 2 or not matrix.any() or (matrix != matrix[0, 0] * np.eye(len(matrix))).any():
        return ""
    return number(float(matrix[0, 0])) + (" I" if len(matrix) > 1 else "")


def _interval(lower: Array, upper: Array) -> str:
    if (lower != lower[0]).any() or (upper != upper[0]).any():
        return "bounds that depend on time"
    low, high = float(lower[0]), float(upper[0])
    if not (np.isfinite(low) or np.isfinite(high)):
        return "no bound"
    if low == -high:
        return f"within \N{PLUS-MINUS SIGN}{number(high)}"
    return _between(low, high)


def _between(low: float, high: float) -> str:
    if not np.isfinite(low):
        return f"at most {number(high)}"
    return f"at least {number(low)}" if not np.isfinite(high) else f"from {number(low)} to {number(high)}"


def _end(low: float, high: float) -> str:
    if low == high:
        return f"at {number(low)}"
    return _between(low, high) if np.isfinite(low) or np.isfinite(high) else "anywhere"
