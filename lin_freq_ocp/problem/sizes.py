"""Sizes of states and controls as the data state them, and scales of a search. The judge has its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import translation_of
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory

SOLVER_ROUNDING = 1e-12  # deviations relative to sizes that the search does not distinguish from zero
FINEST_GAP = 1e-6  # a gap that costs no more than SOLVER_ROUNDING counts as this
WEIGHTY = 0.1  # part of a row's largest coefficient below which the row's limit says nothing of a component
NO_GAIN = 1e-14  # entries of a row of [A, B] below this part of its largest are rounding
FAR_BEYOND = 1e4  # factor between a bound and other sizes of a component from which the bound stands for none


def search_scale(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return the sum of the absolute terms of the cost, or what rounding errors cost, over FINEST_GAP."""
    cost, (x, u) = problem.quadratic, (trajectory.x, trajectory.u)
    total = cost.sum_of_terms(x, u) + sum(float(np.abs(term.cost(x, u)).sum()) for term in problem.terms)
    total += float(np.abs(problem.cost.formula_values(x, u)).sum())
    sizes = zip(stated_sizes(problem), (x, u), strict=True)
    moved = (np.broadcast_to(SOLVER_ROUNDING * size, signal.shape) for size, signal in sizes)
    return max(total, cost.magnitudes().value(*moved) / FINEST_GAP)


def stated_sizes(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return sizes of states, (n,), and controls, (m,), as the data state them, before anything is solved.

    A component is as large as its ends, references and levels, else its bounds, else (a control) what other sets and
    rows allow, else what the others make of it within the horizon, else what makes the others as large as they are,
    else what other sets and rows allow, else 1. Bounds far beyond what ends, references and dynamics imply stand for
    none. States count from where they move.
    """
    near = translation_of(problem).problem
    return completed_sizes(near, given_sizes(near))


def completed_sizes(problem: OptimalControlProblem, given: Array) -> tuple[Array, Array]:
    """Return ``stated_sizes`` from ``given_sizes``."""
    n, sizes = problem.state_dim, given
    if not sizes.all():
        limited = _limited_sizes(problem)
        sizes = _complete_sizes(problem, np.append(sizes[:n], np.where(sizes[n:] > 0, sizes[n:], limited[n:])))
        sizes = _complete_sizes(problem, np.where(sizes > 0, sizes, limited))
        sizes = np.where(sizes > 0, sizes, 1.0)
    return sizes[:n], sizes[n:]


def given_sizes(problem: OptimalControlProblem) -> Array:
    """Return sizes of states and controls, (n+m,): of ends, references and levels, else of their bounds, else 0."""
    cost, n = problem.quadratic, problem.state_dim
    ends = np.maximum(_finite(problem.initial_box).max(0), _finite(problem.terminal_box).max(0))
    ends = np.maximum(ends, np.abs(cost.x_ref).reshape(-1, n).max(0))
    references = np.maximum(np.abs(cost.u_ref).reshape(-1, problem.control_dim).max(0), problem.dynamics.level_sizes)
    stated = np.concatenate([ends, references])
    bounds = np.concatenate([_bounded_sizes(tube) for tube in (problem.state_tube, problem.control_tube)])
    others = np.where(stated > 0, stated, bounds)
    followed = _complete_sizes(problem, stated, np.max) if stated.any() else _implied_sizes(problem, others, np.max)
    bounds = np.where((followed > 0) & (bounds > FAR_BEYOND * followed), followed, bounds)
    return np.where(stated > 0, stated, bounds)


def _bounded_sizes(tube: Box) -> Array:
    """Return how large bounds (times, k) are at most times; of two that are far apart, the smaller; 0: none."""
    lower, upper = _middle_size(tube.lower), _middle_size(tube.upper)
    smaller, larger = np.minimum(lower, upper), np.maximum(lower, upper)
    return np.where((smaller > 0) & (larger > FAR_BEYOND * smaller), smaller, larger)


def _middle_size(bounds: Array) -> Array:
    """Return the median |bound| of each component, bounds (times, k), where it is finite and not 0; 0: nowhere."""
    sizes = np.sort(np.where(np.isfinite(bounds), np.abs(bounds), 0.0), axis=0)
    count, last = np.count_nonzero(sizes, axis=0), len(sizes) - 1
    column, middle = np.arange(sizes.shape[1]), (last - count // 2, last - np.maximum(count - 1, 0) // 2)
    below, above = (sizes[row, column] for row in middle)
    return (below + above) / 2


def _limited_sizes(problem: OptimalControlProblem) -> Array:
    """Return the least value that a limit of a set or row allows a component that weighs in it, 0 where none does."""
    n, m = problem.state_dim, problem.control_dim
    least = np.full(n + m, np.inf)
    for term in problem.terms:
        form = term.map.stage_form(n, m)
        if form is None:
            continue
        limit = (np.broadcast_to(term.penalty.sizes(), term.shape) + np.abs(form[1])).max(0)
        coefficients = np.abs(form[0]).max(0)
        for weights, part in ((coefficients[:, :n], least[:n]), (coefficients[:, n:], least[n:])):
            counts = (weights >= WEIGHTY * weights.max(1, keepdims=True)) & (weights > 0) & (limit[:, None] > 0)
            allowed = np.divide(limit[:, None], weights, out=np.full(weights.shape, np.inf), where=counts)
            np.minimum(part, allowed.min(0), out=part)
    return np.where(np.isfinite(least), least, 0.0)


def _complete_sizes(problem: OptimalControlProblem, sizes: Array, chosen: Callable[..., Array] = np.min) -> Array:
    """Return sizes with those that follow from others filled in: np.min or np.max of what makes others as large."""
    for _ in range(len(sizes)):  # at least another component is known after each pass
        if sizes.all():
            break
        sizes = np.where(sizes > 0, sizes, _implied_sizes(problem, sizes, chosen))
    return sizes


def _implied_sizes(problem: OptimalControlProblem, known: Array, chosen: Callable[..., Array]) -> Array:
    """Return what |x_i| <= T (|A| |x| + |B| |u| + |d|)_i says of the components that are not known (0) yet."""
    n, m = problem.state_dim, problem.control_dim
    A, B, d = problem.dynamics.gains()
    gain = problem.horizon * np.hstack([A * (1 - np.eye(n)), B])  # what a component makes of itself says nothing
    gain = np.where(gain > NO_GAIN * gain.max(axis=1, keepdims=True), gain, 0.0)
    caused = gain @ known + problem.horizon * d
    useful = (known[:n, None] > 0) & (gain > 0)
    absent = np.inf if chosen is np.min else 0.0
    needed = chosen(np.divide(known[:n, None], gain, out=np.full(gain.shape, absent), where=useful), axis=0)
    forwards = np.append(caused, np.zeros(m))
    return np.where(forwards > 0, forwards, np.where(np.isfinite(needed), needed, 0.0))


def _finite(box: Box) -> Array:
    """Return |lower| and |upper| stacked, with 0 where there is no bound."""
    both = np.abs(np.stack([box.lower, box.upper]))
    return np.where(np.isfinite(both), both, 0.0)
