"""From a problem to a judged outcome: the method is chosen, its options are checked, its answer is judged."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from lin_freq_ocp.backends.base import backend as solver_named
from lin_freq_ocp.backends.base import names
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.starts import start_of
from lin_freq_ocp.problem.translation import translation_of
from lin_freq_ocp.solving.families import chosen, require_shorthand, saved_options
from lin_freq_ocp.solving.judging import with_few_fractional
from lin_freq_ocp.solving.method import Method, Report, Request
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.translated import solve_translated


def solve_judged(
    problem: OptimalControlProblem,
    method: str | Method = "auto",
    time_limit: float | None = None,
    progress: Report | None = None,
    start: object = None,
    backend: str = "auto",
    tolerance: float | None = None,
    gap: float | None = None,
    node_limit: int | None = None,
    executor: Executor | None = None,
    global_bound: bool | None = None,
) -> Outcome:
    """Solve a problem, and judge the answer; parameters and errors are those of ``lfo.solve``."""
    require_problem(problem)
    require_options(method, time_limit, backend, tolerance, gap, node_limit)
    options = {"tolerance": tolerance, "gap": gap, "node_limit": node_limit, "executor": executor, "start": start}
    options["global_bound"] = global_bound
    found = chosen(problem, method, {"backend": None if backend == "auto" else backend, **options})
    begin = None if start is None else start_of(problem, start)
    request = Request(np.inf if time_limit is None else time_limit, progress, begin)
    allowed = tolerance or getattr(found, "tolerance", None)
    outcome = solve_translated(found, translation_of(problem), request, allowed)
    outcome = with_few_fractional(outcome, tolerance)
    saved = saved_options(problem, method, found) | ({} if begin is None else {"start": begin.saved})
    return replace(outcome, options=saved | {"time_limit": time_limit})


def require_options(
    method: str | Method,
    time_limit: float | None = None,
    backend: str = "auto",
    tolerance: float | None = None,
    gap: float | None = None,
    node_limit: int | None = None,
) -> None:
    """Raise UnsupportedError unless the options of solve exist, MissingExtraError if the backend is not installed."""
    if isinstance(method, str):
        require_shorthand(method)
    if backend not in ("auto", *names(binaries=True)):
        solver_named(backend)
    limits = {"time_limit": time_limit, "tolerance": tolerance, "gap": gap, "node_limit": node_limit}
    for name, value in limits.items():
        if value is not None and not value > 0:
            raise UnsupportedError(f"{name}: got {value!r}; expected a number above zero, or None.")
