"""Rows of single times and their places in the stages."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.linear_kinds import KINDS, T
from lin_freq_ocp.methods.structured import SpectrumRows, assemble_stages, assign_slots, stage_rows
from lin_freq_ocp.problem import HARD, HalfSpaces, NormBall, StageMap, Term, TermKind
from lin_freq_ocp.program import LinearProgram


def stage_rows_of(*parts):
    """Return the rows of single times of a problem with these terms alone: times, coefficients of x_t, penalty."""
    problem = KINDS["no constraint"]()
    terms = []
    for k, (times, coefficients, penalty) in enumerate(parts):
        coefficients = np.asarray(coefficients, dtype=float)
        stage_map = StageMap(np.asarray(times), coefficients, None, np.zeros(coefficients.shape[-2]))
        terms.append(Term(f"rows {k}", TermKind.STATE_SET, stage_map, penalty))
    problem.__dict__["terms"] = tuple(terms)
    program = LinearProgram(problem)
    none = np.zeros(program.signals, dtype=bool)
    given = none.copy()
    given[:2] = True  # x_0
    return stage_rows(program, given, none)


def test_rows_of_different_times_share_places():
    early = [0, 1], [[1.0, 0.0], [0.0, 1.0]], HalfSpaces(np.array([1.0, 2.0]), HARD)
    late = [1, 2, 3], [[1.0, 1.0]], HalfSpaces(np.array([3.0]), HARD)
    rows = stage_rows_of(early, late)
    found = assign_slots(rows)
    assert found.count == 3  # at t = 1 only
    pairs = list(zip(rows.times[found.source], found.slot, strict=True))
    assert len(set(pairs)) == len(pairs) == 7


def test_cones_of_one_size_share_places_behind_the_single_rows():
    single = [1], [[1.0, 0.0]], HalfSpaces(np.array([1.0]), HARD)
    wide = [0, 1], np.eye(2), NormBall(2, np.ones(()), HARD)
    other = [1, 2], -np.eye(2), NormBall(2, np.ones(()), HARD)
    found = assign_slots(stage_rows_of(single, wide, other))
    assert found.cones == (3, 3)
    assert found.count == 7
    assert sorted(found.slot[1:]) == sorted([1, 2, 3] * 3 + [4, 5, 6])


@pytest.mark.parametrize(("limit", "kept"), [(1.0, 0), (0.0, 0), (-1.0, 1)])
def test_rows_without_coefficients_are_kept_if_they_do_not_hold(limit, kept):
    rows = stage_rows_of(([2], [[0.0, 0.0]], HalfSpaces(np.array([limit]), HARD)))
    assert len(assign_slots(rows).source) == kept


def test_slacks_of_different_times_share_entries():
    stages = assemble_stages(KINDS["soft end"]()).stages
    assert stages.h.shape[1] == 2 + 2 + 4  # two controls, and the slacks of x_T
    soft = assemble_stages(KINDS["soft mask"]()).stages
    assert soft.h.shape[1] == 2 + 2 + 1  # of four balls in all, at different times
    present = soft.present.any(axis=1)
    assert present.sum() == 4
    assert len(present) == T + 1


@pytest.mark.parametrize("points", [8, 9, 16])
def test_spectra_are_their_rows_and_their_adjoints_the_transposes(points):
    """Bins 0 and points/2 are their own conjugates."""
    rng, samples, bins = np.random.default_rng(points), 8 if points == 16 else points, np.array([0, 3, points // 2])
    kept = np.array([True, False, True, True, True, points % 2 == 1])
    rows = SpectrumRows(np.array([1.0, -0.5]), np.hanning(samples + 2)[1:-1], points, bins, np.array([0.7, 2, 3]), kept)
    signals, weights = rng.standard_normal((10, 2, 1)), rng.standard_normal((rows.count, 1))
    waves = np.exp(-2j * np.pi * np.outer(bins, np.arange(samples)) / points) * rows.scale[:, None] * rows.window
    values = waves @ (signals[:samples, :, 0] @ rows.coefficients)
    expected = np.column_stack([values.real, values.imag]).ravel()[kept]
    np.testing.assert_allclose(rows.forward(signals)[:, 0], expected, atol=1e-12)
    adjoint, columns = np.zeros_like(signals), np.zeros((10, 2, rows.count))
    rows.add_adjoint(weights, adjoint)
    rows.add_columns(np.arange(rows.count), columns)
    np.testing.assert_allclose(columns @ weights, adjoint, atol=1e-12)
    assert np.vdot(adjoint, signals) == pytest.approx(float(expected @ weights[:, 0]))
    np.testing.assert_allclose(np.tensordot(columns, signals[..., 0], ([0, 1], [0, 1])), expected, atol=1e-12)
