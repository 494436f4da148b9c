"""The dynamics of a problem in the frequency domain: a recursion, or a response at every bin."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray
from lin_freq_ocp.problem.ocp import OptimalControlProblem


def dynamics_of(problem: OptimalControlProblem) -> tuple[Array, Array, Array, ComplexArray | None]:
    """Return A, B, d, and the response of x_{t+1} at every bin where there is no recursion, (n, m, bins)."""
    T = problem.horizon
    found = problem.dynamics.response(T)
    if found is None:
        return problem.linear.A, problem.linear.B, problem.linear.offset, None
    n, m = problem.state_dim, problem.control_dim
    ahead = np.exp(2j * np.pi * np.arange(T // 2 + 1) / T)
    return np.zeros((n, n)), np.zeros((n, m)), found.base[1:], ahead * np.moveaxis(found.G, 0, -1)
