"""WaveBot in heave: published and independently computed powers."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import ProblemError

POWERS = [(None, 140.007195), (2000.0, 98.11269), (1000.0, 58.75533)]  # W


@pytest.mark.parametrize(("force", "power"), POWERS)
def test_power_within_a_bound_on_the_force(force, power):
    result = lfo.solve(lfo.library.wave_energy(force=force))
    assert -result.cost == pytest.approx(power, rel=1e-6)
    assert result.certificate.globally_optimal
    assert result.certificate.pmp == "satisfied"


def test_coefficients_are_linear_between_those_of_the_file():
    """Bins of a record of 40 s are multiples of 0.025 Hz; the file has those from 0.05 to 2.5 Hz by 0.05 Hz."""
    excitation = {}
    for k in (2, 3, 4):
        problem = lfo.library.wave_energy(horizon=250, record=40.0, wave_frequency=k / 40)
        excitation[k] = problem.dynamics.offset[k, 0] / problem.dynamics.G[k, 0, 0]
    assert excitation[3] == pytest.approx((excitation[2] + excitation[4]) / 2)
    admittance, known = problem.dynamics.G[:, 0, 0], ~problem.control_stop[:, 0]
    assert np.flatnonzero(known).tolist() == list(range(2, 101))
    assert not admittance[~known].any()
    assert (admittance[known].real > 0).all()


def test_a_record_whose_last_harmonic_is_the_nyquist_frequency():
    assert lfo.library.wave_energy(horizon=100).control_stop[-1, 0]


@pytest.mark.parametrize(
    "named", [{"wave_frequency": 0.31}, {"wave_frequency": 2.55}, {"record": 0.0}, {"force": -1.0}]
)
def test_bad_parameters_are_named(named):
    with pytest.raises(ProblemError, match=next(iter(named))):
        lfo.library.wave_energy(**named)
