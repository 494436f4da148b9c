"""Sizes of states and controls from the data of a problem, and the scale of a search. The judge has its own."""

from __future__ import annotations

from collections.abc import Callable
from weakref import WeakKeyDictionary

import numpy as np

from lin_freq_ocp.base.arrays import Array, seal
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.reformulations import translation_of

SOLVER_ROUNDING = 1e-12  # deviations relative to sizes that the search does not distinguish from zero
FINEST_GAP = 1e-6  # smallest relative gap of a search: what SOLVER_ROUNDING costs is this part of the scale
WEIGHTY = 0.1  # a row limits a component whose coefficient is at least this part of the row's largest
NO_GAIN = 1e-14  # entries of a row of [A, B] below this part of its largest are rounding
FAR_BEYOND = 1e4  # a bound that exceeds the other sizes of its component by this factor counts as none


# of the problems in use: methods and judge ask for the sizes of one problem again and again
KNOWN_SIZES: WeakKeyDictionary[OptimalControlProblem, tuple[Array, Array]] = WeakKeyDictionary()


def search_scale(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return the sum of the absolute terms of the cost, at least the cost of rounding errors over FINEST_GAP."""
    cost, (x, u) = problem.quadratic, (trajectory.x, trajectory.u)
    total = float(cost.value_and_terms(x, u)[1]) + sum(float(np.abs(term.cost(x, u)).sum()) for term in problem.terms)
    total += float(np.abs(problem.cost.formula_values(x, u)).sum())
    sizes = zip(stated_sizes(problem), (x, u), strict=True)
    rounding = (np.broadcast_to(SOLVER_ROUNDING * size, signal.shape) for size, signal in sizes)
    return max(total, cost.magnitudes().value(*rounding) / FINEST_GAP)


def stated_sizes(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return sizes of states, (n,), and controls, (m,), from the data alone, before anything is solved.

    The first of these that a component has is its size: the largest of its ends, references and levels; its bounds; of
    a control, the limits of other sets and rows; what the other components cause in it within the horizon; what it must
    be to cause the sizes of the others; the limits of other sets and rows; 1. A bound far above what ends, references
    and dynamics imply counts as none. States are measured from the origin of ``translation_of``.
    """
    if problem not in KNOWN_SIZES:
        translated = translation_of(problem).problem
        x, u = completed_sizes(translated, given_sizes(translated))
        KNOWN_SIZES[problem] = seal(x), seal(u)
    return KNOWN_SIZES[problem]


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
    references = np.maximum(np.abs(cost.u_ref).reshape(-1, problem.control_dim).max(0), problem.level_sizes)
    stated = np.concatenate([ends, references])
    tubes = problem.state_tube, problem.control_tube
    bounds = np.concatenate([_median_size(np.stack(tube.bounds, 1)).max(axis=0) for tube in tubes])
    others = np.where(stated > 0, stated, bounds)
    implied = _complete_sizes(problem, stated, np.max) if stated.any() else _implied_sizes(problem, others, np.max)
    # nor does a bound on one side say how far the other side reaches
    one_sided = np.hstack([(np.isinf(tube.lower) != np.isinf(tube.upper))[-problem.horizon :] for tube in tubes]).any(0)
    beyond = (bounds > FAR_BEYOND * implied) | (one_sided & (FAR_BEYOND * bounds < implied))
    bounds = np.where((implied > 0) & beyond, implied, bounds)
    return np.where(stated > 0, stated, bounds)


def _median_size(bounds: Array) -> Array:
    """Return the median of the finite |bound| > 0 over axis 0, times; 0 without any."""
    sizes = np.where(np.isfinite(bounds), np.abs(bounds), 0.0)
    sizes.sort(axis=0)
    count = np.count_nonzero(sizes, axis=0)
    middle = len(sizes) - 1 - np.stack([count, np.maximum(count - 1, 0)]) // 2
    return np.take_along_axis(sizes, middle, axis=0).mean(axis=0)


def _limited_sizes(problem: OptimalControlProblem) -> Array:
    """Return the smallest value to which a set or row limits each component, (n+m,); 0 where none does."""
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
    """Return the sizes, unknown ones (0) from known ones by ``_implied_sizes``, over and over."""
    for _ in range(len(sizes)):  # at least another component is known after each pass
        if sizes.all():
            break
        sizes = np.where(sizes > 0, sizes, _implied_sizes(problem, sizes, chosen))
    return sizes


def _implied_sizes(problem: OptimalControlProblem, known: Array, chosen: Callable[..., Array]) -> Array:
    """Return sizes of unknown components (0) from |x_i| <= T (|A| |x| + |B| |u| + |d|)_i, (n+m,).

    A state gets the right side from the known components; if that is zero, or it is a control, the value with which it
    alone causes a known x_i, ``chosen`` (np.min or np.max) over i.
    """
    n, m = problem.state_dim, problem.control_dim
    A, B, d = problem.form.gains()
    gain = problem.horizon * np.hstack([A * (1 - np.eye(n)), B])  # a component says nothing of its own size
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
