"""Small problems with linear dynamics, at least one for each class of sets, rows, costs and frequency constraints."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo
from helpers.linear_kinds import COST, KINDS
from helpers.own_kinds import RoundedSimplex, SteadyGain, Variation, WorstThrust

LOW = lfo.low_pass(1.0)
EXTREMES = lfo.sets.Polyhedron([[1.0, 0.2], [-1.0, 0.1]], [1.5, 1.5])
FURTHER: dict[str, dict[str, object]] = {
    "mask at every frequency": {"control_spectrum": lfo.MagnitudeBound(0.9, band=LOW, every_frequency=True)},
    "soft one": {"state_spectrum": lfo.MagnitudeBound(0.9, band=LOW, component=1, every_frequency=True, penalty=0.1)},
    "residual vibration": {"control_spectrum": lfo.ResidualVibration((1.0, 1.5), (0.0, 0.1), 0.5)},
    "fine soft energy": {
        "state_spectrum": lfo.spectrum.EnergyBound(0.2, band=LOW, oversampling=4, window="hann", penalty=0.5)
    },
    "soft output": {
        "output_spectrum": lfo.spectrum.OutputSpectrum(
            [[1.0, 0.3]], None, lfo.MagnitudeBound(0.2, bins=[1], penalty=0.3)
        )
    },
    "equation of states": {"state_spectrum": lfo.spectrum.LinearConstraint(np.ones((10, 1, 2)), [-0.5])},
    "ellipsoid": {"control_set": lfo.sets.Ellipsoid([[1.0, 0.2], [0.0, 2.0]], 0.6)},
    "intersection": {"state_set": lfo.sets.Soft(EXTREMES, 0.2) & lfo.sets.Ball(1.3) & lfo.Box(-2.0, 2.0)},
    "everything": {"state_set": lfo.sets.Everything() & lfo.sets.Ball(1.2)},
    "duty cycles": {"control_set": lfo.FiniteSet([-1, 0, 1], [0.2, 0.0, 0.3], duty_cycles=True)},
    "periodic ends": {"initial_state": None, "terminal_state": lfo.Periodic() & lfo.Box(0.1, None)},
    "harmonics": {"control_spectrum": lfo.MagnitudeBound(amplitude=0.1, harmonics=[2, 3], fundamental_hz=1 / 0.9)},
    "mask of the held control": {
        "control_spectrum": lfo.MagnitudeBound(
            0.09, band=lfo.low_pass(cutoff_hz=2.0), every_frequency=True, hold=True, component=1
        )
    },
    "linked ends": {"initial_state": None, "terminal_state": lfo.sets.LinkedEnds(np.eye(2), np.eye(2), [0.1, 0.2])},
}
OF_A_USER: dict[str, dict[str, object]] = {
    "set of a user": {"control_set": RoundedSimplex(np.array([[1.5, 0.2], [0.0, 1.2]]), 0.5)},
    "set of a user on states": {"state_set": RoundedSimplex(0.9 * np.eye(2), 9.0), "initial_state": [1.0, 0.5]},
    "cost of a user": {"cost": COST + WorstThrust([1.0, 2.0], 0.05), "control_set": lfo.Box(-1, 2)},
    "variation of the controls": {"cost": COST + Variation(2), "control_set": lfo.Box(-0.5, 0.5)},
    "frequency constraint of a user": {
        "dynamics": lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.125], [0.5]]),
        "cost": lfo.QuadraticCost(Q=1.0, R=0.1),
        "control_spectrum": SteadyGain(0.5),
    },
}


def response_within_discs() -> lfo.OptimalControlProblem:
    """Return a mass on a spring that is known by its response at nine bins, up to a tenth."""
    k, T = np.arange(9), 16
    G = 1.0 / (1.0 - (k / 3.5) ** 2 + 0.4j * k)
    G[[0, -1]] = G[[0, -1]].real
    response = lfo.FrequencyResponse(G[:, None, None], 0.5)
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=np.sin(2 * np.pi * np.arange(T + 1) / T)[:, None])
    rows = lfo.StageRows([[1.0]], [[0.5]], [0.9], name="sum")
    bounds = lfo.Box(-0.7, 0.8)
    given = lfo.OptimalControlProblem(response, T, cost, lfo.Box(-1.0, 1.0), bounds, stage_rows=rows)
    masked = replace(given, state_spectrum=lfo.MagnitudeBound(5.0, bins=[1, 2], component=0))
    return replace(given, output_spectrum=lfo.robust(masked, lfo.Discs(0.1 * np.abs(G))).output_spectrum)


STATEMENTS: dict[str, Callable[[], lfo.OptimalControlProblem]] = KINDS | {
    name: lambda fields=fields: replace(KINDS["no constraint"](), **fields)
    for name, fields in (FURTHER | OF_A_USER).items()
}
STATEMENTS["response within discs"] = response_within_discs


def classes_within(described: object) -> Iterable[type]:
    """Yield the classes of an object and of all objects in its fields."""
    yield type(described)
    parts = described if isinstance(described, (list, tuple)) else getattr(described, "__dict__", {}).values()
    for part in parts:
        if not isinstance(part, (str, np.ndarray, float, int)):
            yield from classes_within(part)
