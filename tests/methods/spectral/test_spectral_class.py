"""The whole class of the Fourier-domain method against the sparse program: same cost, certified, residuals of rounding.

Every case names the data that make it special; without them the optimal cost is another one, so that a method that
overlooks them cannot pass.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from helpers.spectral_plants import (
    CONTROL_BOX,
    END,
    LARGE_BOX,
    START,
    STATE_BOX,
    TIGHT,
    T,
    certificate_of_claim,
    moving,
    plant,
    problem_of,
    residuals,
    tube,
    wave,
)


def assert_optimal(problem: lfo.OptimalControlProblem) -> lfo.results.Result:
    """Solve by both methods and compare; return the Fourier-domain method's result."""
    result = lfo.solve(problem, method="spectral")
    reference = lfo.solve(problem, method="convex", tolerance=1e-11)
    assert result.method == "spectral"
    assert result.cost == pytest.approx(reference.cost, rel=1e-8, abs=1e-8)
    assert result.certificate.pmp == "satisfied", result.certificate.failed
    assert -1e-9 < result.gap < 1e-6
    for what, residual in residuals(problem, result.trajectory).items():
        assert residual < 1e-11, what
    assert certificate_of_claim(problem).globally_optimal
    return result


ROTATION = np.cos(2 * np.pi * 3 / T), np.sin(2 * np.pi * 3 / T)
UNDAMPED = np.array([[ROTATION[0], ROTATION[1], 0.0], [-ROTATION[1], ROTATION[0], 0.1], [0.0, 0.0, 0.7]])
NEARLY = np.cos(2 * np.pi * 3 / T + 1e-7), np.sin(2 * np.pi * 3 / T + 1e-7)
NEARLY_UNDAMPED = np.array([[NEARLY[0], NEARLY[1], 0.0], [-NEARLY[1], NEARLY[0], 0.1], [0.0, 0.0, 0.7]])
ONE_EACH = np.array([[1.0, 0.0], [0.3, 0.0], [0.0, 0.6]])
CHAIN = np.array([[1.0, 0.2, 0.02], [0.0, 1.0, 0.2], [0.0, 0.0, 1.0]])
ONE_INPUT = np.array([[0.1], [0.3], [0.5]])
CHAINED = {
    "dynamics": plant(CHAIN, ONE_INPUT),
    "cost": lfo.QuadraticCost(R=1.0),
    "control_spectrum": lfo.stop_band(bins=[6, 7, 8]),
    "control_set": None,
}
UNSTABLE = np.array([[1.3, 0.2, 0.0], [0.0, 0.8, 0.1], [0.1, 0.0, 1.05]])

CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {  # name: changes, and what takes their point away
    "control bounds": ({"control_set": TIGHT}, {"control_set": None}),
    "state bounds": ({"state_set": STATE_BOX}, {"state_set": None}),
    "bounds per time": (
        {"control_set": moving(T, 2, 0.45, 1), "state_set": tube(LARGE_BOX, T + 1)},
        {"control_set": lfo.Box(-0.45, 0.45)},
    ),
    "state values fixed inside": (
        {"state_set": tube(LARGE_BOX, T + 1, t10_1=0.3, t11_0=0.0, t17_2=-0.1)},
        {"state_set": LARGE_BOX},
    ),
    "control values fixed inside": (
        {"control_set": tube(CONTROL_BOX, T, t0_0=0.1, t7_1=0.2, t8_1=0.2, t23_0=0.0)},
        {"control_set": CONTROL_BOX},
    ),
    "a control that is fixed at all times": (
        {"control_set": lfo.Box([-0.7, 0.0], [0.6, 0.0]), "terminal_state": None},
        {"control_set": CONTROL_BOX},
    ),
    "joint rows": (
        {"stage_rows": lfo.StageRows([[1.0, 0, 0.5], [0, -1.0, 0]], [[1.0, 0], [0, 1.0]], [1.0, 0.62])},
        {"stage_rows": None},
    ),
    "joint rows with limits per time, and a second family": (
        {
            "stage_rows": [
                lfo.StageRows([[1.0, 0, 0.5]], [[1.0, -1.0]], 1.2 + 0.2 * np.cos(np.arange(T))[:, None], name="first"),
                lfo.StageRows(None, [[1.0, 1.0]], [0.15], name="second"),
                lfo.StageRows([[1.0, 1.0, 0.0]], None, [0.55], name="third"),
            ],
            "control_set": None,
        },
        {"stage_rows": None},
    ),
    "no band": ({"control_spectrum": None}, {"control_spectrum": lfo.stop_band(bins=range(5, 13))}),
    "DC stopped": (
        {"control_spectrum": [lfo.stop_band(bins=[0], component=0), lfo.stop_band(bins=[9, 12], component=1)]},
        {"control_spectrum": None},
    ),
    "a control that is stopped in every bin but one": (
        {"control_spectrum": lfo.stop_band(bins=[k for k in range(13) if k != 2], component=1)},
        {"control_spectrum": None},
    ),
    "free end": ({"terminal_state": None}, {"terminal_state": END}),
    "free end with a cost": (
        {"terminal_state": None, "cost": lfo.QuadraticCost(R=1.0, P=np.diag([3.0, 0.0, 1.0]), p=[0.2, 0.5, 0.0])},
        {"cost": lfo.QuadraticCost(R=1.0)},
    ),
    "free start": ({"initial_state": None}, {"initial_state": START}),
    "both ends free": (
        {"initial_state": None, "terminal_state": None, "cost": lfo.QuadraticCost(Q=0.3, R=1.0, q=wave(T, 3, 0.3))},
        {"initial_state": START},
    ),
    "ends in boxes": (
        {
            "initial_state": lfo.Box(START - 0.1, START + 0.2),
            "terminal_state": lfo.Box(END - 0.05, END + np.array([0.1, 0, np.inf])),
        },
        {"initial_state": START},
    ),
    "ends partly fixed": (
        {
            "initial_state": lfo.Box([1.0, -np.inf, 0.1], [1.0, np.inf, 0.4]),
            "terminal_state": lfo.Box([-np.inf, 0.6, 0.1], [np.inf, 0.6, np.inf]),
        },
        {"initial_state": START},
    ),
    "a boxed start that the state bounds cut further": (
        {
            "initial_state": lfo.Box(START - 0.3, START + 0.3),
            "state_set": lfo.Box([-1.1, -0.53, -0.25], [0.85, 0.65, 0.42]),
        },
        {"state_set": None},
    ),
    "references per time": (
        {"cost": lfo.QuadraticCost(Q=1.0, R=0.5, P=2.0, x_ref=wave(T + 1, 3, 0.4, 2), u_ref=wave(T, 2, 0.4, 3))},
        {"cost": lfo.QuadraticCost(Q=1.0, R=0.5, P=2.0)},
    ),
    "linear terms per time": (
        {"cost": lfo.QuadraticCost(Q=1.0, R=0.5, q=wave(T, 3, 0.4, 2), r=wave(T, 2, 0.4, 3), p=[1.0, 2.0, 3.0])},
        {"cost": lfo.QuadraticCost(Q=1.0, R=0.5)},
    ),
    "mixed term": (
        {
            "cost": lfo.QuadraticCost(
                Q=1.0, R=1.0, S=[[0.3, -0.4], [0.5, 0.0], [0.1, 0.2]], x_ref=[0.2, 0, 0], u_ref=[0, 0.1]
            )
        },
        {"cost": lfo.QuadraticCost(Q=1.0, R=1.0, x_ref=[0.2, 0, 0], u_ref=[0, 0.1])},
    ),
    "coupled controls": (
        {"cost": lfo.QuadraticCost(R=[[2.0, 0.9], [0.9, 1.0]]), "control_set": TIGHT},
        {"cost": lfo.QuadraticCost(R=[[2.0, 0.0], [0.0, 1.0]])},
    ),
    "offset": ({"dynamics": plant(offset=[0.05, -0.1, 0.0])}, {"dynamics": plant()}),
    "offset per time": ({"dynamics": plant(offset=wave(T, 3, 0.05, 4))}, {"dynamics": plant()}),
    "no cost of the controls": (
        {"cost": lfo.QuadraticCost(Q=np.diag([1.0, 2.0, 3.0])), "control_spectrum": lfo.stop_band(bins=[9, 10])},
        {"cost": lfo.QuadraticCost(Q=np.diag([1.0, 2.0, 3.0]), R=0.1)},
    ),
    "state bands": (
        {"state_spectrum": [lfo.stop_band(bins=[3], component=0), lfo.stop_band(bins=[8, 9], component=2)]},
        {"state_spectrum": None},
    ),
    "state bands, free ends": (
        {
            "state_spectrum": [lfo.stop_band(bins=[0], component=0), lfo.stop_band(bins=[8, 12], component=1)],
            "initial_state": None,
            "terminal_state": lfo.Box(END - 0.3, END + 0.3),
            "cost": lfo.QuadraticCost(Q=0.3, R=1.0, P=1.0, x_ref=wave(T + 1, 3, 0.5, 5)),
        },
        {"state_spectrum": None},
    ),
    "undamped mode on a bin": ({"dynamics": plant(UNDAMPED)}, {"dynamics": plant()}),
    "undamped mode on a stopped bin": (
        {
            "dynamics": plant(UNDAMPED),
            "control_spectrum": lfo.stop_band(bins=[3]),
            "terminal_state": lfo.Box([-np.inf, -np.inf, 0.2], [np.inf, np.inf, 0.2]),
        },
        {"control_spectrum": None},
    ),
    "undamped mode almost on a stopped bin": (
        {
            "dynamics": plant(NEARLY_UNDAMPED),
            "control_spectrum": lfo.stop_band(bins=[3]),
            "terminal_state": lfo.Box([-np.inf, -np.inf, 0.2], [np.inf, np.inf, 0.2]),
        },
        {"control_spectrum": None},
    ),
    "undamped mode whose only control is stopped": (
        {
            "dynamics": plant(UNDAMPED, ONE_EACH),
            "control_spectrum": lfo.stop_band(bins=[3], component=0),
            "terminal_state": None,
            "cost": lfo.QuadraticCost(Q=np.array([[1.0, 0, 0.8], [0, 1.0, 0], [0.8, 0, 1.0]]), R=1.0),
        },
        {"control_spectrum": None},
    ),
    "undamped mode on a bin, cost of the controls only": (
        {"dynamics": plant(UNDAMPED), "cost": lfo.QuadraticCost(R=1.0, P=1.0), "terminal_state": None},
        {"terminal_state": START},
    ),
    "integrator chain": (CHAINED | {"control_set": lfo.Box(-0.27, 0.27)}, {"control_set": None}),
    "integrator chain, DC stopped": (
        CHAINED
        | {"control_spectrum": lfo.stop_band(bins=[0, 7]), "terminal_state": lfo.Box([0.0, 0.1, 0.3], [0.2, 0.1, 0.3])},
        {"control_spectrum": None},
    ),
    "unstable": ({"dynamics": plant(UNSTABLE), "control_set": None}, {"dynamics": plant()}),
    "slow": ({"dynamics": plant(np.diag([1 - 1e-8, 0.99, 0.7]))}, {"dynamics": plant()}),
    "dead beat": (
        {"dynamics": plant([[0.0, 1.0, 0], [0, 0, 1.0], [0, 0, 0]]), "control_set": None},
        {"dynamics": plant()},
    ),
    "odd horizon": ({"horizon": 25, "state_set": STATE_BOX}, {"control_spectrum": None}),
    "even horizon with Nyquist stopped": (
        {"control_spectrum": lfo.stop_band(bins=[11, 12])},
        {"control_spectrum": None},
    ),
}


