"""minimum_time(), the least feasible horizon with its proof."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from typing import final

import numpy as np

from lin_freq_ocp.api.result import Result, present_as
from lin_freq_ocp.api.solve import conflict_in_words, raise_for
from lin_freq_ocp.base.activity import report_progress
from lin_freq_ocp.base.errors import InfeasibleError
from lin_freq_ocp.base.phrases import html_table, plural, runs_in_words, runs_of, term_rows
from lin_freq_ocp.batch.grid import Source, require_executor
from lin_freq_ocp.batch.minimum_time import (
    Search,
    checked_horizons,
    obstacles,
    problem_at_horizon,
    require_source,
    search_horizons,
    solve_horizon,
)
from lin_freq_ocp.batch.sweep import sweep_head
from lin_freq_ocp.files.batch_files import SweepFile
from lin_freq_ocp.problem.description import warn_of_bands
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.solving.families import Options
from lin_freq_ocp.solving.method import Method

MONOTONE = "zeros can be appended to every feasible control, and the trajectory stays feasible"


@final
@dataclass(frozen=True, eq=False)
class MinimumTime:
    """The least feasible horizon of a range, with the infeasibility proofs of shorter ones.

    Attributes
    ----------
    horizon : int or None
        The least feasible horizon; None if no horizon is known to be feasible.
    result : Result or None
        The optimum of the problem's cost at that horizon. Without a horizon: the result at the largest one solved.
    ray : Multipliers or None
        The verified ray of infeasibility at one step less; without a horizon, the ray at the largest horizon of the
        range. None if one step less is outside of the range, or has no ray that proves it infeasible.
    monotone : bool
        Whether feasibility at one horizon is proven to imply feasibility at all longer ones.
    reason : str
        Why feasibility is monotone, or which conditions for it fail.
    proven : bool
        Whether every shorter horizon of the range is proven infeasible; without a horizon, whether all of them are.
    proof : str
        The statement that is proven, in words.
    horizons : (int, int)
        The range.
    verdicts : dict
        The verdict on each solved horizon: "feasible", "infeasible" (by a verified proof) or "undecided".
    rays : dict
        The ray of each horizon that is proven infeasible by one. The file of an earlier run has no rays.
    interrupted : bool
        Whether Ctrl-C ended the search; the attributes then hold the state at that time.

    Examples
    --------
    >>> shortest = lfo.minimum_time(lfo.library.mri_gradient, horizons=(125, 140))
    >>> shortest.horizon, shortest.monotone, shortest.ray is not None
    (132, True, True)
    """

    horizon: int | None
    result: Result | None
    ray: Multipliers | None
    monotone: bool
    reason: str
    proven: bool
    proof: str
    horizons: tuple[int, int]
    verdicts: Mapping[int, str]
    rays: Mapping[int, Multipliers] = field(repr=False)
    interrupted: bool = False

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Return the facts of the search: a term and its text each."""
        known = "none is known to be feasible" if self.horizon is None else plural(self.horizon, "step")
        kind = "monotone" if self.monotone else "not known to be monotone"
        return [
            ("least horizon", known + (" (interrupted)" if self.interrupted else "")),
            ("proof", self.proof),
            ("feasibility", f"{kind}: {self.reason}"),
            ("solved", f"{plural(len(self.verdicts), 'horizon')} of {self.horizons[0]} to {self.horizons[1]}"),
        ]

    def __str__(self) -> str:
        lines = [f"{term:13}  {text}" for term, text in self.rows]
        return "\n".join([*lines, *([] if self.result is None else [str(self.result)])])

    def __repr__(self) -> str:
        return f"MinimumTime(horizon={self.horizon}, horizons={self.horizons}, proof={self.proof!r})"

    def _repr_html_(self) -> str:
        head, *lines = [] if self.result is None else str(self.result).splitlines()
        return html_table("Minimum time", [*self.rows, *([("problem", head)] if head else []), *term_rows(lines)])


