"""Linear problems with known optimal values: those of reference.json, and the six of the pendulum."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.arrays import Array

INSTANCES: dict[str, dict[str, Any]] = {
    one["name"]: one for one in json.loads(Path(__file__).with_name("reference.json").read_text())["instances"]
}
# Those that boxes and stop bands can state; dint200_soft has a mask, and is known to 1e-6 only
STATED = [name for name in INSTANCES if not INSTANCES[name]["soft_u"]]
PENDULUM: dict[str, tuple[dict[str, Any], float]] = {  # keyword arguments, optimal cost
    "paper, constrained": ({}, 3199.18631986),
    "paper, classical": ({"cutoff": None}, 2852.70530277),
    "to rest, constrained": ({"initial_state": (0.05, 0.05, 0, 0), "terminal_state": (0, 0, 0, 0)}, 359.660659090),
    "to rest, classical": (
        {"initial_state": (0.05, 0.05, 0, 0), "terminal_state": (0, 0, 0, 0), "cutoff": None},
        356.560725193,
    ),
    "slow sampling, constrained": ({"sampling_time": 0.1}, 135.081414040),
    "slow sampling, classical": ({"sampling_time": 0.1, "cutoff": None}, 127.758711896),
}


def reference_problem(name: str, **changes: Any) -> lfo.OptimalControlProblem:
    """Return the problem of an instance; ``changes`` replace entries of its data."""
    one = INSTANCES[name] | changes
    T = one["T"]
    bounds = lfo.Box([-bound for bound in one["xmax"]], one["xmax"])
    last = bounds if one["xT"] is None else lfo.sets.Everything()
    A, B = time_varying(T) if name == "ltv200" else (one["A"], one["B"])
    return lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics(A, B),
        horizon=T,
        cost=lfo.QuadraticCost(Q=one["Q"], R=one["R"], P=one["PT"]),
        control_set=lfo.Box(one["ulo"], one["uhi"]),
        state_set=[lfo.sets.Everything(), *[bounds] * (T - 1), last],
        initial_state=one["x0"],
        terminal_state=one["xT"],
        control_spectrum=[
            *(lfo.stop_band(bins=bins, component=j) for j, bins in enumerate(one["stop_u"]) if bins),
            *(lfo.MagnitudeBound(mask["c"], bins=mask["k"], component=int(j)) for j, mask in one["soft_u"].items()),
        ],
        name=name,
    )


def time_varying(T: int) -> tuple[Array, Array]:
    """Return A (T, 2, 2) and B (T, 2, 1) of the time-varying instance."""
    t = np.arange(T)
    A, B = np.zeros((T, 2, 2)), np.zeros((T, 2, 1))
    A[:, 0, 0] = 1
    A[:, 0, 1] = 0.02 + 0.005 * np.sin(2 * np.pi * t / 200)
    A[:, 1, 0] = -0.02 * np.cos(2 * np.pi * t / 100)
    A[:, 1, 1] = 1 - 0.002 * t / 200
    B[:, 1, 0] = 0.02 * (1 + 0.3 * np.sin(2 * np.pi * t / 50))
    return A, B
