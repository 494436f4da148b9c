"""The problem of a step: its first state may lie anywhere, and its frequency constraints see what was applied before.

What was applied and measured is data. A spectrogram without a length keeps as many samples of the past as it was given;
one of short windows keeps those of the windows that have not ended yet, so that windows stand still in absolute time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, real_array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box, Everything
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.base import entries_of

SPECTRA = ("control_spectrum", "state_spectrum", "output_spectrum")


def first_state_free(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem without its state set and rows of the state alone at time 0."""
    given, T = problem.state_set, problem.horizon
    changes: dict[str, object] = {"stage_rows": [_later(rows, T) for rows in problem.stage_rows]}
    if isinstance(given, Sequence) or (given is not None and given.members):
        later = list(given[1:]) if isinstance(given, Sequence) else [given] * T
        changes["state_set"] = [Everything(), *later]
    elif given is not None:
        lower, upper = problem.state_boxes.lower.copy(), problem.state_boxes.upper.copy()
        lower[0], upper[0] = -np.inf, np.inf
        changes["state_set"] = Box(lower, upper)
    return replace(problem, **changes) if given is not None or problem.stage_rows else problem


def _later(rows: StageRows, horizon: int) -> StageRows:
    """Return the rows with those of the state alone left out at time 0."""
    limits = np.array(np.broadcast_to(rows.e, (horizon, rows.rows)))
    on_control = np.broadcast_to(rows.D, (horizon, *rows.D.shape[-2:]))[0].any(axis=-1)
    limits[0, ~on_control] = np.inf
    return StageRows(rows.C, rows.D, limits, rows.name, rows.penalty)


def remembers(problem: OptimalControlProblem) -> bool:
    """Whether frequency constraints of a problem depend on samples of the past."""
    return any(one.remembers for field in SPECTRA for one in entries_of(getattr(problem, field)))


def with_past(problem: OptimalControlProblem, x: Array, u: Array) -> OptimalControlProblem:
    """Return the problem behind states x (k, n) and controls u (k, m), which follow the past it was stated with."""
    return replace(
        problem,
        control_spectrum=[one.behind(u, 0) for one in entries_of(problem.control_spectrum)] or None,
        state_spectrum=[one.behind(x, 1) for one in entries_of(problem.state_spectrum)] or None,
        output_spectrum=[one.behind(x, u) for one in entries_of(problem.output_spectrum)] or None,
    )


def disturbed(problem: OptimalControlProblem, disturbance: ArrayLike) -> OptimalControlProblem:
    """Return the problem with a disturbance, (n,) or (T, n), added to the coming states."""
    dynamics, T, n = problem.dynamics, problem.horizon, problem.state_dim
    if not isinstance(dynamics, LinearDynamics):
        what = type(dynamics).__name__
        raise UnsupportedError(f"disturbance: a preview needs linear dynamics; these are {what}.")
    expected = real_array("disturbance", disturbance)
    if expected.shape not in ((n,), (T, n)):
        raise ProblemError("disturbance", f"shape {expected.shape}", f"shape {(n,)} or {(T, n)}")
    return replace(problem, dynamics=replace(dynamics, offset=dynamics.offset + expected))
