"""A problem file with every table there is, as nested tables, to be spoiled in one place."""

import json
from typing import Any

# A problem with every table there is
GOOD: dict[str, Any] = {
    "schema": 2,
    "name": "cart",
    "horizon": 8,
    "initial_state": [0.0, 0.0],
    "terminal_state": {"kind": "ball", "radius": 0.1, "centre": [1.0, 0.0]},
    "dynamics": {
        **{"A": [[1.0, 0.1], [0.0, 1.0]], "B": [[0.005], [0.1]], "offset": [0.0, 0.0], "sampling_time": 0.1},
        **{"continuous": False, "state_names": ["position [m]", "speed [m/s]"], "control_names": ["force [N]"]},
    },
    "cost": {
        **{"Q": 1.0, "R": [[1.0]], "S": [[0.0], [0.0]], "q": [0.0, 0.0], "r": 0, "P": 2.0, "p": [1.0, 0.0]},
        **{"x_ref": [[1.0, 0.0]] * 9, "u_ref": [0.0]},
        "norms": [{"kind": "L1", "u": 0.1}, {"kind": "Linf", "x": [0.1, 0.2], "terminal": 1.0, "x_ref": 0.5}],
    },
    "control_set": {
        "kind": "intersection",
        "sets": [{"lower": -5.0, "upper": [5.0]}, {"kind": "ball", "radius": 4.0}, {"kind": "box", "upper": 4.5}],
    },
    "state_set": [
        {"kind": "polyhedron", "F": [[1.0, 0.0]], "g": [2.0]},
        {"kind": "ellipsoid", "W": [[1.0, 0.0], [0.0, 2.0]], "radius": 3.0},
        {"kind": "second_order_cone", "F": [[0.0, 1.0]], "g": [0.0], "h": [1.0, 0.0], "d": 5.0},
        {"kind": "soft", "set": {"upper": [1.0, 1.0]}, "penalty": 2.0},
        *[{"lower": [-9.0, -9.0]}] * 5,
    ],
    "control_spectrum": [
        {"kind": "low_pass", "cutoff_hz": 3.0, "component": "force"},
        {"kind": "notch", "centre": 0.8, "width": 0.1, "component": 0},
        {"kind": "stop_band", "bins": [3, -3]},
        {"kind": "magnitude_bound", "limit_db": -3.0, "reference": 2.0, "band": {"kind": "high_pass", "cutoff": 1.0}},
        {"kind": "linear_constraint", "coefficients": [[[1.0]]] * 8, "constant": [0.0], "penalty": 1.0},
        {
            **{"kind": "residual_vibration", "frequency": [0.9, 1.1], "damping": [0.0, 0.1]},
            **{"limit": 3.0, "component": 0, "relative": False},
        },
        {
            **{"kind": "spectrogram", "bound": {"kind": "energy_bound", "limit": 9.0, "bins": [1]}},
            **{"length": 4, "hop": 2, "past": [[0.0], [0.1]]},
        },
    ],
    "state_spectrum": {
        **{"kind": "energy_bound", "limit": 30.0, "bins": [1], "component": "speed"},
        **{"penalty": 1.0, "window": "hann", "oversampling": 2},
    },
    "stage_rows": {"C": [[1.0, 0.0]], "D": [[1.0]], "e": [4.0], "name": "rows", "penalty": 3.0},
    "output_spectrum": {
        **{"C": [[1.0, 0.0]], "D": [[1.0]], "output_names": ["y [m]"]},
        "constraints": [{"kind": "band_pass", "lower_hz": 0.0, "upper_hz": 4.0, "component": "y"}],
    },
    "rate_limit": {"limit": [6.0], "previous": 0.0, "following": [0.0]},
}
# The same with piecewise-affine dynamics
PIECEWISE: dict[str, Any] = GOOD | {
    "dynamics": {
        **{"sampling_time": 0.1, "state_names": ["position [m]", "speed [m/s]"], "control_names": ["force [N]"]},
        "modes": [
            {
                **{"A": [[1.0, 0.1], [0.0, 1.0]], "B": [[0.005], [0.1]], "name": "free"},
                **{"G": [[1.0, 0.0]], "h": [0.5]},
            },
            {
                **{"A": [[1.0, 0.1], [-2.0, 1.0]], "B": [[[0.005], [0.1]]] * 8, "offset": [0.0, 1.0]},
                **{"G": [[-1.0, 0.0], [0.0, 0.0]], "H": [[0.0], [1.0]], "h": [-0.5, float("inf")], "name": "contact"},
            },
        ],
    }
}


def changed(tables: dict[str, Any], place: str, value: Any) -> dict[str, Any]:
    """Return the tables with another value at a place such as ``state_set[0].g``; ``...`` takes it away."""
    tables = json.loads(json.dumps(tables))
    inner: Any = tables
    *way, last = [int(key) if key.isdigit() else key for key in place.replace("]", "").replace("[", ".").split(".")]
    for key in way:
        inner = inner[key]
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    return tables
