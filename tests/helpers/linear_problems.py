"""Random linear dynamics and a small problem of two states."""

from __future__ import annotations

from typing import Any

import numpy as np

from lin_freq_ocp import LinearDynamics, OptimalControlProblem, QuadraticCost

T, N, M = 5, 3, 2  # horizon, states, controls: all different, so that an exchanged axis is an error


def generator(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def dynamics_data(seed: int, varying: str) -> dict[str, np.ndarray]:
    """Return A, B and offset, those named in ``varying`` one per time."""
    rng = generator(seed)
    shapes = {"A": (N, N), "B": (N, M), "offset": (N,)}
    return {name: rng.normal(size=(T, *shape) if name in varying else shape) for name, shape in shapes.items()}


def at_time(data: np.ndarray, t: int, constant_ndim: int) -> np.ndarray:
    return data[t] if data.ndim > constant_ndim else data


VARYING = ["", "A", "B", "offset", "A B offset"]


def problem(**changes: Any) -> OptimalControlProblem:
    """Return a problem of two states and one control, with what a test changes."""
    given: dict[str, Any] = {
        "dynamics": LinearDynamics(
            [[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], sampling_time=0.1, state_names=["position [m]", "speed [m/s]"]
        ),
        "horizon": 4,
        "cost": QuadraticCost(R=1.0),
    }
    return OptimalControlProblem(**(given | changes))
