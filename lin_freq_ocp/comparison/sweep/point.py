"""One point of a sweep: built, solved and judged in any process; the result is plain data."""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Any, TypedDict

from lin_freq_ocp.backends.blas_threads import one_blas_thread
from lin_freq_ocp.comparison.sweep.grid import Parameters, Source, plain_parameters, problem_at
from lin_freq_ocp.errors import BandWarning, LinFreqOCPError
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.status import Status

ERROR = "error"
"""Status of a point that was not solved: its description is bad, or what should have solved it died."""

INTERRUPTED = "interrupted"
"""Status of a point whose solve was stopped by Ctrl-C; no sweep keeps it."""

BROKEN = "breaks constraints"
"""What is said of a point whose cost is none: it may be lower than that of every solution."""

Row = TypedDict(
    "Row",
    {
        "parameters": Parameters,
        "status": str,
        "proven": bool,
        "cost": float | None,
        "lower_bound": float | None,
        "gap": float | None,
        "pmp": str | None,
        "global": bool | None,
        "method": str | None,
        "backend": str | None,
        "seconds": float | None,
        "message": str | None,
    },
)
"""What is known of a point, as JSON has it; None where there is nothing.

parameters: their values. status: of ``Result``, or "error". proven: whether the status is proven, by the maximum
principle or the gap, or by a ray. cost, lower_bound, gap, pmp, global, method, backend: of ``Result`` and its
certificate; cost and gap only of a point that satisfies every constraint. seconds: wall time for building, solving and
judging. message: how it ended, what is wrong with the description, or that a band removes nothing or everything.
"""

_building = threading.Lock()
"""Warnings are caught for a whole process; threads of the same process build one after another."""


def solve_point(source: Source, options: Mapping[str, Any], parameters: Parameters, attempt: int = 0) -> Row:
    """Return the row of one point; errors are in the row.

    Parameters
    ----------
    source : OptimalControlProblem or callable
    options : dict
        "method", "backend", "time_limit" and "tolerance" of ``solve``.
    parameters : dict
    attempt : int
        How often it was lost before: a scheduler that keeps answers must not take it for the same task.
    """
    started, bands = time.perf_counter(), list[str]()
    try:
        with one_blas_thread():  # linear algebra does not depend on how many work beside it
            with _band_warnings(bands):
                problem = problem_at(source, parameters)
            result = solve_judged(problem, **options)
    except LinFreqOCPError as error:
        return failed_point(parameters, str(error), time.perf_counter() - started)
    except Exception as error:  # a function that builds problems may raise anything: the others are solved
        return failed_point(parameters, f"{type(error).__name__}: {error}", time.perf_counter() - started)
    certificate, feasible = result.certificate, result.primal
    broken = [] if feasible or result.cost is None else [f"the point found, with cost {result.cost:.6g}, {BROKEN}"]
    words = "; ".join([*([result.message] if result.message else []), *broken, *bands])
    return {
        "parameters": plain_parameters(parameters),
        "status": INTERRUPTED if result.interrupted else result.status,
        "proven": _proven(result),
        "cost": _finite(result.cost) if feasible else None,
        "lower_bound": _finite(result.lower_bound),
        "gap": _finite(result.gap) if feasible else None,
        "pmp": None if certificate is None else certificate.pmp,
        "global": None if certificate is None else certificate.globally_optimal,
        "method": result.method,
        "backend": result.backend,
        "seconds": time.perf_counter() - started,
        "message": words or None,
    }


def failed_point(parameters: Parameters, words: str, seconds: float | None = None) -> Row:
    """Return the row of a point that was not solved, and why."""
    return {
        "parameters": plain_parameters(parameters),
        "status": ERROR,
        "proven": False,
        "cost": None,
        "lower_bound": None,
        "gap": None,
        "pmp": None,
        "global": None,
        "method": None,
        "backend": None,
        "seconds": seconds,
        "message": words,
    }


def _proven(result: Outcome) -> bool:
    if result.status in (Status.INFEASIBLE, Status.UNBOUNDED):
        return result.dual
    one = result.certificate
    return one is not None and ((one.pmp == "satisfied" and one.normal is True) or one.globally_optimal)


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


@contextmanager
def _band_warnings(words: list[str]) -> Generator[None]:
    """Note what is said of frequency bands, which belongs to the point; other warnings go their way."""
    with _building, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", BandWarning)
        yield
    for one in caught:
        if issubclass(one.category, BandWarning):
            words.append(str(one.message))
        else:
            warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
