"""The KKT solver that is chosen, and the problem that none can take."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.replacing import substitute
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.structured import (
    Coupling,
    DenseReduced,
    Equations,
    NullSpace,
    NullSpaceSolver,
    RangeSpaceSolver,
    Sizes,
    Slacks,
    choose_kkt_solver,
    loops,
    sizes_of,
    sort_rows,
)
from methods.structured.examples import spectrum, stages


def with_stop(T, bins, n=2, k=1, free=False):
    rows = spectrum(bins, T)
    kept = np.ones((len(bins), 2), dtype=bool)
    kept[np.isin(bins, [0, T / 2]), 1] = False
    rows = replace(rows, kept=kept.ravel())
    coupling = Coupling(np.array([n]), np.array([0]), np.zeros(1), (Equations(rows, np.zeros(rows.count)),))
    return stages(T=T, n=n, k=k, coupling=coupling, free=free, growth=1.02)


@pytest.mark.parametrize(("k", "free"), [(1, False), (2, True)])
def test_sizes_are_those_of_the_space(k, free):
    problem = with_stop(200, np.arange(20, 101), k=k, free=free)
    bands, rest = sort_rows(problem)
    space = NullSpace(problem, Slacks(problem, [band.entry for band in bands]), bands, rest, loops(False))
    sizes = sizes_of(problem)
    assert sizes.unknowns == space.size
    assert sizes.left == space.row_count
    assert sizes.rows == problem.coupling.count


def test_a_narrow_pass_band_is_solved_in_null_space_and_a_narrow_stop_band_in_range_space(monkeypatch):
    narrow = with_stop(400, np.arange(20, 201))
    assert isinstance(choose_kkt_solver(narrow, loops(False)), NullSpaceSolver)
    substitute(monkeypatch, "methods.structured.NullSpaceSolver", lambda stages, loops, reduced: reduced)
    assert choose_kkt_solver(narrow, loops(False)) is DenseReduced
    assert isinstance(choose_kkt_solver(with_stop(400, np.arange(1, 15)), loops(False)), RangeSpaceSolver)


@pytest.mark.parametrize("T", [10_000, 100_000])
def test_long_horizons_by_conjugate_gradients(T):
    seconds = Sizes(T, 3, 1, int(0.8 * T), int(0.2 * T), 60, 1).seconds()
    assert min(seconds, key=lambda name: seconds[name]) == "two-level"


def test_what_does_not_fit_is_said(monkeypatch):
    for limit in ("LARGEST_BYTES", "RANGE_SPACE_BYTES"):
        substitute(monkeypatch, f"methods.structured.{limit}", 1e4)
    with pytest.raises(UnsupportedError, match="rows that couple times"):
        choose_kkt_solver(with_stop(200, np.arange(20, 101)), loops(False))
