"""DAQP: branch and bound on dense strictly convex quadratic programs, by a dual active-set method.

DAQP needs three things that a program does not have:

- curvature in the binaries: delta^2 - delta is added, which is 0 at both of their values;
- curvature elsewhere: if P is singular, a small multiple of |z|^2 is added, and the bound is lowered by the largest
  possible effect of that;
- no fixed variables: they are removed.

It cannot be interrupted: a Ctrl-C counts when it returns, at the latest at the time limit.
"""

from __future__ import annotations

from dataclasses import replace

import daqp
import numpy as np
from scipy.sparse.csgraph import connected_components

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.interrupts import interrupts_noted
from lin_freq_ocp.program.backends.base import CONTRADICTION, NO_POINT, Claim, Solution
from lin_freq_ocp.program.program import Program

# Of delta^2 - delta: much more weakens the relaxations, much less makes all rows parallel in DAQP's metric. The second
# is tried if DAQP cycles with the first or finds nothing: of 200 random problems, it never cycled with both.
BINARY_CURVATURES = (0.1, 0.01)
SINGULAR_BLOCK = 1e-7  # eigenvalue, relative to the largest row sum of P, below which a block of P is regularised ...
BLOCK_REGULARISATION = 1e-7  # ... by this, relative to the same: some 1e-6 of the cost where variables are of order 1
# Of rows of order 1. With 1e-8, one of 60 random problems was called infeasible wrongly; with its own 1e-6, costs were
# too low by 5e-6.
DAQP_FEASIBILITY = 1e-7
DAQP_INFINITE = 1e30  # as DAQP has it
DAQP_LEAST_TIME = 1e-6  # seconds given to DAQP when none is left: it says that its limit was reached
EQUATION, BINARY = 5, 16  # kinds of rows

CLAIMS = {
    1: (Claim.SOLVED, "optimal"),
    4: (Claim.SOLVED, "optimal, but inexact"),
    5: (Claim.LIMIT, "feasible, stopped early"),
    -1: (Claim.INFEASIBLE, "infeasible"),
    -2: (Claim.FAILED, "cycling"),
    -3: (Claim.UNBOUNDED, "unbounded"),
    -4: (Claim.LIMIT, "iteration limit"),
    -5: (Claim.FAILED, "not convex"),
    -6: (Claim.FAILED, "equations depend on each other"),
    -7: (Claim.TIME_LIMIT, "time limit"),
}


def solve(program: Program, gap: float, time_limit: float | None) -> Solution:
    """Solve; an answer at a limit has no bound."""
    started, found = now(), list[Solution]()
    for curvature in BINARY_CURVATURES:
        left = None if time_limit is None else time_limit - (now() - started)
        if found and left is not None and left <= 0:
            break
        found.append(_attempt(program, curvature, None if left is None else max(left, DAQP_LEAST_TIME), gap))
        if found[-1].claim not in (Claim.INFEASIBLE, Claim.FAILED):
            break
    answers = [solution for solution in found if solution.claim is not Claim.FAILED]
    last = answers[-1] if answers else found[-1]
    return replace(last, message="; then ".join(solution.message for solution in found))


def _attempt(program: Program, curvature: float, time_limit: float | None, gap: float) -> Solution:
    """Solve with one curvature of the binaries."""
    rows = program.single_bounds()
    # strictly convex, without its fixed variables
    free = np.flatnonzero(rows.below < rows.above)
    fixed = np.where(rows.below < rows.above, 0.0, rows.below)
    A, shift = rows.A.toarray()[:, free], rows.A @ fixed
    lower, upper = rows.lower - shift, rows.upper - shift
    empty = ~A.any(axis=1)
    if rows.violation > CONTRADICTION or (np.maximum(lower, -upper)[empty] > CONTRADICTION).any():
        return NO_POINT
    # blocks of P that are not strictly convex get a small multiple of the identity
    added, binaries = np.zeros(len(program.q)), program.binaries
    block = np.asarray(connected_components(program.P, directed=False)[1], dtype=np.intp)
    block[binaries] = -1
    largest = float(abs(program.P).sum(axis=0).max(initial=0.0)) or 1.0
    for b in np.unique(block[block >= 0]):
        columns = np.flatnonzero(block == b)
        if np.linalg.eigvalsh(program.P[columns][:, columns].toarray())[0] < SINGULAR_BLOCK * largest:
            added[columns] = BLOCK_REGULARISATION * largest
    hessian, gradient = program.P.toarray() + np.diag(added), program.q.copy()
    hessian[binaries, binaries] += 2 * curvature
    gradient[binaries] -= curvature
    # bounds of variables are the first rows
    below, above = (np.append(*pair) for pair in ((rows.below[free], lower[~empty]), (rows.above[free], upper[~empty])))
    kinds = np.where(below == above, EQUATION, 0)
    kinds[: len(free)][np.isin(free, binaries)] = BINARY
    x, flag, nodes = np.zeros(0), 1, 0
    with interrupts_noted() as noted:
        if len(free):
            x, _, flag, info = daqp.solve(
                np.ascontiguousarray(hessian[np.ix_(free, free)]),
                (gradient + hessian @ fixed)[free],
                np.ascontiguousarray(A[~empty]),
                np.clip(above, -DAQP_INFINITE, DAQP_INFINITE),
                np.clip(below, -DAQP_INFINITE, DAQP_INFINITE),
                kinds.astype(np.intc),
                primal_tol=DAQP_FEASIBILITY,
                rel_subopt=gap,
                eps_prox=0.0,
                time_limit=0.0 if time_limit is None else time_limit,
            )
            flag, nodes = int(flag), int(info["nodes"])
    claim, message = CLAIMS.get(flag, (Claim.FAILED, f"exit flag {flag}"))
    message = f"{message}, {nodes} nodes"
    if noted.is_set():
        claim, message = Claim.INTERRUPTED, f"interrupted ({message})"
    if flag < 0 or not np.isfinite(x).all():
        return Solution(claim, None, None, message)
    z = fixed.copy()
    z[free] = x
    if claim is not Claim.SOLVED:
        return Solution(claim, z, None, message)
    # the bound that the claim implies, and the part of the cost that regularisation leaves unknown
    objective, own = program.objective(z), 0.5 * float(added @ z**2)
    searched = objective - program.objective(fixed) + own  # DAQP's cost, which the gap is relative to
    widest = np.maximum(np.abs(rows.below), np.abs(rows.above))
    most = 0.5 * float((added * np.where(added > 0, widest, 0.0) ** 2).sum()) - own
    bound = objective - most - gap * abs(searched) if np.isfinite(most) else None
    unsure = (own if bound is None else most) / max(1.0, abs(objective))
    unknown = f", optimal but for {unsure:.1e} by regularisation" if unsure > 0 else ""
    return Solution(claim, z, None, message + unknown, bound)
