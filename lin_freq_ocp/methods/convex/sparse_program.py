"""One sparse convex program in suitable units, solved by a backend, and its answer as trajectory and multipliers.

Each answer of the backend is measured in units of its own size. Further answers follow while the best one is not
proven: rounded in natural units, and in other units, with and without far bounds, which may disturb the solver.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now, seconds_left
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.absorbed_cost import absorb_cost
from lin_freq_ocp.methods.candidate import DEFAULTS, SOLVED_TOLERANCE, Candidate, SolveOptions, require_convex
from lin_freq_ocp.methods.convex.polish import zero_rounding
from lin_freq_ocp.methods.structured.kkt.recursions import can_compile
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, Claim, Solution, Solver, backend
from lin_freq_ocp.program.linear_program import LinearProgram, dense_rows
from lin_freq_ocp.program.passed_bins import PassedBins, passed_bins_of
from lin_freq_ocp.program.program import Program, Residuals, Scaling
from lin_freq_ocp.program.units import (
    bounds_scaling,
    natural_scaling,
    plain_scaling,
    point_scaling,
    point_sizes,
    revised_scaling,
    stated_scaling,
)
from lin_freq_ocp.transform.reductions import reduce_problem
from lin_freq_ocp.transform.sizes import stated_sizes

REDUCTIONS = (absorb_cost,)  # applied to a problem before it becomes a program
ROUNDING_LEVELS = (1e-12, 1e-9)  # of the units of variables and duals: smaller values may be rounding errors
LARGEST_ERROR = 1e-3  # relative residuals up to which a point is rounded
GRACE = 0.25  # seconds after a time limit in which a solver may still return a point
REVISIONS = 2  # of the units by the size of the answer, at most
MOST_PROGRAMS = 32  # in a cache
FIRST_ROWS = 2  # rows of single times per coefficient of a passed bin, in the first round
GOLDEN = (np.sqrt(5.0) - 1) / 2  # its multiples, less whole numbers, are spread evenly
NEAR_ROW = 0.1  # distance of a row of order 1 from its limit, from which on it is left out again
ROW_VIOLATION = 1e-9  # of rows of order 1 that are left out
LAST_LEAVING = 20  # round
FIRST_ROUNDS = 1  # of the exchange in units of the data
OTHER_UNIT = 1e6  # largest factor between the units of a signal before and after a revision
# The sparse program has a dense row for every frequency constraint, and its time grows with the entries of these rows;
# the structured method has none, but needs more time for a small problem. Measured by scripts/benchmark.py choice.
DENSE_ENTRIES = 3e4  # of dense rows, above which the structured method is faster; both take 0.2 s there
PLAIN_ENTRIES = 1.2e5  # the same without compiled loops
VARIABLES = 9e3  # of a program without dense rows, above which it is a little faster, if its loops are compiled
ACCURATE_ANSWER = 1e-8  # relative residuals up to which an answer of Clarabel is not improved by other units
DIVERGED_SIZE = 1e100  # size, in expected units, of a diverged point
FAR_BOUND = 1e4  # size, in expected units, from which bounds disturb solvers and are left out at first


def solve_convex(problem: OptimalControlProblem, backend_name: str, options: SolveOptions = DEFAULTS) -> Candidate:
    """Solve a problem with linear dynamics and a convex quadratic cost, in units in which it should be of order 1.

    If the answer has other sizes, the problem is also solved in the units of these, and the answer with the smaller
    residuals is returned. UnsupportedError if the cost is not convex, the backend is unknown, or the program does not
    fit into memory.
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
        last_first = reversed(self._known)  # the match is as many programs back as there are steps in a hop
        known = next((entry for entry in last_first if linear.share_matrices(entry[0])), None)
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
    """Yield the answer of ``solve_convex``, then others until the time limit, in case the first is not proven.

    After Ctrl-C the last one is the first again, interrupted. ``programs`` are those of like problems. Raises the
    errors of ``solve_convex``.
    """
    require_convex(problem)
    reduced = reduce_problem(problem, REDUCTIONS)
    if reduced.links:
        yield from map(reduced.recover, convex_candidates(reduced.problem, backend_name, options, programs))
        return
    if problem.response is not None:
        yield from _response_candidates(problem, problem.response, backend(backend_name), options)
        return
    tolerance, time_limit = options.tolerance, options.time_limit
    solver = backend(backend_name)
    started = now()
    rows = dense_rows(problem)
    if time_limit is not None and rows.seconds > time_limit + GRACE:
        program = f"a program of {rows.variables} variables with {rows.count} dense rows"
        message = f"time limit of {time_limit:.3g} s; {program} needs about {rows.seconds:.2g} s"
        yield Candidate(Status.LIMIT, message=message, seconds={"setup": 0.0, "solve": 0.0})
        return
    programs = programs or ProgramCache()
    linear, scaling = programs.program(problem)
    ready = now()
    end = np.inf if time_limit is None else started + time_limit - rows.factorisation_seconds
    if ready >= end + GRACE:
        message = f"time limit of {time_limit:.3g} s, over before the solver began"
        yield Candidate(Status.LIMIT, message=message, seconds={"setup": ready - started, "solve": 0.0})
        return
    target, asked = max(SOLVED_TOLERANCE, tolerance or 0.0), tolerance or DEFAULT_TOLERANCE
    if backend_name == "clarabel":  # its last steps cost little, and often lead to a proof
        target, asked = ACCURATE_ANSWER, min(asked, DEFAULT_TOLERANCE)
    solves = ScaledSolver(linear, solver, tolerance, asked, end, target)
    best = _revise_units(solves, solves.attempt(scaling))
    if best.z is not None and best.scaling is not scaling:
        programs.revise_units(best.scaling)
    seconds = {"setup": ready - started, "solve": now() - ready}
    yield replace(best.candidate, seconds=seconds)
    for candidate in other_candidates(solves, scaling, best):
        yield replace(candidate, seconds={**seconds, "solve": now() - ready})