@pytest.mark.parametrize("name", seeds(CASES))
def test_the_optimum_is_that_of_the_sparse_program(name):
    changes, without = CASES[name]
    result = assert_optimal(problem_of(**changes))
    plain = lfo.solve(problem_of(**(changes | without)), method="convex", throw=False)
    assert plain.cost is None or abs(plain.cost - result.cost) > 1e-4 * max(1.0, abs(result.cost))


@pytest.mark.parametrize("horizon", seeds([50, 150, 200, 400]))
@pytest.mark.parametrize("start", [None, lfo.Box(-0.6, -0.4)], ids=["free", "boxed"])
def test_a_start_that_the_end_has_forgotten(start, horizon):
    """The cost falls by 0.86^T along it, or not at all: to rounding, any start will do."""
    reference = wave(horizon, 1, 0.1)
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.86]], [[1.0]]),
        horizon,
        lfo.QuadraticCost(R=1.0, u_ref=reference),
        control_set=lfo.Box(-0.2, 0.2),
        initial_state=start,
        terminal_state=[0.5],
    )
    result = lfo.solve(problem, method="spectral")
    assert result.certificate.pmp == "satisfied"
    assert abs(result.gap) < 1e-8


SHORT_ENDS = {
    "fixed, free": {"initial_state": [1.0]},
    "fixed, fixed": {"initial_state": [1.0], "terminal_state": [0.3]},
    "free, free": {"state_set": lfo.Box(-0.5, 0.5)},
    "boxed, fixed": {"initial_state": lfo.Box(0.5, 2.0), "terminal_state": [0.3]},
}


@pytest.mark.parametrize("ends", seeds(SHORT_ENDS))
@pytest.mark.parametrize("horizon", [1, 2, 3, 4])
def test_the_shortest_horizons(horizon, ends):
    middle, constant = lfo.stop_band(bins=[horizon // 2]), lfo.stop_band(bins=[0])
    for a, band in ((1.0, None), (0.8, None), (0.8, constant), (1.0, middle)):
        if horizon > 1 or band is None:
            assert_optimal(
                lfo.OptimalControlProblem(
                    lfo.LinearDynamics([[a]], [[1.0]]),
                    horizon,
                    lfo.QuadraticCost(Q=1.0, R=0.5, P=2.0, x_ref=[0.8]),
                    control_spectrum=band,
                    **SHORT_ENDS[ends],
                )
            )
