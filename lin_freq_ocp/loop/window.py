"""The problem of a step: its first state may lie anywhere, and its frequency constraints see what was applied before.

What was applied and measured is data. A spectrogram without a length keeps as many samples of the past as it was given;
one of short windows keeps those of the windows that have not ended yet, so that windows stand still in absolute time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.arrays import Array, real_array
from lin_freq_ocp.errors import ProblemError, UnsupportedError
from lin_freq_ocp.problem.costs.quadratic import CostSum
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box, Everything
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, entries_of
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum
from lin_freq_ocp.problem.spectrum.spectrogram import Spectrogram
from lin_freq_ocp.problem.terms.stage_rows import StageRows

SPECTRA = ("control_spectrum", "state_spectrum", "output_spectrum")
Value = TypeVar("Value")
BOUNDS, REFERENCES = ("state_set", "control_set"), ("x_ref", "u_ref")


@dataclass(frozen=True)
class Preview:
    """What a step knows of its horizon beyond the problem: other references and bounds, and disturbances."""

    references: Mapping[str, ArrayLike] | None = None
    bounds: Mapping[str, object] | None = None
    disturbance: ArrayLike | None = None  # (n,) or (T, n), added to x_{t+1}

    @property
    def empty(self) -> bool:
        """Whether the problem stays as it is."""
        return not self.references and not self.bounds and self.disturbance is None


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
    return any(isinstance(one, Spectrogram) for field in SPECTRA for one in _constraints(problem, field))


def with_past(problem: OptimalControlProblem, x: Array, u: Array) -> OptimalControlProblem:
    """Return the problem behind states x (k, n) and controls u (k, m), which follow the past it was stated with."""
    if not remembers(problem):
        return problem
    outputs = [_outputs_behind(one, x, u) for one in entries_of(problem.output_spectrum)]
    return replace(
        problem,
        control_spectrum=[_behind(one, u, False) for one in entries_of(problem.control_spectrum)] or None,
        state_spectrum=[_behind(one, x, True) for one in entries_of(problem.state_spectrum)] or None,
        output_spectrum=outputs or None,
    )


def with_preview(problem: OptimalControlProblem, preview: Preview) -> OptimalControlProblem:
    """Return the problem with what a step knows of its horizon; ProblemError if something does not fit."""
    changes = _known("bounds", preview.bounds, BOUNDS)
    if preview.references:
        quadratic = replace(problem.quadratic, **_known("references", preview.references, REFERENCES))
        changes["cost"] = CostSum([quadratic, *problem.cost.norms])
    if preview.disturbance is not None:
        changes["dynamics"] = _disturbed(problem, preview.disturbance)
    return first_state_free(replace(problem, **changes)) if changes else problem


def _disturbed(problem: OptimalControlProblem, disturbance: ArrayLike) -> LinearDynamics:
    dynamics, T, n = problem.dynamics, problem.horizon, problem.state_dim
    if not isinstance(dynamics, LinearDynamics):
        what = type(dynamics).__name__
        raise UnsupportedError(f"disturbance: a preview needs linear dynamics; these are {what}.")
    expected = real_array("disturbance", disturbance)
    if expected.shape not in ((n,), (T, n)):
        raise ProblemError("disturbance", f"shape {expected.shape}", f"shape {(n,)} or {(T, n)}")
    return replace(dynamics, offset=dynamics.offset + expected)


def _constraints(problem: OptimalControlProblem, field: str) -> list[FrequencyConstraint]:
    found = list(entries_of(getattr(problem, field)))
    return [bound for one in found for bound in one.constraints] if field == "output_spectrum" else found


def _behind(constraint: FrequencyConstraint, later: Array, of_states: bool) -> FrequencyConstraint:
    """Return a constraint behind samples (k, components) that follow its own past.

    Windows of states that end at time 0, which is measured, are left out.
    """
    if not isinstance(constraint, Spectrogram):
        return constraint
    first = np.zeros((0, later.shape[1])) if constraint.past is None else constraint.past
    whole, length = np.concatenate([first, later]), constraint.length
    if length is None:
        return constraint.with_past(whole[len(later) :] if len(first) else None)
    ended, hop = max(len(whole) + of_states - length + 1, 0), constraint.hop or 1
    begin = constraint.offset + max(-(-(ended - constraint.offset) // hop), 0) * hop  # of the first window not over
    return constraint.with_past(whole[begin:] if begin < len(whole) else None, max(begin - len(whole), 0))


def _outputs_behind(outputs: OutputSpectrum, x: Array, u: Array) -> OutputSpectrum:
    parts = [signal @ matrix.T for matrix, signal in ((outputs.C, x), (outputs.D, u)) if matrix is not None]
    later = sum(parts[1:], parts[0])
    constraints = [_behind(one, later, outputs.D is None) for one in outputs.constraints]
    return OutputSpectrum(outputs.C, outputs.D, constraints, outputs.output_names)


def _known(
    field: str, given: Mapping[str, object] | Mapping[str, ArrayLike] | None, keys: tuple[str, ...]
) -> dict[str, object]:
    for key in given or {}:
        if key not in keys:
            raise ProblemError(f"{field}.{key}", "an unknown key", f"{' or '.join(keys)}")
    return dict(given or {})
