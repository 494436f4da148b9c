"""Keys and types of the JSON that the command prints."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.api import ERRORS

HARMLESS = ("--set", f"cutoff={np.pi!r}")
"""A low pass at the Nyquist frequency: it removes nothing, and says so in a warning."""

HEAD = {
    "schema": int,
    "version": str,
    "problem": {"name": str, "horizon": int, "state_dim": int, "control_dim": int, "sampling_time": (float, None)},
}
DIRECTION = {"slope": float, "residual": float, "time": int}
CERTIFICATE = {
    "descent": (DIRECTION, None),
    "borders": (dict, None),
    "pmp": str,
    "normal": (bool, None),
    "global": bool,
    "conditions": [
        {
            "label": str,
            "name": str,
            "residual": (float, None),
            "scale": (float, None),
            "tolerance": float,
            "passed": bool,
            "time": (int, None),
            "component": (int, None),
        }
    ],
}
VALUES = {"cost": (float, None), "lower_bound": (float, None), "gap": (float, None), "bound": (str, None)}
CERTIFY = {**HEAD, **VALUES, "certificate": CERTIFICATE}
OPTIONAL = {"between_samples", "worst_case"}  # of a continuous plant with state bounds; of a file with loads
TOO_WEAK = ("--set", "horizon=60", "--set", "control_bound=1")
"""An infeasible pendulum that is explained in less than the time there is for it."""

SOLVE = {
    **HEAD,
    **VALUES,
    "status": str,
    "primal": bool,
    "dual": bool,
    "method": str,
    "backend": (str, None),
    "seconds": {"setup": float, "solve": float, "certify": float},
    "certificate": (CERTIFICATE, None),
    "conflict": ([{"block": str, "share": float, "times": [int], "margin": float}], None),
    "explanation": (
        {"family": [str], "irreducible": bool, "cures": [{"block": str, "amount": float, "words": str}]},
        None,
    ),
    "direction": (DIRECTION, None),
    "modes": ([int], None),
    "tree": ({"nodes": int, "leaves": int, "covers": bool}, None),
    "message": (str, None),
    "remarks": [str],
    "attempts": [{"method": str, "status": (str, None), "reason": str, "message": str}],
}
MEASURES = {
    "cost": (float, None),
    "max_control": float,
    "control_violation": float,
    "state_violation": (float, None),
    "stage_violation": (float, None),
    "terminal_error": (float, None),
    "terminal_errors": ([float], None),
    "stopband_energy": (float, None),
    "stopband_peak": (float, None),
    "state_stopband_energy": (float, None),
    "state_stopband_peak": (float, None),
    "amplification": float,
}
FILTERED = {**MEASURES, "description": str, "replay_meaningful": bool, "one_step_residual": [float]}
FILTERS = ("brickwall", "butterworth", "zero_phase", "moving_average", "clipped")


def compared(*filters: str):
    return {
        **SOLVE,
        "classical": (MEASURES, None),
        "constrained": (MEASURES, None),
        "filtered": dict.fromkeys(filters, FILTERED),
    }


def require(value, kind, place="$"):
    """Assert that a value is of a kind: a type, a list of one kind, a table of kinds, or a kind or None."""
    if isinstance(kind, tuple):
        if value is not None:
            require(value, kind[0], place)
    elif isinstance(kind, dict):
        assert isinstance(value, dict), place
        assert set(value) - set(OPTIONAL) == set(kind), place
        for key, of_key in kind.items():
            require(value[key], of_key, f"{place}.{key}")
    elif isinstance(kind, list):
        assert isinstance(value, list), place
        for i, entry in enumerate(value):
            require(entry, kind[0], f"{place}[{i}]")
    else:
        assert type(value) is kind, f"{place}: {value!r}"


def require_words(summary):
    """Assert what the words and numbers of a summary may be, beyond their types."""
    assert summary["schema"] == 2
    assert summary["version"] == lfo.__version__
    assert summary.get("status", "optimal") in ("optimal", "locally_optimal", "extremal", *ERRORS)
    if "method" in summary:
        assert summary["method"] in ("spectral", "structured", "convex")
        assert (summary["backend"] is None) == (summary["method"] != "convex")
    assert summary["bound"] in ("rigorous", "numerical", None)
    assert (summary["lower_bound"] is None) == (summary["gap"] is None)
    assert (summary["bound"] is None) == (summary["lower_bound"] is None and summary.get("status") != "infeasible")
    if summary["gap"] is not None:
        cost = summary["cost"]
        assert summary["gap"] * abs(cost) == pytest.approx(cost - summary["lower_bound"], abs=1e-12 * abs(cost))
    certificate = summary["certificate"]
    if certificate is not None:
        assert certificate["pmp"] in ("satisfied", "violated", "not_applicable")
        for condition in certificate["conditions"]:
            assert condition["label"] in "C-i C-ii C-iii C-iv C-v C-vi C-vii N-r S-x S-u N-x N-u".split()


UNCLOCKED = """
schema = 1
horizon = 6
initial_state = [1.0]
[dynamics]
A = [[1.0]]
B = [[1.0]]
[cost]
R = 1.0
P = 1.0
"""
