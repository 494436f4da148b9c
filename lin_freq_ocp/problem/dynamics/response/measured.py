"""Measured frequency responses at the bins of a record: tables of frequency, real and imaginary part, interpolated.

Between two frequencies, real and imaginary part are linear. A bin outside the table is an error that names it, or has a
response of 0. At the Nyquist frequency N/2, where a sampled signal has no phase, the response is the real part.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, brief, positive_integer, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import first_few

OUTSIDE = ("refuse", "zero")
COVERED = 1e-9  # of the distance of bins: how far a bin may lie outside a table whose frequencies were rounded


def response_at_bins(
    field: str, frequencies: Array, values: ComplexArray, samples: int, sampling_time: float, outside: str
) -> ComplexArray:
    """Return the response at the bins of a record, (N//2 + 1, ...), from values (k, ...) at frequencies (k,) in Hz."""
    if outside not in OUTSIDE:
        raise ProblemError("outside", brief(outside), "'refuse' or 'zero'")
    if len(frequencies) < 2 or frequencies[0] < 0 or (np.diff(frequencies) <= 0).any():
        got = f"{len(frequencies)} frequencies from {frequencies[:3].tolist()}"
        raise ProblemError(field, got, "at least two frequencies in Hz, zero or above, each above the one before")
    N = positive_integer("samples", samples)
    spacing = 1 / (N * positive_number("dynamics.sampling_time", sampling_time))
    bins = spacing * np.arange(N // 2 + 1)
    slack = COVERED * spacing
    missing = np.flatnonzero((bins < frequencies[0] - slack) | (bins > frequencies[-1] + slack))
    if len(missing) and outside == "refuse":
        named = first_few([f"{k} ({bins[k]:.6g} Hz)" for k in missing], 6)
        got = f"frequencies from {frequencies[0]:.6g} to {frequencies[-1]:.6g} Hz"
        advice = f"Not covered: bins {named}. outside='zero' makes the response 0 there; remove them by a stop band."
        raise ProblemError(field, got, f"all bins of the record, 0 to {bins[-1]:.6g} Hz", advice)
    flat = values.reshape(len(values), -1)
    columns = [
        np.interp(bins, frequencies, column.real) + 1j * np.interp(bins, frequencies, column.imag) for column in flat.T
    ]
    found = np.stack(columns, axis=1)
    found[missing] = 0.0
    if N % 2 == 0:
        found[-1] = found[-1].real
    return found.reshape(len(bins), *values.shape[1:])


def read_response(path: Path) -> Array:
    """Return the table of a CSV file, (k, 3): frequency in Hz, real and imaginary part; a header line is left out."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise ProblemError(str(path), f"{error}", "a readable CSV file") from None
    return response_table(path.name, [line for line in lines if line.strip() and not line.lstrip().startswith("#")])


def response_table(name: str, lines: list[str]) -> Array:
    """Return the table of lines of text, of which the first may be a header."""
    rows = list[list[float]]()
    for i, line in enumerate(lines):
        try:
            row = [float(entry) for entry in line.split(",")]
        except ValueError:
            row = []
        if i == 0 and not row:
            continue
        if len(row) != 3 or not np.isfinite(row).all():
            expected = "three finite numbers: frequency in Hz, real part, imaginary part"
            raise ProblemError(f"{name}: row {i}", brief(line), expected)
        rows.append(row)
    if not rows:
        raise ProblemError(name, "no rows", "rows of frequency in Hz, real part, imaginary part")
    return np.array(rows)
