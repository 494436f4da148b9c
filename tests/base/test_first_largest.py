"""The entry that an answer names among equal ones."""

import numpy as np
import pytest

from lin_freq_ocp.base import first_largest


@pytest.mark.parametrize("size", [3.0, -3.0, 1e-300])
@pytest.mark.parametrize("rounding", [0.0, 1e-12, -1e-12])
def test_rounding_does_not_choose_among_equal_entries(size, rounding):
    values = np.array([-abs(4 * size), size, size * (1 + rounding), -abs(5 * size)])
    assert first_largest(values) == (1,)
    assert first_largest(values.reshape(2, 2)) == (0, 1)
    assert first_largest(values, [0.0, 2.0, 1.0, 0.5]) == (2,)  # the earliest, wherever it stands
    assert first_largest(np.array([size, size + 1e-8 * abs(size)])) == (1,)


@pytest.mark.parametrize("largest", [np.inf, -np.inf, 0.0])
def test_infinite_values_and_zeros_are_compared(largest):
    assert first_largest(np.array([-np.inf, largest, largest])) == (0 if largest == -np.inf else 1,)
