"""Problems that use every part of the description, and a small one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost, StageRows, low_pass, stop_band

N, M = 3, 2


def everything_at_once(horizon: int, seed: int = 5, per_time: bool = True) -> OptimalControlProblem:
    """Return a random problem that uses every part of the description, with partly infinite bounds."""
    rng = np.random.default_rng(seed)
    T = horizon
    times = (T,) if per_time else ()

    def psd(size: int, count: tuple[int, ...]) -> np.ndarray:
        root = rng.normal(size=(*count, size, size))
        return root @ np.swapaxes(root, -1, -2)

    H = psd(N + M, times)
    lower, upper = -1 - rng.random((T + 1, N)), 1 + rng.random((T + 1, N))
    lower[rng.random(lower.shape) < 0.4], upper[rng.random(upper.shape) < 0.4] = -np.inf, np.inf
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            rng.normal(size=(*times, N, N)) / 2, rng.normal(size=(*times, N, M)), rng.normal(size=(*times, N))
        ),
        horizon=T,
        cost=QuadraticCost(
            Q=(H[..., :N, :N] + np.swapaxes(H[..., :N, :N], -1, -2)) / 2,
            R=(H[..., N:, N:] + np.swapaxes(H[..., N:, N:], -1, -2)) / 2,
            S=H[..., :N, N:],
            q=rng.normal(size=(*times, N)),
            r=rng.normal(size=(*times, M)),
            P=psd(N, ()),
            p=rng.normal(size=N),
            x_ref=rng.normal(size=(T + 1, N)),
            u_ref=rng.normal(size=(T, M)),
        ),
        state_set=Box(lower, upper),
        control_set=[Box([-1.0 - t, None], [2.0, 0.5 + t]) for t in range(T)],
        initial_state=Box([0.1, None, None], [0.1, 0.5, None]),
        terminal_state=Box([None, -0.3, None], [None, -0.3, 0.2]),
        control_spectrum=[stop_band(bins=[0, 2], component=0), low_pass(1.9, component=1)],
        state_spectrum=[stop_band(bins=[1], component=2), stop_band(bins=[T // 2], component=0)],
        stage_rows=[
            StageRows(rng.normal(size=(*times, 3, N)), rng.normal(size=(3, M)), [1.0, np.inf, 2.0], name="first"),
            StageRows(None, rng.normal(size=(*times, 1, M)), np.where(np.arange(T) % 3, 1.5, np.inf)[:, None]),
        ],
    )


PROBLEMS = [everything_at_once(T, per_time=per_time) for T in (7, 8) for per_time in (True, False)]
each_problem = pytest.mark.parametrize("problem", PROBLEMS, ids=["7", "7 constant", "8", "8 constant"])


def small_problem(**changes: Any) -> OptimalControlProblem:
    """Return a double integrator with a tight control bound and a stop band."""
    given: dict[str, Any] = {
        "dynamics": LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]]),
        "horizon": 20,
        "cost": QuadraticCost(R=1.0, Q=np.diag([1.0, 0.1])),
        "initial_state": [0.4, 0.0],
        "terminal_state": [0.0, 0.0],
        "control_set": Box(-1.5, 1.5),
        "control_spectrum": stop_band(bins=[5, 8, 10]),
    }
    return OptimalControlProblem(**(given | changes))