def _response_candidates(
    problem: OptimalControlProblem, response: Response, solver: Solver, options: SolveOptions
) -> Iterator[Candidate]:
    """Yield the answer of a frequency response in the passed bins of its controls, in units of its size.

    The first round, in units of the data, finds the size.
    """
    started, linear = now(), LinearProgram(problem)
    end = np.inf if options.time_limit is None else started + options.time_limit
    units, setup = stated_sizes(problem), 0.0
    for attempt in range(1 + REVISIONS):
        bins = passed_bins_of(linear, response, linear.column_units(*units))
        setup = setup or now() - started
        tolerance = options.tolerance or DEFAULT_TOLERANCE
        solution, final = _exchange_rows(bins, solver, tolerance, end, FIRST_ROUNDS if attempt == 0 else np.inf)
        if final:
            candidate = _candidate_in_bins(bins, solution)
            yield replace(candidate, seconds={"setup": setup, "solve": now() - started - setup})
            if candidate.trajectory is None or now() >= end or candidate.interrupted:
                return
        assert solution.z is not None
        change = linear.direction(bins.point(solution.z))
        sizes = zip((change.x, change.u), units, strict=True)
        units = tuple(np.clip(np.abs(part).max(axis=0), unit / OTHER_UNIT, unit * OTHER_UNIT) for part, unit in sizes)


def _exchange_rows(
    bins: PassedBins, solver: Solver, tolerance: float, end: float, most_rounds: float
) -> tuple[Solution, bool]:
    """Solve with few of the rows that stand alone, and with more where these are violated most, until none is.

    Return the solution, with duals of all rows, and whether it is final: no row is violated, or there is no optimum.
    The first rows are spread evenly. Of rows next to each other, which are those of one time or the next, the most
    violated one joins; rows far from their limits leave, at first.
    """
    single = np.flatnonzero(bins.single)
    wanted = min(len(single), FIRST_ROWS * bins.basis.shape[1])
    chosen = ~bins.single
    chosen[single[np.unique((len(single) * (np.arange(wanted) * GOLDEN % 1)).astype(int))]] = True
    rounds = 0
    while True:
        rounds += 1
        solution = solver(bins.program(chosen), tolerance, seconds_left(end))
        y = None if solution.y is None else np.zeros(len(chosen))
        if y is not None:
            y[chosen] = solution.y
        solution = replace(solution, y=y)
        if solution.claim is Claim.UNBOUNDED and not chosen.all():
            chosen[:] = True
        elif solution.claim is Claim.SOLVED and solution.z is not None:
            violation = bins.violations(solution.z)
            near, violation = violation > -NEAR_ROW, np.where(chosen, -np.inf, violation)
            around = np.pad(violation, 1, constant_values=-np.inf)
            most = (violation > ROW_VIOLATION) & (violation >= np.maximum(around[:-2], around[2:]))
            if not most.any() or rounds >= most_rounds:
                return solution, not most.any()
            chosen = most | ~bins.single | (chosen & (near | (rounds > LAST_LEAVING)))  # so that the rounds end
        else:
            return solution, True


