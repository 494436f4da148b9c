"""Problems over a frequency response in everything that shows, compares, explains or exports a problem."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.api import raise_for
from lin_freq_ocp.errors import InfeasibleError, ProblemError, UnsupportedError


@pytest.fixture(scope="module")
def wave():
    return lfo.library.wave_energy(horizon=100)


@pytest.fixture(scope="module")
def padded():
    dynamics = lfo.FrequencyResponse(1 / (1.5 - np.exp(-2j * np.pi * np.arange(21) / 40)), mode="zero-padded")
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=1.0)
    return lfo.OptimalControlProblem(dynamics, 20, cost, lfo.Box(-0.4, 0.4))


@expensive
def test_a_comparison_replays_by_the_response(wave, blank, tmp_path):
    comparison = lfo.compare(wave)
    assert comparison.constrained.cost == pytest.approx(lfo.solve(wave).cost)
    page = comparison.save(tmp_path).read_text(encoding="utf-8")
    assert "simulated open-loop; no state follows from the first." in page
    assert "-fold" not in page


@expensive
def test_what_cannot_hold_is_explained_with_the_least_change(wave):
    problem = replace(wave, state_set=lfo.Box(-0.01, 0.01), control_set=lfo.Box(-500.0, 500.0))
    with pytest.raises(InfeasibleError, match="proven by a rigorous ray"):
        raise_for(lfo.solve(problem, throw=False))
    explanation = lfo.explain(problem)
    assert set(explanation.family) == {"state bound on velocity [m/s]", "control bound on force [N]"}
    cured = replace(problem, state_set=lfo.Box(-0.01 - explanation.cures[0].amount, 0.01 + explanation.cures[0].amount))
    assert lfo.solve(cured).certificate.globally_optimal


def test_facts_say_what_is_known(wave):
    facts = wave._repr_html_()
    assert str(wave.dynamics).startswith("frequency response: y = G u")
    assert len(str(wave.dynamics)) < 120
    assert "frequency response: y = G u + g at 51 bins, periodic, 1 output, 1 control" in facts
    assert "starts anywhere" not in facts


def test_soft_sets_beside_a_power(wave):
    problem = replace(wave, state_set=lfo.sets.Soft(lfo.Box(-0.3, 0.3), 10.0))
    certificate = lfo.solve(problem).certificate
    assert certificate.globally_optimal
    assert certificate.pmp == "satisfied"


@pytest.mark.parametrize(
    "change",
    [
        {"control_set": lfo.sets.Ball(1500.0)},
        {"state_spectrum": lfo.stop_band(bins=[7, 8])},
        {"state_set": lfo.sets.Polyhedron([[1.0]], [0.3])},
        {"output_spectrum": lfo.spectrum.OutputSpectrum([[1.0]], constraints=lfo.MagnitudeBound(10.0, bins=[6]))},
    ],
)
def test_sets_and_bands_on_outputs_and_controls(wave, change):
    certificate = lfo.solve(replace(wave, **change)).certificate
    assert certificate.globally_optimal
    assert certificate.pmp == "satisfied"


def test_masks_at_every_frequency(padded):
    mask = lfo.MagnitudeBound(1.0, band=lfo.low_pass(cutoff=1.5), every_frequency=True)
    assert lfo.solve(replace(padded, control_spectrum=mask)).certificate.globally_optimal


def test_cvxpy_has_the_same_cost_and_multipliers(padded):
    program = lfo.to_cvxpy(padded)
    program.solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    result = lfo.solve(padded)
    assert program.value == pytest.approx(result.cost, rel=1e-8)


def test_what_needs_a_recursion_refuses_with_words(wave, padded):
    with pytest.raises(UnsupportedError, match="a FrequencyResponse cannot be stepped"):
        lfo.RecedingHorizon(wave).step(np.zeros(1))
    with pytest.raises(UnsupportedError, match=r"solve takes such a cost over a frequency response"):
        lfo.SpectralSolver(wave)
    with pytest.raises(UnsupportedError, match="only a periodic frequency response"):
        lfo.solve(padded, method="spectral")
    with pytest.raises(ProblemError, match="got levels with FrequencyResponse"):
        replace(padded, control_set=lfo.sets.FiniteSet([-1.0, 0.0, 1.0]))


def test_other_references_are_those_of_the_given_cost(wave):
    reference = 0.2 * np.cos(2 * np.pi * 6 * np.arange(101) / 100)[:, None]
    found = lfo.Solver(wave).solve(references={"x_ref": reference})
    changed = replace(wave, cost=replace(wave.quadratic, x_ref=reference))
    assert found.cost == pytest.approx(lfo.solve(changed).cost, rel=1e-9)
    assert abs(found.cost - lfo.solve(wave).cost) > 1.0
