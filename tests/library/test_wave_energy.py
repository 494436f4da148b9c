"""WaveBot in heave: published and independently computed powers."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.library.waveforms import coefficients_at

POWERS = [(None, 140.007195), (2000.0, 98.11269), (1000.0, 58.75533)]  # W


@pytest.mark.parametrize(("force", "power"), POWERS)
def test_power_within_a_bound_on_the_force(force, power):
    result = lfo.solve(lfo.library.wave_energy(force=force))
    assert -result.cost == pytest.approx(power, rel=1e-6)
    assert result.certificate.globally_optimal
    assert result.certificate.pmp == "satisfied"


def test_coefficients_are_linear_between_those_of_the_file():
    found = coefficients_at(np.array([0.0, 0.075, 0.05, 0.1, 2.5, 2.51]), 45.0)
    assert found.valid.tolist() == [False, True, True, True, True, False]
    assert found.excitation[1] == pytest.approx(found.excitation[2:4].mean())
    assert not found.admittance[~found.valid].any()
    assert (found.admittance[found.valid].real > 0).all()


def test_a_record_whose_last_harmonic_is_the_nyquist_frequency():
    assert lfo.library.wave_energy(horizon=100).control_stop[-1, 0]


@pytest.mark.parametrize(
    "named", [{"wave_frequency": 0.31}, {"wave_frequency": 2.55}, {"record": 0.0}, {"force": -1.0}]
)
def test_bad_parameters_are_named(named):
    with pytest.raises(ProblemError, match=next(iter(named))):
        lfo.library.wave_energy(**named)
