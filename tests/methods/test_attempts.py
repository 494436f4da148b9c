"""Answers of a solver that are no numbers in the units of the problem are no answers."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.methods import ScaledSolver
from lin_freq_ocp.program import Claim, Solution, scaled_program


@pytest.mark.parametrize("claim", [Claim.SOLVED, Claim.LIMIT, Claim.INFEASIBLE])
def test_duals_that_overflow_are_no_answer(claim):
    linear, scaling, program = scaled_program(lfo.library.double_integrator(horizon=4))
    solves = ScaledSolver(linear, lambda *given: pytest.fail("called"), None, 1e-9, np.inf, 0.0)
    z, y = np.zeros(program.A.shape[1]), np.full(program.A.shape[0], 1e308)
    with np.errstate(over="ignore"):
        scale = type(scaling)(scaling.columns, scaling.rows, scaling.cost * 1e-9)
        attempt = solves.recover(scale, program, Solution(claim, z, y, "as told"))
    assert attempt.candidate.status == "numerical_error"
    assert attempt.candidate.multipliers is None
    assert attempt.error == np.inf
