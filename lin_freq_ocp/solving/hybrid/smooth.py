"""The method for piecewise-smooth dynamics: search, polish, judge, and bound from below.

``Nonsmooth.solve`` calls ``LocalSearch``, ``refine_optimum``, ``best_multipliers``, and so ``judge``; answers of linear
methods alone pass through ``judge_candidate``.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import join_words, plural
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import NEVER_NEGATIVE, RIGOROUS, Bound
from lin_freq_ocp.certificate.hybrid.clarke import facts_where_modes_meet
from lin_freq_ocp.certificate.hybrid.global_bound.bound import value_bounds
from lin_freq_ocp.certificate.hybrid.global_bound.lattice import least_by_formulas
from lin_freq_ocp.certificate.hybrid.global_bound.step import OutOfTimeError
from lin_freq_ocp.certificate.hybrid.smooth import convex_bound, is_proven_convex, judged_modes, tangents_exclude
from lin_freq_ocp.certificate.reach import cost_is_never_negative
from lin_freq_ocp.certificate.sizes import cost_scale
from lin_freq_ocp.certificate.tolerances import ARITHMETIC_ROUNDING, GAP_TOLERANCE
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.methods.candidate import Attempt, require_convex, zero_multipliers
from lin_freq_ocp.methods.correction import trajectory_at_rest
from lin_freq_ocp.methods.hybrid.search.multipliers import multipliers_with_weights
from lin_freq_ocp.methods.hybrid.smooth.local_optimum import LocalOptimum, is_smooth
from lin_freq_ocp.methods.hybrid.smooth.local_search import DECREASE, LocalSearch, SmoothProgress, states_of_controls
from lin_freq_ocp.methods.hybrid.smooth.model import Pieces
from lin_freq_ocp.methods.hybrid.smooth.polish import newton_points, quadratic_model
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import box_of, map_sets
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.hybrid.certify_modes import best_multipliers
from lin_freq_ocp.solving.linear import LinearAuto
from lin_freq_ocp.solving.method import Request
from lin_freq_ocp.solving.outcome import Evidence, Judged, Outcome
from lin_freq_ocp.transform.hybrid.convex_cost import with_convex_terms
from lin_freq_ocp.transform.hybrid.cost_state import CostState
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from lin_freq_ocp.transform.limits import BOXES, SPECTRA
from lin_freq_ocp.transform.sizes import search_scale
from lin_freq_ocp.transform.starts import Start

UNBOUNDED = "no global bound was found in time; time_limit= gives it more"
EXCLUDED_BY_TANGENTS = "proven by a ray: no trajectory satisfies tangents of convex path constraints ({})"
EXCLUDED_BY_INTERVALS = "proven by dynamic programming with intervals: no trajectory exists"
EXCLUDED_BY_STATES = "proven without dynamics: no states satisfy the sets, ends and spectra of states"
EXCLUDED_BY_RAY = "proven without formulas: no trajectory satisfies the other constraints (explain names them)"

GLOBAL_GAP = 1e-4  # default of the relative gap to prove
GLOBAL_SECONDS = 10.0  # for the bound, without a time limit: enough for short horizons
# relative cost by which a start may be below the answer: violations within the judge's tolerance gain as much
SAVED_BY_TOLERANCE = 1e-6
FEASIBILITY_LOSS = 1.0  # of each step, if no cost is known and only the existence of a trajectory is in question
MOST_SADDLES = 10  # that are left one after the other
# Parts of a direction of descent, whose largest entry is 1 in the sizes of the judge: those of the next optimum may be
# far from them
PARTS_OF_DIRECTION = 10.0 ** np.arange(-9, 10)
NEARLY_WITHIN = 0.01  # of a direction, by which it may leave the bounds: it keeps active ones to a thousandth
MOST_STARTS = 6  # along a direction

NO_SECONDS = {"setup": 0.0, "solve": 0.0, "certify": 0.0}


@dataclass(frozen=True)
class Nonsmooth:
    """Local optima of mode sequences, of which the best is polished (docs/nonsmooth.md).

    Attributes
    ----------
    global_bound : bool
        Whether a global lower bound is computed, by dynamic programming with intervals; up to three states.
    gap : float, optional
        Relative gap (J - D)/S at which the bound is good enough, 1e-4 by default.

    Raises
    ------
    UnsupportedError
        If a gap is given without a global bound.

    Examples
    --------
    >>> problem = lfo.library.norm_dynamics(horizon=3)
    >>> lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False)).status
    'locally_optimal'
    """

    global_bound: bool = True
    gap: float | None = None

    shorthand: ClassVar[str] = "nonsmooth"
    takes_start: ClassVar[bool] = True

    def __post_init__(self):
        if not isinstance(self.global_bound, bool):
            raise UnsupportedError(f"global_bound: got {self.global_bound!r}; expected True or False.")
        if self.gap is not None and not self.global_bound:
            raise UnsupportedError(f"gap: got {self.gap!r} without a global bound; leave it out, or ask for the bound.")

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Search for local optima, judge the best, and bound the cost from below."""
        require_convex(problem)
        started, ends = now(), problem.fixed_ends.items()
        excluded = [(one.name, t) for one in problem.path_constraints for t, x in ends if one.excludes(t, x)]
        if excluded:
            message = f"the path constraint {excluded[0][0]!r} does not hold at the fixed state of t = {excluded[0][1]}"
            return outcome_of_search(problem, "nonsmooth", None, (Status.INFEASIBLE, message), NO_SECONDS, False)
        judged = _solve_convex_terms(problem, request)
        if judged is not None and judged.certificate.proven_within(self.gap or GLOBAL_GAP):
            seconds = {"setup": 0.0, "solve": now() - started, "certify": 0.0}
            return outcome_of_search(problem, "nonsmooth", judged, (Status.OPTIMAL, ""), seconds, False)
        is_proven = partial(_is_proven, problem, self.gap or GLOBAL_GAP)
        least = _least_cost(problem)
        search = LocalSearch(problem, request.time_limit, request.progress, request.start, is_proven, least)
        search.end = started + request.time_limit
        search.run()
        solved = now()
        best = search.best
        judged = None
        if best is not None and best.feasible:
            judged = _leave_saddles(search, refine_optimum(problem, best, search.end))
        judged = judged if request.start is None else _take_start(problem, request.start, judged)
        status, message = _status(search, judged)
        limited = request.time_limit < np.inf
        left = request.time_limit - (now() - started) if limited else GLOBAL_SECONDS
        if judged is None and not search.message and left > 0:
            at = None if best is None else best.trajectory
            proof = _proof_of_infeasibility(problem, at, left, self.global_bound)
            status, message = (Status.INFEASIBLE, proof) if proof else (status, message)
        elif judged is not None and status.solved and self.global_bound:
            bounding = _Bounding(search, judged, self.gap or GLOBAL_GAP, now() + left)
            message = bounding.run() if left > 0 else UNBOUNDED
            judged = bounding.judged  # the bound may lead to a better answer
            status = judged.certificate.status_within(bounding.gap)
        seconds = {"setup": 0.0, "solve": solved - started, "certify": now() - solved}
        ending, tried = (status, message), search.attempts
        return outcome_of_search(problem, "nonsmooth", judged, ending, seconds, search.interrupted, attempts=tried)


