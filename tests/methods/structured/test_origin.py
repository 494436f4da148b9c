"""Where y is measured from, and which controls leave the stages."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.linear_kinds import KINDS, T
from lin_freq_ocp.methods.structured.assembly import stages_of
from lin_freq_ocp.methods.structured.recovery import origin_of


def test_references_and_fixed_controls_are_the_origin():
    problem = KINDS["coasting"]()
    origin, fixed = origin_of(problem), np.arange(T) % 3 != 0
    np.testing.assert_array_equal(origin.x, problem.quadratic.x_ref)
    np.testing.assert_array_equal(origin.u[fixed], 0.1)
    np.testing.assert_array_equal(origin.u[~fixed], problem.quadratic.u_ref[~fixed])
    np.testing.assert_array_equal(origin.held[:-1, 2:].all(axis=1), fixed)
    assert not origin.held[:, :2].any()
    assert not origin.held[-1].any()


def test_held_controls_act_on_nothing():
    stages, held = stages_of(KINDS["coasting"]()).stages, np.arange(T) % 3 != 0
    assert not stages.B[:-1, :, :2][held].any()
    assert stages.B[:-1, :, :2][~held].any()
    assert not stages.G[:-1, :, 2:4][held].any()
    np.testing.assert_array_equal(stages.H[:-1, 2:4, 2:4][held], np.broadcast_to(np.eye(2), (held.sum(), 2, 2)))
    assert not stages.h[:-1, 2:4][held].any()
    assert not stages.coupling.equations


@pytest.mark.parametrize("kind", ["coasting with a band", "linear constraint"])
def test_controls_of_rows_that_couple_times_are_not_held(kind):
    problem = KINDS[kind]()
    assert not origin_of(problem).held.any()


def test_fixed_controls_of_a_band_are_equations():
    equations = stages_of(KINDS["coasting with a band"]()).stages.coupling.equations
    assert [part.rows.count for part in equations] == [2, 6]  # of the bin, and at the times of two in three
