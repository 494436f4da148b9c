"""A sample of the random problems of ``scripts/verify.py --part formulas``."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks.formula_costs import STATIONARY, check, random_problem, slope_left
from helpers.seeds import seeds


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_an_accepted_answer_is_stationary_by_differences(seed):
    checked = check(seed)
    assert checked.passed, checked


def test_the_check_notices_other_trajectories():
    problem = random_problem(0)
    u = lfo.solve(problem, "nonsmooth").trajectory.u + 0.01 * np.sin(np.arange(problem.horizon))[:, None]
    assert slope_left(problem, np.clip(u, -1.0, 0.8)) > 10 * STATIONARY