def _is_proven(problem: OptimalControlProblem, gap: float, local: LocalOptimum) -> bool:
    """Whether a local optimum is within a gap of the bound of a convex problem."""
    bound = convex_bound(problem, local.trajectory, local.multipliers)
    allowed = gap * cost_scale(problem, local.trajectory)
    return bound is not None and bound.kind == RIGOROUS and local.cost - bound.value <= allowed


def _least_cost(problem: OptimalControlProblem) -> float:
    """Return what a cost costs at least, whatever the trajectory is: a sum of squares by intervals of its formulas."""
    if cost_is_never_negative(problem):
        with suppress(UnsupportedError):
            return least_by_formulas(problem)
    return -np.inf


def outcome_of_search(
    problem: OptimalControlProblem,
    method: str,
    judged: Judged | None,
    ending: tuple[Status, str],
    seconds: dict[str, float],
    interrupted: bool,
    sequence: Indices | None = None,
    evidence: Evidence | None = None,
    attempts: Sequence[Attempt] = (),
) -> Outcome:
    """Return the outcome of a search with its best judged point, if any; ``ending`` is its status with the message.

    By default, the mode sequence is that of the trajectory. ``attempts`` are the local searches.
    """
    (status, message), point = ending, (None, None, None) if judged is None else judged
    if sequence is None and judged is not None:
        sequence = _modes(problem, judged.trajectory)
    outcome = Outcome(problem, status, method, None, seconds, *point, None, message, interrupted)
    return replace(outcome, sequence=sequence, evidence=evidence, attempts=(*attempts, outcome.attempt))


