"""Polyhedral sets as joint rows, which the Fourier-domain method takes, and the multipliers on the way back.

F x_t <= g for t < T is a row with D = 0, and F x_T <= g is one on the step before: F A x + F B u <= g - F d. There the
adjoint of the rows' problem is eta', that of the given one eta_{T-1} = eta'_{T-1} - F'lambda.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.maps import StageMap
from lin_freq_ocp.problem.terms.penalties import Below
from lin_freq_ocp.problem.terms.stage_rows import StageRows
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers

AT_THE_END = " at the end"
"""What the name of rows on x_T ends with."""


@dataclass(frozen=True, eq=False)
class RowForm:
    """A problem whose polyhedral sets are joint rows.

    Attributes
    ----------
    given, problem : OptimalControlProblem
        Before and after.
    polyhedra : tuple of Term
        Of the given problem, those that became rows.
    """

    given: OptimalControlProblem
    problem: OptimalControlProblem
    polyhedra: tuple[Term, ...]

    def multipliers(self, found: Multipliers) -> Multipliers:
        """Return multipliers of the given problem from those of the problem in rows."""
        if not self.polyhedra:
            return found
        eta, stage, T = found.eta.copy(), dict(found.stage), self.given.horizon
        for term in self.polyhedra:
            one = term.map
            assert isinstance(one, StageMap)  # that is what polyhedra are
            weights, before = np.zeros(term.shape), one.times < T
            if before.any():
                weights[before] = stage.pop(term.name)[one.times[before]]
            if not before.all():
                weights[~before] = stage.pop(term.name + AT_THE_END)[-1:]
                assert one.C is not None  # it is a set of states
                eta[-1] -= one.C.T @ weights[~before][0]
            stage[term.name] = weights
        return Multipliers(found.eta_C, eta, found.mu, found.nu, found.rho_u, found.rho_x, stage)


def row_form(problem: OptimalControlProblem) -> RowForm:
    """Return the problem with its hard polyhedral sets as joint rows; as it is if it has none, or other sets, too."""
    others = [term for term in problem.terms if term.kind != "stage rows"]
    if not others or problem.linear.time_varying or not all(map(_is_polyhedron, others)):
        return RowForm(problem, problem, ())
    try:
        rows = [one for term in others for one in _rows(problem, term)]
        changed = replace(
            problem,
            state_set=problem.state_boxes,
            control_set=problem.control_tube,
            initial_state=problem.initial_box,
            terminal_state=problem.terminal_box,
            stage_rows=[*problem.stage_rows, *rows],
        )
    except ProblemError:  # a row on x_T that no control and no state before it can change
        return RowForm(problem, problem, ())
    return RowForm(problem, changed, tuple(others))


def _is_polyhedron(term: Term) -> bool:
    one = term.map
    if not isinstance(one, StageMap) or not isinstance(term.penalty, Below) or not term.hard:
        return False
    constant = all(part is None or part.ndim == 2 for part in (one.C, one.D))
    return term.kind in ("state set", "control set") and constant and len(set(one.times)) == len(one.times)


def _rows(problem: OptimalControlProblem, term: Term) -> list[StageRows]:
    one, T, dynamics = term.map, problem.horizon, problem.linear
    assert isinstance(one, StageMap)
    assert isinstance(term.penalty, Below)
    limits = np.broadcast_to(term.penalty.limit, term.shape) - one.constant
    before, rows = one.times < T, list[StageRows]()
    if before.any():
        e = np.full((T, limits.shape[1]), np.inf)
        e[one.times[before]] = limits[before]
        rows.append(StageRows(one.C, one.D, e, term.name))
    if not before.all():
        assert one.C is not None
        e = np.full((T, limits.shape[1]), np.inf)
        offset = dynamics.at(T - 1)[2]
        e[-1] = limits[~before][0] - one.C @ offset
        rows.append(StageRows(one.C @ dynamics.A, one.C @ dynamics.B, e, term.name + AT_THE_END))
    return rows
