"""The classical solution, its filtered controls, and the constrained solution, side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from lin_freq_ocp.base.activity import activity_step
from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import LEAST_SECONDS, now
from lin_freq_ocp.base.errors import LimitError, ProblemError, SolveError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.hybrid.clarke import facts_where_modes_meet
from lin_freq_ocp.certificate.hybrid.smooth import Kink, kinks
from lin_freq_ocp.comparison.filters import FILTERS, apply_filter, can_be_filtered, has_frequency_constraint
from lin_freq_ocp.comparison.moves import Moves, shaper_obstacle, shortest_moves, why_not_shaped
from lin_freq_ocp.comparison.shapers import SHAPERS, USUAL_SHAPERS
from lin_freq_ocp.comparison.trajectories import (
    CLASSICAL,
    CONSTRAINED,
    MeasuredTrajectory,
    measured_solution,
    replay_control,
    solution_label,
)
from lin_freq_ocp.derivatives.sensitivities import bin_prices
from lin_freq_ocp.problem.measures import Measures
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.solving.families import Options, family_of
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged

PREFERRED_FILTER = "brickwall"
SEARCH_SECONDS = 30.0  # for a comparison whose modes are searched, which by itself may take hours

Solve = Callable[..., Outcome]  # lfo.solve: a problem, and the keywords method, backend, time_limit, start and throw


@dataclass(frozen=True, eq=False)
class Filtered:
    """A filter, its description in words, and the simulated trajectory of the filtered classical control."""

    name: str
    description: str
    replay: MeasuredTrajectory


@dataclass(frozen=True, eq=False)
class ComparisonOutcome:
    """Filtering afterwards against solving with the frequency constraint; all is measured on ``problem``."""

    problem: OptimalControlProblem
    classical: Outcome  # without any frequency constraint
    constrained: Outcome  # may be infeasible, which is then the finding
    filtered: tuple[Filtered, ...]  # in the order asked for
    moves: Moves | None = None  # of input shapers, where controls have a bound on their residual vibration

    @cached_property
    def classical_solution(self) -> MeasuredTrajectory:
        """Return the classical trajectory."""
        solution = measured_solution(CLASSICAL, self.problem, self.classical)
        assert solution is not None
        return solution

    @cached_property
    def constrained_solution(self) -> MeasuredTrajectory | None:
        """Return the trajectory with the frequency constraint; None without one."""
        return measured_solution(self.constrained_label, self.problem, self.constrained)

    @property
    def constrained_label(self) -> str:
        """Return "constrained"; of a problem without frequency constraints, the label of its solution."""
        return CONSTRAINED if has_frequency_constraint(self.problem) else solution_label(self.constrained)

    @property
    def classical_measures(self) -> Measures:
        """Return the measures of the classical trajectory."""
        return self.classical_solution.measures

    @property
    def constrained_measures(self) -> Measures | None:
        """Return the measures of the constrained trajectory, if there is one."""
        return None if self.constrained_solution is None else self.constrained_solution.measures

    @property
    def replay_is_meaningful(self) -> bool:
        """Whether open-loop replays show more than amplified rounding errors."""
        return all(entry.replay.meaningful for entry in self.filtered)

    @property
    def trajectories(self) -> tuple[MeasuredTrajectory, ...]:
        """Return the classical trajectory, the replays, and the constrained one, if there is one.

        Without a frequency constraint all of these are one trajectory, which is returned alone.
        """
        last = () if self.constrained_solution is None else (self.constrained_solution,)
        if not has_frequency_constraint(self.problem):
            return last
        replays = [entry.replay for entry in self.filtered] if can_be_filtered(self.problem) else []
        return (self.classical_solution, *replays, *last)

    @property
    def shown_filter(self) -> Filtered | None:
        """Return the filter that figures and sentences show: the brick wall, or the first; None without any."""
        if not self.filtered or not can_be_filtered(self.problem):
            return None
        return next((entry for entry in self.filtered if entry.name == PREFERRED_FILTER), self.filtered[0])

    @property
    def kinks(self) -> tuple[Kink, ...]:
        """Return the kinks along the constrained trajectory, as judged; none without multipliers."""
        result = self.constrained
        borders = None if result.certificate is None else facts_where_modes_meet(result.certificate)
        if borders is None or result.trajectory is None or result.multipliers is None:
            return ()
        return kinks(result.problem, result.trajectory, result.multipliers, borders)

    @property
    def prices(self) -> tuple[Array, Array] | None:
        """Return |d J* / d bin| of controls and states; None without multipliers or without removed bins."""
        multipliers, problem = self.constrained.multipliers, self.problem
        banded = problem.control_band.any() or problem.state_band.any()
        return bin_prices(problem, multipliers) if multipliers is not None and banded else None

    @property
    def shaper_obstacle(self) -> str:
        """Return in words why no input shaper applies to a limit on residual vibrations; empty if one does."""
        return "" if self.moves is not None else shaper_obstacle(self.problem)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Return the name of every trajectory, with its origin and its measures in words."""
        rows: list[tuple[str, str, MeasuredTrajectory | None]] = []
        rows.append(("classical", self.classical.status, self.classical_solution))
        for entry in self.filtered:
            unstable = entry.replay.stopped or "not simulated: that would amplify rounding errors"
            rows.append((entry.name, "simulated" if entry.replay.meaningful else unstable, entry.replay))
        nothing = self.constrained.status == Status.LIMIT and self.constrained.trajectory is None
        status = f"{self.constrained.status}, no point found" if nothing else self.constrained.status
        rows.append(("constrained", status, self.constrained_solution))
        moves = () if self.moves is None else self.moves.all
        return [
            *((name, ", ".join([origin, *_measures_in_words(measured)])) for name, origin, measured in rows),
            *((move.name, str(move)) for move in moves),
            *([("input shapers", f"do not apply: {self.shaper_obstacle}")] if self.shaper_obstacle else []),
        ]

    def __str__(self) -> str:
        width = max(len(name) for name, _ in self.rows)
        return "\n".join([str(self.problem), *(f"{name:{width}}  {text}" for name, text in self.rows)])


