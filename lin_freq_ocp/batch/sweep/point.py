"""One point of a sweep: built, solved and judged in any process; the result is plain data."""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Any, TypedDict

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import BandWarning, LinFreqOCPError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.sweep.grid import Parameters, Source, plain_parameters, problem_at
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged

ERROR = "error"  # status of a point that was not solved: its description is bad, or its worker died
INTERRUPTED = "interrupted"  # status of a point whose solve was stopped by Ctrl-C; no sweep keeps it

Row = TypedDict(
    "Row",
    {
        "parameters": Parameters,  # as JSON has them
        "status": str,  # of Result, or "error"
        "proven": bool,  # the status: by the maximum principle, the gap, or a ray
        "cost": float | None,  # like the gap, only of a point that satisfies every constraint
        "lower_bound": float | None,
        "bound": str | None,  # "rigorous" or "numerical", of the cost or of infeasibility
        "gap": float | None,
        "pmp": str | None,
        "global": bool | None,
        "method": str | None,
        "backend": str | None,
        "seconds": float | None,  # wall time for building, solving and judging
        "message": str | None,  # how it ended, a bad description, or a band that removes nothing or everything
    },
)

_building = threading.Lock()  # warnings are caught for a whole process: its threads build one after another


def solve_point(source: Source, options: Mapping[str, Any], parameters: Parameters, attempt: int = 0) -> Row:
    """Return the row of one point; errors are in the row.

    ``attempt`` counts how often the point was lost before: a scheduler that keeps answers must not take it for the
    same task.
    """
    started, bands = now(), list[str]()
    try:
        with one_blas_thread():  # linear algebra does not depend on how many workers there are
            with _band_warnings(bands):
                problem = problem_at(source, parameters)
            result = solve_judged(problem, **options)
    except LinFreqOCPError as error:
        return failed_point(parameters, str(error), now() - started)
    except Exception as error:  # a function that builds problems may raise anything: the others are solved
        return failed_point(parameters, f"{type(error).__name__}: {error}", now() - started)
    row = failed_point(parameters, None, now() - started)
    certificate, messages = result.certificate, [result.message] if result.message else []
    row["status"] = INTERRUPTED if result.interrupted else result.status
    row["proven"], row["lower_bound"] = _proven(result), _finite(result.lower_bound)
    row["bound"] = result.bound
    row["method"], row["backend"] = result.method, result.backend
    if certificate is not None:
        row["pmp"], row["global"] = certificate.pmp, certificate.globally_optimal
    if result.primal:
        row["cost"], row["gap"] = _finite(result.cost), _finite(result.gap)
    elif result.cost is not None:  # it may be lower than that of every solution
        messages.append(f"the point found, with cost {result.cost:.6g}, breaks constraints")
    row["message"] = "; ".join([*messages, *bands]) or None
    return row


def failed_point(parameters: Parameters, message: str | None, seconds: float | None = None) -> Row:
    """Return the row of a point that was not solved, and why."""
    return {
        "parameters": plain_parameters(parameters),
        "status": ERROR,
        "proven": False,
        "cost": None,
        "lower_bound": None,
        "bound": None,
        "gap": None,
        "pmp": None,
        "global": None,
        "method": None,
        "backend": None,
        "seconds": seconds,
        "message": message,
    }


def _proven(result: Outcome) -> bool:
    if result.status in (Status.INFEASIBLE, Status.UNBOUNDED):
        return result.dual
    certificate = result.certificate
    if certificate is None:
        return False
    return (certificate.pmp == "satisfied" and certificate.normal is True) or certificate.globally_optimal


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


@contextmanager
def _band_warnings(messages: list[str]) -> Generator[None]:
    """Collect the warnings on frequency bands, which belong to the point; other warnings are issued again."""
    with _building, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", BandWarning)
        yield
    for warning in caught:
        if issubclass(warning.category, BandWarning):
            messages.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
