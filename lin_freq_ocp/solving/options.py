"""Which options of solve each method takes: one that a method does not know is refused, never ignored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem

LINEAR, AFFINE, SMOOTH = "linear", "piecewise-affine", "piecewise-smooth"

TAKES: dict[tuple[str, str], tuple[str, ...]] = {
    (LINEAR, "auto"): ("tolerance",),
    (LINEAR, "spectral"): ("tolerance",),
    (LINEAR, "convex"): ("tolerance",),
    (AFFINE, "auto"): ("tolerance", "node_limit", "executor", "start"),
    (AFFINE, "branch_and_bound"): ("tolerance", "node_limit", "executor", "start"),
    (AFFINE, "enumerate"): ("tolerance", "node_limit"),
    (AFFINE, "miqp"): ("tolerance", "node_limit"),
    (SMOOTH, "auto"): ("tolerance", "start"),
    (SMOOTH, "nonsmooth"): ("start",),
    (SMOOTH, "minlp"): ("tolerance",),
}
"""What each method takes beside a time limit, which all know, and a backend, which each looks at itself."""

WHERE = {
    "tolerance": "the method 'nonsmooth' has no gap to prove; 'auto' does",
    "node_limit": "only a search over affine modes has nodes",
    "executor": "only 'branch_and_bound' has parts for it",
    "start": "only 'branch_and_bound' and the search over smooth pieces begin with one",
}
"""Why other methods do not take an option."""


def require_taken(problem: OptimalControlProblem, method: str, given: Mapping[str, Any]) -> None:
    """Raise UnsupportedError if an option is given that the method does not know for these dynamics."""
    kind = _kind(problem)
    taken = TAKES.get((kind, method))
    if taken is None:  # a method for other dynamics, which is refused elsewhere
        return
    for option, value in given.items():
        if value is not None and option not in taken:
            got = f"{value!r}" if isinstance(value, (int, float)) else "one"
            raise UnsupportedError(
                f"{option}: got {got} for the method {method!r} and {kind} dynamics, which do not use it: "
                f"{WHERE[option]}. Leave it out."
            )


def _kind(problem: OptimalControlProblem) -> str:
    if isinstance(problem.dynamics, LinearDynamics):
        return LINEAR
    return AFFINE if isinstance(problem.dynamics, PiecewiseAffineDynamics) else SMOOTH
