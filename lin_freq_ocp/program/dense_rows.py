"""Memory and time of a sparse program with dense rows of frequency constraints, estimated before it is made."""

from __future__ import annotations

from dataclasses import dataclass

from lin_freq_ocp.base.arrays import require_memory
from lin_freq_ocp.problem.ocp import OptimalControlProblem

BYTES_PER_ENTRY = 100.0  # of a dense row at the peak, with indices during assembly and the scaled copies for solvers
BYTES_OF_FACTOR = 12.0  # per entry of a solver's factor: a value and an index
SECONDS_PER_ENTRY = 7.5e-7  # to make, scale and order dense rows, measured with Clarabel
SECONDS_PER_PRODUCT = 4e-10  # of one factorisation, measured with Clarabel: d^2 V for d dense rows and V variables
SECONDS_PER_VARIABLE = 5e-6  # of one factorisation without dense rows, or of measuring a point
LEAST_FACTORISATIONS = 5.0  # of an interior-point method


@dataclass(frozen=True)
class DenseRows:
    """The numbers of dense rows, of their entries, and of the variables of the program."""

    count: int
    entries: int
    variables: int

    @property
    def size(self) -> float:
        """Return the bytes that the rows and their part of a factor take, estimated."""
        factor = self.count * (self.variables + self.count / 2)
        return BYTES_PER_ENTRY * self.entries + BYTES_OF_FACTOR * factor

    @property
    def factorisation_seconds(self) -> float:
        """Return the time of one factorisation, estimated."""
        return (SECONDS_PER_PRODUCT * self.count**2 + SECONDS_PER_VARIABLE) * self.variables

    @property
    def seconds(self) -> float:
        """Return the least time to an answer, estimated."""
        return SECONDS_PER_ENTRY * self.entries + LEAST_FACTORISATIONS * self.factorisation_seconds


def dense_rows(problem: OptimalControlProblem) -> DenseRows:
    """Return the dense rows of stop bands, masks, energy bounds, and of a frequency response."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    of_u, of_x = 2 * int(problem.control_stop.sum()), 2 * int(problem.state_stop.sum())
    count, entries = of_u + of_x, of_u * T + of_x * (T + 1)
    if problem.dynamics.response(T) is not None:
        count, entries = count + T * n, entries + T * n * T * m
    for term in problem.terms:
        rows, size = term.map.dense_size
        count, entries = count + rows, entries + size
    return DenseRows(count, entries, (T + 1) * n + T * m)


def require_dense_memory(problem: OptimalControlProblem) -> None:
    """Raise UnsupportedError if the dense rows of a problem do not fit into memory."""
    rows = dense_rows(problem)
    require_memory(
        f"the frequency constraints, {rows.count} dense rows of a program of {rows.variables} variables,",
        rows.size,
        "Method 'spectral' needs no dense rows (time-invariant linear dynamics, quadratic costs, boxes, joint rows "
        "and stop bands; it says what it cannot take); else choose a shorter horizon or a longer sampling time.",
    )
