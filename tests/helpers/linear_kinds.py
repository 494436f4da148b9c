"""Small feasible problems with linear dynamics, one for each kind of set, row, cost and frequency constraint."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import lin_freq_ocp as lfo

T = 9
A, B = np.array([[1.0, 0.3], [-0.2, 0.9]]), np.array([[0.05, 0.1], [0.3, -0.2]])
PLANT = lfo.LinearDynamics(A, B, [0.01, -0.02], sampling_time=0.1)
WAVE = np.sin(1.3 * np.arange(T + 1))
VARYING = lfo.LinearDynamics(
    A * (1 + 0.2 * WAVE[:-1, None, None]), B * (1 - 0.3 * WAVE[1:, None, None]), 0.02 * np.outer(WAVE[:-1], [1, -1])
)
COST = lfo.QuadraticCost(Q=np.diag([1.0, 0.2]), R=np.diag([0.1, 0.3]), P=[[2.0, 0.5], [0.5, 1.0]])
REFERENCES = lfo.QuadraticCost(
    Q=0.5,
    R=0.1,
    P=1.0,
    S=[[0.05, 0], [0.02, -0.03]],
    q=[0.1, -0.2],
    r=[0.05, 0.02],
    x_ref=np.outer(WAVE, [1.0, -0.4]),
    u_ref=np.outer(WAVE[:-1], [0.3, 0.2]),
)
HALF = [0.3, 0.2]
PAST = 0.1 * np.column_stack([WAVE, -WAVE])[:6]


def _problem(**fields: object) -> lfo.OptimalControlProblem:
    given = {"dynamics": PLANT, "horizon": T, "cost": COST, "initial_state": [1.0, -0.5]} | fields
    return lfo.OptimalControlProblem(**given)


def _partial(x: float) -> lfo.Box:
    return lfo.Box([x, -np.inf], [x, np.inf])


KINDS: dict[str, Callable[[], lfo.OptimalControlProblem]] = {
    "no constraint": lambda: _problem(),
    "boxes": lambda: _problem(control_set=lfo.Box(-0.8, [0.7, 0.5]), state_set=lfo.Box([-0.3, -1], [1.2, None])),
    "fixed ends": lambda: _problem(terminal_state=[0.2, 0.1]),
    "partly fixed ends": lambda: _problem(initial_state=_partial(1.0), terminal_state=_partial(0.4)),
    "end boxes": lambda: _problem(initial_state=lfo.Box(0.5, 1.0), terminal_state=lfo.Box(-0.1, -0.05)),
    "free ends": lambda: _problem(initial_state=None, cost=REFERENCES),
    "end sets": lambda: _problem(
        initial_state=lfo.sets.Ball(0.1, [1.0, -0.5]), terminal_state=lfo.sets.Polyhedron([[1.0, 1.0]], [-0.2])
    ),
    "fixed controls": lambda: _problem(
        control_set=[lfo.Box(*([[0.1, -1], [0.1, 1]] if t % 4 == 1 else [-1, 1])) for t in range(T)]
    ),
    "coasting": lambda: _problem(
        control_set=[lfo.Box(0.1, 0.1) if t % 3 else lfo.Box(-0.4, [0.3, 0.5]) for t in range(T)],
        stage_rows=[
            lfo.StageRows([[1.0, 0.5]], [[0.2, 1.0]], [0.6]),
            lfo.StageRows(None, [[1.0, 1.0], [-2.0, 1.0]], [0.2, 0.4], name="controls"),
        ],
        cost=REFERENCES + lfo.costs.L1Cost(u=0.2),
        dynamics=VARYING,
    ),
    "coasting with a band": lambda: _problem(
        control_set=[lfo.Box([0.1, -1.0], [0.1, 1.0]) if t % 3 else lfo.Box(-1.0, 1.0) for t in range(T)],
        control_spectrum=lfo.stop_band(bins=[2], component=0),
    ),
    "rows": lambda: _problem(stage_rows=lfo.StageRows([[1.0, 0.5]], [[0.2, 1.0]], [0.6])),
    "rows at some times": lambda: _problem(
        stage_rows=lfo.StageRows([[1.0, 0.5]], None, np.where(np.arange(T) < 5, np.inf, 0.1)[:, None])
    ),
    "soft rows": lambda: _problem(stage_rows=lfo.StageRows([[1.0, 0.5], [-1.0, 2.0]], None, [0.3, 0.1], penalty=0.3)),
    "L1 cost": lambda: _problem(cost=COST + lfo.costs.L1Cost(x=[0.1, 0.0], u=0.2, terminal=1.0)),
    "LInf cost": lambda: _problem(cost=REFERENCES + lfo.costs.LInfCost(x=0.3, u=0.4, terminal=[1.0, 2.0])),
    "control ball": lambda: _problem(control_set=lfo.sets.Ball(0.4, [0.1, 0.0])),
    "soft ball": lambda: _problem(state_set=lfo.sets.Soft(lfo.sets.Ball(0.2), 0.3)),
    "polyhedron": lambda: _problem(control_set=lfo.sets.Polyhedron([[1, 1], [-1, 2], [0, -1]], [0.4, 0.5, 0.6])),
    "cone": lambda: _problem(state_set=lfo.sets.SecondOrderCone(np.eye(2), np.zeros(2), [0.2, -0.5], 1.0)),
    "sets per time": lambda: _problem(
        control_set=[lfo.sets.Ball(0.3 + 0.1 * t) if t % 2 else lfo.Box(-0.4, 0.3 + 0.1 * t) for t in range(T)]
    ),
    "soft end": lambda: _problem(terminal_state=lfo.sets.Soft(lfo.Box(HALF, HALF), 0.7)),
    "control band": lambda: _problem(
        control_spectrum=[lfo.stop_band(bins=[3, 4], component=0), lfo.stop_band(bins=[0], component=1)]
    ),
    "state band": lambda: _problem(state_spectrum=lfo.stop_band(bins=[2, 5], component=1), cost=REFERENCES),
    "mask": lambda: _problem(control_spectrum=lfo.MagnitudeBound(0.5, bins=[0, 2, 3]), cost=REFERENCES),
    "soft mask": lambda: _problem(control_spectrum=lfo.MagnitudeBound([0.3, 0.2], bins=[1, 3], penalty=0.2)),
    "window": lambda: _problem(state_spectrum=lfo.MagnitudeBound(0.3, bins=[1, 3], component=0, window="hann")),
    "fine mask": lambda: _problem(
        control_spectrum=lfo.MagnitudeBound(0.5, bins=[2, 3, 4], oversampling=3), dynamics=VARYING
    ),
    "zero mask": lambda: _problem(control_spectrum=lfo.MagnitudeBound([0.0, 0.2], bins=[0, 2], component=1)),
    "spectrogram": lambda: _problem(
        control_spectrum=lfo.spectrum.Spectrogram(lfo.MagnitudeBound(0.3, bins=[1, 2], component=0), 4, 1, PAST)
    ),
    "past and future": lambda: _problem(
        control_spectrum=[
            lfo.spectrum.Spectrogram(lfo.MagnitudeBound(0.6, bins=[2, 3], component=1), past=PAST),
            lfo.spectrum.Spectrogram(lfo.spectrum.EnergyBound(0.3, bins=[1, 2], component=0, window="hann"), past=PAST),
        ]
    ),
    "soft spectrogram": lambda: _problem(
        state_spectrum=lfo.spectrum.Spectrogram(
            lfo.spectrum.EnergyBound(0.05, bins=[1], component=0, penalty=0.4), 5, past=PAST
        )
    ),
    "output mask": lambda: _problem(
        output_spectrum=lfo.spectrum.OutputSpectrum([[1.0, 0.5]], [[0.3, 0.0]], lfo.MagnitudeBound(0.5, bins=[0, 1]))
    ),
    "output band": lambda: _problem(
        output_spectrum=lfo.spectrum.OutputSpectrum([[1.0, 0.5]], None, lfo.stop_band(bins=[2, 5]))
    ),
    "energy": lambda: _problem(
        state_spectrum=lfo.spectrum.EnergyBound(0.8, bins=[0, 1, 5], component=0), cost=REFERENCES
    ),
    "soft energy": lambda: _problem(control_spectrum=lfo.spectrum.EnergyBound(0.1, bins=[1, 2], penalty=0.4)),
    "linear constraint": lambda: _problem(
        control_spectrum=lfo.spectrum.LinearConstraint(WAVE[:-1, None, None] * [[1.0, 0.2]], [0.3]), cost=REFERENCES
    ),
    "soft linear constraint": lambda: _problem(
        state_spectrum=lfo.spectrum.LinearConstraint(WAVE[:, None, None] * np.eye(2), [0.3, -0.9], penalty=0.4)
    ),
    "soft linear row": lambda: _problem(
        control_spectrum=lfo.spectrum.LinearConstraint(WAVE[:-1, None, None] * [[1.0, 0.2]], [0.6], penalty=0.05),
        cost=REFERENCES,
    ),
    "two soft spectra": lambda: _problem(
        control_spectrum=[
            lfo.MagnitudeBound(0.2, bins=[0, 1, 2, 3, 4], component=0, penalty=0.1, oversampling=2),
            lfo.spectrum.EnergyBound(0.05, bins=[1, 2], component=1, penalty=0.1),
        ],
        control_set=lfo.sets.Soft(lfo.Box(-0.2, 0.2), 0.5),
    ),
    "time-varying": lambda: _problem(dynamics=VARYING, cost=REFERENCES, control_set=lfo.Box(-0.5, 0.5)),
}


def infeasible(kind: str) -> lfo.OptimalControlProblem:
    """Return a problem whose constraints of one kind contradict its ends."""
    fields: dict[str, dict[str, object]] = {
        "boxes": {"control_set": lfo.Box(-0.01, 0.01), "terminal_state": [3.0, 0.0]},
        "cones": {"control_set": lfo.sets.Ball(0.01), "terminal_state": [3.0, 0.0]},
        "bands": {
            "control_spectrum": lfo.stop_band(bins=[0, 1, 2, 3]),
            "control_set": lfo.Box(-0.5, 0.5),
            "terminal_state": [3.0, 0.0],
        },
        "masks": {"control_spectrum": lfo.MagnitudeBound(0.01, bins=[0, 1, 2, 3, 4]), "terminal_state": [3.0, 0.0]},
        "fixed controls": {"control_set": lfo.Box(0.1, 0.1), "terminal_state": [3.0, 0.0]},
        "rows of fixed controls": {
            "control_set": lfo.Box(0.1, 0.1),
            "stage_rows": lfo.StageRows(None, [[1.0, 1.0]], [0.15]),
        },
        "rows": {"stage_rows": lfo.StageRows([[1.0, 0.0], [-1.0, 0.0]], None, [-1.5, 2.0])},
    }
    return _problem(**fields[kind])
