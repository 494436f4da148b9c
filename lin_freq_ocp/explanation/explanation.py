"""An irreducible infeasible family of constraints, and for each member the least relaxation that restores feasibility.

The family is found by deletion: each block is dropped in turn, for good if the others are still infeasible. For bounds,
joint rows and ends the least relaxation is the optimum of a convex problem of the usual kind: a state delta, constant
in time, relaxes the block's rows. For a term it is a bisection on its limit, for a stop band a bisection on the number
of bins that are passed at its edges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, positive_number
from lin_freq_ocp.base.clock import LEAST_SECONDS, now, processor_now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.explanation.blocks import ENDS, Block, blocks, drop_blocks, hard_only, kept_stopped, relax_block
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.reformulations import AddedStates, extended
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.solving.families import family_of
from lin_freq_ocp.solving.outcome import Cure, Explanation, Outcome
from lin_freq_ocp.solving.solve import solve_judged

Feasible = Callable[[OptimalControlProblem], bool | None]  # whether a problem has a solution; None if undecided

# The first margin by which more than the least amount cures is taken, so that rounding does not decide.
MARGINS = (1e-6, 1e-4, 1e-2)
FIRST_AMOUNT, GROWTH, PRECISION = 1e-3, 8.0, 1e-4  # relative to a limit: first rise tried, its growth, final precision
SMALLEST_CURE = 1e-9  # fraction of a cure below which no smaller one is looked for
CLOSE = 1.05  # factor to which a cure by bounds or rows is the least
# Cost of controls of their stated sizes, relative to that of a delta as large: keeps the problem well-posed.
CONTROL_PRICE = 1e-6
LARGEST = 1e6  # an amount beyond this multiple of the sizes in the data is no cure

# Whether a problem has a solution, by the statuses that decide it.
DECIDED = {Status.OPTIMAL: True, Status.LOCALLY_OPTIMAL: True, Status.INFEASIBLE: False}
BUSY = 20.0  # seconds that a solve may last for each processor second that is left: solves watch the other clock


def explain(
    problem: OptimalControlProblem, time_limit: float | None = None, processor_time: float | None = None
) -> Explanation:
    """Explain why a problem has no solution.

    Parameters
    ----------
    problem : OptimalControlProblem
    time_limit : float, optional
        Seconds after which nothing more is tried, nor after Ctrl-C; what was found until then is returned.
    processor_time : float, optional
        The same in processor seconds of this process: what else runs on the machine takes nothing away.

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
    >>> explanation = lfo.explain(lfo.library.double_integrator(cutoff_hz=0.3))
    >>> print(explanation.cures[0])
    initial state: ...
    """
    require_problem(problem)
    if problem.dynamics.affine and problem.dynamics.mode_names:
        raise UnsupportedError(
            "explain: got piecewise-affine dynamics, where every mode sequence has its own reasons; "
            "explain(problem.with_modes(sequence)) tells those of one."
        )
    limits = {"time_limit": (now, time_limit), "processor_time": (processor_now, processor_time)}
    ends = [
        (clock, clock() + positive_number(name, limit)) for name, (clock, limit) in limits.items() if limit is not None
    ]
    with one_blas_thread():  # several would use up the processor time while they wait for each other
        search = _VariantSolver(problem, ends)
        result = search.solved(problem)
        if result.status != Status.INFEASIBLE:
            raise UnsupportedError(f"explain: this problem was not proven infeasible, it ended as '{result.status}'.")
        family = search.family(result)
        cures = tuple(cure for block in family if (cure := search.cure(block)) is not None)
    return Explanation(tuple(block.name for block in family), search.sure, cures)


class _VariantSolver:
    """Solves variants of one problem; ``sure`` until one stays undecided or the time is over."""

    def __init__(self, problem: OptimalControlProblem, ends: list[tuple[Callable[[], float], float]]):
        cost = QuadraticCost(R=np.diag(1 / stated_sizes(problem)[1] ** 2))
        self.problem, self.ends, self.sure, self.interrupted = replace(problem, cost=cost), ends, True, False
        self.blocks = blocks(problem)

    def solved(self, problem: OptimalControlProblem) -> Outcome:
        """Return how a variant ends, with a simple cost or none: only feasibility matters."""
        result = solve_judged(replace(problem, cost=self.problem.quadratic), time_limit=self._seconds_left())
        self.interrupted |= result.interrupted
        if result.interrupted or result.status in DECIDED or "convex" not in family_of(problem).shorthands:
            return result
        return solve_judged(replace(problem, cost=QuadraticCost()), "convex", time_limit=self._seconds_left())

    def _seconds_left(self) -> float | None:
        left = [(end - clock()) * (BUSY if clock is processor_now else 1.0) for clock, end in self.ends]
        return max(min(left), LEAST_SECONDS) if left else None

    def _time_is_over(self) -> bool:
        return self.interrupted or any(clock() > end for clock, end in self.ends)

    def feasible(self, problem: OptimalControlProblem) -> bool | None:
        """Whether a variant has a solution; None where that is not known, as where the time is over."""
        if self._time_is_over():
            return None
        return DECIDED.get(self.solved(problem).status)

    def family(self, result: Outcome) -> list[Block]:
        """Return an irreducible family: each block is dropped in turn, for good if the others are still infeasible."""
        named = {one.block: one.share for one in result.conflict or ()}
        some = [block for block in self.blocks if block.name in named]
        family = some if self._infeasible(some) else list(self.blocks)
        for block in sorted(family, key=lambda block: named.get(block.name, 0.0)):
            rest = [one for one in family if one is not block]
            if self._infeasible(rest):
                family = rest
        return family

    def _infeasible(self, kept: list[Block]) -> bool:
        """Whether these blocks alone are known to have no solution."""
        if self._time_is_over():
            self.sure = False
            return False
        found = self.feasible(drop_blocks(self.problem, [block for block in self.blocks if block not in kept]))
        self.sure &= found is not None
        return found is False

    def cure(self, block: Block) -> Cure | None:
        """Return the least change of a block that cures the problem, if it does and there is time."""
        return None if self._time_is_over() else least_cure(self.problem, block, self.feasible, self._seconds_left())


def least_cure(
    problem: OptimalControlProblem, block: Block, feasible: Feasible, time_limit: float | None = None
) -> Cure | None:
    """Return the least relaxation of a block that cures the problem, tried on it; None if none of it alone does."""
    if block.kind.endswith("stop band"):
        return _least_narrowing(problem, block, feasible)
    if block.kind == "term":
        return _least_rise(problem, block, feasible)
    if problem.dynamics.response(problem.horizon) is not None:  # it takes no state delta
        amount = None if block.kind in ENDS else _least_amount(problem, block, feasible, _bounded_size(problem, block))
        if amount is None:
            return None
        cured = relax_block(problem, block, amount)
        return Cure(block.name, amount, _cure_description(problem, cured, block, amount, np.zeros(0)))
    result = solve_judged(_elastic_problem(problem, block), "convex", time_limit=time_limit)
    if result.trajectory is None:  # an inaccurate one is good enough: the amount is tried below
        return None
    least, sizes = max(float(result.trajectory.x[-1, -1]), 0.0), stated_sizes(problem)
    if least > LARGEST * max(map(np.max, sizes)):
        return None
    end = result.trajectory.x[0 if block.kind == ENDS[0] else -1, :-1]

    def relaxed_by(amount: float) -> OptimalControlProblem:
        return relax_block(problem, block, amount * sizes[0] if block.kind in ENDS else amount)

    for margin in MARGINS:
        amount = least * (1 + margin)
        if feasible(relaxed_by(amount)):
            if block.kind not in ENDS:
                amount = _reduce_amount(amount, lambda less: bool(feasible(relaxed_by(less))))
            return Cure(block.name, amount, _cure_description(problem, relaxed_by(amount), block, amount, end))
    return None


def _least_narrowing(problem: OptimalControlProblem, block: Block, feasible: Feasible) -> Cure | None:
    """Return the fewest bins to pass at the edges of a stop band, by bisection."""
    stopped = (problem.state_stop if block.kind == "state stop band" else problem.control_stop)[:, block.index]
    most = len(stopped)
    if not feasible(relax_block(problem, block, most)):
        return None
    least = 0  # bins that do not suffice
    while most - least > 1:
        middle = (least + most) // 2
        least, most = (least, middle) if feasible(relax_block(problem, block, middle)) else (middle, most)
    before, after = (np.flatnonzero(~mask) for mask in (stopped, kept_stopped(stopped, most)))
    text = f"{len(before)} -> {len(after)} passed bins of {len(stopped)}"
    if len(before) and stopped[before.max() + 1 :].all() and not stopped[: before.max()].any():  # a low pass
        length, Ts = problem.state_samples if "state" in block.kind else problem.horizon, problem.sampling_time
        factor, unit = (2 * np.pi, "rad/sample") if Ts is None else (1 / Ts, "Hz")
        first, second = (f"{factor * bins.max() / length:.6g}" for bins in (before, after))
        text = f"cut-off {first} -> {second} {unit}"
    return Cure(block.name, float(most), text)


def _least_rise(problem: OptimalControlProblem, block: Block, feasible: Feasible) -> Cure | None:
    """Return the least amount by which the limits of a term must rise, by bisection: it need not be a row."""
    terms = [term for term in problem.terms if term.source == (block.family, block.index)]
    limit = max(float(np.max(term.penalty.sizes())) for term in terms)
    most = _least_amount(problem, block, feasible, limit if limit > 0 else 1.0)
    if most is None:
        return None
    if limit == 0:
        return Cure(block.name, most, f"wider by {most:.6g}")
    power = 2 if all(term.name.startswith("energy bound") for term in terms) else 1  # energies are given as squares
    return Cure(block.name, most, f"limit {limit**power:.6g} -> {(limit + most) ** power:.6g}")


def _least_amount(problem: OptimalControlProblem, block: Block, feasible: Feasible, unit: float) -> float | None:
    """Return the least amount by which a block must be relaxed, by bisection; None if no multiple of a unit does."""
    most = unit * FIRST_AMOUNT
    while not feasible(relax_block(problem, block, most)):
        most *= GROWTH
        if most > LARGEST * unit:
            return None
    least = most / GROWTH if most > unit * FIRST_AMOUNT else 0.0
    while most - least > PRECISION * (unit + most):
        middle = (least + most) / 2
        least, most = (least, middle) if feasible(relax_block(problem, block, middle)) else (middle, most)
    return most


def _bounded_size(problem: OptimalControlProblem, block: Block) -> float:
    """Return the size of what a block bounds."""
    x, u = stated_sizes(problem)
    if block.kind == "row":
        return float(_rows_of_block(problem, block).sizes(x, u)[..., block.index].max())
    return float({"state bound": x, "control bound": u}.get(block.kind, np.ones(1 + block.index))[block.index])


def _rows_of_block(problem: OptimalControlProblem, block: Block) -> StageRows:
    return next(rows for rows in problem.stage_rows if rows.name == block.family)


def _cure_description(
    problem: OptimalControlProblem, cured: OptimalControlProblem, block: Block, amount: float, end: Array
) -> str:
    if block.kind in ENDS:
        before = problem.initial_box if block.kind == ENDS[0] else problem.terminal_box
        text = " x ".join(f"[{low:.6g}, {high:.6g}]" for low, high in zip(before.lower, before.upper, strict=True))
        if before.fixed.all():
            text = np.array2string(before.lower, precision=6, separator=", ")
        return f"{text} -> {np.array2string(end, precision=6, separator=', ')}"
    if block.kind == "row":
        limits = _rows_of_block(problem, block).e[..., block.index]
        if np.ptp(limits) == 0:
            shown = [f"{limit:.6g}" for limit in (np.max(limits), np.max(limits) + amount)]
            return f"<= {shown[0]} -> {shown[1]}" + _small_amount_note(shown, amount)
        return f"limits higher by {amount:.6g}"
    tubes = [one.state_boxes if block.kind == "state bound" else one.control_tube for one in (problem, cured)]
    lower, upper = tubes[0].lower[:, block.index], tubes[0].upper[:, block.index]
    if (lower == lower[0]).all() and (upper == upper[0]).all():
        shown = [f"[{one.lower[0, block.index]:.6g}, {one.upper[0, block.index]:.6g}]" for one in tubes]
        return " -> ".join(shown) + _small_amount_note(shown, amount)
    return f"bounds wider by {amount:.6g}"


def _small_amount_note(shown: list[str], amount: float) -> str:
    """Return the amount where rounded limits do not show it: the problem is nearly feasible."""
    return f" (by {amount:.2g}: nearly feasible)" if shown[0] == shown[1] else ""


def _elastic_problem(problem: OptimalControlProblem, block: Block) -> OptimalControlProblem:
    """Return the problem of the least delta >= 0, its last state, by which the block is relaxed."""
    m, T = problem.control_dim, problem.horizon
    delta = AddedStates(np.eye(1), np.zeros((1, m)), Box([0.0], [np.inf]), np.zeros(1), ["relaxation"])
    base = replace(
        hard_only(relax_block(problem, block, np.inf)), cost=QuadraticCost(), name=f"least change of the {block.name}"
    )
    elastic, (x, u) = extended(base, delta), stated_sizes(problem)
    unit = _bounded_size(problem, block)
    cost = QuadraticCost(R=np.diag(CONTROL_PRICE / T / u**2), P=np.diag(np.append(np.zeros_like(x), unit**-2)))
    return replace(elastic, cost=cost, stage_rows=[*elastic.stage_rows, _elastic_rows(problem, block)])


def _elastic_rows(problem: OptimalControlProblem, block: Block) -> StageRows:
    """Return the block's rows, each less delta times its size; those on x_T as rows on A x + B u of the step before."""
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    i, x, u = block.index, np.eye(n), np.eye(m)
    if block.kind == "row":
        rows = _rows_of_block(problem, block)
        C, D = (np.broadcast_to(part, (T, *part.shape[-2:]))[:, [i]] for part in (rows.C, rows.D))
        limits = np.broadcast_to(rows.e, (T, rows.rows))[:, [i]]
        return StageRows(np.concatenate([C, np.full((T, 1, 1), -1.0)], axis=2), D, limits, "relaxed")
    A, B, d = problem.linear.at(T - 1)
    parts: list[tuple[Array, Array, Array]] = []  # rows on (x, delta) and on u, limits (T,)

    def add(C: Array, D: Array, upper: Array, lower: Array, size: float = 1.0) -> None:
        parts.extend([(np.append(C, -size), D, upper), (np.append(-C, -size), -D, -lower)])

    def at(t: int, value: float, absent: float) -> Array:
        return np.where(np.arange(T) == t, value, absent)

    if block.kind == "control bound":
        add(np.zeros(n), u[i], problem.control_tube.upper[:, i], problem.control_tube.lower[:, i])
    elif block.kind == "state bound":
        upper, lower = problem.state_boxes.upper[:, i], problem.state_boxes.lower[:, i]
        add(x[i], np.zeros(m), upper[:T], lower[:T])
        add(A[i], B[i], at(T - 1, upper[T] - d[i], np.inf), at(T - 1, lower[T] - d[i], -np.inf))
    else:
        first = block.kind == ENDS[0]
        end = problem.initial_box if first else problem.terminal_box
        t, C, D, offset = (0, x, np.zeros((n, m)), np.zeros(n)) if first else (T - 1, A, B, d)
        for j, size in enumerate(stated_sizes(problem)[0]):
            upper, lower = at(t, end.upper[j] - offset[j], np.inf), at(t, end.lower[j] - offset[j], -np.inf)
            add(C[j], D[j], upper, lower, size)
    rows_x, rows_u, limits = map(np.array, zip(*parts, strict=True))
    return StageRows(rows_x, rows_u, limits.T, "relaxed")


def _reduce_amount(amount: float, suffices: Callable[[float], bool]) -> float:
    """Return the least amount that suffices, to 5 %: small amounts are dominated by the price of the controls."""
    if not suffices(amount / CLOSE):
        return amount
    least, most = amount / GROWTH, amount / CLOSE
    while least > SMALLEST_CURE * amount and suffices(least):
        least, most = least / GROWTH, least
    while most > CLOSE * least:
        middle = float(np.sqrt(least * most))
        least, most = (least, middle) if suffices(middle) else (middle, most)
    return most
