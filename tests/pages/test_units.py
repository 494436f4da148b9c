"""Numbers and units as readers see them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.pages import double_integrator
from lin_freq_ocp.base import NOTHING, join_words, number, runs_in_words, split_unit
from lin_freq_ocp.pages import align, frequency_scale, quantity, rough, time_scale
from lin_freq_ocp.spectrum import notch


def test_axes_have_readable_units():
    def scales(step: float | None) -> tuple[str, str]:
        problem = double_integrator(horizon=100, sampling_time=step)
        return time_scale(problem).unit, frequency_scale(problem).unit

    assert scales(None) == ("steps", "rad/sample")
    assert scales(1e-6) == ("\N{MICRO SIGN}s", "Hz")
    assert scales(1e-3) == ("ms", "Hz")
    assert scales(10.0) == ("s", "Hz")
    assert scales(900.0) == ("h", "Hz")  # a day in quarters of an hour, in 100 steps
    assert scales(86400.0) == ("d", "Hz")
    problem = double_integrator(horizon=100, sampling_time=1e-3, control_spectrum=notch(centre_hz=100, width_hz=50))
    scale = frequency_scale(problem)
    assert scale.factor * 2 * np.pi * 10 / 100 == pytest.approx(100)
    assert time_scale(problem).factor * 100 == pytest.approx(100)
    assert (time_scale(problem, 10**7).unit, time_scale(problem, 10**7).factor * 10**7) == ("h", pytest.approx(25 / 9))


@given(st.floats(-1e300, 1e300))
def test_numbers_are_close_to_what_they_show(value: float):
    for shown, accuracy in ((number(value), 5e-2), (align(value), 5e-2), (rough(value), 6e-2)):
        assert float(shown) == pytest.approx(value, rel=accuracy, abs=0)
    assert value == 0 or float(number(value)) != 0


def test_numbers_read_well():
    assert [number(one) for one in (None, 0, 2852.7053, 12345.6, 9.0e-27, 8.1e46, 0.25)] == [
        NOTHING,
        *("0", "2852.7", "12346", "9.0e-27", "8.1e46", "0.25"),
    ]
    assert [align(one) for one in (None, 0, 5.0, 2852.7, 9.0e-27)] == [NOTHING, "0", "5.000", "2852.7", "9.0e-27"]
    assert split_unit("angular speed [rad/s]") == ("angular speed", "rad/s")
    assert split_unit("x_0") == ("x_0", "")
    assert quantity(0.85752, "force [N]") == "0.858 N"
    assert join_words(["a"]) == "a"
    assert join_words(["a", "b", "c"]) == "a, b and c"
    assert runs_in_words([(3, 3), (7, 9)]) == "3 and 7 to 9"
