"""Calibrations of 3D printers: the power of a measured vibration over frequency, and the bands that a shaper is for."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.comparison.shapers import bands_of
from lin_freq_ocp.files.reading import naming_file, read_text
from lin_freq_ocp.files.solution_files import parse_table, require_columns

FREQUENCY, POWER = "freq", "psd_xyz"  # columns: Hz, and the power of all axes together


def read_calibration(
    path: str | PathLike[str], share: float = 0.05, column: str = POWER
) -> tuple[tuple[float, float], ...]:
    r"""Return the bands of frequencies in Hz in which the power is above a share of its largest value.

    Parameters
    ----------
    path : path
        A CSV file as firmware for 3D printers writes it after a test of resonances: columns ``freq`` in Hz, ascending,
        ``psd_x``, ``psd_y``, ``psd_z`` and ``psd_xyz``. Other columns are left out.
    share : float
        Of the largest power, between 0 and 1. Each band is widened by 5 % of its edges; bands that meet are joined.
    column : str
        The power to read.

    Returns
    -------
    tuple of (lowest, highest)

    Raises
    ------
    ProblemError
        If the file cannot be read, holds accelerations over time, lacks a column, or has no power.

    Examples
    --------
    >>> from pathlib import Path
    >>> rows = [f"{f},{1 / (1 + (f - 40) ** 2):.6f}" for f in range(5, 100)]
    >>> _ = Path("calibration.csv").write_text("freq,psd_xyz\n" + "\n".join(rows))
    >>> lfo.io.read_calibration("calibration.csv")
    ((34.2, 46.2),)
    """
    if not 0 < real_array("share", share).item() < 1:
        raise ProblemError("share", brief(share), "a number between 0 and 1, such as 0.05")
    frequencies, power = _columns(Path(path), column)
    return bands_of(frequencies, power, share)


def _columns(path: Path, column: str) -> tuple[Array, Array]:
    """Return frequencies in Hz, ascending, and a power, (k,) each."""
    text = read_text(path).lstrip("#")
    with naming_file(path):
        table = parse_table(text)
        if any(name.startswith("accel") for name in table.head):
            expected = f"the power over frequency, with the columns {FREQUENCY} and {column}"
            advice = "The firmware's script for calibration turns accelerations into it."
            raise ProblemError("columns", "accelerations over time", expected, advice)
        at = [table.find(name) for name in (FREQUENCY, column)]
        require_columns(table, (FREQUENCY, column), at)
        frequencies, power = np.array(table.numbers(at, len(table.rows))).reshape(-1, 2).T
        if len(frequencies) < 2 or (np.diff(frequencies) <= 0).any() or frequencies[0] < 0:
            raise ProblemError(FREQUENCY, brief(frequencies.tolist()), "ascending frequencies in Hz")
        if (power < 0).any() or not power.any():
            got = "negative values" if (power < 0).any() else "zeros alone"
            raise ProblemError(column, got, "a power, which is not negative, above zero somewhere")
    at_zero = frequencies == 0  # no vibration
    return frequencies[~at_zero], power[~at_zero]
