"""solve(): an answer with its certificate, or an error."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace

from lin_freq_ocp.api.result import Result, present_as
from lin_freq_ocp.base.activity import report_progress
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import (
    InfeasibleError,
    LimitError,
    LinFreqOCPError,
    NumericalError,
    SolveError,
    UnboundedError,
)
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.families import Options
from lin_freq_ocp.solving.method import Method, Report
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged

EXPLAIN_SECONDS = 5.0  # of processor time for the explanation of an infeasible problem

# The errors of statuses without an answer.
ERRORS: dict[Status, type[SolveError]] = {
    Status.INFEASIBLE: InfeasibleError,
    Status.INFEASIBLE_CLAIMED: InfeasibleError,
    Status.UNBOUNDED: UnboundedError,
    Status.LIMIT: LimitError,
    Status.NUMERICAL_ERROR: NumericalError,
}


def solve(
    problem: OptimalControlProblem,
    method: str | Method = "auto",
    backend: str = "auto",
    time_limit: float | None = None,
    tolerance: float | None = None,
    throw: bool = True,
    node_limit: int | None = None,
    progress: Report | None = None,
    executor: Executor | None = None,
    start: object = None,
    gap: float | None = None,
    global_bound: bool | None = None,
) -> Result:
    """Solve a problem, and certify the answer.

    Parameters
    ----------
    problem : OptimalControlProblem
    method : str or Method
        An object with its options: ``Spectral``, ``Structured``, ``Convex`` (linear dynamics); ``BranchAndBound``,
        ``Enumeration``, ``MixedInteger`` (piecewise affine); ``Nonsmooth`` (piecewise smooth). Or its shorthand,
        "spectral", "structured", "convex", "branch_and_bound", "enumerate", "miqp" or "nonsmooth", whose options are
        the keywords below. "auto" chooses by the dynamics. Linear: spectral if it applies and its answer is proven,
        otherwise structured for large problems and convex for small ones (``result.reason`` says why). Piecewise
        affine: branch and bound. Piecewise smooth: nonsmooth with a global bound (up to three states), for which it
        uses 10 s or the rest of the time limit. A single smooth map: Newton's method from a few starts, without search.
    backend : str
        For "convex": "auto" (Clarabel), "clarabel", "osqp" or "qpsolvers:NAME"; with linear dynamics, a backend makes
        "auto" mean "convex". For "miqp": "auto" (SCIP), "scip" or "daqp".
    time_limit : float, optional
        Seconds for set-up and solve, without the certificate. A step that is estimated to take longer is not begun.
    tolerance : float, optional
        Linear dynamics: relative residuals for the solver. Above 1e-6, up to 1e-2, the judge allows the same. Piecewise
        dynamics: the same as ``gap``.
    throw : bool
        Whether to raise unless the status is "optimal", "locally_optimal" or "extremal"; the error holds the result.
    node_limit : int, optional
        Piecewise-affine dynamics: the largest number of relaxations to solve.
    progress : callable, optional
        Piecewise-affine dynamics: called with a ``SearchProgress`` (cost, lower_bound, nodes, open, seconds) at every
        node. Piecewise-smooth dynamics: called with a ``SmoothProgress`` (cost, lower_bound, tried, level, share) at
        every start of a local search and every step of the bound. Default: a line on a terminal or in a notebook.
    executor : concurrent.futures.Executor, optional
        Branch and bound: workers that search subtrees. The answer does not depend on their number.
    start : Trajectory, (T, m) or (T,) integers, optional
        Piecewise dynamics: a trajectory (or a result), controls to simulate from the initial state, or the mode at
        every time. Branch and bound starts with the best trajectory of these modes, the local search with this
        trajectory; their answer is not worse.
    gap : float, optional
        Relative gap (J - D)/S to prove: 1e-6 by default for piecewise-affine dynamics, 1e-4 for piecewise-smooth ones.
    global_bound : bool, optional
        Piecewise-smooth dynamics: whether to bound the cost of all trajectories. False returns a local answer at once.

    Returns
    -------
    Result

    Raises
    ------
    InfeasibleError, UnboundedError, LimitError, NumericalError
        With ``throw``; a subclass of SolveError, with ``.result``.
    UnsupportedError
        If the method or backend does not exist, does not take this problem or one of the options, or the problem does
        not fit into memory.
    MissingExtraError
        If the package of the backend is not installed.
    ProblemError
        If the start does not fit the problem, or a keyword is unknown.

    References
    ----------
    Kotpalliwar, Paruchuri, Chatterjee and Banavar, "Discrete time optimal control with frequency constraints for
    non-smooth systems", 2019: Theorem 4.1 and its corollaries, which the certificate checks.

    Examples
    --------
    >>> import lin_freq_ocp as lfo
    >>> result = lfo.solve(lfo.library.pendulum())
    >>> result.status, result.certificate.globally_optimal
    ('optimal', True)
    """
    started = now()
    options = Options(method, backend, time_limit, tolerance, gap, node_limit, executor, start, global_bound)
    with report_progress(progress, "solving", str) as report:
        outcome = solve_judged(problem, options, report)
    return result_of(outcome, throw, None if time_limit is None else time_limit - (now() - started))


def result_of(outcome: Outcome, throw: bool, seconds_left: float | None = None) -> Result:
    """Return an outcome as a result; with ``throw``, raise the error of a status without an answer, explained."""
    result = present_as(Result, outcome)
    if throw:
        excluded = result.status == Status.INFEASIBLE or result.ray is not None
        raise_for(with_explanation(result, seconds_left) if excluded else result)
    return result


def raise_for(result: Result) -> None:
    """Raise the error of a result whose status is neither "optimal" nor "locally_optimal" nor "extremal"."""
    name = result.problem.name or "the problem"
    if result.status not in ERRORS:
        return
    if result.status in (Status.INFEASIBLE, Status.INFEASIBLE_CLAIMED):
        message = f"No trajectory of {name} satisfies all constraints ({result.message})."
        if result.status == Status.INFEASIBLE_CLAIMED and result.ray is not None:
            message = f"{name}: {result.message}. Larger ones are not excluded: bound all states and controls."
        elif result.status == Status.INFEASIBLE_CLAIMED:
            message = f"{name}: {result.solver} claims infeasibility without a proof ({result.message})."
        message += conflict_in_words(result)
    elif result.status == Status.UNBOUNDED:
        message = f"The cost of {name} has no lower bound. Bound the controls, or give every one of them a cost."
    elif result.status == Status.LIMIT:
        figures = {"cost": result.cost, "lower bound": result.lower_bound, "gap": result.gap}
        texts = [f"{term} {'unknown' if value is None else format(value, '.6g')}" for term, value in figures.items()]
        best = f"the best point is in .result: {', '.join(texts)}"
        if result.trajectory is None:
            bound = "" if result.lower_bound is None else f", lower bound {result.lower_bound:.6g}"
            best = f"no point was found{bound}"
        message = f"{name}: stopped before the answer was accurate ({result.message}); {best}."
    else:
        message = (
            f"{name}: {result.solver} ended with '{result.message}', and its residuals are too large for a solution; "
            "its last point is in .result. Try another backend or method."
        )
    raise ERRORS[result.status](message, result)


def conflict_in_words(result: Result) -> str:
    """Return a sentence with the constraints in conflict and the advice on them; empty where no ray names them."""
    if result.conflict is None:
        return ""
    of_ray = {part.block: str(part) for part in result.conflict}  # with times or bins
    family = result.explanation.family if result.explanation else of_ray
    cures = "; or ".join(map(str, result.explanation.cures)) if result.explanation else ""
    advice = f"Smallest change that restores feasibility: {cures}." if cures else "Relax one of these."
    return f" In conflict: {'; '.join(of_ray.get(block, block) for block in family)}. {advice}"


def with_explanation(
    result: Result, seconds_left: float | None = None, processor_time: float | None = EXPLAIN_SECONDS
) -> Result:
    """Return an infeasible result with its explanation, if one is found within these limits; None for no limit."""
    from lin_freq_ocp.explanation.explanation import explain  # few problems are infeasible

    if seconds_left is not None and seconds_left <= 0:
        return result
    try:
        return replace(result, explanation=explain(result.problem, seconds_left, processor_time))
    except LinFreqOCPError:  # the proof stands without it
        return result
