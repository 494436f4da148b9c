"""Known optima of the piecewise-affine problems, what is extremal, errors of pieces, and the ball's contacts."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.hybrid_equations import STEPS, random_points, single_step, successors
from helpers.seeds import expensive, seeds
from lin_freq_ocp import library
from lin_freq_ocp.methods import solve_convex

# --- known optima, by enumeration


def optimum(problem: lfo.OptimalControlProblem, prune: bool) -> float:
    """Return the least cost over all mode sequences; with ``prune`` those that begin infeasibly are left out."""
    modes, prefixes = range(len(problem.dynamics.modes)), [()]
    for t in range(1, problem.horizon):
        longer = [(*prefix, mode) for prefix in prefixes for mode in modes]
        prefixes = [prefix for prefix in longer if not prune or begins(problem, t, prefix)]
    costs = []
    for sequence in ((*prefix, mode) for prefix in prefixes for mode in modes):
        result = lfo.solve(problem.with_modes(np.array(sequence)), throw=False)
        assert result.status in ("optimal", "infeasible")
        if result.status == "optimal":
            assert result.certificate.globally_optimal
            costs.append(result.cost)
    return min(costs)


def begins(problem: lfo.OptimalControlProblem, horizon: int, prefix: tuple[int, ...]) -> bool:
    """Whether a trajectory can begin with these modes, whatever the frequency constraint says of the whole."""
    boxes = {
        field: lfo.Box(box.lower[0], box.upper[0])
        for field, box in (("control_set", problem.control_tube), ("state_set", problem.state_boxes))
    }
    short = replace(problem, horizon=horizon, cost=lfo.QuadraticCost(R=1.0), control_spectrum=None, **boxes)
    return solve_convex(short.with_modes(np.array(prefix)), "clarabel").status != "infeasible"


FROM_NEAR = {"initial_state": (1, 1), "terminal_cost": False, "horizon": 5}


@pytest.mark.parametrize(
    ("name", "parameters", "cost"),
    seeds(
        [
            ("switched_rotation", {}, 159.320358),
            ("switched_rotation", {"control_spectrum": "freq"}, 161.197114),
            ("switched_rotation", FROM_NEAR, 2.8371550),
            ("switched_rotation", FROM_NEAR | {"control_spectrum": [2]}, 3.0424267),
            ("pendulum_with_wall", {}, 34.990971),
            ("pendulum_with_wall", {"control_spectrum": "freq"}, 35.066890),
            ("buck_affine", {}, 32.681386),
        ]
    ),
)
def test_optima_are_the_known_ones(name, parameters, cost):
    problem = library.by_name(name)(**parameters)
    assert optimum(problem, prune=name != "buck_affine") == pytest.approx(cost, rel=1e-6)


@expensive
def test_the_cart_meets_the_wall_once_as_published():
    problem, published = library.cart_between_walls(), 3.104370011916  # with 1/2
    costs = [lfo.solve(problem.with_modes(np.eye(60, dtype=int)[impact])).cost for impact in range(14, 18)]
    assert np.argmin(costs) == 1
    assert costs[1] == pytest.approx(2 * published, rel=1e-8)
    result = lfo.solve(problem)
    assert result.certificate.globally_optimal
    assert result.cost == pytest.approx(2 * published, rel=1e-8)
    assert lfo.solve(problem.with_modes(np.zeros(60, dtype=int)), throw=False).status == "infeasible"


# --- the absolute value and the network: what is extremal


def replayed(problem: lfo.OptimalControlProblem, u: Any) -> float:
    trajectory = lfo.simulate(problem, np.reshape(u, (problem.horizon, 1)))
    return problem.value(trajectory.x, trajectory.u)


@pytest.mark.parametrize("horizon", [2, 5])
@pytest.mark.parametrize("preferred", [0.1, 0.3])
def test_two_mode_sequences_are_extremal_with_different_costs(horizon, preferred):
    problem = library.absolute_value(horizon, preferred)
    best = -horizon * (preferred + 0.25)
    for second, cost, first in ((0, best, preferred + 0.5), (1, best + 2 * preferred, preferred - 0.5)):
        sequence = np.zeros(horizon, dtype=int)
        sequence[1] = second
        result = lfo.solve(problem.with_modes(sequence))
        assert result.cost == pytest.approx(cost, rel=1e-8)
        np.testing.assert_allclose(result.control[:, 0], [first, *[preferred + 0.5] * (horizon - 1)], atol=1e-6)
        region = result.multipliers.stage["mode region"]
        assert np.abs(region[1:]).max() < 1e-6, "no border holds it: it is extremal for the whole map"
        assert np.abs(result.trajectory.x[1:]).min() > 0.1
        assert replayed(problem, result.control) == pytest.approx(cost, rel=1e-8)


def test_the_kink_between_the_two_extremals_is_a_local_maximum():
    problem, step = library.absolute_value(), 1e-3
    at_kink, either = replayed(problem, [0.0, 0.6]), [replayed(problem, [sign * step, 0.6]) for sign in (1, -1)]
    assert max(either) < at_kink
    eta = [-0.2, 1.0]  # eta_t = 2 (u_t - 0.1); joint Clarke: eta_0 lies between -eta_1 and eta_1
    assert eta == pytest.approx([2 * (0.0 - 0.1), 2 * (0.6 - 0.1)])
    assert abs(eta[0]) < eta[1]


def test_the_smallest_convex_kink():
    result = lfo.solve(library.absolute_value(1, preferred_control=0.0).with_modes(np.array([0])))
    assert result.cost == pytest.approx(-0.25)
    assert result.control[0, 0] == pytest.approx(0.5)
    assert result.multipliers.eta[0, 0] == pytest.approx(1.0)


def test_states_of_the_absolute_value_cannot_leave_their_default_bound():
    problem = library.absolute_value(7, initial_state=(-2.0,), control_bound=0.5)
    trajectory = lfo.simulate(problem, np.full((7, 1), 0.5))
    assert trajectory.x[-1, 0] == problem.state_boxes.upper[0, 0] == 5.5


def test_the_network_is_best_where_all_its_pieces_meet():
    problem = library.max_min_network()
    costs = [lfo.solve(problem.with_modes(np.array([0, mode]))).cost for mode in range(4)]
    assert costs == pytest.approx([0.0] * 4, abs=1e-8)
    grid = np.linspace(-1, 1, 41)
    values = [replayed(problem, [first, -first]) for first in grid]
    assert values == pytest.approx([u / 2 if u >= 0 else 2.5 * -u for u in grid], abs=1e-12)


def test_the_network_loads_its_state_first_only_if_asked():
    loaded = lfo.simulate(library.max_min_network(3), [[-0.3], [0.2], [0.1]], [0.7]).x[:, 0]
    network = STEPS["max_min_network"]
    np.testing.assert_allclose(loaded, [0.7, -0.3, network(-0.3, 0.2), network(network(-0.3, 0.2), 0.1)], atol=1e-15)
    at_once = lfo.simulate(library.max_min_network(1, load_first=False, control_spectrum=None), [[-0.3]], [0.7]).x[:, 0]
    np.testing.assert_allclose(at_once, [0.7, network(0.7, -0.3)], atol=1e-15)


# --- the buck converter in pieces


def true_buck(i: np.ndarray, v: np.ndarray) -> np.ndarray:
    a = np.exp(-0.5)
    border = (1 - v / 2) / a + v / 2
    return np.where(i <= border, a * i + (1 - a) / 2 * v, (a * v - 2 * a * i) / (v - 2))


def buck_error(pieces: int) -> float:
    """Return the largest error of the next current in A, as docs/hybrid_systems.md has it, between 2.2 and 6 V."""
    relative = np.tanh(np.log(4.0 / 0.2) / (4 * (pieces - 1))) if pieces > 1 else 4.0 / 0.35 - 1
    return (1 - np.exp(-0.5)) * relative


@pytest.mark.parametrize("pieces", [1, 2, 3, 4, 5, 9])
def test_pieces_of_the_buck_keep_their_error_bound_and_reach_it(pieces):
    problem, bound = library.buck_affine(pieces=pieces), buck_error(pieces)
    assert len(problem.dynamics.modes) == pieces + 1
    i, v = random_points(problem, 20_000)
    errors = np.abs(successors(problem, i, v)[:, 0] - true_buck(i[:, 0], v[:, 0]))
    assert errors.max() <= bound * (1 + 1e-12)
    assert errors.max() >= 0.9 * bound
    corners = np.array([2.2, 2.35, 6.0])[:, None]
    on_top = np.abs(successors(problem, np.ones_like(corners), corners)[:, 0] - true_buck(np.ones(3), corners[:, 0]))
    assert on_top[1] < 1e-12
    assert (on_top.max() < 1e-12) == (pieces > 1)


def test_the_error_is_attained_between_two_pieces():
    breaks, alpha = np.geomspace(0.2, 4.0, 5), (np.exp(0.5) - 1) / 2
    problem, bound = library.buck_affine(pieces=5), buck_error(5)
    for j, (one, other) in enumerate(pairwise(breaks)):
        s = np.sqrt(one * other)
        share = (other - s) / (other - one)
        excess = alpha * one * share if j % 2 == 0 else alpha * other * (1 - share)  # the first is above
        i, v = np.array([[excess + np.exp(0.5) - alpha * (s + 2)]]), np.array([[s + 2]])
        error = abs(successors(problem, i, v)[0, 0] - true_buck(i, v)[0, 0])
        assert error == pytest.approx(bound, rel=1e-9)


@pytest.mark.parametrize("pieces", [2, 3, 6])
def test_pieces_of_the_buck_are_continuous(pieces):
    borders = library.buck_affine(pieces=pieces).borders
    assert all(border.continuous for border in borders)
    assert len(borders) == (pieces + 1) // 2 + pieces - 1  # every second piece meets "on", and each the next


def test_stated_errors_of_the_buck():
    stated = {1: 4.1, 2: 0.25, 3: 0.14, 5: 0.073, 9: 0.037}
    assert {pieces: float(f"{buck_error(pieces):.2g}") for pieces in stated} == stated


# --- the ball


def test_the_ball_rests_on_the_paddle_and_rolls_with_it():
    problem = library.ball_and_paddle(horizon=10)
    at_rest = lfo.simulate(problem, np.zeros((10, 2)), np.zeros(10))
    np.testing.assert_allclose(at_rest.x, 0, atol=1e-15)
    rolling = lfo.simulate(problem, np.tile([1.0, 0.0], (10, 1)), np.zeros(10)).x
    np.testing.assert_allclose(rolling[:, 1], rolling[:, 4], atol=1e-15)
    np.testing.assert_allclose(rolling[:, 5] + 0.1 * rolling[:, 7], rolling[:, 8], atol=1e-12)
    np.testing.assert_allclose(rolling[:, 5], rolling[:, 8] * 2 / 7, atol=1e-12)  # a solid sphere's share


@pytest.mark.parametrize("where", ["paddle", "ceiling"])
def test_friction_opposes_sliding_and_keeps_to_coulombs_law(where):
    problem = single_step("ball_and_paddle")
    on_paddle = where == "paddle"
    for slip in (1.5, -1.5):
        start = np.zeros(10)
        start[1], start[5], start[6] = (0.0, slip, -0.5) if on_paddle else (0.2, slip, 1.0)
        after = lfo.simulate(problem, np.zeros((1, 2)), start).x[1]
        normal = after[6] - (start[6] - 0.5) if on_paddle else (start[6] - 0.5) - after[6]
        assert normal > 0
        assert after[1] == pytest.approx(after[4] if on_paddle else 0.2, abs=1e-12)
        assert after[5] - start[5] == pytest.approx(-0.2 * normal * np.sign(slip), rel=1e-12)
        assert after[7] == pytest.approx((after[5] - start[5]) * 0.1 / 0.004 * (1 if on_paddle else -1), rel=1e-12)


def test_jumps_of_the_ball_lie_beyond_the_bounds():
    problem = single_step("ball_and_paddle")
    x, u = random_points(problem, 50_000)
    after = successors(problem, x, u)
    fallen = x[:, 1] + 0.05 * (x[:, 6] - 0.5)
    squeezed = (fallen < after[:, 4]) & (fallen > 0.2)
    assert squeezed.any()
    assert (after[squeezed, 4] > problem.state_boxes.upper[0, 4]).all()


def test_the_ball_stays_over_the_paddle_unless_it_has_no_end():
    kept, free = library.ball_and_paddle(), library.ball_and_paddle(keep_over_paddle=False)
    beside = np.zeros((21, 10))
    beside[5, [0, 3]] = 0.25, -0.1
    (term,) = kept.terms
    assert term.violation(beside, np.zeros((20, 2))).max() == pytest.approx(0.05)
    assert not free.terms


def test_the_ball_can_be_turned():
    problem = library.ball_and_paddle()
    sequence = np.array([1, 0, 3, 3, 6, 4, 0, 2, 1, 2, 0, 2, 1, 5, 5, 0, 2, 0, 0, 1])
    result = lfo.solve(problem.with_modes(sequence))
    assert result.cost == pytest.approx(80.086072, rel=1e-6)
    assert result.certificate.globally_optimal
    state = np.array(problem.initial_state.lower)
    for control, reached in zip(result.control, result.trajectory.x[1:], strict=True):
        state = STEPS["ball_and_paddle"](state, control)
        np.testing.assert_allclose(state, reached, atol=1e-6)
    np.testing.assert_allclose(state, 0, atol=1e-6)


def test_the_published_model_of_the_ball_has_the_cost_of_its_record():
    """The record's own sequence; its optimum, found with a solver's tolerance on bounds, was 37.207761."""
    problem = library.ball_and_paddle(friction="published", control_spectrum="freq")
    assert problem.control_stop.any(axis=0).tolist() == [True, True, False]
    problem = library.ball_and_paddle(friction="published")
    assert problem.gap is not None
    sequence = np.array([1, 1, 0, 5, 0, 0, 3, 1, 1, 1, 1, 1, 1, 0, 6, 0, 0, 0, 1, 1])
    result = lfo.solve(problem.with_modes(sequence))
    assert result.cost == pytest.approx(37.207866, rel=1e-7)
    assert result.certificate.globally_optimal
    laws, speeds = result.control[[3, 14], 2], result.trajectory.x[[3, 14], 5]
    after = result.trajectory.x[[4, 15], 5]
    assert laws[0] >= 0.5 - 1e-6
    assert laws[1] <= -0.5 + 1e-6
    assert ((after - speeds) * np.sign(laws) > 0).all()  # friction drives the ball on
    assert len(library.ball_and_paddle(friction="published", keep_over_paddle=False).dynamics.modes) == 7


@expensive
def test_solve_finds_multipliers_at_a_kink_where_the_sequences_own_do_not_fit():
    certificate = lfo.solve(library.max_min_network(horizon=2)).certificate
    assert certificate.globally_optimal
    assert (certificate.pmp, certificate.borders.joint) == ("satisfied", True)