def _solve_convex_terms(problem: OptimalControlProblem, request: Request) -> Judged | None:
    """Return the global optimum with its bound if the cost by formulas is convex terms, else None."""
    convex = None if problem.dynamics.mode_names or problem.path_constraints else with_convex_terms(problem)
    found = None if convex is None else LinearAuto().solve(convex, Request(request.time_limit))
    if convex is None or found is None or found.trajectory is None or found.multipliers is None:
        return None
    bound = None if found.certificate is None else found.certificate.bound
    if found.status != Status.OPTIMAL or bound is None:
        return None
    first = replace(found.multipliers, stage={term.name: found.multipliers.stage[term.name] for term in problem.terms})
    sequence, cost = _modes(problem, found.trajectory), problem.value(found.trajectory.x, found.trajectory.u)
    local = LocalOptimum(sequence, found.trajectory, first, cost, 0.0)
    judged = refine_optimum(problem, local, now() + request.time_limit)
    trajectory, certificate = judged.trajectory, judged.certificate
    constant = certificate.cost - convex.value(trajectory.x, trajectory.u)
    rounding = ARITHMETIC_ROUNDING * (certificate.cost_scale + cost_scale(convex, trajectory))
    return judged.with_bound(replace(bound, value=bound.value + constant - rounding))


def refine_optimum(problem: OptimalControlProblem, local: LocalOptimum, end: float = np.inf) -> Judged:
    """Return a local optimum with the multipliers that fit best, polished if that improves them.

    Steps go on as long as they improve it or conditions fail, until ``end``, by ``clock.now``.
    """
    first = _with_weights(problem, local.trajectory, local.multipliers, local.sequence)
    plain = best_multipliers(problem, local.trajectory, first)
    # a cost that no search tells from zero may be what an iteration leaves of rest
    rounding = DECREASE * search_scale(problem, local.trajectory)
    rests = not plain.certificate.extremal or 0 < plain.certificate.cost <= rounding
    resting = trajectory_at_rest(problem, local.trajectory) if rests else None
    if resting is not None:  # where rounding would count
        at_rest = best_multipliers(problem, resting, first)
        allowed = plain.certificate.cost + plain.certificate.allowed_gap
        plain = at_rest if not at_rest.certificate.failed and at_rest.certificate.cost <= allowed else plain
    if plain.certificate.extremal and is_smooth(problem):
        return _prove_by_linear(problem, plain, end)
    best = plain
    steps = chain.from_iterable(newton_points(problem, local, end, solved) for solved in (False, True))
    for trajectory, multipliers in steps:
        first = _with_weights(problem, trajectory, multipliers, local.sequence)
        point = best_multipliers(problem, trajectory, first)
        better = _shortfall(point) < _shortfall(best)
        best = point if better else best
        if not (better or best.certificate.failed):
            break
    return best


def _prove_by_linear(problem: OptimalControlProblem, plain: Judged, end: float) -> Judged:
    """Return a convex answer with multipliers that prove it: those of its problem to second order.

    Where sets meet in a single point, multipliers grow without limit, and the barrier ends before they prove enough.
    """
    trajectory, multipliers, certificate = plain
    if certificate.bound is None or certificate.bound.kind != RIGOROUS or certificate.proven_within(GAP_TOLERANCE):
        return plain
    one_mode = Pieces.of(problem, np.zeros(problem.horizon, dtype=np.intp))
    with suppress(UnsupportedError):  # rounding makes the Hessian indefinite
        linear = quadratic_model(problem, one_mode, trajectory, multipliers)
        others = LinearAuto().solve(linear, Request(end - now())).multipliers
        if others is not None:
            proven = Judged(trajectory, others, judge(problem, trajectory, others))
            return proven if proven.certificate.proven_within(GAP_TOLERANCE) else plain
    return plain


def _with_weights(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, sequence: Indices
) -> Multipliers:
    """Return multipliers of a mode sequence as those of the problem, with weights of its modes."""
    reduced, affine, at, arrays = judged_modes(problem, trajectory)
    with_adjoint = reduced.with_adjoint if isinstance(reduced, CostState) else reduced.multipliers
    return reduced.multipliers(multipliers_with_weights(affine, at, sequence, with_adjoint(multipliers), arrays=arrays))


