"""Polyhedral sets, hard and soft, as joint rows, which the Fourier-domain method takes, and their multipliers.

F x_t <= g for t < T is a row with D = 0, and F x_T <= g is one on the step before: F A x + F B u <= g - F d. There the
adjoint of the rows' problem is eta', that of the given one eta_{T-1} = eta'_{T-1} - F'lambda.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.methods.spectral.model.soft_sets import SETS, soft_sets
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.terms.penalty import HARD
from lin_freq_ocp.problem.terms.term import LinearRows, Term, TermKind
from lin_freq_ocp.problem.trajectory import Multipliers

AT_THE_END = " at the end"  # suffix of the names of rows on x_T


@dataclass(frozen=True, eq=False)
class RowForm:
    """A given problem, the problem with its polyhedral sets as joint rows, and the sets that became rows."""

    given: OptimalControlProblem
    problem: OptimalControlProblem
    polyhedra: tuple[LinearRows, ...]

    def multipliers(self, found: Multipliers) -> Multipliers:
        """Return multipliers of the given problem from those of the problem in rows."""
        if not self.polyhedra:
            return found
        eta, stage, T = found.eta.copy(), dict(found.stage), self.given.horizon
        for rows in self.polyhedra:
            weights, before = np.zeros(rows.e.shape), rows.times < T
            if before.any():
                weights[before] = stage.pop(rows.name)[rows.times[before]]
            if not before.all():
                weights[~before] = stage.pop(rows.name + AT_THE_END)[-1:]
                eta[-1] -= rows.C[0, :, : eta.shape[1]].T @ weights[~before][0]
            stage[rows.name] = weights
        return Multipliers(found.eta_C, eta, found.mu, found.nu, found.rho_u, found.rho_x, stage)


def row_form(problem: OptimalControlProblem) -> RowForm:
    """Return the problem with its polyhedral sets as joint rows.

    Unchanged if it has none, or other sets too, or if all are soft sets that bounds can say.
    """
    sets = [term for term in problem.terms if term.kind != TermKind.STAGE_ROWS]
    found = [(rows, term) for term in sets if (rows := _polyhedron(problem, term)) is not None]
    recursion = problem.dynamics.response(problem.horizon) is None
    others = len(found) < len(sets) or soft_sets(problem) is not None
    if others or not recursion or problem.linear.time_varying:
        return RowForm(problem, problem, ())
    polyhedra = tuple(rows for rows, _ in found)
    try:
        rows = [joint for given, term in found for joint in _stage_rows(problem, given, _price(term))]
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
    return RowForm(problem, changed, polyhedra)


def _polyhedron(problem: OptimalControlProblem, term: Term) -> LinearRows | None:
    """Return the rows of a polyhedral set that is the same at all its times, with one price; else None."""
    if term.kind not in SETS or not term.penalty.polyhedral or len(np.unique(term.penalty.weights)) > 1:
        return None
    hard = term if term.hard else replace(term, penalty=term.penalty.softened(HARD))
    rows = hard.polyhedron(problem.state_dim, problem.control_dim)
    if rows is None or len(rows.C) > 1:
        return None
    return rows if len(set(rows.times)) == len(rows.times) else None


def _price(term: Term) -> float | None:
    """Return the price of a unit of excess; None for what must hold."""
    return None if term.hard else float(np.max(term.penalty.weights))


def _stage_rows(problem: OptimalControlProblem, given: LinearRows, price: float | None) -> list[StageRows]:
    T, n, dynamics = problem.horizon, problem.state_dim, problem.linear
    before, rows = given.times < T, list[StageRows]()
    C, D = given.C[0, :, :n], given.C[0, :, n:]
    if before.any():
        e = np.full((T, given.e.shape[1]), np.inf)
        e[given.times[before]] = given.e[before]
        rows.append(StageRows(C, D, e, given.name, price))
    if not before.all():
        e = np.full((T, given.e.shape[1]), np.inf)
        e[-1] = given.e[~before][0] - C @ dynamics.at(T - 1)[2]
        rows.append(StageRows(C @ dynamics.A, C @ dynamics.B, e, given.name + AT_THE_END, price))
    return rows
