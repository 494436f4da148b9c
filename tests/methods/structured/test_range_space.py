"""The multipliers of a fixed x_T, whose distance the regulator prices."""

import pytest

from lin_freq_ocp.methods.structured import CouplingResponse, RangeSpaceSolver, loops

from .linear_systems import random_system, solved


@pytest.mark.parametrize("growth", [0.0, 60.0])
def test_multipliers_of_a_fixed_end_count_its_price_in_the_regulator(growth):
    """Else what is left of the end, by the compliance of equations and rounding, is left of stationarity, too."""
    worst = 0.0
    for seed in range(12):
        stages, Phi, C, right = random_system(seed, growth=growth, others=False, T=60)
        side = RangeSpaceSolver(CouplingResponse(stages, loops(False)))
        worst = max(worst, solved(side, stages, Phi, C, right, refinements=0)[1])
    assert worst < 1e-8  # 1e-6 without
