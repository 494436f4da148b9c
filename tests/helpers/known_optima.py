"""Answers to nonsmooth problems with known optima, which several files look at: each is found once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import lin_freq_ocp as lfo

RESULTS: dict[str, lfo.results.Result] = {}


def solved(build: Callable[..., lfo.OptimalControlProblem], arguments: dict[str, Any]) -> lfo.results.Result:
    """Return the local answer to the problem that is built with these arguments, without a global bound."""
    key = f"{build.__name__} {sorted(arguments.items())}"
    if key not in RESULTS:
        RESULTS[key] = lfo.solve(build(**arguments), method="nonsmooth", throw=False)
    return RESULTS[key]
