"""One sparse convex program: made, scaled, solved by a backend, measured, and mapped back.

Where the best answer is not proven, others follow. Small residuals of a program do not suffice if a component that
should be zero holds rounding, which is judged by its own size, or if a far bound disturbed the solver. So answers are
polished and rounded, and the program is solved in other units, with and without far bounds. Trajectories without cost
or slope are computed directly: solvers approach them only to the root of their tolerance.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.methods.absorbed_cost import ABSORBED_COST
from lin_freq_ocp.methods.candidate import DEFAULTS, SOLVED_TOLERANCE, Candidate, SolveOptions, require_convex
from lin_freq_ocp.methods.convex.attempts import ACCURATE_ANSWER, Attempt, Solves, better_of
from lin_freq_ocp.methods.convex.polish import polish_point, without_rounding
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reductions import reduce_problem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, Claim, Solution, backend
from lin_freq_ocp.program.linear_program import LinearProgram, dense_rows
from lin_freq_ocp.program.program import Program, Scaling
from lin_freq_ocp.program.units import (
    bounds_scaling,
    natural_scaling,
    own_scaling,
    plain_scaling,
    revised_scaling,
    scaled_program,
    stated_scaling,
)

REDUCTIONS = (ABSORBED_COST,)  # of a problem, before it is transcribed
ROUNDING_LEVELS = (1e-12, 1e-9)  # parts of the units of variables and duals that may be rounding: the judge decides
LARGEST_ERROR = 1e-3  # relative residuals up to which versions of a point are judged
FLAT_SLOPE = 1e-4  # slope, relative to its terms, below which a trajectory without slope may exist nearby
GRACE = 0.25  # seconds beyond a time limit in which a solver may return a point
REVISIONS = 2  # of the units by the answer
MOST_PROGRAMS = 32  # that a cache holds
# The sparse program needs a dense row for every frequency constraint, and its time grows with the entries of these
# rows; the structured method needs none, but more time for a small problem. Measured by scripts/benchmark.py choice.
DENSE_ENTRIES = 3e4  # of dense rows, from which the structured method is the faster one; both take 0.2 s there
PLAIN_ENTRIES = 1.2e5  # the same without compiled loops
VARIABLES = 9e3  # of a program without dense rows, from which it is, by a little; compiled only


def solve_convex(problem: OptimalControlProblem, backend_name: str, options: SolveOptions = DEFAULTS) -> Candidate:
    """Solve a problem with linear dynamics and a convex quadratic cost, in units in which it should be of order 1.

    Where the answer shows other sizes, or is inaccurate, it is solved again in other units; the smallest residuals
    count. UnsupportedError if the cost is not convex, the backend is unknown, or the program does not fit into memory.
    """
    return next(convex_candidates(problem, backend_name, options))


class ProgramCache:
    """Programs of like problems, with their units: one with the same matrices lends these to the next.

    In a control loop with windows over applied samples, as many programs take turns as there are steps in a hop.
    """

    def __init__(self):
        self._known = deque[tuple[LinearProgram, Scaling]](maxlen=MOST_PROGRAMS)

    def program(self, problem: OptimalControlProblem) -> tuple[LinearProgram, Scaling]:
        """Return the program of a problem, and the units in which it should be of order 1."""
        linear = LinearProgram(problem)
        known = next((entry for entry in self._known if linear.share_matrices(entry[0])), None)
        if known is not None:
            self._known.remove(known)  # and is the last again
        scaling = natural_scaling(linear) if known is None else known[1]
        self._known.append((linear, scaling))
        return linear, scaling

    def revise_units(self, scaling: Scaling) -> None:
        """Replace the units of the last program: those were not of order 1."""
        self._known.append((self._known.pop()[0], scaling))


def convex_candidates(
    problem: OptimalControlProblem,
    backend_name: str,
    options: SolveOptions = DEFAULTS,
    programs: ProgramCache | None = None,
) -> Iterator[Candidate]:
    """Yield what ``solve_convex`` returns, then other answers, until the time limit, for where the first is not proven.

    After Ctrl-C the last is the first again, interrupted. ``programs`` are those of like problems. Raises what
    ``solve_convex`` raises.
    """
    require_convex(problem)
    reduced = reduce_problem(problem, REDUCTIONS)
    if reduced.inverses:
        yield from map(reduced.recover, convex_candidates(reduced.problem, backend_name, options, programs))
        return
    tolerance, time_limit = options.tolerance, options.time_limit
    solver = backend(backend_name)
    started = now()
    rows = dense_rows(problem)
    if time_limit is not None and rows.seconds > time_limit + GRACE:
        program = f"a program of {rows.variables} variables with {rows.count} dense rows"
        message = f"time limit of {time_limit:.3g} s; {program} needs about {rows.seconds:.2g} s"
        yield Candidate("limit", message=message, seconds={"setup": 0.0, "solve": 0.0})
        return
    programs = programs or ProgramCache()
    linear, scaling = programs.program(problem)
    ready = now()
    end = np.inf if time_limit is None else started + time_limit - rows.factorisation_seconds
    if ready >= end + GRACE:
        message = f"time limit of {time_limit:.3g} s, over before the solver began"
        yield Candidate("limit", message=message, seconds={"setup": ready - started, "solve": 0.0})
        return
    interior = backend_name == "clarabel"  # its last steps cost little, and often lead to a proof
    target = max(ACCURATE_ANSWER if interior else SOLVED_TOLERANCE, 0.0 if interior else tolerance or 0.0)
    asked = DEFAULT_TOLERANCE if tolerance is None else min(tolerance, DEFAULT_TOLERANCE) if interior else tolerance
    solves = Solves(linear, solver, tolerance, asked, end, target)
    best = _revise_units(solves, solves.attempt(scaling))
    # other units where it is not accurate, each from the best attempt so far
    ways: list[Callable[[Attempt], Attempt]] = [
        lambda best: solves.attempt(
            scaling if best.z is None else own_scaling(linear, best.z, scaling.columns, per_time=True)
        ),
        lambda best: solves.attempt(stated_scaling(linear)),
        lambda best: solves.attempt(plain_scaling(linear)),
    ]
    if asked > DEFAULT_TOLERANCE:
        ways.insert(0, lambda best: solves.attempt(best.scaling, DEFAULT_TOLERANCE))
    for attempt in ways:
        if best.ended or best.error <= max(SOLVED_TOLERANCE, tolerance or 0.0) or solves.over:
            break
        best = better_of(best, _revise_units(solves, attempt(best)))
    if best.z is not None and best.scaling is not scaling:
        programs.revise_units(best.scaling)
    seconds = {"setup": ready - started, "solve": now() - ready}
    yield replace(best.candidate, seconds=seconds)
    for candidate in other_candidates(solves, scaling, best):
        yield replace(candidate, seconds={**seconds, "solve": now() - ready})


def _revise_units(solves: Solves, attempt: Attempt) -> Attempt:
    """Return the attempt, or a better one in units of its own answer."""
    best = attempt
    for _ in range(REVISIONS):
        if best.ended or best.z is None or best.error <= solves.target or solves.over:
            break
        revised = revised_scaling(solves.linear, best.scaling, best.z)
        if revised is None:
            break
        second = solves.attempt(revised)
        if not second.ended and second.error >= best.error:
            break
        best = better_of(best, second)
    return best


def other_candidates(solves: Solves, natural: Scaling, best: Attempt) -> Iterator[Candidate]:
    """Yield other candidates than the best attempt until the time limit or Ctrl-C; ``natural``: the expected units."""
    if best.ended:
        return
    yield from _versions(solves, natural, best)
    linear = solves.linear

    def own(attempt: Attempt, per_time: bool) -> Scaling | None:
        return None if attempt.z is None else own_scaling(linear, attempt.z, natural.columns, per_time)

    # units that need a point come last, and take the best point so far: the residual of a ray says nothing about it
    best_point = best if best.z is not None else replace(best, error=np.inf)
    others: list[Callable[[Attempt], Scaling | None]] = [
        lambda _: plain_scaling(linear),
        lambda _: stated_scaling(linear),
        lambda _: natural,
        lambda _: bounds_scaling(linear, natural),
        lambda attempt: own(attempt, per_time=False),
        lambda attempt: own(attempt, per_time=True),
    ]
    for units in others:
        for solve in (solves.complete, solves.near):
            if solves.over:
                return
            scaling = units(best_point)
            attempt = None if scaling is None else solve(scaling)
            if attempt is None:
                continue
            if attempt.ended:
                if attempt.candidate.interrupted:
                    yield replace(best.candidate, interrupted=True)
                return
            if attempt.z is not None or attempt.candidate.status in ("infeasible", "unbounded"):
                yield attempt.candidate
            yield from _versions(solves, natural, attempt)
            best_point = best_point if attempt.z is None else better_of(best_point, attempt)


def _versions(solves: Solves, natural: Scaling, attempt: Attempt) -> Iterator[Candidate]:
    """Yield a point with exact zeros for rounding, polished, and both."""
    if attempt.z is None or attempt.y is None or attempt.error > LARGEST_ERROR:
        return
    yield from _rounded_versions(solves, natural, attempt)
    program = solves.linear.sparse.scaled(attempt.scaling)
    if program.cones or solves.over:
        return
    scaling = attempt.scaling
    found = polish_point(program, scaling.scaled_primal(attempt.z), scaling.scaled_dual(attempt.y))
    if found is not None:
        better = solves.recovered(scaling, program, Solution(Claim.SOLVED, *found, "polished"))
        if better.z is not None and better.error <= LARGEST_ERROR:
            yield better.candidate
            yield from _rounded_versions(solves, natural, better)


def _rounded_versions(solves: Solves, natural: Scaling, attempt: Attempt) -> Iterator[Candidate]:
    """Yield a point with exact zeros for what is rounding in the natural units, if that changes it."""
    assert attempt.z is not None
    assert attempt.y is not None
    program, before = solves.linear.sparse.scaled(natural), (attempt.z, attempt.y)
    for level in ROUNDING_LEVELS:
        z = without_rounding(attempt.z, natural.columns, level)
        y = without_rounding(attempt.y, natural.rows / natural.cost, level)
        if np.array_equal(z, before[0]) and np.array_equal(y, before[1]):
            continue
        before = z, y
        scaled = natural.scaled_primal(z), natural.scaled_dual(y)
        yield solves.recovered(natural, program, Solution(Claim.SOLVED, *scaled, attempt.candidate.message)).candidate


def free_of_cost(problem: OptimalControlProblem, near: Trajectory) -> Candidate | None:
    """Return the trajectory of controls at their references, with multipliers of zero; None if it diverges.

    Controls without a cost, and the first state, are those of ``near``.
    """
    cost, (T, m) = problem.quadratic, near.u.shape
    priced = np.broadcast_to(np.diagonal(cost.R, axis1=-2, axis2=-1) > 0, (T, m))
    u = np.where(priced, cost.u_ref, near.u)
    follows = problem.dynamics.response(T) is not None  # x_0, too, from the controls
    try:
        trajectory = simulate(problem, u, None if follows else problem.state_tube.at(0).project(near.x[0]))
    except NumericalError:
        return None
    rho_u, rho_x = np.zeros(problem.control_stop.shape), np.zeros(problem.state_stop.shape)
    none = Multipliers(1.0, np.zeros((T, near.x.shape[1])), np.zeros_like(near.x), np.zeros((T, m)), rho_u, rho_x)
    return Candidate("optimal", trajectory, none, message="controls at their references")


def free_of_slope(problem: OptimalControlProblem, near: Trajectory, time_limit: float | None) -> Candidate | None:
    """Return a trajectory that satisfies all constraints and P z + q = 0, with multipliers of zero, or None.

    It is computed where the slope at ``near`` is small.
    """
    if any(not term.hard for term in problem.terms):
        return None
    # the largest slope of the cost, relative to that of terms of the stated sizes
    signals = near.x, near.u
    steady = [np.broadcast_to(size, at.shape) for size, at in zip(stated_sizes(problem), signals, strict=True)]
    slopes = zip(problem.quadratic.gradient(*signals), steady, strict=True)
    usual = zip(problem.quadratic.gradient_magnitudes(*steady), steady, strict=True)
    most, least = (max(float(np.abs(g * size).max()) for g, size in pairs) for pairs in (usual, slopes))
    if not most > 0 or least / most > FLAT_SLOPE:
        return None
    linear, scaling, program = scaled_program(problem)
    curved = np.flatnonzero(abs(program.P).sum(1) + np.abs(program.q))
    flat = Program(
        P=sp.csc_array(program.P.shape),
        q=np.zeros_like(program.q),
        constant=0.0,
        A=sp.csc_array(sp.vstack([program.A, program.P[curved]])),
        lower=np.concatenate([program.lower, -program.q[curved]]),
        upper=np.concatenate([program.upper, -program.q[curved]]),
        rows=program.rows,
        cones=program.cones,
    )
    solution = backend("clarabel")(flat, DEFAULT_TOLERANCE, time_limit)
    if solution.claim is not Claim.SOLVED or solution.z is None or solution.y is None:
        return None
    better = None if program.cones else polish_point(flat, solution.z, np.zeros_like(solution.y))
    z: Array = scaling.primal(solution.z if better is None else better[0])
    none = linear.multipliers(np.zeros(len(program.lower)), 1.0)
    return Candidate("optimal", linear.trajectory(z), none, message="a point where the cost has no slope")


def structured_first(problem: OptimalControlProblem) -> str:
    """Return why the structured method is taken before the sparse program; an empty text if it is not."""
    signals = problem.state_dim, problem.control_dim
    if any(len(term.map.locations) and term.map.spectrum_form(*signals) is None for term in problem.terms):
        return "frequencies of a mask that are close together cost the sparse program digits"
    rows, compiled = dense_rows(problem), find_spec("numba") is not None
    if rows.entries >= (DENSE_ENTRIES if compiled else PLAIN_ENTRIES):
        return f"the sparse program would have {rows.count} dense rows"
    if compiled and rows.variables >= VARIABLES:
        return f"the sparse program would have {rows.variables} variables"
    return ""