def _candidate_in_bins(bins: PassedBins, solution: Solution) -> Candidate:
    """Return a solver's answer in w as a trajectory with multipliers, a ray or a direction."""
    claim, message, w, y = solution.claim, solution.message, solution.z, solution.y
    if claim is Claim.INFEASIBLE:
        size = 0.0 if y is None else float(np.abs(y).max(initial=0.0))  # a ray has no size of its own
        ray = bins.multipliers(y / size, None) if y is not None and 0 < size < np.inf else None
        return Candidate(Status.INFEASIBLE, ray=ray, message=message)
    if claim is Claim.UNBOUNDED:
        along = None if w is None else bins.linear.direction(bins.units * bins.change(w))
        return Candidate(Status.UNBOUNDED, message=message, descent=along)
    message = f"time limit: {message}" if claim is Claim.TIME_LIMIT else message
    status = {Claim.SOLVED: Status.OPTIMAL, Claim.FAILED: Status.NUMERICAL_ERROR}.get(claim, Status.LIMIT)
    interrupted = claim is Claim.INTERRUPTED
    if w is None or y is None or not np.abs(np.append(w, y)).max(initial=0.0) < DIVERGED_SIZE:
        return Candidate(status, message=message, interrupted=interrupted)
    z = bins.point(w)
    found = bins.linear.trajectory(z), bins.multipliers(y, z)
    return Candidate(status, *found, message=message, interrupted=interrupted)


def _revise_units(solves: ScaledSolver, attempt: ScaledAnswer) -> ScaledAnswer:
    """Return the attempt, or a better one in the units of its point."""
    best = attempt
    for _ in range(REVISIONS):
        if best.ended or best.z is None or best.error <= solves.target or solves.over:
            break
        revised = revised_scaling(solves.linear, best.scaling, best.z)
        if revised is None:
            break
        attempt = solves.attempt(revised)
        if not attempt.ended and attempt.error >= best.error:
            break
        best = better_of(best, attempt)
    return best


def other_candidates(solves: ScaledSolver, natural: Scaling, best: ScaledAnswer) -> Iterator[Candidate]:
    """Yield candidates other than the best attempt until the time limit or Ctrl-C; ``natural``: the expected units."""
    if best.ended:
        return
    yield from _round_point(solves, natural, best)
    linear = solves.linear
    for scaling in (plain_scaling(linear), stated_scaling(linear), bounds_scaling(linear, natural)):
        for solve in (solves.solve_with_all_bounds, solves.solve_without_far_bounds):
            attempt = None if solves.over else solve(scaling)
            if attempt is None:
                continue
            if attempt.ended:
                if attempt.candidate.interrupted:
                    yield replace(best.candidate, interrupted=True)
                return
            if attempt.z is not None or attempt.candidate.status in (Status.INFEASIBLE, Status.UNBOUNDED):
                yield attempt.candidate


def _round_point(solves: ScaledSolver, natural: Scaling, attempt: ScaledAnswer) -> Iterator[Candidate]:
    """Yield a point with exact zeros in place of rounding errors, judged by the natural units, if that changes it."""
    if attempt.z is None or attempt.y is None or attempt.error > LARGEST_ERROR:
        return
    program, before = solves.linear.sparse.scaled(natural), (attempt.z, attempt.y)
    for level in ROUNDING_LEVELS:
        z = zero_rounding(attempt.z, natural.columns, level)
        y = zero_rounding(attempt.y, natural.rows / natural.cost, level)
        if np.array_equal(z, before[0]) and np.array_equal(y, before[1]):
            continue
        before = z, y
        scaled = natural.scaled_primal(z), natural.scaled_dual(y)
        yield solves.recover(natural, program, Solution(Claim.SOLVED, *scaled, attempt.candidate.message)).candidate


def structured_first(problem: OptimalControlProblem) -> str:
    """Return why the structured method comes before the sparse program; an empty text if it does not."""
    signals = problem.state_dim, problem.control_dim
    if any(len(term.map.locations) and term.map.spectrum_form(*signals) is None for term in problem.terms):
        return "close frequencies of a mask cost the sparse program digits"
    rows = dense_rows(problem)
    if rows.entries >= PLAIN_ENTRIES or (rows.entries >= DENSE_ENTRIES and can_compile()):
        return f"the sparse program would have {rows.count} dense rows"
    if rows.variables >= VARIABLES and can_compile():
        return f"the sparse program would have {rows.variables} variables"
    return ""


@dataclass(frozen=True, eq=False)
class ScaledAnswer:
    """The answer of a solver in given units; a point z with duals y is in the units of the program."""

    candidate: Candidate
    scaling: Scaling
    error: float = np.inf  # the largest residual; that of a point in units of its own size
    z: Array | None = None
    y: Array | None = None
    late: bool = False  # whether the time limit ended it

    @property
    def ended(self) -> bool:
        """Whether the solve was the last: interrupted, or at the time limit."""
        return self.candidate.interrupted or self.late


