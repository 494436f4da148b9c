"""Small problems with path constraints."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import lin_freq_ocp as lfo

STEP = 0.1
MASS = lfo.LinearDynamics(np.eye(4) + STEP * np.eye(4, k=2), np.vstack([0.5 * STEP**2 * np.eye(2), STEP * np.eye(2)]))


def disc(x: Any, u: Any) -> Any:
    """Return how far a mass is within a disc."""
    return 0.25 - x[0] ** 2 - x[1] ** 2


def mass(h: Any = disc, horizon: int = 12, cost: Any = None, **given: Any) -> lfo.OptimalControlProblem:
    """Return a mass in the plane that goes around a disc, or is limited by h; further keywords are of h."""
    ends = {name: given.pop(name) for name in ("initial_state", "terminal_state", "dynamics") if name in given}
    rows = lfo.sets.PathConstraint(h, **({"name": "path"} | given))
    return lfo.OptimalControlProblem(
        ends.get("dynamics", MASS),
        horizon,
        cost or lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(-30, 30),
        initial_state=ends.get("initial_state", [-1, 0.1, 0, 0]),
        terminal_state=ends.get("terminal_state", [1, 0, 0, 0]),
        stage_rows=rows,
    )


@cache
def way_around() -> lfo.results.Result:
    """Return the way of the mass around the disc, which is searched for once."""
    return lfo.solve(mass(), "nonsmooth")
