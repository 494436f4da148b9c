"""Known optimal costs: reference.json and the pendulum (linear), and library problems with modes or kinks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.base.arrays import Array

INSTANCES: dict[str, dict[str, Any]] = {
    one["name"]: one for one in json.loads(Path(__file__).with_name("reference.json").read_text())["instances"]
}
# Those that boxes and stop bands can state; dint200_soft has a mask, and is known to 1e-6 only
STATED = [name for name in INSTANCES if not INSTANCES[name]["soft_u"]]
PENDULUM: dict[str, tuple[dict[str, object], float]] = {  # keyword arguments, optimal cost
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
NEAR: dict[str, object] = {"initial_state": (1, 1), "terminal_cost": False}
# System, arguments, and the known optimal cost, if there is one (reference: docs/hybrid_systems.md)
PIECEWISE_AFFINE: dict[str, tuple[str, dict[str, object], float | None]] = {
    "rotation, T = 6": ("switched_rotation", {"horizon": 6}, 159.320358),
    "rotation, T = 6, freq": ("switched_rotation", {"horizon": 6, "control_spectrum": "freq"}, 161.197114),
    "rotation, T = 10": ("switched_rotation", {"horizon": 10, **NEAR}, 2.8378768),
    "rotation, T = 10, bin 5": ("switched_rotation", {"horizon": 10, "control_spectrum": [5], **NEAR}, 2.8944270),
    "pendulum, T = 6": ("pendulum_with_wall", {"horizon": 6}, 34.990971),
    "pendulum, T = 10, freq": ("pendulum_with_wall", {"horizon": 10, "control_spectrum": "freq"}, None),
    "buck, T = 6": ("buck_affine", {"horizon": 6}, 32.681386),
    "buck, T = 8, freq": ("buck_affine", {"horizon": 8, "control_spectrum": "freq"}, None),
    "absolute value, T = 8": ("absolute_value", {"horizon": 8}, -2.8),
    "network, T = 4, freq": ("max_min_network", {"horizon": 4, "control_spectrum": "freq"}, None),
}
# Examples 2 and 3 of the paper, by dynamic programming, enumeration with a local solver, and a global solver; those of
# T = 20 by this project alone
FREE_END: dict[str, object] = {"terminal_state": None}
PIECEWISE_SMOOTH: dict[str, tuple[str, dict[str, object], float]] = {
    "norm from (0, 1), T = 3": ("norm_dynamics", {"initial_state": (0.0, 1.0), "horizon": 3}, 1.0),
    "norm from (1, 0), T = 3": ("norm_dynamics", {"initial_state": (1.0, 0.0), "horizon": 3}, 1.959023692803284),
    "norm from (1, 0), T = 10": ("norm_dynamics", {"initial_state": (1.0, 0.0)}, 2.382234308047054),
    "norm from (1, 1), T = 10": ("norm_dynamics", {"initial_state": (1.0, 1.0)}, 3.644688839725019),
    "buck, T = 3": ("buck_converter", {"horizon": 3}, 17.345547997984184),
    "buck, T = 4": ("buck_converter", {"horizon": 4}, 22.36493035150289),
    "buck, T = 8": ("buck_converter", {"horizon": 8}, 44.67772239475926),
    "buck to I_ref, T = 4": ("buck_converter", {"horizon": 4, "terminal_state": [1.0]}, 22.400633302541934),
    "buck, T = 8, bins 3 to 5": ("buck_converter", {"control_spectrum": [3, 4, 5]}, 44.69913880875864),
    "buck, T = 15": ("buck_converter", {"horizon": 15}, 83.66744364376612),
    "buck, T = 20": ("buck_converter", {"horizon": 20}, 111.447689650827),
    "buck, T = 20, bins 7 to 10": ("buck_converter", {"horizon": 20, "control_spectrum": [7, 8, 9, 10]}, 111.45769391),
    "buck, wrong sign at 0": (
        "buck_converter",
        {"horizon": 2, "initial_state": [0.9351278729299871], **FREE_END},
        11.554464138730564,
    ),
    "buck, wrong sign inside": (
        "buck_converter",
        {"horizon": 3, "initial_state": [0.8281718171540953], **FREE_END},
        17.080332697458882,
    ),
    "buck as posed, T = 8": ("buck_converter", {"v_min": None, "v_max": None}, 11.221825808084372),
    "buck on the border, T = 4": (
        "buck_converter",
        {"horizon": 4, "terminal_price": -40.0, **FREE_END},
        -17.5993666975,
    ),
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
