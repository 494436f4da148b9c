"""A sample of the random problems with path constraints of ``scripts/verify.py --part formulas``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks.path_constraints import STATIONARY, check, random_path, slope_left
from helpers.seeds import expensive, seeds


@pytest.mark.parametrize("seed", seeds(range(9)))
def test_an_accepted_answer_satisfies_its_conditions_by_differences(seed):
    checked = check(seed)
    assert checked.passed, checked


@expensive
def test_the_check_notices_other_multipliers():
    random = random_path(1)
    result = lfo.solve(random.problem, "nonsmooth")
    price = result.multipliers.stage["path"]
    assert price.max() > 1e-3
    other = replace(result.multipliers, stage={"path": 1.1 * price})

    class Changed:
        trajectory, multipliers = result.trajectory, other

    assert slope_left(random, result) < STATIONARY < slope_left(random, Changed)


def test_the_check_notices_other_controls():
    random = random_path(2)
    result = lfo.solve(random.problem, "nonsmooth")

    class Changed:
        trajectory = lfo.Trajectory(
            result.trajectory.x, result.trajectory.u + 0.05 * np.sin(np.arange(random.problem.horizon))[:, None]
        )
        multipliers = result.multipliers

    assert slope_left(random, Changed) > 10 * STATIONARY