def minimum_time(
    problem: Source,
    horizons: tuple[int, int],
    method: str | Method = "auto",
    backend: str = "auto",
    time_limit: float | None = None,
    tolerance: float | None = None,
    throw: bool = True,
    progress: Callable[[int, str], None] | None = None,
    executor: Executor | None = None,
    path: str | PathLike[str] | None = None,
) -> MinimumTime:
    """Find the least feasible horizon of a problem, its optimum, and a proof that one step less is infeasible.

    If feasibility is monotone (zeros can be appended to any feasible control), the search bisects; otherwise it solves
    horizon by horizon from below. The conditions are checked, and ``reason`` names those that fail. A horizon is
    infeasible only if the judge has verified a proof, and undecided if there is no answer. With masks at every
    frequency and linear dynamics, a solve ends at any trajectory that satisfies all constraints, with the status
    "limit"; the optimum is computed at the least horizon.

    Parameters
    ----------
    problem : OptimalControlProblem or callable
        A problem whose data do not depend on time and so are the same at every horizon; or a function of ``horizon``,
        such as ``lfo.library.mri_gradient`` or a ``functools.partial`` of it.
    horizons : (int, int)
        The least and the largest horizon to consider.
    method, backend, time_limit, tolerance
        As for ``solve``, for each horizon.
    throw : bool
        Whether to raise if no horizon is known to be feasible.
    progress : callable, optional
        Called with each solved horizon and its verdict. Default: a line on a terminal or in a notebook.
    executor, path
        As for ``sweep``: where to solve several horizons at once, and a file that gets a line for each horizon.
        ``load_sweep`` reads the file as a sweep over the horizon.

    Returns
    -------
    MinimumTime
        After Ctrl-C: the state of the search, with ``interrupted`` set.

    Raises
    ------
    ProblemError
        If the range is invalid, a field of the problem fixes its horizon, or as for ``sweep``, for an executor and a
        path.
    InfeasibleError
        With ``throw``, if all horizons are proven infeasible; ``.result`` is that of the largest, with its ray.
    LimitError, NumericalError
        With ``throw``, if no horizon is known to be feasible, and some are undecided.
    UnsupportedError
        If the method or backend does not exist or cannot take this problem.

    References
    ----------
    Hargreaves, Nishimura and Conolly, "Time-optimal multidimensional gradient waveform design for rapid imaging",
    Magnetic Resonance in Medicine 51(1), 2004: minimum time by feasibility problems of fixed length.

    Examples
    --------
    >>> mover = lfo.library.double_integrator(cutoff_hz=None)
    >>> shortest = lfo.minimum_time(mover, horizons=(100, 300))
    >>> shortest.horizon, shortest.proof
    (182, '182 is feasible; 181 is proven infeasible, and with it all shorter horizons')
    """
    low, high = checked_horizons(horizons)
    require_source(problem)
    options = Options(method, backend, time_limit, tolerance)
    failing = obstacles(partial(problem_at_horizon, problem), low, high, same_data=not callable(problem))
    monotone = not failing

    require_executor(executor, problem, {"method": [method]})
    name = method if isinstance(method, str) else repr(method)
    stated = {"method": name, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    head = sweep_head(problem, {"horizon": range(low, high + 1)}, stated) if path is not None else {}
    with report_progress(progress, "looking for the least horizon", "horizon {}: {}".format) as report:
        solve_at = partial(solve_horizon, problem, options)
        record = None if path is None else SweepFile(path, head)
        search = search_horizons(low, high, monotone, solve_at, report, executor, record)
    horizon, proven = search.horizon, search.proven
    outcome, last = (search.last, high) if horizon is None else (search.best, horizon - 1)
    if outcome is not None:
        warn_of_bands(outcome.problem)
    # If feasibility is monotone, a proof at one horizon proves all shorter ones infeasible.
    first = max(proven, default=low - 1) + 1 if monotone else low
    unproven = [T for T in range(first, last + 1) if T not in proven]
    shortest = MinimumTime(
        horizon=horizon,
        result=None if outcome is None else present_as(Result, outcome),
        ray=search.rays.get(last),
        monotone=monotone,
        reason=MONOTONE if monotone else "; ".join(failing),
        proven=not unproven,
        proof=_proof_in_words(search, unproven, monotone),
        horizons=(low, high),
        verdicts={T: str(search.verdicts[T]) for T in sorted(search.verdicts)},
        rays=search.rays,
        interrupted=search.interrupted,
    )
    if throw and horizon is None and shortest.result is not None and not search.interrupted:
        if shortest.proven:
            text = f"No horizon from {low} to {high} is feasible: {shortest.proof}. Allow longer ones. "
            text += f"At {high}: {shortest.result.message}.{conflict_in_words(shortest.result)}"
            raise InfeasibleError(text, shortest.result)
        raise_for(shortest.result)
    return shortest


def _proof_in_words(search: Search, unproven: list[int], monotone: bool) -> str:
    proven = [T for T in search.proven if search.horizon is None or T < search.horizon]  # an executor solves more
    facts = [] if search.horizon is None else [f"{search.horizon} is feasible"]
    if search.horizon == search.low:
        facts.append("shorter horizons are outside of the range")
    elif monotone and proven:
        facts.append(f"{proven[-1]} is proven infeasible, and with it all shorter horizons")
    elif proven:
        each = f"{proven[0]} is" if len(proven) == 1 else f"each of {runs_in_words(runs_of(np.array(proven)))} is"
        facts.append(f"{each} proven infeasible")
    if unproven:
        claimed = [T for T in unproven if T in search.claimed]
        if claimed:
            where = runs_in_words(runs_of(np.array(claimed)))
            facts.append(f"a solver claims without a proof that no trajectory exists at {where}")
        facts.append(f"nothing is proven of {runs_in_words(runs_of(np.array(unproven)))}")
    return "; ".join(facts)
