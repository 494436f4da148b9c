"""Polyhedral sets in the Fourier-domain method: joint rows there, multipliers of the sets on the way back."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from helpers.spectral_plants import certificate_of_claim

T = 40
PLANT = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]], offset=[0.0, 0.01], sampling_time=0.1)
SLOW = lfo.sets.Polyhedron([[0.3, 1.0], [0.0, -1.0]], [0.55, 0.5])
NEAR = lfo.sets.Polyhedron([[1, 0], [-1, 0.2], [0, 1], [0.1, -1]], [1.05, -0.95, 0.05, 0.2])
WEAK = lfo.sets.Polyhedron([[1.0], [-2.0]], [0.3, 0.62])


def problem(**sets) -> lfo.OptimalControlProblem:
    given = {"initial_state": [0, 0], "terminal_state": [1, 0], **sets}
    return lfo.OptimalControlProblem(PLANT, T, lfo.QuadraticCost(Q=0.01, R=1.0), **given)


CASES = {
    "states": {"state_set": SLOW},
    "controls": {"control_set": WEAK},
    "end": {"terminal_state": NEAR},
    "end with a box": {"terminal_state": NEAR & lfo.Box([None, -0.01], [None, 0.01])},
    "states and end": {
        "state_set": lfo.sets.Polyhedron([[0.3, 1.0], [0.5, 0.1]], [0.7, 0.485]),
        "terminal_state": NEAR,
    },
    "all, with a band": {
        "state_set": lfo.Box([None, -1], [None, 0.6]) & SLOW,
        "control_set": WEAK,
        "terminal_state": NEAR,
        "control_spectrum": lfo.low_pass(1.5),
        "stage_rows": lfo.StageRows([[0.0, 1.0]], [[0.1]], [0.5]),
    },
    "start": {"initial_state": lfo.sets.Polyhedron([[1, 1], [-1, 0], [0, -1]], [-0.1, 0.4, 0.3]), "state_set": SLOW},
    "one set per time": {"control_set": [WEAK] * 10 + [lfo.sets.Polyhedron([[1.0], [-2.0]], [0.35, 0.61])] * (T - 10)},
}


@pytest.mark.parametrize("name", seeds(CASES))
def test_the_optimum_is_that_of_the_sparse_program_and_its_multipliers_those_of_the_sets(name):
    given = problem(**CASES[name])
    ours, theirs = lfo.solve(given, method="spectral"), lfo.solve(given, method="convex")
    assert ours.certificate.pmp == certificate_of_claim(given).pmp == "satisfied"
    assert abs(ours.gap) < 1e-8
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-8)
    assert set(ours.multipliers.stage) == {term.name for term in given.terms}
    assert max(np.abs(one).max() for one in ours.multipliers.stage.values()) > 1e-3
    for term in given.terms:
        weights = ours.multipliers.stage[term.name]
        assert weights.shape == term.shape
        if not ours.uniqueness.unique:
            continue
        np.testing.assert_allclose(weights, theirs.multipliers.stage[term.name], atol=1e-5)
    if ours.uniqueness.unique:
        np.testing.assert_allclose(ours.multipliers.eta, theirs.multipliers.eta, atol=1e-5)


@expensive
def test_most_of_the_cases_have_unique_multipliers_to_compare():
    unique = [name for name, sets in CASES.items() if lfo.solve(problem(**sets)).uniqueness.unique]
    assert len(unique) >= len(CASES) - 2


def test_auto_takes_the_fourier_domain_method_for_polyhedra_and_not_for_balls():
    assert lfo.solve(problem(state_set=SLOW)).method == "spectral"
    assert lfo.solve(problem(state_set=lfo.sets.Ball(1.2))).method == "convex"
    with pytest.raises(lfo.errors.UnsupportedError, match="state set"):
        lfo.solve(problem(state_set=lfo.sets.Ball(1.2)), method="spectral")


def test_a_set_that_cannot_be_reached_is_proven_infeasible():
    far = lfo.sets.Polyhedron([[-1, 0]], [-40])
    result = lfo.solve(problem(terminal_state=far, control_set=WEAK), method="spectral", throw=False)
    assert result.status == "infeasible"
    assert "terminal state" in {one.block for one in result.conflict}


def test_a_row_that_nothing_can_change_is_left_to_the_sparse_program():
    still = lfo.LinearDynamics([[1, 0.0], [0, 0.0]], [[1.0], [0.0]])
    given = lfo.OptimalControlProblem(
        still, 5, lfo.QuadraticCost(R=1), initial_state=[0, 1], terminal_state=lfo.sets.Polyhedron([[0, 1]], [-1])
    )
    assert lfo.solve(given, throw=False).status == "infeasible"
