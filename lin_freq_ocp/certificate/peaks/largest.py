"""Where a trajectory reaches or exceeds infinitely many constraints."""

from __future__ import annotations

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.semi_infinite import peaks_above


def peak_points(problem: OptimalControlProblem, x: Array, u: Array, above: float) -> dict[str, Array]:
    """Return the points of all local maxima above a ratio, by name of the terms that have some."""
    sets = {term.name: term.everywhere for term in problem.terms if term.everywhere is not None}
    found = {name: peaks_above(everywhere, x, u, above)[0] for name, everywhere in sets.items()}
    return {name: points for name, points in found.items() if len(points)}
