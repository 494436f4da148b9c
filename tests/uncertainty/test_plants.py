"""Several plants under one control: every limit on each of them, in one ordinary problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import lin_freq_ocp as lfo

T = 40
ENDS = lfo.Box([0.999, -0.005, -0.002, -0.01], [1.001, 0.005, 0.002, 0.01])
NAMES = ["position [m]", "speed [m/s]", "deflection [m]", "rate [m/s]"]


def arm(frequency: float, step: float = 0.1) -> lfo.LinearDynamics:
    """Return a cart that carries a mode of some frequency in Hz."""
    w = 2 * np.pi * frequency
    A = np.array([[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, -(w**2), -0.04 * w]])
    M = expm(np.block([[A, np.array([[0], [1], [0], [-1.0]])], [np.zeros((1, 5))]]) * step)
    return lfo.LinearDynamics(M[:4, :4], M[:4, 4:], sampling_time=step, state_names=NAMES)


SOFT_WINDOWS = lfo.spectrum.Spectrogram(lfo.MagnitudeBound(0.1, bins=[2], penalty=1.0), length=8)
ARMS = [arm(frequency) for frequency in (0.8, 1.0, 1.25)]


def move(**changes) -> lfo.OptimalControlProblem:
    fields = {"terminal_state": ENDS, "initial_state": np.zeros(4)}
    box, bend = lfo.Box(-2, 2), lfo.Box([None, None, -0.02, None], [None, None, 0.02, None])
    return lfo.OptimalControlProblem(ARMS[1], T, lfo.QuadraticCost(R=1.0), box, bend, **(fields | changes))


def test_one_force_moves_three_arms_within_all_limits():
    problem, plants = move(), lfo.Plants(ARMS)
    nominal, found = lfo.solve(problem), lfo.solve(lfo.robust(problem, plants))
    assert found.status == "optimal"
    assert found.problem.state_names[5] == "speed of plant 2 [m/s]"
    for k, plant in enumerate(ARMS):
        x = lfo.simulate(replace(problem, dynamics=plant), found.trajectory.u).x
        np.testing.assert_allclose(x, found.trajectory.x[:, 4 * k : 4 * k + 4], atol=1e-9)
        assert max((np.abs(x[1:, 2]) - 0.02).max(), ENDS.violation(x[-1]).max()) < 1e-7
    worst = lfo.worst_case(problem, plants, found)
    assert worst
    assert {one.plant for one in worst.limits} <= {1, 2, 3}
    broken = lfo.worst_case(problem, plants, nominal)
    assert not broken
    one = broken.closest
    x = lfo.simulate(replace(problem, dynamics=ARMS[one.plant - 1]), nominal.trajectory.u).x
    assert one.attained in x[one.index]
    assert one.sign * one.attained == pytest.approx(one.sign * one.planned + one.margin)


def test_the_cost_is_the_mean_by_shares_and_rows_and_spectra_are_those_of_each_plant():
    rows = lfo.StageRows([[0.0, 1.0, 0.0, 0.0]], [[0.1]], [0.5], name="ramp")
    problem = replace(
        move(stage_rows=rows, terminal_state=None),
        cost=lfo.QuadraticCost(Q=np.diag([1.0, 0.1, 0.0, 0.0]), R=1.0, x_ref=[1.0, 0, 0, 0]),
        state_spectrum=lfo.MagnitudeBound(0.05, band=lfo.low_pass(cutoff_hz=1.5), component="deflection"),
        output_spectrum=lfo.spectrum.OutputSpectrum([[0, 1.0, 0, 0]], constraints=lfo.MagnitudeBound(0.5, bins=[12])),
    )
    shares = [1.0, 2.0, 1.0]
    plants = lfo.Plants(ARMS, shares)
    found = lfo.solve(lfo.robust(problem, plants))
    u, costs = found.trajectory.u, []
    for plant in ARMS:
        own = replace(problem, dynamics=plant)
        one = lfo.simulate(own, u)
        costs.append(own.value(one.x, one.u))
        assert all(term.violation(one.x, one.u).max() < 1e-6 for term in own.terms)
    assert found.cost == pytest.approx(np.average(costs, weights=shares), rel=1e-9)
    worst = lfo.worst_case(problem, plants, found)
    assert worst
    assert {"ramp", "mask on deflection [m]"} <= {one.name for one in worst.limits}


def test_measured_plants_share_one_force():
    rng, N = np.random.default_rng(0), 64
    k = np.arange(N // 2 + 1)
    responses = [lfo.FrequencyResponse(1 / (1 + 1j * s * k * (k < N // 2) / 8), offset=None) for s in (0.8, 1.0, 1.3)]
    wave = np.fft.rfft(np.sin(2 * np.pi * 3 * np.arange(N) / N) + 0.1 * rng.standard_normal(N))
    responses = [lfo.FrequencyResponse(one.G, offset=wave) for one in responses]
    cost = lfo.QuadraticCost(Q=1.0, R=0.1)
    problem = lfo.OptimalControlProblem(responses[1], N, cost, lfo.Box(-1, 1), lfo.Box(-1.2, 1.2))
    plants = lfo.Plants(responses)
    found = lfo.solve(lfo.robust(problem, plants))
    assert found.status == "optimal"
    assert lfo.worst_case(problem, plants, found)
    x = np.column_stack([lfo.simulate(replace(problem, dynamics=one), found.trajectory.u).x for one in responses])
    np.testing.assert_allclose(found.trajectory.x, x, atol=1e-9)


def test_sets_of_every_plant_and_periodic_ends():
    ball = lfo.sets.Ellipsoid(np.diag([0.0, 1.0, 1.0, 0.0])[[1, 2]], 0.9)
    problem = replace(
        move(),
        terminal_state=lfo.Periodic(),
        initial_state=lfo.sets.Everything(),
        state_set=ball,
        cost=lfo.QuadraticCost(
            Q=np.diag([1.0, 0, 0, 0]), R=0.1, x_ref=np.outer(np.sin(2 * np.pi * np.arange(T + 1) / T), [1, 0, 0, 0])
        ),
    )
    found = lfo.solve(lfo.robust(problem, lfo.Plants(ARMS[:2])))
    assert found.status == "optimal"
    x = found.trajectory.x
    np.testing.assert_allclose(x[-1], x[0], atol=1e-8)
    assert max(ball.violation(x[:, :4]).max(), ball.violation(x[:, 4:]).max()) < 1e-6


@pytest.mark.parametrize(
    ("plants", "message"),
    [
        (lambda: lfo.Plants([]), "plants: got .*; expected a list of at least one"),
        (
            lambda: lfo.Plants([ARMS[0], arm(1.0, 0.2)]),
            r"plants\[1\]: got 4 states, 1 controls, 0.2 s; expected 4 states",
        ),
        (lambda: lfo.Plants([lfo.LinearDynamics(np.eye(2), np.ones((2, 1)))]), r"plants\[0\]: got 2 states"),
        (
            lambda: lfo.Plants([lfo.library.pendulum_with_wall().dynamics]),
            r"plants\[0\]: got .*expected a LinearDynamics",
        ),
        (lambda: lfo.Plants(ARMS, [1.0, 2.0]), r"plants.shares: got .*; expected 3 weights"),
        (lambda: lfo.Plants(ARMS, [1.0, -2.0, 1.0]), r"plants.shares: got .*; expected 3 weights"),
    ],
)
def test_plants_that_do_not_fit_are_refused_with_their_number(plants, message):
    with pytest.raises(lfo.errors.ProblemError, match=message):
        lfo.robust(move(), plants())


def test_what_plants_do_not_take_is_unsupported():
    for changes, end in (
        ({"cost": lfo.QuadraticCost(R=1.0) + lfo.costs.L1Cost(u=0.1)}, None),
        ({"terminal_state": lfo.sets.LinkedEnds(np.eye(4), -2 * np.eye(4))}, None),
        ({"state_spectrum": SOFT_WINDOWS}, None),
        ({}, "invariant"),
    ):
        with pytest.raises(lfo.errors.UnsupportedError):
            lfo.robust(replace(move(), **changes), lfo.Plants(ARMS), end=end)


def test_a_plan_with_other_states_is_refused_with_the_shapes():
    problem = lfo.library.double_integrator(horizon=4, cutoff_hz=None, terminal_state=None)
    plan = lfo.Trajectory(np.zeros((5, 3)), np.zeros((4, 1)))
    message = r"trajectory: got x \(5, 3\), u \(4, 1\); expected x \(5, 2\), u \(4, 1\)"
    with pytest.raises(lfo.errors.ProblemError, match=message):
        lfo.worst_case(problem, lfo.Plants([problem.dynamics] * 2), plan)


@pytest.mark.parametrize("shares", [[1.0, 3.0], [1.0, 0.0]])
@pytest.mark.parametrize(
    "changes",
    [
        {"state_set": lfo.sets.Soft(lfo.Box(None, [None, 0.25, None, None]), 5.0)},
        {"state_set": lfo.Box(-5, 5) & lfo.sets.Soft(lfo.sets.Ball(0.5), 4.0)},
        {"stage_rows": lfo.StageRows([[1.0, 1.0, 0, 0]], [[0.0]], [0.3], name="sum", penalty=2.0)},
        {"state_spectrum": lfo.MagnitudeBound(0.02, bins=[2, 3], component=1, penalty=0.5)},
        {
            "output_spectrum": lfo.spectrum.OutputSpectrum(
                [[1.0, 0, 0, 0]], None, lfo.MagnitudeBound(2.0, bins=[1, 2], penalty=1.0)
            )
        },
    ],
    ids=["box", "ball", "rows", "mask", "mask of an output"],
)
def test_soft_limits_cost_the_mean_over_the_plants(changes, shares):
    free = replace(move(), state_set=None)
    problem = replace(free, **changes)
    found = lfo.solve(lfo.robust(problem, lfo.Plants(ARMS[:2], shares)))
    costs = []
    for plant in ARMS[:2]:
        own = replace(problem, dynamics=plant)
        one = lfo.simulate(own, found.trajectory.u)
        costs.append(own.value(one.x, one.u))
    assert found.status == "optimal"
    assert found.cost == pytest.approx(np.average(costs, weights=shares), rel=1e-7)
    assert found.cost > lfo.solve(lfo.robust(free, lfo.Plants(ARMS[:2], shares))).cost * (1 + 1e-6)
    worst = lfo.worst_case(problem, lfo.Plants(ARMS[:2], shares), found)
    assert worst
    assert worst.cost == pytest.approx(found.cost, rel=1e-7)
