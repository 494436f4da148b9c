"""The null-space solver against the equations of kkt/system.py, and against the range-space solver."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.seeds import seeds
from lin_freq_ocp.methods.structured import (
    Coefficients,
    Coupling,
    DenseReduced,
    Equations,
    NullSpaceSolver,
    Slacks,
    break_times,
    can_compile,
    loops,
    range_space_solver,
    sort_rows,
    unit_scale,
)
from methods.structured.linear_systems import random_system, solved, stop_band

GROWTHS = (0.0, 12.0, -5.0)


@pytest.fixture(params=["compiled", "arrays"])
def chosen(request):
    if request.param == "compiled" and not can_compile():
        pytest.skip("no C compiler")
    return loops(request.param == "compiled")


@pytest.mark.parametrize("seed", seeds(range(12)))
@pytest.mark.parametrize("others", [False, True], ids=["bands", "all rows"])
def test_it_solves_the_system_of_a_step(chosen, seed, others):
    system = random_system(seed, GROWTHS[seed % 3], others)
    _, left = solved(NullSpaceSolver(system[0], chosen, DenseReduced), *system)
    assert left < 1e-11


@pytest.mark.parametrize("seed", seeds(range(4)))
def test_both_solvers_agree(chosen, seed):
    system = random_system(seed)
    kept, _ = solved(NullSpaceSolver(system[0], chosen, DenseReduced), *system)
    stopped, _ = solved(range_space_solver(system[0], chosen), *system)
    for a, b in zip(kept, stopped, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7 * max(1.0, np.abs(b).max(initial=0.0)))


def test_restarts_hold_unstable_dynamics(chosen):
    system = random_system(3, growth=80.0, T=100)
    assert len(break_times(system[0].A, system[0].horizon, 100.0)) > 10
    _, left = solved(NullSpaceSolver(system[0], chosen, DenseReduced), *system)
    assert left < 1e-9


@pytest.mark.parametrize("T", [12, 13])
def test_coefficients_are_an_orthonormal_basis_of_what_the_bands_leave(T):
    stages, *_ = random_system(5, T=T)
    bands, rest = sort_rows(stages)
    assert bands
    assert rest
    slacks = Slacks(stages, [band.entry for band in bands])
    basis = Coefficients(stages, bands, slacks.controls)
    N = basis.synthesis(np.eye(basis.count)).reshape(-1, basis.count)
    np.testing.assert_allclose(N.T @ N, np.eye(basis.count), atol=1e-13)
    f = np.arange(1.0, stages.coupling.count + 1)
    w = np.zeros((T + 1, stages.B.shape[2]))
    w[:, slacks.controls] = basis.particular(f) + basis.synthesis(np.ones((1, basis.count)))[:, :, 0]
    signals = np.concatenate([np.zeros((T + 1, stages.states)), w], axis=1)[:, stages.coupling.channels, None]
    families = list(stages.coupling.families())
    for band in bands:
        rows = next(rows for rows, at in families if np.array_equal(at, band.rows))
        np.testing.assert_allclose(rows.forward(signals)[:, 0], f[band.rows])


@pytest.mark.parametrize("T", [6, 7])
def test_scale_of_the_dft(T):
    pairs = np.fft.rfft(np.eye(T), axis=1).view(float) * unit_scale(T)
    np.testing.assert_allclose(pairs @ pairs.T, np.eye(T), atol=1e-14)


@pytest.mark.parametrize("taper", [np.ones, np.hamming])
def test_rows_of_a_windowed_control_are_no_stop_band(taper):
    """A window mixes the coefficients of a control: rows of such a spectrum do not fix one coefficient each."""
    T = 12
    stages = random_system(5, T=T)[0]
    channels = np.array([stages.states])
    rows = replace(stop_band(channels, stages.states, T, np.array([1, 2]), np.ones(2)), window=taper(T))
    coupling = Coupling(channels, np.zeros(0, dtype=int), np.zeros(0), (Equations(rows, np.zeros(rows.count)),))
    bands, rest = sort_rows(replace(stages, coupling=coupling))
    assert (len(bands), len(rest)) == ((1, 0) if taper is np.ones else (0, 1))
    for band in bands:
        w = np.random.default_rng(0).standard_normal((T + 1, 1, 1))
        pairs = np.fft.rfft(w[:-1, 0, 0]).view(float) * unit_scale(T)
        np.testing.assert_allclose(rows.forward(w)[:, 0], band.gain * pairs[band.coefficients])
