# pyright: reportAttributeAccessIssue=false
"""SCIP, by PySCIPOpt: branch and cut on linear rows and second-order cones; the quadratic cost is also a cone.

With y = L'z, P = L L', the epigraph variable w of 1/2 z'P z lies in the cone |(y, w - 1/2)| <= w + 1/2. Written as a
quadratic row, 1/2 z'P z <= w, SCIP's bound was seen to stop 3e-6 short of the optimum, for want of cuts.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from pyscipopt import Eventhdlr, Model, quicksum
from pyscipopt.scip import PY_SCIP_EVENTTYPE, Event, Expr, Variable
from scipy.sparse.csgraph import connected_components

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now, seconds_left
from lin_freq_ocp.base.interrupts import interrupts_noted
from lin_freq_ocp.program.backends.base import CONTRADICTION, NO_POINT, Claim, Solution
from lin_freq_ocp.program.program import Program, SingleBounds

SCIP_FEASIBILITY = 1e-6  # SCIP's default; with less, its LP solver may fail, and a mode sequence is solved again anyway
NEGLIGIBLE_EIGENVALUE = 1e-14  # eigenvalue of a block of P, relative to its largest, that is rounding of 0
SCIP_INFINITE = 1e20  # as SCIP has it

SETTINGS: dict[str, bool | float | str] = {
    "numerics/feastol": SCIP_FEASIBILITY,
    "lp/threads": 1,
    "parallel/maxnthreads": 1,
    "randomization/randomseedshift": 0,
    "misc/catchctrlc": False,  # SCIP's handler prints, and replaces ours
}

CLAIMS = {
    "optimal": Claim.SOLVED,
    "gaplimit": Claim.SOLVED,
    "infeasible": Claim.INFEASIBLE,
    "unbounded": Claim.UNBOUNDED,
    "timelimit": Claim.TIME_LIMIT,
    "memlimit": Claim.LIMIT,
    "nodelimit": Claim.LIMIT,
    "totalnodelimit": Claim.LIMIT,
    "userinterrupt": Claim.INTERRUPTED,
}

# events at which Python runs
WATCHED = (PY_SCIP_EVENTTYPE.PRESOLVEROUND, PY_SCIP_EVENTTYPE.LPSOLVED, PY_SCIP_EVENTTYPE.NODEFOCUSED)


def solve(program: Program, gap: float, time_limit: float | None) -> Solution:
    """Solve; if a limit or Ctrl-C ends the search, the best point so far is returned."""
    end = np.inf if time_limit is None else now() + time_limit
    rows = program.single_bounds()
    if rows.violation > CONTRADICTION:
        return NO_POINT
    model, variables = convex_model(program, rows)
    set_objective(model, program, variables)
    solution = run_scip(model, variables, seconds_left(end), gap)
    return solution or decide_claim(lambda costless: solve(costless, gap, seconds_left(end)), program)


def run_scip(model: Model, variables: list[Variable], time_limit: float | None, gap: float) -> Solution | None:
    """Run SCIP on a model; None if SCIP reports 'infeasible or unbounded'."""
    model.setParams({**SETTINGS, "limits/gap": gap})
    if time_limit is not None:
        model.setParam("limits/time", time_limit)
    with interrupts_noted() as noted:
        model.includeEventhdlr(_Watch(noted), "interrupts", "stops the search when Ctrl-C was noted")
        try:
            model.optimize()
        except Exception as error:  # PySCIPOpt has no class of its own for SCIP's errors
            return Solution(Claim.FAILED, None, None, str(error))
    status = str(model.getStatus())
    if status == "inforunbd":
        return None
    bound = float(model.getDualbound())
    z = np.array([model.getVal(variable) for variable in variables]) if model.getNSols() else None
    message, claimed = f"{status}, {int(model.getNTotalNodes())} nodes", bound if abs(bound) < SCIP_INFINITE else None
    return Solution(CLAIMS.get(status, Claim.FAILED), z, None, message, claimed)


def decide_claim(solve_one: Callable[[Program], Solution], program: Program) -> Solution:
    """Return whether the program is infeasible or unbounded, by solving it without its cost."""
    found = solve_one(replace(program, P=sp.csc_array(program.P.shape), q=np.zeros_like(program.q)))
    claim = Claim.UNBOUNDED if found.claim is Claim.SOLVED else found.claim
    return Solution(claim, None, None, f"infeasible or unbounded; without its cost: {found.message}")


class _Watch(Eventhdlr):
    """Interrupts the search at the next event after Ctrl-C."""

    def __init__(self, noted: threading.Event):
        self.noted = noted

    def eventinit(self) -> None:
        for event in WATCHED:
            self.model.catchEvent(event, self)

    def eventexit(self) -> None:
        for event in WATCHED:
            self.model.dropEvent(event, self)

    def eventexec(self, event: Event) -> None:
        if self.noted.is_set():
            self.model.interruptSolve()


def convex_model(program: Program, rows: SingleBounds) -> tuple[Model, list[Variable]]:
    """Return a model with all rows of a program and no objective, and its variables."""
    model, integer = Model(), np.isin(np.arange(len(program.q)), program.binaries)
    model.hideOutput()
    z = [
        model.addVar(vtype="B" if whole else "C", lb=_finite(low), ub=_finite(high))
        for whole, low, high in zip(integer, rows.below, rows.above, strict=True)
    ]
    A = rows.A
    for i, (low, high) in enumerate(zip(rows.lower, rows.upper, strict=True)):
        row = _linear(A.data[A.indptr[i] : A.indptr[i + 1]], A.indices[A.indptr[i] : A.indptr[i + 1]], z)
        if low == high:
            model.addCons(row == float(high))
            continue
        if np.isfinite(high):
            model.addCons(row <= float(high))
        if np.isfinite(low):
            model.addCons(row >= float(low))
    # s = A z - lower, s_0 >= 0, and s_1^2 + ... <= s_0^2; a constant s_0 makes it a ball
    A = sp.csr_array(program.A)
    for cone in program.cones:
        squares = list[Expr | float]()
        for i in range(cone.start, cone.stop):
            entries = slice(A.indptr[i], A.indptr[i + 1])
            row, first = _linear(A.data[entries], A.indices[entries], z) - float(program.lower[i]), i == cone.start
            if not len(A.data[entries]):
                squares.append(float(program.lower[i]) ** 2)
                continue
            s = model.addVar(lb=0.0 if first else None)
            model.addCons(s == row)
            squares.append(s * s)
        model.addCons(quicksum(squares[1:]) - squares[0] <= 0)
    return model, z


def _linear(values: Array, columns: Iterable[int], z: list[Variable]) -> Expr:
    return quicksum(float(value) * z[j] for value, j in zip(values, columns, strict=True))


def set_objective(model: Model, program: Program, z: list[Variable]) -> None:
    """Minimise the cost of a program in the variables of its model."""
    linear = _linear(program.q, np.arange(len(z)), z) + program.constant
    squares = list[Expr]()
    # the columns of L, P = L L', block by block
    _, labels = connected_components(program.P, directed=False)
    block = np.where(abs(program.P).sum(axis=0) > 0, labels, -1)
    for b in np.unique(block[block >= 0]):
        columns = np.flatnonzero(block == b)
        eigenvalues, vectors = np.linalg.eigh(program.P[columns][:, columns].toarray())
        for value, vector in zip(eigenvalues, vectors.T, strict=True):
            if value > NEGLIGIBLE_EIGENVALUE * eigenvalues[-1]:
                y = model.addVar(lb=None)
                model.addCons(y == _linear(np.sqrt(value) * vector, columns, z))
                squares.append(y * y)
    if not squares:
        model.setObjective(linear)
        return
    epigraph, more, less = model.addVar(lb=0.0), model.addVar(lb=0.0), model.addVar(lb=None)
    model.addCons(more == epigraph + 0.5)
    model.addCons(less == epigraph - 0.5)
    model.addCons(quicksum(squares) + less * less - more * more <= 0)
    model.setObjective(epigraph + linear)


def _finite(bound: float) -> float | None:
    return float(bound) if np.isfinite(bound) else None
