"""The structured interior-point method for linear dynamics, in units in which the problem should be of order 1.

The first solve runs the self-dual embedding. If a trajectory of a similar problem is known, a solve begins with its
active rows and pivots among them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.resources import require_memory
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.candidate import DEFAULTS, Candidate, SolveOptions, require_convex
from lin_freq_ocp.methods.structured.active import RowResponses, solve_active
from lin_freq_ocp.methods.structured.assembly import Assembly, assemble_stages
from lin_freq_ocp.methods.structured.choice import choose_kkt_solver, step_seconds
from lin_freq_ocp.methods.structured.embedding import Answer, Embedding, End, Targets
from lin_freq_ocp.methods.structured.kkt.recursions import Loops, loops
from lin_freq_ocp.methods.structured.kkt.system import StepSystem, System
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

MATRICES, VECTORS = 12, 100  # of the size of a stage that are in memory at the same time
LATE = 2.0  # a step may take so many times as long as estimated
MOST_REVISIONS = 3  # of the units by the size of the answer: if nothing has a size, each answer has other units
RESIDUAL, GAP = 1e-10, 1e-9  # relative, by default


def solve_structured(
    problem: OptimalControlProblem,
    options: SolveOptions = DEFAULTS,
    accept_ray: Callable[[Multipliers], bool] = lambda ray: False,
    stage_cache: StageCache | None = None,
) -> Iterator[Candidate]:
    """Solve a problem with linear dynamics and a convex cost; yield the answer, then answers in units of its size.

    ``accept_ray`` tells whether a ray that is still rough proves infeasibility; ``stage_cache`` holds the stages of a
    similar problem. UnsupportedError if the cost is not convex, a term of the problem does not fit, or too many rows
    couple times.
    """
    require_convex(problem)
    time_limit = options.time_limit
    entries = problem.state_dim + problem.control_dim
    size = 8.0 * problem.horizon * entries * (MATRICES * entries + VECTORS)
    method = f"method 'structured' with horizon = {problem.horizon}"
    require_memory(method, size, "Choose a shorter horizon or a longer sampling time.")
    started = now()
    targets = _targets(options)
    end, assembly = targets.end, (stage_cache or StageCache()).assembly(problem)
    recursions = loops(options.compiled)
    setup = now() - started
    needed = 0.0 if time_limit is None else LATE * step_seconds(assembly.stages, recursions)
    if time_limit is not None and now() + needed > end:
        yield Candidate(Status.LIMIT, message=f"time limit of {time_limit:.3g} s; one step may need {needed:.2g} s")
        return
    for _ in range(MOST_REVISIONS + 1):
        system = System(assembly.stages, recursions)
        step = StepSystem(system, choose_kkt_solver(assembly.stages, recursions))
        answer = Embedding(
            system, step, targets, lambda z, assembly=assembly: accept_ray(assembly.multipliers(z, 0.0))
        ).run()
        seconds = {"setup": setup, "solve": now() - started - setup}
        yield _candidate(answer, assembly, seconds)
        revised = assembly.revised(answer.y) if answer.end in (End.OPTIMAL, End.STALLED) else None
        if revised is None or now() + needed > end:
            return
        assembly = revised


def solve_from_warm_start(
    problem: OptimalControlProblem, stage_cache: StageCache, options: SolveOptions = DEFAULTS
) -> Candidate | None:
    """Return the answer from the active rows of the warm start; None without a warm start, or if rows are in cones.

    Raises the errors of ``solve_structured``.
    """
    has_start = stage_cache.warm_start is not None
    if not has_start:
        return None
    require_convex(problem)
    time_limit, started, targets = options.time_limit, now(), _targets(options)
    assembly, recursions = stage_cache.assembly(problem), loops(options.compiled)
    stages, near = assembly.stages, stage_cache.warm_start
    if near is None or stages.cones or stages.coupling.balls:
        return None
    if time_limit is not None and LATE * step_seconds(stages, recursions) > time_limit:
        return None
    responses, system = stage_cache.responses(assembly, recursions), System(stages, recursions)
    answer = solve_active(system, responses, targets, assembly.point(near))
    seconds = {"setup": 0.0, "solve": now() - started}
    return None if answer is None else _candidate(answer, assembly, seconds)


class StageCache:
    """The stages of similar problems and the responses of their rows, made when needed and reused while valid."""

    def __init__(self):
        self.warm_start: Trajectory | None = None  # a trajectory near the next answer
        self._assembly: Assembly | None = None
        self._rows: tuple[Assembly, bool, RowResponses] | None = None

    def __getstate__(self) -> dict[str, object]:
        """Return what another process needs; the responses are made anew: those in C hold addresses."""
        return {**vars(self), "_rows": None}

    def assembly(self, problem: OptimalControlProblem) -> Assembly:
        """Return the stages of a problem: those of the last one with other numbers, if nothing else differs."""
        exchanged = None if self._assembly is None else self._assembly.exchanged(problem)
        if self._assembly is None or exchanged is None or not exchanged.same_matrices(self._assembly):
            self.warm_start = None  # responses of rows pay only if many solves use them
        self._assembly = exchanged or assemble_stages(problem)
        return self._assembly

    def responses(self, assembly: Assembly, loops: Loops) -> RowResponses:
        """Return the responses of the rows, which depend on everything but right-hand sides."""
        if self._rows is None or not self._rows[0].same_matrices(assembly) or self._rows[1] != loops.compiled:
            stages = assembly.stages
            rows = RowResponses(System(stages, loops), choose_kkt_solver(stages, loops))
            self._rows = assembly, loops.compiled, rows
        return self._rows[2]


def _targets(options: SolveOptions) -> Targets:
    """Return residual, gap and end of a solve that begins now."""
    tolerance, end = options.tolerance, np.inf if options.time_limit is None else now() + options.time_limit
    return Targets(RESIDUAL, GAP, end) if tolerance is None else Targets(tolerance, tolerance, end)


def _candidate(answer: Answer, assembly: Assembly, seconds: dict[str, float]) -> Candidate:
    """Return the answer of the embedding, or of pivoting, in the units of the problem."""
    if not all(np.isfinite(part).all() for part in (answer.y, *answer.z)):
        return Candidate(Status.NUMERICAL_ERROR, message="no step has finite numbers", seconds=seconds)
    message, errors = f"{answer.end.value} after {answer.steps} steps", answer.errors
    if answer.end is End.TIME:
        message += f": relative residuals of {max(errors.primal, errors.dual):.0e}, a gap of {errors.gap:.0e}"
    if answer.end is End.INFEASIBLE:
        return Candidate(Status.INFEASIBLE, ray=assembly.multipliers(answer.z, 0.0), message=message, seconds=seconds)
    if answer.end is End.UNBOUNDED:
        return Candidate(Status.UNBOUNDED, descent=assembly.direction(answer.y), message=message, seconds=seconds)
    statuses = {End.OPTIMAL: Status.OPTIMAL, End.STALLED: Status.NUMERICAL_ERROR}
    return Candidate(
        statuses.get(answer.end, Status.LIMIT),
        assembly.trajectory(answer.y),
        assembly.multipliers(answer.z, 1.0, answer.y),
        message=message,
        seconds=seconds,
        interrupted=answer.end is End.INTERRUPTED,
    )