def _shortfall(point: Judged) -> tuple[bool, int, float]:
    certificate = point.certificate
    return not certificate.feasible, len(certificate.failed), certificate.worst.relative


def _leave_saddles(search: LocalSearch, judged: Judged) -> Judged:
    """Return the answer, or a better one to which its directions of descent of second order lead."""
    for _ in range(MOST_SADDLES):
        test, sequence = judged.certificate.second_order, np.zeros(search.problem.horizon, dtype=np.intp)
        if test is None or test.direction is None:
            break
        for cost, start in _starts_along(search, judged, test.direction):
            # a search that raises the cost of its start may return to the saddle
            if search.look_near(start, sequence) and search.best is not None and search.best.cost <= cost:
                judged = refine_optimum(search.problem, search.best, search.end)
                break
        else:
            break
    return judged


def _starts_along(search: LocalSearch, judged: Judged, d: Trajectory) -> list[tuple[float, Trajectory]]:
    """Return trajectories with controls along a direction of descent, on both sides, the least cost first.

    On each side, its parts rise until the trajectory leaves the bounds or costs more. Bounds of the last state do not
    count: the direction keeps it to first order only.
    """
    problem, (trajectory, _, certificate) = search.problem, judged
    starts, limit = list[tuple[float, Trajectory]](), certificate.cost + certificate.allowed_gap
    for sign in (1.0, -1.0):
        u = trajectory.u + sign * PARTS_OF_DIRECTION[:, None, None] * d.u
        first, controls = trajectory.x[0] + sign * PARTS_OF_DIRECTION[:, None] * d.x[0], problem.control_tube.project(u)
        states = states_of_controls(problem, problem.initial_box.project(first), controls)
        trials = zip(PARTS_OF_DIRECTION, map(Trajectory, states, controls), u - controls, strict=True)
        for part, start, beyond in trials:
            moved = NEARLY_WITHIN * part * np.abs(np.hstack([d.x[:-1], d.u])).max(axis=0)
            outside = np.hstack([problem.state_tube.violation(start.x)[:-1], beyond])
            cost = problem.value(start.x, start.u)
            if now() > search.end or not cost <= limit or not (np.abs(outside) <= moved).all():
                break
            starts.append((cost, start))
    return sorted(starts, key=lambda pair: pair[0])[:MOST_STARTS]


def _take_start(problem: OptimalControlProblem, start: Start, judged: Judged | None) -> Judged | None:
    """Return the answer, or the start itself if that is a trajectory of lower cost."""
    if start.trajectory is None:
        return judged
    cost = problem.value(start.trajectory.x, start.trajectory.u)
    known = None if judged is None or not judged.certificate.feasible else judged.certificate
    if known is not None and known.cost - cost <= SAVED_BY_TOLERANCE * known.cost_scale:
        return judged
    if not judge(problem, start.trajectory, zero_multipliers(problem, 1.0)).feasible:
        return judged
    return best_multipliers(problem, start.trajectory, zero_multipliers(problem, 1.0))


