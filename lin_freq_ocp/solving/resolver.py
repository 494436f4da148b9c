"""A problem that is solved again with other ends, references and bounds, and the solver state that its solves share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.many import batch_judge_takes, judge_batch
from lin_freq_ocp.certificate.rays import infeasibility_certificate
from lin_freq_ocp.methods.condensed.plans import UNLIMITED, Budget, Plan, extremals_of
from lin_freq_ocp.methods.convex.sparse_program import ProgramCache
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.families import Options, choose_method, saved_options
from lin_freq_ocp.solving.judging import judge_candidate
from lin_freq_ocp.solving.linear import LinearAuto, Spectral
from lin_freq_ocp.solving.method import Method, Request
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import restore_outcome, solve_translated
from lin_freq_ocp.solving.solver_cache import SearchCache, SolverCache
from lin_freq_ocp.transform.reductions import Change
from lin_freq_ocp.transform.reformulations import Translation, far_origin, translated_by
from lin_freq_ocp.transform.starts import start_of

JUDGED_AT_ONCE = 3_000  # states of plans: an array of them in extended precision takes some 0.2 MB, as a cache has it
TRAVEL = 100.0  # largest moves of a state in a solve: an origin that is farther away is replaced


@dataclass(frozen=True, eq=False)
class PlannedStart:
    """A plan of a translated problem from another initial state, not certified yet."""

    translation: Translation  # of the problem with another initial state
    plan: Plan

    @property
    def control(self) -> Array:
        """Return u_0, (m,)."""
        return self.plan.control

    @property
    @one_blas_thread
    def trajectory(self) -> Trajectory:
        """Return the plan in the given coordinates."""
        return self.translation.trajectory(self.plan.trajectory)

    @one_blas_thread
    def better_of(self, last: Trajectory | None) -> PlannedStart:
        """Return the better of this plan and the rest of the last one from the same state; see ``Plan.rank``."""
        if last is None:
            return self
        other = self.plan.following(self.translation.start(last))
        return replace(self, plan=other) if other.rank < self.plan.rank else self

    @one_blas_thread
    def certified(self, tolerance: float | None) -> Outcome:
        """Return the judged outcome."""
        problem = self.translation.problem.with_ends(self.plan.start)
        base = self.translation.given.with_ends(self.plan.start + self.translation.origin)
        outcome = judge_candidate(problem, self.plan.candidate(problem), "condensed", None, tolerance)
        return restore_outcome(Translation(base, problem, self.translation.origin), outcome, tolerance)


@dataclass(frozen=True, eq=False)
class ProvenPlan:
    """An optimal plan, x (T+1, n) and u (T, m), with its cost, a rigorous lower bound, and the relative gap."""

    x: Array
    u: Array
    cost: float
    lower_bound: float
    gap: float


@one_blas_thread
def proven_in_batch(planned: Mapping[int, PlannedStart]) -> dict[int, ProvenPlan]:
    """Return the plans of one problem, by number, that the batch judge proves optimal."""
    translation, proven = next(iter(planned.values())).translation, dict[int, ProvenPlan]()
    if not batch_judge_takes(translation.problem):
        return proven
    problem = translation.problem
    at_once = max(1, JUDGED_AT_ONCE // (problem.horizon + 1))
    for first in range(0, len(planned), at_once):
        part = dict(islice(planned.items(), first, first + at_once))
        plans = [one.plan for one in part.values()]
        extremals = extremals_of(problem, plans)
        judged = judge_batch(problem, np.array([plan.start for plan in plans]), extremals)
        costs, bounds = judged.costs + translation.cost, judged.bounds + translation.cost
        figures = zip(costs.tolist(), bounds.tolist(), judged.gaps.tolist(), strict=True)
        for k, (number, of_plan) in enumerate(zip(part, figures, strict=True)):
            if judged.proven[k]:
                proven[number] = ProvenPlan(extremals.x[k] + translation.origin, extremals.u[k], *of_plan)
    return proven


class Resolver:
    """A problem with its method, and the solver state that earlier solves left."""

    def __init__(self, problem: OptimalControlProblem, method: str | Method = "auto", tolerance: float | None = None):
        require_problem(problem)
        self.problem, self.options = problem, Options(method, tolerance=tolerance)
        self.method = choose_method(problem, self.options)
        self.linear = not problem.mode_names and problem.form.affine and problem.response is None
        self._cache: SolverCache | None = None
        self._programs = ProgramCache()
        self._moves = np.zeros(problem.state_dim)  # of each state, the largest in a solve until now

    @property
    def spectral(self) -> bool:
        """Whether the Fourier-domain method comes first, with its own tolerance."""
        method = self.method
        if not isinstance(method, (Spectral, LinearAuto)) or method.tolerance is not None:
            return False
        return isinstance(method, Spectral) or method.backend == "auto"

    def take_programs(self, other: Resolver) -> None:
        """Share the programs of another problem, for those with the same matrices."""
        self._programs = other._programs

    @one_blas_thread
    def cache_for(self, changed: OptimalControlProblem) -> SolverCache:
        """Return the solver state of the problem with its states counted from near those of a changed problem.

        The origin stays until a state has travelled far from it, compared with its moves within a solve.
        """
        start, cache = changed.ends[0], self._cache
        if cache is not None and not self._is_far(cache, start.lower, start.fixed):
            return cache
        origin = far_origin(changed)
        if cache is None or (origin != cache.origin).any():
            base = self.problem.with_ends(changed.initial_state) if origin.any() else self.problem
            self._cache = cache = SolverCache(translated_by(base, origin), self._programs)
        else:  # it stays the best one: states this far from it are not far
            self._moves = np.maximum(self._moves, np.where(start.fixed, np.abs(start.lower - origin), 0.0) / TRAVEL)
        return cache

    def _is_far(self, cache: SolverCache, start: Array, fixed: Mask | bool = True) -> bool:
        """Whether a state has travelled far from the origin, compared with what it moves in a solve."""
        reach = TRAVEL * self._moves
        far = (np.abs(start - cache.origin) > reach) & (reach > 0)
        return bool((far if fixed is True else far & fixed).any())

    def prepare(self, start: Array) -> None:
        """Set up the condensed method for states near this one, (n,), if the problem is one of the method."""
        if not self.spectral or not self.linear:
            return
        cache = self._cache
        if cache is None or self._is_far(cache, start):
            cache = self.cache_for(self.problem.with_ends(start))
        cache.prepare()

    def can_plan_from(self, start: Array) -> bool:
        """Whether the condensed method is set up for states near this one, (n,)."""
        return self._cache is not None and not self._is_far(self._cache, start) and self._cache.plans

    @property
    def no_plans(self) -> str:
        """Return why the condensed method, which has been set up if that is possible, has no plans for the problem."""
        if self._cache is None or not self.spectral or not self.linear:
            return "only methods 'auto' and 'spectral' plan in this way, for linear dynamics."
        return self._cache.no_plans

    def plan(self, start: Array, budget: Budget = UNLIMITED) -> PlannedStart | None:
        """Return a plan from another initial state, (n,), without a certificate; None where only ``solve`` helps."""
        cache = self._cache
        if cache is None or not self.can_plan_from(start):
            return None
        plan = cache.plan(start - cache.origin, budget)
        return plan and PlannedStart(cache.translation, plan)

    @one_blas_thread
    def plan_batch(self, starts: Array) -> tuple[dict[int, PlannedStart], bool]:
        """Return plans from initial states (N, n) by number, without certificates, and whether Ctrl-C came.

        The condensed method is set up if need be; without it there are none, nor from states that a ray excludes.
        """
        if not self.linear or not self.spectral:
            return {}, False
        cache = self.cache_for(self.problem.with_ends(starts[0]))
        moved, rays = starts - cache.origin, cache.exclusions
        tried = [i for i, start in enumerate(moved) if not any(ray.applies_to(start) for ray in rays)]
        plans, interrupted = cache.plan_batch(moved[tried])
        return {tried[i]: PlannedStart(cache.translation, plan) for i, plan in plans.items()}, interrupted

    def excluded(self, change: Change) -> bool:
        """Whether a ray of an infeasible problem before excludes the changed initial state."""
        cache = self._cache
        if cache is None or not cache.exclusions or not change.starts_elsewhere:
            return False
        start = change.apply(self.problem).initial_box
        return bool(start.fixed.all()) and any(ray.applies_to(start.lower - cache.origin) for ray in cache.exclusions)

    def remember_ray(self, outcome: Outcome) -> None:
        """Keep the ray of an infeasible problem that differs from this one in its initial state alone."""
        cache = self._cache
        if cache is not None and outcome.status == Status.INFEASIBLE and outcome.ray is not None:
            ray = infeasibility_certificate(translated_by(outcome.problem, cache.origin).problem, outcome.ray)
            if ray is not None:
                cache.exclusions.appendleft(ray)

    def note_moves(self, plan: Trajectory) -> None:
        """Count what the states of a plan move: an origin is far if it is many such moves away."""
        self._moves = np.maximum(self._moves, np.ptp(plan.x, axis=0))

    @one_blas_thread
    def solve(
        self,
        change: Change,
        time_limit: float | None = None,
        start: Trajectory | None = None,
        tree: SearchCache | None = None,
    ) -> Outcome:
        """Solve the changed problem, from a start and a tree if the method takes them, and judge the answer."""
        options = replace(self.options, time_limit=time_limit)
        problem = change.apply(self.problem)
        cache = self.cache_for(problem)
        change = cache.translation.change(change, problem)
        moved = problem if cache.problem is self.problem else change.apply(cache.problem)
        translation = Translation(problem, moved, cache.origin)
        if start is not None:
            cache.stage_cache.warm_start = translation.start(start)
        begin = start_of(problem, start) if start is not None and self.method.takes_start else None
        if tree is not None:
            tree.set_base(cache.problem if change.starts_elsewhere else None)
        tolerance: float | None = getattr(self.method, "tolerance", None)
        cached = (cache, change) if self.linear else None
        request = Request(time_limit or np.inf, tolerance, start=begin, cached=cached, tree=tree)
        outcome = restore_outcome(translation, solve_translated(self.method, translation, request), tolerance)
        if outcome.status.solved and outcome.trajectory is not None:
            self.note_moves(outcome.trajectory)
        return replace(outcome, options=saved_options(problem, options, self.method))
