"""Published smooth problems from cold starts: nothing but dynamics, quartic costs, unstable maps, saddles."""

from __future__ import annotations

import pytest

import lin_freq_ocp as lfo
from helpers.published import PUBLISHED

QUICK = [
    "DTOC1L, N = 10",
    "DTOC1L, N = 50",
    "DTOC2, N = 10",
    "DTOC2, N = 50",
    "DTOC2, N = 100",
    "DTOC4, N = 100",
    "DTOC5, N = 50",
    "DTOC6, N = 11",
    "DTOC6, N = 21",
    "DTOC6, N = 51",
    "DTOC6, N = 101",
    "Chen-Allgoewer, T = 100",
    "Chen-Allgoewer, T = 400",
    "pendulum of acados, T = 40",
]


@pytest.mark.parametrize("name", QUICK)
def test_a_published_optimum_is_found_or_a_better_one(name):
    case = PUBLISHED[name]
    result = lfo.solve(case.build(case.horizon), global_bound=False)
    assert result.status == "locally_optimal"
    assert result.cost <= case.cost * (1 + 1e-7)
    assert result.certificate.worst.relative <= 1e-6
