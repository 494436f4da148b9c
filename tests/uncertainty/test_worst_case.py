"""The worst case of plans: attained by simulation, noticed where a margin is too small, and spectra."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import robust_plans
from helpers.seeds import expensive, seeds
from helpers.tubes import simulate, tube
from lin_freq_ocp.base import number
from lin_freq_ocp.transform import translated_by

LOAD = lfo.Disturbance(lfo.Box(-0.15, 0.15))


def test_the_worst_case_of_the_example_is_that_of_the_design():
    problem = tube()
    found = lfo.solve(lfo.robust(problem, LOAD))
    worst = lfo.worst_case(problem, LOAD, found)
    assert found.cost == pytest.approx(212.47, abs=0.01)
    assert lfo.solve(problem).cost == pytest.approx(190.02, abs=0.01)
    speed, low = worst["x_1, upper"], worst["u_0, lower"]
    with pytest.raises(KeyError, match=r"worst case: got 'u_0, lowre'; expected one of .* Did you mean 'u_0, lower'"):
        worst["u_0, lowre"]
    assert (speed.limit, low.limit, low.index) == (2, -1, 8)
    assert low.planned == pytest.approx(-0.74, abs=1e-3)
    assert low.margin == pytest.approx(0.26, abs=1e-3)
    np.testing.assert_allclose(worst.end, (1.227, 0.514), atol=1e-3)
    assert "1 % larger loads cost 0.136 %" in str(worst)
    assert "proven" in str(worst)
    assert "u_0, lower" in worst._repr_html_()


@pytest.mark.parametrize("seed", seeds(range(120)))
def test_a_random_plan_bears_all_sequences_of_extreme_loads_and_its_worst_case_is_theirs(seed):
    """In units of 1e-6 to 1e6, with soft limits, rate limits, polyhedra, ends and masks."""
    found = robust_plans.check(seed)
    assert found.passed, found


def test_loads_that_are_larger_than_stated_are_seen_to_exceed_the_worst_case():
    found = [robust_plans.check(seed, share=1.01) for seed in range(12)]
    assert sum(any("exceeded" in fault for fault in one.faults) for one in found) >= 11


def test_every_worst_case_is_attained_by_the_loads_that_it_returns():
    problem = tube()
    worst = lfo.worst_case(problem, LOAD, lfo.solve(problem))  # a plan without margins
    plan, K = lfo.solve(problem).trajectory, LOAD.feedback(problem)
    for one in worst.limits:
        assert np.abs(one.loads).max() <= 0.15
        x, u = simulate(problem, K, plan, np.eye(2), one.loads[None])
        signal, component = (x, one.name[2]) if one.name[0] == "x" else (u, one.name[2])
        value = signal[0, one.index, int(component)]
        assert one.attained == pytest.approx(value, abs=1e-12)
        assert one.planned + one.sign * one.margin == pytest.approx(value, abs=1e-12)
    assert not worst
    assert [one.name for one in worst.limits if not one.holds] == ["x_1, upper", "u_0, upper", "u_0, lower"]
    assert "violated" in str(worst)
    assert worst.closest.name == "x_1, upper"
    assert "Violated: 3 limits" in worst.verdict


@pytest.mark.parametrize("missing", [1e-6, 1e-3])
def test_a_margin_that_is_a_little_too_small_is_noticed(missing):
    problem = tube()
    tight = lfo.robust(problem, LOAD)
    wider = lfo.Box(tight.control_set.lower - missing, tight.control_set.upper + missing)
    worst = lfo.worst_case(problem, LOAD, lfo.solve(replace(tight, control_set=wider)))
    broken = [one for one in worst.limits if not one.holds]
    assert broken
    assert "violated by" in str(worst)
    assert all(one.name.startswith("u_0") for one in broken)
    assert max(one.violation for one in broken) == pytest.approx(missing, rel=1e-2)
    assert max(one.sign * (one.attained - one.limit) for one in broken) == pytest.approx(missing, rel=1e-2)


def test_a_limit_that_is_far_from_zero_is_judged_as_closely():
    """Of loads and of plants: 1e-8 of 1e6 would have let an excess of 1e-4 pass."""
    near, place, loads = tube(), np.array([1e6, 0.0]), lfo.Disturbance(lfo.Box(-1e-3, 1e-3), gain=None)
    near = replace(near, state_set=lfo.Box([-9.05, -2.0], [2.0, 2.0]))
    far = translated_by(near, -place).problem
    plan = lfo.solve(near).trajectory
    plants = lfo.Plants([near.dynamics, replace(near.dynamics, B=near.dynamics.B * 1.0001)])
    for uncertainty in (loads, plants):
        one = lfo.worst_case(near, uncertainty, plan)
        other = lfo.worst_case(far, uncertainty, lfo.Trajectory(plan.x + place, plan.u))
        assert not one
        assert [(a.name, a.index, a.holds) for a in one.limits] == [(b.name, b.index, b.holds) for b in other.limits]
        np.testing.assert_allclose([b.violation for b in other.limits], [a.violation for a in one.limits], atol=1e-9)
        lower = other["x_0, lower"]
        assert lower.planned == pytest.approx(one["x_0, lower"].planned + 1e6, abs=1e-9)
        assert other.cost == pytest.approx(one.cost, rel=1e-9) if one.cost is not None else other.cost is None


def test_the_price_of_larger_loads_is_the_slope_of_the_cost():
    rows = lfo.StageRows([[1.0, 1.0]], [[0.0]], [1.5], name="sum")
    problem = tube(stage_rows=rows, terminal_state=lfo.Box([-1.5, -1], [1.5, 1]))
    K = LOAD.feedback(problem)
    loads = [lfo.Disturbance(lfo.Box(-size, size), gain=K) for size in (0.1, 0.1 * 1.0001, 0.1 * 0.9999)]
    plans = [lfo.solve(lfo.robust(problem, load)) for load in loads]
    worst = lfo.worst_case(problem, loads[0], plans[0])
    assert worst.price == pytest.approx((plans[1].cost - plans[2].cost) / 2e-4, rel=1e-4)
    assert worst
    assert worst["sum"].attained == pytest.approx(worst["sum"].planned + worst["sum"].margin)
    assert worst["end of x_0, upper"].index == 10


def test_sets_rows_and_soft_limits_are_tightened_and_judged():
    rows = lfo.StageRows([[1.0, 0.0], [0.0, 1.0]], [[0.5], [0.0]], [1.8, np.inf], name="joint")
    varying = lfo.StageRows(
        np.tile([[[0.0, 1.0]]], (10, 1, 1)), np.zeros((10, 1, 1)), np.linspace(1.9, 1.5, 10)[:, None], "ramp"
    )
    sets = [lfo.Box([-10, -2], [2, 2]) & lfo.sets.Polyhedron([[1.0, 1.0]], [2.5])] * 11
    soft = lfo.Box([-10, -2], [2, 2]) & lfo.sets.Soft(lfo.Box([None, -1.0], [None, 1.0]), 50.0)
    load = lfo.Disturbance(lfo.Box(-0.05, 0.05))
    for changes in ({"stage_rows": [rows, varying], "state_set": sets}, {"state_set": soft}):
        problem = tube(**changes)
        tight = lfo.robust(problem, load)
        found = lfo.solve(tight)
        assert found.status == "optimal"
        worst = lfo.worst_case(problem, load, found)
        assert worst
        assert all(one.attained == pytest.approx(one.planned + one.sign * one.margin) for one in worst.limits)
    assert {"joint", "ramp"} <= {
        one.name.removeprefix("row 0 of ")
        for one in lfo.worst_case(tube(stage_rows=[rows, varying]), load, found).limits
    }
    over = load.error_loop(problem).margins(np.eye(2), np.zeros((2, 1)))[:, 1]
    part = tight.state_set[4].members[0].soft_set
    np.testing.assert_allclose(part.violation([0.0, 1.0 - over[4] + 0.1]), 0.1)


@pytest.mark.parametrize("method", ["convex", "structured", "spectral", "auto"])
def test_all_methods_take_a_tightened_problem(method):
    problem = lfo.rate_limited(tube(12, initial_state=[-5.0, 0.0]), 0.6, previous=[0.0])
    load = lfo.Disturbance(lfo.Box(-0.05, 0.05), np.eye(3, 2))
    found = lfo.solve(lfo.robust(problem, load), method)
    assert found.status == "optimal"
    assert lfo.worst_case(problem, load, found)
    rng = np.random.default_rng(0)
    w = rng.choice([-0.05, 0.05], (5000, 12, 2))
    _, u = simulate(problem, load.feedback(problem), found.trajectory, np.eye(3, 2), w)
    assert np.abs(np.diff(u, axis=1, prepend=0.0)).max() < 0.6 + 1e-8


def test_leakage_into_stop_bands_is_attained_and_that_of_all_vertices():
    problem = tube(5, control_spectrum=lfo.stop_band(bins=[2]), initial_state=[0.0, 0.0])
    load = lfo.Disturbance(lfo.Box([-0.02, -0.01], [0.03, 0.02]))
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="control_spectrum"):
        found = lfo.solve(lfo.robust(problem, load))
    (leak,) = lfo.worst_case(problem, load, found).leakage
    w = np.array(list(product([[-0.02, -0.01], [-0.02, 0.02], [0.03, -0.01], [0.03, 0.02]], repeat=5)))
    _, u = simulate(problem, load.feedback(problem), found.trajectory, np.eye(2), w)
    brute = np.abs(np.fft.rfft(u[..., 0], axis=1))[:, 2].max()
    assert (leak.index, np.isnan(leak.limit)) == (2, True)
    assert leak.planned + leak.margin == pytest.approx(brute, rel=1e-12)
    assert leak.attained == pytest.approx(brute, rel=1e-12)


def test_leakage_into_many_removed_bins_of_a_longer_plan_is_attained_and_exceeded_by_no_load():
    T, size = 40, 0.01
    problem = tube(T, control_spectrum=lfo.stop_band(bins=list(range(4, T // 2 + 1))), initial_state=[-2.0, 0.0])
    load = lfo.Disturbance(lfo.Box(-size, size))
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="control_spectrum"):
        found = lfo.solve(lfo.robust(problem, load))
    (leak,) = lfo.worst_case(problem, load, found).leakage
    assert leak.index >= 4
    assert leak.attained == pytest.approx(leak.planned + leak.margin, rel=1e-9)
    w = np.random.default_rng(0).choice([-size, size], (20_000, T, 2))
    _, u = simulate(problem, load.feedback(problem), found.trajectory, np.eye(2), w)
    reached = np.abs(np.fft.rfft(u[..., 0], axis=1))[:, 4:].max()
    assert 0.4 * leak.attained < reached < leak.attained


@expensive
@pytest.mark.parametrize(
    "loads", [lfo.Box(-0.01, 0.01), lfo.sets.Ball(0.01), 0.01 * np.array([[1.0, 1], [-1, 1], [0, -1]])]
)
def test_masks_of_the_applied_control_hold_for_all_loads(loads):
    T = 40
    bins = list(range(5, T // 2 + 1))
    problem = tube(T, control_spectrum=lfo.MagnitudeBound(1.5, bins=bins), initial_state=[-4.0, 0.0])
    load = lfo.Disturbance(loads)
    worst = lfo.worst_case(problem, load, lfo.solve(lfo.robust(problem, load)))
    mask = worst["mask on u_0"]
    assert worst
    assert mask.attained <= mask.planned + mask.margin + 1e-12 <= 1.5 + 1e-6
    assert mask.attained > 1.3
    nominal = lfo.worst_case(problem, load, lfo.solve(problem))
    assert not nominal
    assert not nominal["mask on u_0"].holds


def test_masks_of_states_and_outputs_are_tightened_without_a_gain_as_well():
    T, gain = 20, None
    output = lfo.spectrum.OutputSpectrum([[1.0, 0.0]], constraints=lfo.MagnitudeBound(2.0, bins=[6, 7]))
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.9, 0.2], [0.0, 0.8]], [[0.0], [1.0]], sampling_time=0.1),
        T,
        lfo.QuadraticCost(Q=np.eye(2), R=0.1),
        lfo.Box(-1, 1),
        initial_state=[2.0, 0.0],
        state_spectrum=lfo.MagnitudeBound(amplitude=0.2, band=lfo.low_pass(cutoff_hz=2.0), component=1),
        control_spectrum=lfo.low_pass(cutoff_hz=3.0),
        output_spectrum=output,
    )
    load = lfo.Disturbance(lfo.Box(-0.01, 0.01), gain=gain)
    found = lfo.solve(lfo.robust(problem, load))
    worst = lfo.worst_case(problem, load, found)
    assert worst
    assert worst.leakage[0].margin == 0.0
    masks = [one for one in worst.limits if one.in_spectrum]
    assert len(masks) == 2
    assert all(one.margin > 0 for one in masks)
    assert all(one.attained == pytest.approx(one.planned + one.margin, rel=1e-9) for one in masks)
    assert lfo.solve(problem).cost <= found.cost + 1e-9


def test_a_plan_of_another_tool_is_judged_by_its_controls_and_its_states():
    """States that deviate from the model by known amounts move the closed loop."""
    problem = tube(4, initial_state=[0.0, 0.0])
    plan = lfo.Trajectory(np.full((5, 2), 0.1) * np.arange(5)[:, None], np.zeros((4, 1)))
    worst = lfo.worst_case(problem, LOAD, plan)
    K = LOAD.feedback(problem)
    x, _ = simulate(problem, K, plan, np.eye(2), np.zeros((1, 4, 2)))
    assert worst["x_0, upper"].planned == pytest.approx(x[0, worst["x_0, upper"].index, 0], abs=1e-14)


def test_of_limits_that_are_equally_close_but_for_rounding_the_first_is_the_closest():
    worst = lfo.worst_case(tube(), LOAD, lfo.solve(lfo.robust(tube(), LOAD)))
    first = worst.closest
    closer = replace(first, margin=first.margin + 1e-12 * first.size)
    assert closer.violation > first.violation
    assert replace(worst, limits=(first, closer)).closest is first


@pytest.mark.parametrize(
    ("changes", "start"),
    [
        ({"terminal_state": lfo.Box([0.4, -0.1], [0.6, 0.1])}, None),
        ({"terminal_state": lfo.Box([0.5, -0.05], [0.5, 0.05])}, None),
        ({"terminal_state": lfo.Box([0.4, -0.1], [0.6, 0.1])}, 0.02),
        ({"initial_state": lfo.Box([-0.2, 0.0], [0.0, 0.3]), "terminal_state": lfo.Box([0.3, -0.3], [0.5, 0.3])}, 0.02),
    ],
    ids=["end in a box", "position fixed", "uncertain start", "start in a box"],
)
@pytest.mark.filterwarnings("ignore::lin_freq_ocp.errors.ClosedLoopWarning")
def test_bounds_of_states_and_of_ends_that_share_multipliers_are_priced_once(changes, start):
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]])
    cost = lfo.QuadraticCost(Q=np.diag([0.3, 0.1]), R=1.0, x_ref=[0.6, 0.0])
    states, fields = lfo.Box([-1, -0.32], [1, 0.32]), {"initial_state": [0.0, 0.0]} | changes
    problem = lfo.OptimalControlProblem(dynamics, 20, cost, lfo.Box(-1, 1), states, **fields)

    def plan(size: float) -> lfo.results.Result:
        of_start = None if start is None else lfo.Box(-start * size, start * size)
        loads = lfo.Box(-0.02 * size, 0.02 * size)
        return lfo.solve(lfo.robust(problem, lfo.Disturbance(loads, dynamics.B, [[-1.0, -1.5]], of_start)))

    found = plan(1.0)
    worst = lfo.worst_case(problem, found.problem.uncertainty, found)
    assert worst
    assert worst.price > 0.01
    assert worst.price == pytest.approx((plan(1.001).cost - plan(0.999).cost) / 0.002, rel=1e-6)


def test_a_limit_that_loads_of_one_sign_move_away_from_is_judged_at_its_worst_time():
    """The plan stays at 0, its limit at t = 1 is -2, and the loads are -1 and -3: the worst one leaves -1."""
    sets, cost = [lfo.Box(-10, 10), lfo.Box(-10, -2)], lfo.QuadraticCost(R=1.0)
    dynamics = lfo.LinearDynamics([[1.0]], [[1.0]])
    problem = lfo.OptimalControlProblem(dynamics, 1, cost, state_set=sets, initial_state=0.0)
    plan = lfo.Trajectory([[0.0], [0.0]], [[0.0]])
    worst = lfo.worst_case(problem, lfo.Disturbance([[-1.0], [-3.0]], gain=None), plan)
    upper = worst["x_0, upper"]
    assert (upper.index, upper.limit, upper.size) == (1, -2.0, pytest.approx(3.0))
    assert upper.violation == pytest.approx(1.0)
    assert not worst


def test_an_input_of_the_plant_fits_filtered_controls_but_no_state_of_the_plant_may_be_left_out():
    problem, E = tube(12, initial_state=[-5.0, 0.0]), [[0.0], [1.0]]
    band = lfo.low_pass(cutoff=1.0)
    filtered = lfo.filtered_control(problem, band, price=1e-3)
    absent = filtered.state_dim - 2
    plans = [lfo.robust(filtered, lfo.Disturbance(lfo.Box(-0.01, 0.01), rows)) for rows in (E, E + absent * [[0.0]])]
    assert absent > 0
    assert lfo.solve(plans[0]).cost == lfo.solve(plans[1]).cost
    with pytest.raises(
        lfo.errors.ProblemError, match=r"disturbance.input: got shape \(1, 1\); expected shape \(2, 1\)"
    ):
        lfo.robust(problem, lfo.Disturbance(lfo.Box(-0.01, 0.01), E[1:]))


def test_no_zero_of_a_table_is_negative():
    one = replace(lfo.worst_case(tube(), LOAD, lfo.solve(tube())).limits[0], planned=-0.0, margin=0.0, attained=-0.0)
    assert "-0 " not in str(one)
    assert str(one).split()[5:7] == ["0", "0"]


def test_soft_limits_are_shown_at_their_worst_and_priced_but_break_nothing():
    soft = lfo.Box([-10, -2], [2, 2]) & lfo.sets.Soft(lfo.Box([None, -1.0], [None, 1.0]), 5.0)
    rows = lfo.StageRows([[1.0, 1.0]], [[0.0]], [0.3], name="sum", penalty=2.0)
    problem = tube(state_set=soft, stage_rows=rows)
    K = lfo.Disturbance(lfo.Box(-0.05, 0.05)).feedback(problem)

    def plan(size: float) -> lfo.results.Result:
        return lfo.solve(lfo.robust(problem, lfo.Disturbance(lfo.Box(-0.05 * size, 0.05 * size), gain=K)))

    found = plan(1.0)
    worst = lfo.worst_case(problem, found.problem.uncertainty, found)
    assert worst
    assert [one.name for one in worst.soft] == ["sum", "row 1 of state set", "row 3 of state set"]
    assert not worst["row 1 of state set"].holds  # at a price
    for one in worst.soft:
        assert one.attained == pytest.approx(one.planned + one.margin, rel=1e-12)
    assert worst.price == pytest.approx((plan(1.001).cost - plan(0.999).cost) / 0.002, rel=1e-6)
    broken, kept = worst["row 1 of state set"], replace(worst["sum"], limit=10.0)
    assert broken.remark(soft=True) == f"soft, exceeded by {number(broken.attained - broken.limit)}"
    assert broken.remark() == broken.remark(soft=True).replace("soft, exceeded", "violated")
    assert (kept.remark(soft=True), kept.remark(), replace(kept, limit=np.nan).remark()) == ("soft, holds", "holds", "")
    assert str(worst).count("  soft, ") == worst._repr_html_().count("  soft, ") == 3
    assert "violated" not in str(worst)
    assert not all(one.holds for one in worst.soft)
    assert worst.verdict.startswith("No case violates one of the hard limits: proven")
