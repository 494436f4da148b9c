"""The section PROBLEM of a proof: an optimal control problem as lines, with every number as it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.proof.lines import Value, line
from lin_freq_ocp.proof.terms import term_lines

Parts = Mapping[str, tuple[Array, int]]  # by field: values, constant or one per time, and their dimensions at a time


def problem_lines(problem: OptimalControlProblem) -> Iterator[str]:
    """Yield the section PROBLEM; UnsupportedError, naming the field, if the format does not hold something."""
    try:
        modes = _modes(problem)
    except UnsupportedError:
        got = type(problem.dynamics).__name__
        raise UnsupportedError(f"dynamics: got {got}; a proof states linear or piecewise-affine dynamics.") from None
    yield line(
        section="problem",
        name=problem.name,
        horizon=problem.horizon,
        states=list(problem.state_names),
        controls=list(problem.control_names),
        modes=[name for name, _ in modes],
    )
    for index, (_, parts) in enumerate(modes):
        for t, values in runs(parts, problem.horizon):
            bounded = np.isfinite(values["h"])
            rows = {name: values[name][bounded] for name in "GHh"}
            yield line(**{"mode": index, "from": t}, A=values["A"], B=values["B"], d=values["d"], **rows)
    yield from _cost_lines(problem)
    yield from _bound_lines(problem)
    yield from _stop_lines(0, problem.state_stop, problem.state_samples)
    yield from _stop_lines(problem.state_dim, problem.control_stop, problem.horizon)
    yield from term_lines(problem.terms, (problem.horizon, problem.state_dim, problem.control_dim))


def _modes(problem: OptimalControlProblem) -> list[tuple[str, Parts]]:
    """Return the name and the data of each mode; of linear dynamics, a single mode without rows."""
    n, m = problem.state_dim, problem.control_dim
    if not problem.dynamics.mode_names:
        linear = problem.linear
        none = {"G": (np.zeros((0, n)), 2), "H": (np.zeros((0, m)), 2), "h": (np.zeros(0), 1)}
        return [("linear", {"A": (linear.A, 2), "B": (linear.B, 2), "d": (linear.offset, 1), **none})]
    found = problem.piecewise.arrays(problem.horizon)
    named = {"A": (found.A, 2), "B": (found.B, 2), "d": (found.offset, 1), "G": (found.G, 2), "H": (found.H, 2)}
    named["h"] = found.h, 1
    return [
        (name, {field: (once(values[:, i]), ndim) for field, (values, ndim) in named.items()})
        for i, name in enumerate(problem.dynamics.mode_names)
    ]


def once(values: Array) -> Array:
    """Return values (T, ...) that stand in memory once for all times without their time."""
    return values if values.strides[0] else values[0]


def runs(parts: Parts, horizon: int) -> Iterator[tuple[int, dict[str, Array]]]:
    """Yield each time t < T at which a part changes, the first one 0, with the values of all parts from then on."""
    changed = np.zeros(horizon, dtype=bool)
    changed[0] = True
    for values, ndim in parts.values():
        if values.ndim > ndim:
            differs = values[1:horizon] != values[: horizon - 1]
            changed[1:] |= differs.any(axis=tuple(range(1, values.ndim)))
    for t in np.flatnonzero(changed).tolist():
        yield t, {name: values[t] if values.ndim > ndim else values for name, (values, ndim) in parts.items()}


def _cost_lines(problem: OptimalControlProblem) -> Iterator[str]:
    """Yield the quadratic cost; a line names what changes."""
    cost, T = problem.quadratic, problem.horizon
    hessians = cost.stage_hessians()
    parts = {
        "hessian": (hessians if len(hessians) > 1 else hessians[0], 2),
        "center": (joined(cost.x_ref, cost.u_ref, T), 1),
        "linear": (joined(cost.q, cost.r, T), 1),
    }
    before = dict[str, Array]()
    for t, values in runs(parts, T):
        new: dict[str, Value] = {
            name: value for name, value in values.items() if not np.array_equal(value, before.get(name, np.zeros(0)))
        }
        yield line(**{"cost": "stage", "from": t, **new})
        before = values
    x_ref = cost.x_ref[-1] if cost.x_ref.ndim == 2 else cost.x_ref
    yield line(cost="end", hessian=cost.P, center=x_ref, linear=cost.p)


def joined(of_x: Array, of_u: Array, T: int) -> Array:
    """Return (x, u), (n + m,) or (T, n + m), of vectors that are constant or one per time (of x, maybe T + 1)."""
    if of_x.ndim == of_u.ndim == 1:
        return np.concatenate([of_x, of_u])
    of_x = of_x[:T] if of_x.ndim == 2 else of_x
    return np.hstack([np.broadcast_to(part, (T, part.shape[-1])) for part in (of_x, of_u)])


def _bound_lines(problem: OptimalControlProblem) -> Iterator[str]:
    states, controls, T = problem.state_tube, problem.control_tube, problem.horizon
    parts = {
        "lower": (joined(states.lower, controls.lower, T), 1),
        "upper": (joined(states.upper, controls.upper, T), 1),
    }
    for t, values in runs(parts, T):
        yield line(**{"bounds": "stage", "from": t, **values})
    yield line(bounds="end", lower=states.lower[-1], upper=states.upper[-1])


def _stop_lines(first: int, stop: Mask, samples: int) -> Iterator[str]:
    """Yield the removed bins of components; the first of them is ``first`` of (x, u)."""
    for component in np.flatnonzero(stop.any(axis=0)).tolist():
        bins = intervals(np.flatnonzero(stop[:, component]))
        yield line(stop=first + component, samples=samples, bins=bins)


def intervals(numbers: Indices) -> list[list[int]]:
    """Return increasing whole numbers as [first, last] of each run."""
    ends = np.flatnonzero(np.diff(numbers) > 1)
    firsts, lasts = np.append(0, ends + 1), np.append(ends, len(numbers) - 1)
    return np.column_stack([numbers[firsts], numbers[lasts]]).tolist()
