"""Which method "auto" takes first for linear dynamics, after the Fourier-domain method has refused the problem.

Measured by scripts/benchmark.py choice. The sparse program needs a dense row for every frequency constraint, and its
time grows with the entries of these rows; the structured method needs none, but more time for a small problem.
"""

from __future__ import annotations

from importlib.util import find_spec

from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.dense_rows import dense_rows

DENSE_ENTRIES = 3e4  # of dense rows, from which the structured method is the faster one; both take 0.2 s there
PLAIN_ENTRIES = 1.2e5  # the same without compiled loops
VARIABLES = 9e3  # of a program without dense rows, from which it is, by a little; compiled only


def structured_first(problem: OptimalControlProblem) -> str:
    """Return why the structured method is taken before the sparse program; an empty text if it is not."""
    signals = problem.state_dim, problem.control_dim
    if any(len(term.map.places) and term.map.spectrum_form(*signals) is None for term in problem.terms):
        return "frequencies of a mask that are close together cost the sparse program digits"
    rows, compiled = dense_rows(problem), find_spec("numba") is not None
    if rows.entries >= (DENSE_ENTRIES if compiled else PLAIN_ENTRIES):
        return f"the sparse program would have {rows.count} dense rows"
    if compiled and rows.variables >= VARIABLES:
        return f"the sparse program would have {rows.variables} variables"
    return ""
