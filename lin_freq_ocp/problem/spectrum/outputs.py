"""Frequency constraints on linear outputs of states and controls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, brief, names, real_array, with_columns
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import MOST_TEXT, combination, plural, short_name
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal, component_indices
from lin_freq_ocp.problem.terms.term import Term, TermKind


@dataclass(frozen=True, eq=False, init=False)
class OutputSpectrum:
    """Frequency constraints on linear outputs y_t = C x_t + D u_t.

    Parameters
    ----------
    C : (outputs, n), or None
    D : (outputs, m), or None
        At least one is given. Without D the signal has T+1 samples, 0 .. T, else T.
    constraints : Band, MagnitudeBound, EnergyBound, or a list of them
        Their component is an output.
    output_names : sequence of str, optional

    Raises
    ------
    ProblemError
        If shapes do not match.

    Examples
    --------
    >>> limited = lfo.spectrum.OutputSpectrum(C=[[1.0, -1.0]], constraints=lfo.low_pass(1.0))
    >>> limited.output_names
    ('y_0',)
    """

    C: Array | None
    D: Array | None
    constraints: tuple[FrequencyConstraint, ...]
    output_names: tuple[str, ...]

    def __init__(
        self,
        C: ArrayLike | None = None,
        D: ArrayLike | None = None,
        constraints: FrequencyConstraint | Sequence[FrequencyConstraint] = (),
        output_names: Sequence[str] | None = None,
    ):
        matrices = [
            None if value is None else real_array(f"output_spectrum.{name}", value)
            for name, value in (("C", C), ("D", D))
        ]
        given = [matrix for matrix in matrices if matrix is not None]
        if not given or any(matrix.ndim != 2 or 0 in matrix.shape or len(matrix) != len(given[0]) for matrix in given):
            shapes = ", ".join(str(matrix.shape) for matrix in given) or "neither C nor D"
            raise ProblemError("output_spectrum", shapes, "a matrix C or D, or both, with one row per output")
        entries = tuple(constraints) if isinstance(constraints, (list, tuple)) else (constraints,)
        wrong = [one for one in entries if not isinstance(one, FrequencyConstraint) or not one.on_outputs]
        if wrong or not entries:
            got = brief(wrong[0]) if wrong else "nothing"
            raise ProblemError("output_spectrum.constraints", got, "bands, MagnitudeBound or EnergyBound")
        checked_names = names("output_spectrum.output_names", output_names, len(given[0]), "y")
        assign(self, C=matrices[0], D=matrices[1], constraints=entries, output_names=checked_names)

    def describe(self, signals: Sequence[str]) -> str:
        """Return the outputs that are constrained, for states and then controls of these names."""
        used = {j for one in self.constraints for j in component_indices("", one.component, self.output_names)}
        rows = np.hstack([part for part in (self.C, self.D) if part is not None])
        offset = len(signals) - rows.shape[1] if self.C is None else 0
        parts = [f"{short_name(self.output_names[j])} = {combination(rows[j], signals[offset:])}" for j in sorted(used)]
        text = ", ".join(parts)
        return text if len(text) <= MOST_TEXT else f"{plural(len(parts), 'linear combination')} of states and controls"

    def extended(self, n: int, k: int) -> OutputSpectrum:
        """Return the constraints on the same outputs of (x, w), w in R^k."""
        C = None if self.C is None else with_columns(self.C, k)
        return OutputSpectrum(C, self.D, self.constraints, self.output_names)

    def behind(self, x: Array, u: Array) -> OutputSpectrum:
        """Return the constraints after states (k, n) and controls (k, m)."""
        parts = [signal @ matrix.T for matrix, signal in ((self.C, x), (self.D, u)) if matrix is not None]
        past = sum(parts[1:], parts[0])
        constraints = [one.behind(past, int(self.D is None)) for one in self.constraints]
        return OutputSpectrum(self.C, self.D, constraints, self.output_names)

    @property
    def remembers(self) -> bool:
        """Whether they depend on samples of the past."""
        return any(one.remembers for one in self.constraints)

    def terms(
        self, n: int, m: int, horizon: int, sampling_time: float | None, field: str, index: int
    ) -> Iterator[Term]:
        """Yield its terms: it is the entry ``index`` of its field, named by ``field``."""
        for name, matrix, columns in (("C", self.C, n), ("D", self.D, m)):
            if matrix is not None and matrix.shape[1] != columns:
                raise ProblemError(f"{field}.{name}", f"shape {matrix.shape}", f"{columns} columns")
        length = horizon + (self.D is None)
        signal = Signal(TermKind.OUTPUT_SPECTRUM, self.C, self.D, self.output_names, length, sampling_time)
        for i, one in enumerate(self.constraints):
            yield from one.terms(signal, f"{field}.constraints[{i}]", ("output_spectrum", index))
