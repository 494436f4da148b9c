"""Few samples between levels: in any units of the rows, and where there are none."""

import numpy as np
import pytest

import lin_freq_ocp as lfo


def mover(costs, scale=1.0, control=1.0, terminal=(0.37, 0.1)):
    """Return a double integrator with duty cycles; its velocity in other units, and its control, too."""
    h, S = 0.5, np.diag([1.0, scale])
    A, B = np.array([[1.0, h], [0.0, 1.0]]), np.array([[h * h / 2], [h]])
    dynamics = lfo.LinearDynamics(S @ A @ np.linalg.inv(S), S @ B / control)
    levels = lfo.FiniteSet(control * np.array([-1.0, 0.0, 1.0]), costs, duty_cycles=True)
    end = None if terminal is None else S @ terminal
    return lfo.OptimalControlProblem(dynamics, 8, lfo.QuadraticCost(), levels, None, [0, 0], end)


@pytest.mark.parametrize(("scale", "control"), [(1.0, 1.0), (1e12, 1.0), (1e-12, 1e-9), (1e12, 1e9)])
def test_rows_do_not_depend_on_units(scale, control):
    result = lfo.solve(mover([1.0, 0.0, 1.0], scale, control))
    assert result.status == "optimal"
    assert result.level_use.rows == 2
    assert result.level_use.fractional <= 2


def test_without_rows_no_sample_is_between_levels():
    result = lfo.solve(mover([1.0, 1.0, 1.0], terminal=None))
    assert (result.level_use.rows, result.level_use.fractional) == (0, 0)
    assert "0 linear rows" in str(result)
