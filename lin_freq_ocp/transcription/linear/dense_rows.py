"""What frequency constraints cost a sparse program: dense rows, counted before they are made."""

from __future__ import annotations

from dataclasses import dataclass

from lin_freq_ocp.memory import require_memory
from lin_freq_ocp.problem.ocp import OptimalControlProblem

# Of a dense row at the peak: its value, places while it is put in, and the scaled copies that solvers are given
BYTES_PER_ENTRY = 100.0
BYTES_OF_FACTOR = 12.0  # per entry of a solver's factor: a value and an index
# To make, scale and order dense rows, measured with Clarabel; a solver's set-up does not stop before it is done
SECONDS_PER_ENTRY = 7.5e-7
# Of one factorisation, measured with Clarabel: d dense rows and V variables are d^2 V products
SECONDS_PER_PRODUCT = 4e-10
LEAST_FACTORISATIONS = 5.0  # fewer lead no interior-point method to an answer


@dataclass(frozen=True)
class DenseRows:
    """Dense rows of a sparse program.

    Attributes
    ----------
    count : int
    entries : int
        Numbers in them.
    variables : int
        Of the program.
    """

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
        return SECONDS_PER_PRODUCT * self.count**2 * self.variables

    @property
    def seconds(self) -> float:
        """Return the least time to an answer, estimated."""
        return SECONDS_PER_ENTRY * self.entries + LEAST_FACTORISATIONS * self.factorisation_seconds


def dense_rows(problem: OptimalControlProblem) -> DenseRows:
    """Return the dense rows of stop bands, masks and energy bounds."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    of_u, of_x = 2 * int(problem.control_stop.sum()), 2 * int(problem.state_stop.sum())
    count, entries = of_u + of_x, of_u * T + of_x * (T + 1)
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