@dataclass(frozen=True, eq=False)
class ScaledSolver:
    """A program with a solver and its limits, which is solved in one system of units after another."""

    linear: LinearProgram
    solver: Solver
    tolerance: float | None  # that the user asks for
    solver_tolerance: float
    end: float  # by clock.now
    target: float  # residuals from which an answer is not improved

    @property
    def over(self) -> bool:
        """Whether there is no time left."""
        return now() >= self.end

    def attempt(self, scaling: Scaling) -> ScaledAnswer:
        """Solve in the given units, at first without far bounds."""
        program = self.linear.sparse.scaled(scaling)
        near = program.without_bounds_beyond(FAR_BOUND)
        attempt = self._solve(near or program, scaling)
        final = attempt.ended or attempt.candidate.status in (Status.OPTIMAL, Status.INFEASIBLE) or self.over
        if near is None or final:
            return attempt
        complete = self._solve(program, scaling)
        return complete if attempt.candidate.status == Status.UNBOUNDED else better_of(attempt, complete)

    def solve_with_all_bounds(self, scaling: Scaling) -> ScaledAnswer:
        """Solve in the given units with all bounds."""
        return self._solve(self.linear.sparse.scaled(scaling), scaling)

    def solve_without_far_bounds(self, scaling: Scaling) -> ScaledAnswer | None:
        """Solve without far bounds; None if no bound is far, or if the program is unbounded without them."""
        near = self.linear.sparse.scaled(scaling).without_bounds_beyond(FAR_BOUND)
        attempt = None if near is None else self._solve(near, scaling)
        return None if attempt is None or attempt.candidate.status == Status.UNBOUNDED else attempt

    def recover(self, scaling: Scaling, program: Program, solution: Solution) -> ScaledAnswer:
        """Return a solver's answer, which is in the units of ``scaling``, as a measured trajectory with multipliers."""
        z, y, claim = solution.z, solution.y, solution.claim
        late = claim is Claim.TIME_LIMIT
        interrupted = claim is Claim.INTERRUPTED
        unsolved = Status.LIMIT if late else Status.NUMERICAL_ERROR
        failed = Candidate(unsolved, message=solution.message, interrupted=interrupted)
        with np.errstate(over="ignore"):
            finite = y is None or bool(np.isfinite(scaling.dual(y)).all())
        if not finite:  # too large for the units of the problem
            return ScaledAnswer(failed, scaling)
        if claim is Claim.INFEASIBLE:
            ray = None if y is None else self.linear.multipliers(scaling.dual(y), 0.0)
            error = np.inf if y is None else program.infeasibility_residual(y)
            return ScaledAnswer(Candidate(Status.INFEASIBLE, ray=ray, message=solution.message), scaling, error)
        if claim is Claim.UNBOUNDED:
            along = None if z is None else self.linear.direction(scaling.primal(z))  # which the judge projects
            return ScaledAnswer(Candidate(Status.UNBOUNDED, message=solution.message, descent=along), scaling, 0.0)
        if z is None or y is None:
            return ScaledAnswer(failed, scaling, late=late)
        if not program.P.nnz and not program.q.any():
            y = np.zeros_like(y)  # without a cost, multipliers of zero are exact, and the solver's are rounding errors
        point, duals = scaling.primal(z), scaling.dual(y)
        residuals = Residuals(np.inf, np.inf, np.inf)
        if (np.abs(point) < DIVERGED_SIZE * scaling.columns).all():  # in the units of the point
            units = point_scaling(self.linear, point, scaling.columns)
            scaled, sizes = units.scaled_primal(point), units.scaled_primal(point_sizes(self.linear, point))
            with np.errstate(over="ignore", invalid="ignore"):  # residuals that are not finite are no small ones
                residuals = self.linear.sparse.scaled(units).residuals(scaled, units.scaled_dual(duals), sizes)
        if late or claim in (Claim.LIMIT, Claim.INTERRUPTED):
            status = Status.LIMIT
        else:
            solved = residuals.worst <= max(SOLVED_TOLERANCE, self.tolerance or 0.0)
            status = Status.OPTIMAL if solved else Status.NUMERICAL_ERROR
        found = self.linear.trajectory(point), self.linear.multipliers(duals, 1.0)
        candidate = Candidate(status, *found, None, residuals, solution.message, interrupted=interrupted)
        if not np.isfinite(residuals.worst):
            point, duals = None, None
        return ScaledAnswer(candidate, scaling, residuals.worst, point, duals, late)

    def _solve(self, program: Program, scaling: Scaling) -> ScaledAnswer:
        solution = self.solver(program, self.solver_tolerance, seconds_left(self.end))
        return self.recover(scaling, program, solution)


def better_of(first: ScaledAnswer, second: ScaledAnswer) -> ScaledAnswer:
    """Return the attempt with the smaller residuals; the first if the second was cut short."""
    if second.ended:
        return replace(first, candidate=replace(first.candidate, interrupted=second.candidate.interrupted))
    return second if second.error < first.error else first
