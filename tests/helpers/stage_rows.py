"""Problems with joint rows C x_t + D u_t <= e_t, and altered multipliers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.results import Certificate

T, N, M = 16, 3, 2
KINDS = ("x", "u", "xu")
VARYING = ("", "C", "D", "e", "CDe")


def solve(problem: lfo.OptimalControlProblem, method: str = "convex", backend: str = "auto") -> lfo.results.Result:
    return lfo.solve(problem, method=method, backend=backend)


def problem_of(kind: str, varying: str, seed: int = 0) -> lfo.OptimalControlProblem:
    """A random problem whose trajectory without control is feasible, and whose optimum without the rows is not."""
    rng = np.random.default_rng([seed, KINDS.index(kind), VARYING.index(varying)])
    root = rng.normal(size=(N + M, N + M))
    H = root @ root.T + np.eye(N + M)
    H = (H + H.T) / 2
    dynamics = lfo.LinearDynamics(0.8 * np.eye(N) + 0.1 * rng.normal(size=(N, N)), rng.normal(size=(N, M)))
    problem = lfo.OptimalControlProblem(
        dynamics=dynamics,
        horizon=T,
        cost=lfo.QuadraticCost(Q=H[:N, :N], R=H[N:, N:], S=H[:N, N:], P=1.0, x_ref=2 + rng.normal(size=N)),
        control_set=lfo.Box(-4.0, 4.0),
        initial_state=0.3 * rng.normal(size=N),
        control_spectrum=lfo.stop_band(bins=[5, 8], component=0),
    )
    free, rest = solve(problem).trajectory, lfo.simulate(problem, np.zeros((T, M)))
    C = rng.normal(size=(T, 2, N) if "C" in varying else (2, N)) if "x" in kind else np.zeros((2, N))
    D = rng.normal(size=(T, 2, M) if "D" in varying else (2, M)) if "u" in kind else np.zeros((2, M))
    values = lfo.StageRows(C, D, np.zeros(2)).values(free.x, free.u)
    sign = np.where(values.max(0) > -values.min(0), 1.0, -1.0)[:, None]
    rows = lfo.StageRows(sign * C, sign * D, np.zeros(2))
    at_rest, at_optimum = rows.values(rest.x, rest.u), rows.values(free.x, free.u)
    if "e" not in varying:
        at_rest, at_optimum = at_rest.max(0), at_optimum.max(0)
    cut = at_optimum > at_rest + 1e-9  # x_0 is fixed: a row on it alone would have no unique multiplier
    assert cut.any()
    e = np.where(cut, at_rest + 0.4 * (at_optimum - at_rest), np.inf)
    return replace(problem, stage_rows=lfo.StageRows(rows.C, rows.D, e, name=f"rows on {kind}"))


@pytest.fixture(scope="module")
def two_families():
    """A problem with two families of joint rows, both active, one with limits per time; and its solution."""
    problem = problem_of("xu", "CDe")
    other = problem_of("xu", "", 1).stage_rows[0]
    x, u = (getattr(solve(problem).trajectory, name) for name in "xu")
    most = other.values(x, u).max(0)
    e = most - 0.05 * np.ptp(other.values(x, u), axis=0) * (np.arange(2) == 0)
    problem = replace(problem, stage_rows=[*problem.stage_rows, replace_limits(other, e)])
    return solve(problem)


def replace_limits(rows: lfo.StageRows, e: Any, name: str = "second") -> lfo.StageRows:
    return lfo.StageRows(rows.C, rows.D, e, name=name)


def changed(multipliers: lfo.results.Multipliers, **fields: Any) -> lfo.results.Multipliers:
    names = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x", "stage")
    return lfo.results.Multipliers(**({name: getattr(multipliers, name) for name in names} | fields))


def scaled(multipliers: lfo.results.Multipliers, factor: float) -> lfo.results.Multipliers:
    return changed(multipliers, stage={name: factor * weights for name, weights in multipliers.stage.items()})


def failed(certificate: Certificate) -> set[str]:
    return {one.label for one in certificate.failed}


def place_of_largest(multipliers: lfo.results.Multipliers, name: str) -> tuple[int, int]:
    weights = multipliers.stage[name]
    t, row = np.unravel_index(np.argmax(weights), weights.shape)
    return int(t), int(row)


def cart(**changes: Any) -> lfo.OptimalControlProblem:
    given = {
        "dynamics": lfo.LinearDynamics(
            [[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], state_names=["place [m]", "speed [m/s]"]
        ),
        "horizon": 24,
        "cost": lfo.QuadraticCost(R=1.0),
        "control_set": lfo.Box(-5.0, 5.0),
        "initial_state": [0.0, 0.0],
        "terminal_state": [1.0, 0.0],
    }
    return lfo.OptimalControlProblem(**(given | changes))
