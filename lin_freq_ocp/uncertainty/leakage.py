"""What loads add to spectra: u = v + K e, and e has every frequency that loads excite.

At a bin, the spectrum of K e, or of any output of e, is sum_j M_kj w_j with
M_kj = sum_{t>j} exp(-2 pi i k t/N) c'A_K^(t-1-j) E.

Over boxes these numbers are a zonogon with known vertices, so the largest modulus is exact; over other sets it is
bounded from a finite number of directions (docs/robust.md).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import frequency_constraints
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, OutputSpectrum, entries_of
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.uncertainty.error_loop import ErrorLoop

MOST_GENERATORS = 2**22  # steps of bins of loads, up to which the spectra of all bins are bounded


def bin_values(spectrum: SpectrumMap, trajectory: Trajectory) -> ComplexArray:
    """Return the complex values of a spectrum, (bins,)."""
    return replace(spectrum, joint=False).values(trajectory.x, trajectory.u) @ np.array([1.0, 1j], dtype=np.complex128)


def leakage(loop: ErrorLoop, spectrum: SpectrumMap, planned: ComplexArray) -> tuple[Array, Array | None]:
    """Return the largest |planned + added|, (bins,), over all loads, and loads (bins, T, k) at which it is attained.

    It is exact or an upper bound; infinite, if there is none.
    """
    n, m = loop.E.shape[-2], len(loop.K)
    of_x, of_u = (np.zeros(k) if row is None else row for row, k in ((spectrum.C, n), (spectrum.D, m)))
    row = of_x + of_u @ loop.K
    if not row.any():
        return np.abs(planned), np.zeros((len(planned), loop.horizon, loop.E.shape[-1]))
    pairs = replace(spectrum, joint=False).waves().reshape(len(planned), 2, -1)
    M = loop.leakage(pairs[:, 0] + 1j * pairs[:, 1], row)
    found = None if loop.forever or loop.start is not None else loop.loads.modulus(M, planned)
    return found or (np.full(len(planned), np.inf), None)


def largest_spectra(loop: ErrorLoop, plan: Trajectory) -> Array | None:
    """Return the largest magnitude of each bin of the controls over all loads, (bins, m); None without such bounds.

    The plan is as the model has it, without loads.
    """
    T, m = plan.u.shape
    if not loop.K.any() or T * T * loop.E.shape[-1] > MOST_GENERATORS:
        return None
    maps = [SpectrumMap(None, unit, np.ones(T), T, np.arange(T // 2 + 1)) for unit in np.eye(m)]
    largest = np.column_stack([leakage(loop, spectrum, bin_values(spectrum, plan))[0] for spectrum in maps])
    return largest if np.isfinite(largest).all() else None


def tightened_spectra(problem: OptimalControlProblem, loop: ErrorLoop) -> dict[str, object]:
    """Return the fields of spectra, with masks at bins less the worst leakage of each bin."""

    def leak(field: str, spectrum: SpectrumMap) -> Array:
        added = leakage(loop, spectrum, np.zeros(len(spectrum.bins), dtype=complex))[0]
        if np.isinf(added).any():
            got = "a mask of a signal that loads change, with Gaussian loads, start or forever"
            raise UnsupportedError(f"{field}: got {got}; expected bounded loads from the start of the plan on.")
        return added

    parts, changes = dict[tuple[str, int], list[FrequencyConstraint]](), dict[str, list[object]]()
    for source, where, one, signal in frequency_constraints(problem):
        parts.setdefault(source, []).extend(one.tightened(signal, where, partial(leak, where)))
    for (field, i), tight in parts.items():
        entry = entries_of(getattr(problem, field))[i]
        whole = [entry.with_constraints(tight)] if isinstance(entry, OutputSpectrum) else tight
        changes.setdefault(field, []).extend(whole)
    return {**changes}
