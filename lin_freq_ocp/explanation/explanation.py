"""An irreducible infeasible subset of the constraints, and for each member the smallest relaxation that cures it.

The family is found by deletion: each block is dropped in turn, for good if the others are still infeasible. For bounds,
joint rows and ends the least relaxation is the optimum of a convex problem of the usual kind: states delta, constant
in time, relax the block's rows. An end has one for each component, and their sum is the least: only those that have to
move do. For a term it is a bisection on its limit, for a stop band a bisection on the number
of bins that are passed at its edges.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from lin_freq_ocp.base.activity import activity, tell
from lin_freq_ocp.base.arrays import Array, positive_number
from lin_freq_ocp.base.clock import LEAST_SECONDS, now, processor_now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sets.box import Box, box_of, map_sets
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.base import map_constraints
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.families import Options, family_of
from lin_freq_ocp.solving.outcome import Cure, Explanation, Outcome
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.transform.limits import BOXES, SPECTRA, Limit, constraints, drop_limits, intersection, replace_bounds
from lin_freq_ocp.transform.reformulations import AddedStates, add_states
from lin_freq_ocp.transform.sizes import stated_sizes

Feasible = Callable[[OptimalControlProblem], bool | None]  # whether a problem has a solution; None if undecided

# Relative margins on the least amount, tried in turn until rounding no longer decides.
MARGINS = (1e-6, 1e-4, 1e-2)
ACCURATE = 1e-8  # residuals of the least amount: below its first margin, and reached where all digits are not
FIRST_AMOUNT, GROWTH, PRECISION = 1e-3, 8.0, 1e-4  # relative to a limit: first rise tried, its growth, final precision
UNMOVED = 1e-6  # fraction of the changes of an end below which a component stays, or is zero afterwards
# Cost of controls of their stated sizes, relative to that of a delta as large: keeps the problem well-posed.
CONTROL_PRICE = 1e-6
DELTA_CURVATURE = 1e-3  # of the cost of a delta in units of its size: it bounds the deltas that cost no more
LARGEST = 1e6  # an amount above this multiple of the sizes in the data is no cure

# Whether a problem has a solution, by the statuses that decide it.
BUSY = 20.0  # seconds that a solve may last for each processor second that is left: solves watch the other clock


@activity("looking for the constraints in conflict")
@one_blas_thread
def explain(
    problem: OptimalControlProblem, time_limit: float | None = None, processor_time: float | None = None
) -> Explanation:
    """Explain why a problem has no solution.

    Parameters
    ----------
    problem : OptimalControlProblem
    time_limit : float, optional
        Seconds after which the search ends, as it does at Ctrl-C; the findings so far are returned.
    processor_time : float, optional
        The same in processor seconds of this process, which do not depend on other work of the machine.

    Returns
    -------
    Explanation

    Raises
    ------
    ProblemError
        If a limit is not above zero.
    UnsupportedError
        If the problem has a solution, or none of the methods could prove that it has none; or if its dynamics have
        modes.

    Examples
    --------
    >>> explanation = lfo.explain(lfo.library.double_integrator(horizon=20, cutoff_hz=0.3))
    >>> print(explanation.cures[0])
    initial state: ...
    """
    require_problem(problem)
    if problem.cost.has_formulas:  # no cost decides whether there is a trajectory
        problem = problem.derived(cost=QuadraticCost())
    if problem.form.affine and problem.mode_names:
        raise UnsupportedError(
            "explain: got piecewise-affine dynamics, where every mode sequence has its own reasons; "
            "explain(problem.with_modes(sequence)) tells those of one."
        )
    if "angles" in family_of(problem).shorthands:
        raise UnsupportedError(
            "explain: got a pulse train, whose search over angles needs all of its limits; expected linear dynamics. "
            "Solve with wider ends or shorter dwells to see which of them is in conflict."
        )
    if problem.path_constraints:
        names = ", ".join(repr(one.name) for one in problem.path_constraints)
        raise UnsupportedError(
            f"explain: got path constraints by formulas, {names}; expected linear rows. Without them, "
            "dataclasses.replace(problem, stage_rows=...), it tells whether the rest is in conflict."
        )
    limits = {"time_limit": (now, time_limit), "processor_time": (processor_now, processor_time)}
    ends = [
        (clock, clock() + positive_number(name, limit)) for name, (clock, limit) in limits.items() if limit is not None
    ]
    search = _VariantSolver(problem, ends)
    result = search.solve_variant(problem)
    if _is_feasible(result) is not False:
        got = f"with the status '{result.status}'"
        raise UnsupportedError(f"explain: got a problem {got}; expected one with a ray of infeasibility.")
    family = search.irreducible_family(result)
    cures = tuple(cure for block in family if (cure := search.cure(block)) is not None)
    return Explanation(tuple(block.name for block in family), search.sure, cures)


class _VariantSolver:
    """Solves variants of one problem; ``sure`` turns false when one stays undecided or the time is over."""

    def __init__(self, problem: OptimalControlProblem, ends: list[tuple[Callable[[], float], float]]):
        cost = QuadraticCost(R=np.diag(1 / stated_sizes(problem)[1] ** 2))
        self.problem, self.ends, self.sure, self.interrupted = problem.derived(cost=cost), ends, True, False
        self.blocks = constraints(problem)

    def solve_variant(self, problem: OptimalControlProblem) -> Outcome:
        """Solve a variant with a simple cost, or with none: only feasibility matters."""
        result = solve_judged(problem.derived(cost=self.problem.quadratic), Options(time_limit=self._seconds_left()))
        self.interrupted |= result.interrupted
        if result.interrupted or _is_feasible(result) is not None or "convex" not in family_of(problem).shorthands:
            return result
        return solve_judged(problem.derived(cost=QuadraticCost()), Options("convex", time_limit=self._seconds_left()))

    def _seconds_left(self) -> float | None:
        left = [(end - clock()) * (BUSY if clock is processor_now else 1.0) for clock, end in self.ends]
        return max(min(left), LEAST_SECONDS) if left else None

    def _time_is_over(self) -> bool:
        return self.interrupted or any(clock() > end for clock, end in self.ends)

    def feasible(self, problem: OptimalControlProblem) -> bool | None:
        """Whether a variant is feasible; None if it stays undecided or the time is over."""
        if self._time_is_over():
            return None
        return _is_feasible(self.solve_variant(problem))

    def irreducible_family(self, result: Outcome) -> list[Limit]:
        """Return an irreducible family: each block is dropped in turn, for good if the others are still infeasible."""
        shares = {entry.block: entry.share for entry in result.conflict or ()}
        of_ray = [block for block in self.blocks if block.name in shares]
        family = of_ray if len(of_ray) < len(self.blocks) and self._infeasible(of_ray) else list(self.blocks)
        for block in sorted(family, key=lambda block: shares.get(block.name, 0.0)):
            tell(f"{len(family)} constraints in conflict at most; without the {block.name}")
            rest = [member for member in family if member is not block]
            if self._infeasible(rest):
                family = rest
        return family

    def _infeasible(self, family: list[Limit]) -> bool:
        """Whether the problem with these blocks alone is known to be infeasible."""
        if self._time_is_over():
            self.sure = False
            return False
        answer = self.feasible(drop_limits(self.problem, [block for block in self.blocks if block not in family]))
        self.sure &= answer is not None
        return answer is False

    def cure(self, block: Limit) -> Cure | None:
        """Return the smallest relaxation of a block that restores feasibility; None if there is none, or no time."""
        tell(f"smallest change of the {block.name}")
        return None if self._time_is_over() else least_cure(self.problem, block, self.feasible, self._seconds_left())


def _is_feasible(result: Outcome) -> bool | None:
    """Whether there is a trajectory; none if a ray excludes it, at least up to the sizes that it states; else None."""
    if result.status == Status.INFEASIBLE or result.infeasibility is not None:
        return False
    return True if result.status.solved else None


def least_cure(
    problem: OptimalControlProblem, limit: Limit, feasible: Feasible, time_limit: float | None = None
) -> Cure | None:
    """Return the smallest relaxation of one limit that restores feasibility, tried on the problem; None without one."""
    rows, reached = None, np.zeros(0)
    if problem.response is None:  # else it takes no state delta
        rows = limit.rows()
    if rows is not None:
        relaxation = _least_by_delta(problem, limit, rows, feasible, time_limit)
        if relaxation is None:
            return None
        amount, reached = relaxation
    elif limit.end is not None:
        return None
    else:
        least = _least_bins if limit.whole else _least_amount
        amount = least(limit.size, lambda by: bool(feasible(limit.relaxed(problem, by))))
        if amount is None:
            return None
    return Cure(limit.name, amount, limit.words(limit.relaxed(problem, amount), amount, reached))


def _least_by_delta(
    problem: OptimalControlProblem, limit: Limit, rows: StageRows, feasible: Feasible, time_limit: float | None
) -> tuple[float, Array] | None:
    """Return the least amount by which rows must be relaxed, the optimum of a problem, and the end that it reaches."""
    elastic = _elastic_problem(problem, limit, rows)
    for method in ("structured", "convex"):  # the second is slower, and takes what the first one does not
        found = None
        with suppress(UnsupportedError):
            found = solve_judged(
                elastic, Options(method, time_limit=time_limit, tolerance=ACCURATE), proof=False
            ).trajectory
        relaxation = None if found is None else _try_relaxation(problem, limit, found, feasible)
        if relaxation is not None:
            return relaxation
    return None


def _try_relaxation(
    problem: OptimalControlProblem, limit: Limit, found: Trajectory, feasible: Feasible
) -> tuple[float, Array] | None:
    """Return the amount of an elastic problem's trajectory with which the problem is feasible, and the end reached."""
    n, of_x = problem.state_dim, stated_sizes(problem)[0]
    least = np.maximum(found.x[-1, n:], 0.0)
    least[least <= UNMOVED * least.sum()] = 0.0
    for margin in MARGINS:
        amount, reached = float(least.sum()) * (1 + margin), np.zeros(0)
        if limit.end is None:
            relaxed = limit.relaxed(problem, amount)
        else:  # a component that needs no change gets none
            box, by = (problem.initial_box, problem.terminal_box)[limit.end], least * (1 + margin) * of_x
            end = Box(box.lower - by, box.upper + by)
            relaxed = problem.derived(**{limit.field: replace_bounds(getattr(problem, limit.field), end)})
            reached = end.project(found.x[limit.end, :n])
            reached = np.where(np.abs(reached) < UNMOVED * least * of_x, 0.0, reached)
        if feasible(relaxed):
            return amount, reached
    return None


