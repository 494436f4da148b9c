"""Limits on how much a control may change from one step to the next: joint rows on the state (x_t, u_{t-1})."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Bound, brief, one_component, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import split_unit
from lin_freq_ocp.problem.augmented import AddedStates, extended
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.stage_rows import StageRows

NAME = "rate limit"  # of the added rows


def rate_limited(
    problem: OptimalControlProblem, limit: Bound, previous: ArrayLike | None = None
) -> OptimalControlProblem:
    """Return the problem with |u_t - u_{t-1}| <= limit, in the states (x, u_{t-1}).

    Parameters
    ----------
    problem : OptimalControlProblem
    limit : float or (m,)
        Largest change per step, zero or above; None or inf: no limit on that control. A single number holds for all.
    previous : (m,), or a number for a single control, optional
        The control before the first, u_{-1}; without it, the first control is free of the limit.

    Returns
    -------
    OptimalControlProblem
        With one more state for each limited control, named after it, and stage rows "rate limit".

    Raises
    ------
    ProblemError
        If the limit or the previous control does not fit the problem.

    Examples
    --------
    >>> problem = lfo.rate_limited(lfo.library.double_integrator(), 0.5)
    >>> problem.state_dim
    3
    """
    require_problem(problem)
    m = problem.control_dim
    limits = _limits(limit, m)
    limited = np.flatnonzero(np.isfinite(limits))
    if not len(limited):
        raise ProblemError("rate_limit", brief(limit), "a limit on at least one control", "Leave it out for none.")
    if any(rows.name == NAME for rows in problem.stage_rows):
        raise ProblemError("rate_limit", "a problem with one", f"a problem without stage rows named '{NAME}'")
    k, chosen = len(limited), np.eye(m)[limited]
    before = (
        np.full((2, k), [[-np.inf], [np.inf]]) if previous is None else np.tile(_previous(previous, m)[limited], (2, 1))
    )
    names = [_before(problem.control_names[j]) for j in limited]
    added = AddedStates(np.zeros((k, k)), chosen, Box(*before), np.full(k, -np.inf), names)
    remembering = extended(problem, added)
    of_x = np.zeros((k, problem.state_dim))
    rows = StageRows(
        np.vstack([np.hstack([of_x, -np.eye(k)]), np.hstack([of_x, np.eye(k)])]),
        np.vstack([chosen, -chosen]),
        np.tile(limits[limited], 2),
        name=NAME,
    )
    return replace(remembering, stage_rows=[*remembering.stage_rows, rows])


def _before(name: str) -> str:
    label, unit = split_unit(name)
    return f"{label} before [{unit}]" if unit else f"{label} before"


def _limits(limit: Bound, m: int) -> Array:
    given = [np.inf if one is None else one for one in limit] if isinstance(limit, (list, tuple)) else limit
    limits = real_array("rate_limit", np.inf if given is None else given, allow_infinite=True)
    if limits.shape not in ((), (m,)) or (limits < 0).any():
        raise ProblemError(
            "rate_limit", brief(limit), f"one number, zero or above, or one for each of the {m} controls"
        )
    return np.broadcast_to(limits, m)


def _previous(previous: ArrayLike, m: int) -> Array:
    before = one_component(real_array("previous", previous), m)
    if before.shape != (m,):
        raise ProblemError("previous", f"shape {before.shape}", f"one number for each of the {m} controls")
    return before
