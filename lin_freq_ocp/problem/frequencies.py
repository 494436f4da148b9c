"""A problem with masks at every frequency, or for all plants of a box, and its terms at finitely many."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, component_indices, entries_of
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum
from lin_freq_ocp.problem.terms.continuum import Continuum
from lin_freq_ocp.problem.terms.term import Term

Kind = TypeVar("Kind", bound=Continuum)


def at_frequencies(
    problem: OptimalControlProblem, frequencies: Mapping[str, Array], relaxed: bool = False
) -> OptimalControlProblem:
    """Return the problem whose terms stand at these points, (groups,) in rad/sample or (groups, 2), by their name.

    Others stay where they are. ``relaxed``: nothing is required at other points.
    """
    found = [term for term in problem.terms if term.everywhere is not None]
    if not found or not (frequencies or relaxed):
        return problem
    pending = iter([frequencies.get(term.name, term.map.places) for term in found])
    states = [_placed(one, problem.state_names, pending, relaxed) for one in entries_of(problem.state_spectrum)]
    controls = [_placed(one, problem.control_names, pending, relaxed) for one in entries_of(problem.control_spectrum)]
    outputs = [_outputs_placed(one, pending, relaxed) for one in entries_of(problem.output_spectrum)]
    return replace(problem, state_spectrum=states, control_spectrum=controls, output_spectrum=outputs)


def everywhere_of(problem: OptimalControlProblem, kind: type[Kind]) -> list[tuple[Term, Kind]]:
    """Return the terms whose infinitely many constraints are of a kind, and these."""
    return [(term, found) for term in problem.terms if isinstance(found := term.everywhere, kind)]


def _placed(
    constraint: FrequencyConstraint, names: Sequence[str], pending: Iterator[Array], relaxed: bool
) -> FrequencyConstraint:
    if not constraint.every_frequency:
        return constraint
    count = len(component_indices("spectrum", constraint.component, names))
    return constraint.at_frequencies([next(pending) for _ in range(count)], relaxed)


def _outputs_placed(outputs: OutputSpectrum, pending: Iterator[Array], relaxed: bool) -> OutputSpectrum:
    constraints = [_placed(one, outputs.output_names, pending, relaxed) for one in outputs.constraints]
    return OutputSpectrum(outputs.C, outputs.D, constraints, outputs.output_names)