def _least_bins(most: float, suffices: Callable[[float], bool]) -> float | None:
    """Return the fewest bins to pass at the edges of a stop band, by bisection."""
    least = 0.0  # bins that do not suffice
    if not suffices(most):
        return None
    while most - least > 1:
        middle = (least + most) // 2
        least, most = (least, middle) if suffices(middle) else (middle, most)
    return most


def _least_amount(size: float, suffices: Callable[[float], bool]) -> float | None:
    """Return the least amount that suffices, by bisection; None if no multiple of a size does."""
    most = size * FIRST_AMOUNT
    while not suffices(most):
        most *= GROWTH
        if most > LARGEST * size:
            return None
    least = most / GROWTH if most > size * FIRST_AMOUNT else 0.0
    while most - least > PRECISION * (size + most):
        middle = (least + most) / 2
        least, most = (least, middle) if suffices(middle) else (middle, most)
    return most


def _elastic_problem(problem: OptimalControlProblem, limit: Limit, rows: StageRows) -> OptimalControlProblem:
    """Return the problem of the least sum of delta >= 0, its last states, by which the rows of a limit are relaxed."""
    m, T, k = problem.control_dim, problem.horizon, rows.C.shape[-1] - problem.state_dim
    names, zero = [f"relaxation {i}" for i in range(k)], np.zeros(k)
    delta = AddedStates(np.eye(k), np.zeros((k, m)), Box(zero, zero + np.inf), zero, names)
    base, name = hard_part(limit.relaxed(problem, np.inf)), f"least change of the {limit.name}"
    base = base.derived(cost=QuadraticCost(), name=name)
    elastic, (x, u) = add_states(base, delta), stated_sizes(problem)
    p = np.append(np.zeros_like(x), zero + 1 / limit.size)
    cost = QuadraticCost(R=np.diag(CONTROL_PRICE / T / u**2), P=np.diag(DELTA_CURVATURE * p**2), p=p)
    return elastic.derived(cost=cost, stage_rows=[*elastic.stage_rows, rows])


def hard_part(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem without its soft constraints: whether there is a solution does not depend on them."""
    sets = {
        field: map_sets(getattr(problem, field), lambda part: intersection(box_of(part), part.hard_members))
        for field in BOXES
    }
    spectra = {field: map_constraints(getattr(problem, field), lambda part: part.hard_part) for field in SPECTRA}
    rows = [part for family in problem.stage_rows if (part := family.hard_part) is not None]
    return problem.derived(**sets, **spectra, stage_rows=rows)
