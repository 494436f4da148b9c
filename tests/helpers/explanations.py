"""Explanations of infeasible problems: ``lin_freq_ocp.solve`` searches for that of equal problems once a session."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

from lin_freq_ocp import OptimalControlProblem
from lin_freq_ocp.batch import fingerprint
from lin_freq_ocp.results import Explanation

Explain = Callable[..., Explanation]


def explain_once(explain: Explain) -> Explain:
    """Return ``explain``, which remembers its answers by problem and limits.

    A test that changes clocks or code below it, and asks ``solve``, takes a problem of its own.
    """
    known: dict[tuple[object, ...], Explanation] = {}

    @wraps(explain)
    def remembered(problem: OptimalControlProblem, *limits: float | None) -> Explanation:
        key = fingerprint(problem), *limits
        if key not in known:
            known[key] = explain(problem, *limits)
        return known[key]

    return remembered
