"""Multipliers for the judge: changed, written by hand, and those of the peak of ``kinks``."""

from __future__ import annotations

import numpy as np

import lin_freq_ocp as lfo
from helpers import kinks
from lin_freq_ocp.methods.hybrid import multipliers_with_weights


def changed(multipliers, **fields):
    names = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x", "stage", "weights")
    return lfo.results.Multipliers(**({name: getattr(multipliers, name) for name in names} | fields))


def multipliers_of(problem, eta, mu, nu, rho_u=0.0, weights=None):
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    bins = np.full((T // 2 + 1, m), 0.0 + 0.0j)
    bins[0] = rho_u
    shaped = (np.reshape(part, shape) for part, shape in ((eta, (T, n)), (mu, (T + 1, n)), (nu, (T, m))))
    return lfo.results.Multipliers(1.0, *shaped, bins, np.zeros(((T + 1) // 2 + 1, n)), weights=weights)


def peak_optimum():
    """The optimum of the peak, with the multipliers of its rising sequence."""
    problem = kinks.peak()
    result = lfo.solve(problem.with_modes([0, 0]))
    return (
        problem,
        result.trajectory,
        multipliers_with_weights(problem, result.trajectory, np.array([0, 0]), result.multipliers),
    )
