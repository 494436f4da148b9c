"""Rows of stopped bins, real and of programs, and their multipliers as a function of time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.linear_kinds import KINDS, T
from lin_freq_ocp import stop_band
from lin_freq_ocp.problem import time_signal
from lin_freq_ocp.program import Block, LinearProgram, bin_multipliers, real_rows


def masks(length: int) -> list[np.ndarray]:
    """Return masks of stopped bins: none, all, DC alone, the last alone, and random ones."""
    bins = length // 2 + 1
    rng = np.random.default_rng(length)
    fixed = [np.zeros(bins, bool), np.ones(bins, bool), np.arange(bins) == 0, np.arange(bins) == bins - 1]
    return fixed + [rng.random(bins) < 0.5 for _ in range(3)]


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 12, 13, 240, 241])
def test_real_rows_are_orthonormal_and_as_many_as_the_closed_set_of_bins(length):
    for mask in masks(length):
        rows = real_rows(length, mask)
        closed = {int(k) for k in np.flatnonzero(mask)} | {-int(k) % length for k in np.flatnonzero(mask)}
        assert rows.shape == (len(closed), length)
        np.testing.assert_allclose(rows @ rows.T, np.eye(len(closed)), atol=1e-12)
        assert len(closed) == 0 or np.linalg.matrix_rank(rows) == len(closed)


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 12, 13, 240, 241])
def test_real_rows_measure_the_stopped_bins_and_no_other(length):
    """R v = 0 iff the bins are zero: |R v|^2 is the energy of the closed set of bins over N (Parseval)."""
    rng = np.random.default_rng(length + 1)
    for mask in masks(length):
        rows = real_rows(length, mask)
        v = rng.normal(size=length)
        spectrum = np.fft.rfft(v)
        energy = np.abs(np.fft.fft(v)) ** 2
        closed = sorted({int(k) for k in np.flatnonzero(mask)} | {-int(k) % length for k in np.flatnonzero(mask)})
        assert ((rows @ v) ** 2).sum() == pytest.approx(energy[closed].sum() / length, rel=1e-11, abs=1e-12)
        kept = np.fft.irfft(np.where(mask, 0, spectrum), n=length)
        np.testing.assert_allclose(rows @ kept, 0, atol=1e-12)
        np.testing.assert_allclose(kept, v - rows.T @ (rows @ v), atol=1e-12)  # R'R is the projection on the band


def test_every_row_is_the_formula():
    mask = np.array([True, False, True, True])
    t = np.arange(6)
    expected = [
        np.ones(6) / np.sqrt(6),
        np.sqrt(2 / 6) * np.cos(2 * np.pi * 2 * t / 6),
        -np.sqrt(2 / 6) * np.sin(2 * np.pi * 2 * t / 6),
        (-1.0) ** t / np.sqrt(6),
    ]
    np.testing.assert_allclose(real_rows(6, mask), expected, atol=1e-15)


def test_long_signals_lose_no_digits():
    length = 100_003
    mask = np.zeros(length // 2 + 1, bool)
    mask[-2:] = True
    rows = real_rows(length, mask)
    np.testing.assert_allclose(rows @ rows.T, np.eye(4), atol=1e-12)
    kept = np.fft.irfft(np.where(mask, 0, np.fft.rfft(np.random.default_rng(1).normal(size=length))), n=length)
    np.testing.assert_allclose(rows @ kept, 0, atol=1e-10)


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 12, 13, 240, 241])
def test_bin_multipliers_are_the_duals_as_a_function_of_time(length):
    rng = np.random.default_rng(length + 2)
    for mask in masks(length):
        rows = real_rows(length, mask)
        duals = rng.normal(size=len(rows))
        rho = bin_multipliers(length, mask, duals)
        assert rho.shape == mask.shape
        assert not rho[~mask].any()
        k = np.arange(length // 2 + 1)
        single = (k == 0) | (2 * k == length)
        assert not rho[single].imag.any()
        phase = np.exp(2j * np.pi * np.outer(np.arange(length), k) / length)
        np.testing.assert_allclose((phase @ rho).real, rows.T @ duals, atol=1e-12)
        np.testing.assert_allclose(time_signal(rho[:, None], length)[:, 0], rows.T @ duals, atol=1e-12)


def test_rows_of_stop_bands_are_the_real_rows_of_each_component():
    bands = [stop_band(bins=[0, 3], component=0), stop_band(bins=[1, 4], component=1)]
    problem = replace(KINDS["control band"](), control_spectrum=bands)
    program = LinearProgram(problem)
    found = program.sparse.A[program.sparse.rows[Block.CONTROL_SPECTRUM], program.states : program.signals].toarray()
    expected = [np.kron(real_rows(T, problem.control_stop[:, j]), np.eye(1, 2, j)) for j in range(2)]
    np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-15)


def test_spectra_have_no_dense_rows_before_they_are_asked_for():
    rows = LinearProgram(KINDS["mask"]()).of_terms[0]
    assert rows.spectrum is not None
    assert rows.times is None
    assert "signals" not in vars(rows)