@dataclass
class _Bounding:
    """The global bound of an answer, and better answers along its paths; ``run`` it once."""

    search: LocalSearch
    judged: Judged
    gap: float
    deadline: float
    best: float = -float("inf")
    sets: str = ""

    def __post_init__(self):
        self._known = {_modes(self.search.problem, self.judged.trajectory).tobytes()}

    def run(self) -> str:
        """Bound until the gap is proven or the time is over; return the message of the answer."""
        message = ""
        self.best = self.search.least
        self.sets = NEVER_NEGATIVE if self.best >= 0 else "intervals of the cost"
        self._take(self.judged.certificate.bound)  # of a convex problem
        try:
            if not self._proven:
                self._take(_bound_without_obstacles(self.search.problem, self.judged, self.deadline))
            while not self._proven and self._improve():
                pass
        except UnsupportedError as error:
            message = str(error)
        except OutOfTimeError:
            pass
        except KeyboardInterrupt:
            self.search.interrupted = True
        if self.best == -float("inf"):
            return message or UNBOUNDED
        self.judged = self.judged.with_bound(Bound(self.best, RIGOROUS, sets=self.sets))
        if self._proven:
            return ""
        trivial = message and self.best == self.search.least
        return message if trivial else f"the global bound leaves a gap of {self.judged.certificate.gap:.1e}"

    def _take(self, bound: Bound | None) -> None:
        if bound is not None and bound.kind == RIGOROUS and bound.value > self.best:
            self.best, self.sets = bound.value, bound.sets

    @property
    def _wanted_gap(self) -> float:
        return self.gap * self.judged.certificate.cost_scale

    @property
    def _proven(self) -> bool:
        return self.judged.certificate.cost - self.best <= self._wanted_gap

    @np.errstate(invalid="ignore")  # inf - inf where a cost is not defined: no bound follows from NaN
    def _improve(self) -> bool:
        """Replace the answer by a better one along a path of the bound; return whether there is one."""
        _, multipliers, certificate = self.judged
        given = self.search.problem, multipliers, certificate.cost, self._wanted_gap, self.deadline, self._report
        for level in value_bounds(*given, certificate.cost_scale):
            if level.value > self.best:
                self.best, self.sets = level.value, "dynamic programming over cells of the states, with intervals"
            if self._proven:
                return False
            if level.path is None or level.sequence is None:
                continue
            if level.sequence.tobytes() in self._known and not self.search.problem.path_constraints:
                continue  # around obstacles, a single mode has several local optima
            self._known.add(level.sequence.tobytes())
            if self.search.look_near(level.path, level.sequence) and self.search.best is not None:
                better = refine_optimum(self.search.problem, self.search.best, self.deadline)
                if better.certificate.pmp == "satisfied":
                    self.judged = better
                    return True
        return False

    def _report(self, level: int, share: float) -> None:
        if self.search.progress is not None:
            cost = self.judged.certificate.cost
            self.search.progress(SmoothProgress(cost, self.best, self.search.tried, level, share))


def _bound_without_obstacles(problem: OptimalControlProblem, judged: Judged, deadline: float) -> Bound | None:
    """Return the bound of linear dynamics without the path constraints that are not convex; None without such ones."""
    obstacles = [
        one.name
        for one in problem.path_constraints
        if not one.convex and not is_proven_convex(problem, one, judged.trajectory)
    ]
    if problem.dynamics.mode_names or not obstacles:
        return None
    relaxed = problem.derived(stage_rows=[row for row in problem.stage_rows if row.name not in obstacles])
    linear = not relaxed.path_constraints and not relaxed.cost.has_formulas
    method = LinearAuto() if linear else Nonsmooth(global_bound=False)
    found = method.solve(relaxed, Request(deadline - now()))
    bound = None if found.certificate is None else found.certificate.bound
    return bound and replace(bound, sets="; ".join([*filter(None, [bound.sets]), f"without {join_words(obstacles)}"]))


@np.errstate(invalid="ignore")  # as for _improve
def _proof_of_infeasibility(
    problem: OptimalControlProblem, at: Trajectory | None, seconds: float, intervals: bool
) -> str:
    """Return what proves that there is no trajectory, an empty text if nothing does.

    Of linear dynamics, it is a ray, whatever the cost by formulas is, with the tangents at a trajectory of the path
    constraints that are convex; of others, a ray of the sets, ends and spectra of states alone; else ``intervals``, if
    they are asked for, prove it by bounds and path constraints alone: D is infinite. They are not tried if a trajectory
    satisfies these.
    """
    deadline, stated = now() + seconds, problem.dynamics
    if stated.mode_names:
        n, names, step = problem.state_dim, problem.state_names, problem.sampling_time
        fields = {"control_set": None, "control_spectrum": None, "output_spectrum": None, "stage_rows": ()}
        anywhere = LinearDynamics(np.zeros((n, n)), np.eye(n), sampling_time=step, state_names=names)
        of_states = problem.derived(dynamics=anywhere, cost=QuadraticCost(), **fields)
        found = LinearAuto().solve(of_states, Request(seconds))
        if found.status == Status.INFEASIBLE and found.bound == RIGOROUS:
            return EXCLUDED_BY_STATES
    if not stated.mode_names:
        rows, given = problem.stage_rows if at is None else problem.rows_along(at), problem.path_constraints
        left_out = {one.name for one in given if at is None or not is_proven_convex(problem, one, at)}
        hard = [row for row in rows if row.hard_part is not None and row.name not in left_out]
        relaxed = problem.derived(dynamics=stated, cost=QuadraticCost(), stage_rows=hard)
        found = LinearAuto().solve(relaxed, Request(seconds))
        if found.status == Status.INFEASIBLE and found.bound == RIGOROUS:
            if not problem.path_constraints:
                return EXCLUDED_BY_RAY
            if at is None or found.ray is None or tangents_exclude(problem, relaxed, at, found.ray):
                named = "" if at is None or found.ray is None else _named_in_conflict(problem, relaxed, at, found.ray)
                return EXCLUDED_BY_TANGENTS.format(named) if named else EXCLUDED_BY_RAY
    try:
        none, loss = zero_multipliers(problem, 1.0), FEASIBILITY_LOSS
        hopeless = not intervals or _bounds_admit_trajectory(problem, deadline - now())
        levels = [] if hopeless else value_bounds(problem, none, np.inf, loss, deadline, scale=loss)
        return EXCLUDED_BY_INTERVALS if any(level.value == np.inf for level in levels) else ""
    except (UnsupportedError, OutOfTimeError):
        return ""