def _measures_in_words(measured: MeasuredTrajectory | None) -> list[str]:
    """Return the measures of a trajectory; of limited spectra, the value nearest to its limit, in the unit of that."""
    if measured is None:
        return []
    measures, problem, plan = measured.measures, measured.problem, measured.trajectory
    known = [term for term in problem.terms if measured.meaningful or term.kind.of == "controls"]
    readings = [one for term in known for one in term.readings(plan.x, plan.u)]
    stops = problem.control_stop.any() or problem.state_stop.any() or not readings
    figures = {
        "end missed by": measures.terminal_error,
        "controls out of bounds by": measures.control_violation,
        "states by": measures.state_violation,
        "energy in control bands": measures.stopband_energy if stops else None,
        "in state bands": measures.state_stopband_energy if stops else None,
    }
    cost = [] if measures.cost is None else [f"cost {measures.cost:.6g}"]
    nearest = [str(max(readings, key=lambda one: one.ratio))] if readings else []
    return [*cost, *(f"{what} {value:.2g}" for what, value in figures.items() if value is not None), *nearest]


@one_blas_thread
def compare_methods(
    problem: OptimalControlProblem,
    solve: Solve,
    filters: Sequence[str] | None,
    backend: str,
    time_limit: float | None,
    start: object = None,
) -> ComparisonOutcome:
    """Return the parts of a comparison, whose two problems ``solve`` solves; see ``lfo.compare``."""
    require_problem(problem)
    names, shapers = _chosen(problem, filters)
    free = replace(problem, control_spectrum=None, state_spectrum=None, output_spectrum=None)
    alone = not has_frequency_constraint(problem)
    # A classical plan is only filtered, and needs no global bound.
    method = "nonsmooth" if "nonsmooth" in family_of(free).shorthands and not alone else "auto"
    if time_limit is None and "branch_and_bound" in family_of(problem).shorthands:
        time_limit = SEARCH_SECONDS
    begun = now()

    def limit_of(share: float) -> float | None:
        """Return a share of the time left for all solves."""
        if time_limit is None or time_limit <= 0:  # it is refused
            return time_limit
        return max(share * (time_limit - (now() - begun)), LEAST_SECONDS)

    def solve_within(
        variant: OptimalControlProblem, share: float = 1.0, start: object = None, **options: object
    ) -> Outcome:
        begin = {} if start is None else {"start": start}
        return solve(variant, backend=backend, time_limit=limit_of(share), **begin, **options)

    failure: LimitError | None = None
    try:
        with activity_step("without frequency constraints"):
            classical = solve_within(free, 1.0 if alone else 0.5, start, method=method)
    except LimitError as error:  # an unproven point can also be filtered
        classical, failure = error.result, error
    with activity_step("with frequency constraints"):
        constrained = classical if alone else solve_within(problem, 1.0, start, throw=False)
    if classical.trajectory is None and constrained.trajectory is not None:
        classical = solve_within(free, 1.0, constrained.trajectory, method=method, throw=False)
    plan = classical.trajectory
    if plan is None and failure is not None:
        raise LimitError(f"{failure} Nothing can be filtered: begin with a trajectory (start), or wait.", classical)
    if plan is None:
        raise SolveError("The classical problem was solved without a trajectory.", classical)
    entries = list[Filtered]()
    for name in names:
        control = apply_filter(name, problem, plan.u)
        replay = replay_control(name.replace("_", " "), problem, control.u, plan)
        entries.append(Filtered(name, control.description, replay))

    def solve_move(variant: OptimalControlProblem, any_point: bool) -> Outcome:
        if variant is problem:
            return constrained
        return solve_judged(variant, Options(backend=backend, time_limit=limit_of(1.0)), any_point=any_point)

    moves = shortest_moves(problem, solve_move, shapers) if shapers else None
    return ComparisonOutcome(problem, classical, constrained, tuple(entries), moves)


def _chosen(problem: OptimalControlProblem, given: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return the names of filters and of shapers; by default all filters that apply, and the usual shapers."""
    obstacle = why_not_shaped(problem)
    if given is None:
        return list(FILTERS) if can_be_filtered(problem) or obstacle else [], [] if obstacle else list(USUAL_SHAPERS)
    for name in given:
        if name not in FILTERS and name not in SHAPERS:
            raise ProblemError("filters", repr(name), f"some of {', '.join([*FILTERS, *SHAPERS])}")
        if name in SHAPERS and obstacle:
            raise ProblemError("filters", repr(name), f"a problem that input shapers apply to: {obstacle}")
    return [name for name in given if name in FILTERS], [name for name in given if name in SHAPERS]
