"""Every method with every kind of dynamics that it takes: a problem with an answer, and one without."""

from __future__ import annotations

import numpy as np

import lin_freq_ocp as lfo
from helpers.own_kinds import Bilinear, DelayedInput, FromRest
from lin_freq_ocp.problem import Dynamics
from lin_freq_ocp.solving import FAMILIES, Family, Shorthand

Problem = lfo.OptimalControlProblem
A, B = [[1.0, 0.2], [0.0, 0.9]], [[0.0], [0.2]]
LAG = 1.0 / (1.2 - np.exp(-2j * np.pi * np.arange(9) / 16)).real
SMOOTH = lfo.PiecewiseSmoothDynamics.from_formulas(["0.9*x_0 + sin(u_0)"], 1, 1)


def problem(dynamics: Dynamics, horizon: int, start: list[float] | None, **fields: object) -> Problem:
    """Return the tracking of 0.3 by all states within bounds on the control."""
    cost = lfo.QuadraticCost(Q=1.0, R=0.5, x_ref=[0.3] * dynamics.state_dim)
    return Problem(dynamics, horizon, cost, lfo.Box(-1, 1), initial_state=start, **fields)


OWN_FAMILY = Family("bilinear", {"auto": Shorthand(FromRest()), "from_rest": Shorthand(FromRest())})
"""The methods for the dynamics of a user, which a test registers."""

FAR = {"terminal_state": lfo.Box(50.0, 60.0)}
BAND = {"control_spectrum": lfo.stop_band(bins=[3])}
PROBLEMS: dict[str, tuple[Problem, dict[str, object]]] = {  # and the change that leaves no answer
    "linear": (problem(lfo.LinearDynamics(A, B), 8, [1.0, -0.5], **BAND), FAR),
    "linear, of a user": (problem(DelayedInput(A, B, 0.1), 8, [1.0, -0.5, 0.0], **BAND), FAR),
    "frequency-response": (problem(lfo.FrequencyResponse(LAG + 0j), 16, None), {"state_set": lfo.Box(50.0, 60.0)}),
    "piecewise-affine": (lfo.library.absolute_value(), FAR),
    "piecewise-smooth": (problem(SMOOTH, 3, [1.0]), FAR),
    "pulse-train": (lfo.library.pulse_pattern(kind="opp"), {}),  # it has an answer with enough switches
    "bilinear": (problem(Bilinear(A, [[0.0, 0.1], [-0.1, 0.0]], [0.0, 0.2]), 8, [1.0, -0.5]), FAR),
}
TOO_LONG = {("pulse-train", "nonsmooth")}  # it takes seconds, and finds no answer
FAMILY_OF = {family.kind: family for family in (*FAMILIES.values(), OWN_FAMILY)}
METHODS = [
    (kind, method)
    for kind in PROBLEMS
    for method in FAMILY_OF[kind.split(",")[0]].shorthands
    if (kind, method) not in TOO_LONG
]