def _named_in_conflict(
    problem: OptimalControlProblem, tangents: OptimalControlProblem, at: Trajectory, ray: Multipliers
) -> str:
    """Return the names of the path constraints without whose tangents a ray proves nothing."""
    names = list[str]()
    for name in [one.name for one in problem.path_constraints if one.name in ray.stage]:
        rest = replace(ray, stage={**ray.stage, name: np.zeros_like(ray.stage[name])})
        if tangents_exclude(problem, tangents, at, rest):
            ray = rest
        else:
            names.append(repr(name))
    return join_words(names) if names else ""


def _bounds_admit_trajectory(problem: OptimalControlProblem, seconds: float) -> bool:
    """Whether a trajectory satisfies the bounds and path constraints of a problem that also has others."""
    constraints, stops = problem.path_constraints, problem.control_stop.any() or problem.state_stop.any()
    if len(problem.terms) == len(constraints) and not stops:
        return False
    sets = {field: map_sets(getattr(problem, field), box_of) for field in BOXES}
    bounded = problem.derived(**sets, **dict.fromkeys(SPECTRA), stage_rows=constraints)
    search = LocalSearch(bounded, seconds, is_proven=lambda _: True).run()
    if search.interrupted:
        raise KeyboardInterrupt
    return search.best is not None and search.best.feasible


def _modes(problem: OptimalControlProblem, trajectory: Trajectory) -> Indices:
    """Return the mode sequence of a trajectory, (T,)."""
    return piecewise_smooth(problem).sequence_of(trajectory.x, trajectory.u)


def _status(search: LocalSearch, judged: Judged | None) -> tuple[Status, str]:
    """Return the status of the answer without a bound, and the message."""
    if search.message and (judged is None or search.interrupted):
        return Status.LIMIT, search.message
    if judged is None:
        problem = search.problem
        constrained = ["path constraints"] * bool(problem.path_constraints)
        undefined = " or ".join(["dynamics", *["the cost"] * problem.cost.has_formulas, *constrained])
        nearest = f", where the {undefined} are not defined; start= takes a trajectory where they are"
        if search.best is not None:
            violated = " or ".join(["dynamics", *constrained])
            nearest = f"; the nearest violates {violated} by {search.best.violation:.1e}"
        return Status.NUMERICAL_ERROR, f"no trajectory was found from {search.tried} starts{nearest}"
    certificate = judged.certificate
    status = certificate.status_within(GAP_TOLERANCE)
    if status == Status.OPTIMAL:
        return status, ""
    facts = facts_where_modes_meet(certificate)
    if facts is not None and facts.gaps:
        holds = "hold" if facts.stationary_on_rims else "do not hold"
        advice = f"the map is not defined beyond it, and the conditions {holds} with the region as a constraint"
        return status, f"{facts.touched_gaps}; {advice} (docs/borders.md, Gaps)"
    if facts is not None and facts.unqualified:
        return status, f"{facts.dependent_gradients}: the theorem does not apply there"
    if status == Status.NUMERICAL_ERROR and search.message:
        return Status.LIMIT, search.message
    if status == Status.NUMERICAL_ERROR:
        return status, f"the best point does not satisfy the maximum principle: {certificate.worst.name}"
    if status == Status.EXTREMAL:
        return status, str(certificate.second_order)
    return status, f"no global bound was asked for, and {plural(search.tried, 'start')} tried"
