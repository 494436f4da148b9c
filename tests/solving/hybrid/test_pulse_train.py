"""Optimal pulse patterns against published intervals, their bound, files, bad input, and trains that do not exist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp import Trajectory
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.methods.hybrid import bound_near, nearest_train


# Miller, Karamanakos and Geyer, arXiv 2512.08201: distortion of moment relaxations, and of polished points
@expensive
@pytest.mark.parametrize(
    ("modulation", "switches", "lower", "upper"), [(0.9, 8, 0.042201, 0.042206), (1.0, 8, 0.029132, 0.02916)]
)
def test_published_intervals_hold_the_optimum_and_the_bound(modulation, switches, lower, upper):
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", modulation=modulation, switches=switches))
    assert result.status == "optimal"
    assert result.certificate.pmp == "satisfied"
    assert lower <= np.sqrt(result.cost) <= upper
    assert lower <= np.sqrt(result.lower_bound) <= np.sqrt(result.cost)
    assert result.gap <= 1e-6


def published(modulation: float, switches: int) -> lfo.OptimalControlProblem:
    """Return the problem of the published class."""
    dwell = 0.01 * np.pi
    return lfo.library.pulse_pattern(
        "opp", modulation=modulation, switches=switches, least_dwell=dwell, unipolar=True, exactly=True
    )


# The same authors: distortion of moment relaxations, and of polished points
@expensive
@pytest.mark.parametrize(
    ("modulation", "switches", "lower", "upper", "gap"),
    [
        *(
            (0.05, 8, 0.01353, 0.013543, 1e-6),
            (0.05, 12, 0.009637, 0.009648, 1e-6),
            (0.7, 32, 0.010474, 0.010506, 1e-6),
        ),
        *(
            (0.5, 20, 0.01315, 0.013164, 1e-6),
            (0.55, 20, 0.013484, 0.025066, 1e-6),
            (0.5, 32, 0.009715, 0.009838, 1e-6),
        ),
        *((1.1, 16, 0.0, 0.038226, 1e-6), (1.05, 20, 0.0, 0.016794, 1e-6)),  # a first train is hard to find
    ],
)
def test_the_published_class_is_exact(modulation, switches, lower, upper, gap):
    result = lfo.solve(published(modulation, switches), gap=gap)
    assert result.status == "optimal"
    assert lower <= np.sqrt(result.cost) <= upper
    assert lower - 4e-6 < np.sqrt(result.lower_bound) <= np.sqrt(result.cost)
    x, dwells = result.trajectory.x, result.trajectory.u[:, 0]
    assert len(dwells) == switches // 4 + 1
    assert (dwells[1:-1] >= 0.01 * np.pi - 1e-8).all()
    assert (dwells[[0, -1]] >= 0.005 * np.pi - 1e-8).all()
    assert x[:, 1].min() >= 0


@expensive
def test_the_verdict_does_not_depend_on_the_unit_of_the_cost():
    problem = lfo.library.pulse_pattern(kind="opp")
    result = lfo.solve(replace(problem, cost=lfo.QuadraticCost(p=[0, 0, 0, 1e-9, 0, 0])))
    assert result.status == "optimal"
    assert result.cost == pytest.approx(1e-9 * lfo.solve(problem).cost, rel=1e-6)


def in_units(problem: lfo.OptimalControlProblem, unit: float) -> lfo.OptimalControlProblem:
    """Return a problem whose levels count in another unit, which may be negative, and the cost in its square."""
    scale = np.array([1, unit, unit, unit**2, *[unit] * (problem.state_dim - 4)])
    boxes = {}
    for name in ("initial_state", "terminal_state", "state_set"):
        ends = getattr(problem, name).lower * scale, getattr(problem, name).upper * scale
        boxes[name] = lfo.Box(np.minimum(*ends), np.maximum(*ends))
    step, orders = problem.dynamics.step, problem.dynamics.orders
    return replace(problem, dynamics=lfo.dynamics.PulseTrain(abs(unit) * step, orders), **boxes)


@pytest.mark.parametrize("unit", seeds([1e-6, 1e-3, 300.0, 1e6]))
def test_the_verdict_does_not_depend_on_the_unit_of_the_levels(unit):
    """Of 300 V, the search once took forty times as long, and of 1 mV proved nothing."""
    for problem in (published(0.05, 8), lfo.library.pulse_pattern(kind="opp")):
        result = lfo.solve(in_units(problem, unit))
        assert result.status == "optimal"
        assert result.cost == pytest.approx(unit**2 * lfo.solve(problem).cost, rel=1e-9)
    assert lfo.solve(in_units(published(0.55, 8), unit), throw=False).status == "infeasible"


def test_levels_may_all_be_below_zero():
    """The mirror image of a pattern without levels below zero; its last step leads to none above zero."""
    problem = published(0.05, 8)
    mirrored = in_units(problem, -1.0)
    result = lfo.solve(mirrored)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(lfo.solve(problem).cost, rel=1e-9)
    assert result.trajectory.x[:, 1].max() == 0.0


@expensive
def test_three_angles():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", modulation=0.8, switches=12), gap=1e-4)
    assert result.status == "optimal"
    assert 0.023661 <= np.sqrt(result.cost) <= 0.023664


def test_the_distortion_is_that_of_the_sampled_pattern():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp"))
    x, u = result.trajectory.x, result.trajectory.u
    theta = (np.arange(200_000) + 0.5) * np.pi / 2 / 200_000
    level = x[np.searchsorted(np.cumsum(u[:, 0]), theta).clip(max=2), 1]
    current = np.cumsum(level[::-1])[::-1] * -(np.pi / 2 / 200_000)
    assert 4 / np.pi * (current**2).mean() * np.pi / 2 - 0.81 == pytest.approx(result.cost, abs=2e-5)
    assert 4 / np.pi * (level * np.sin(theta)).mean() * np.pi / 2 == pytest.approx(0.9, abs=1e-5)


def test_an_angle_that_is_moved_fails_the_end():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp"))
    u = result.trajectory.u.copy()
    u[0, 0] += 1e-5
    moved = lfo.simulate(result.problem, u, result.trajectory.x[0])
    verdict = lfo.certify(result.problem, Trajectory(moved.x, moved.u), result.multipliers)
    assert not verdict.feasible
    assert "S-x" in {condition.label for condition in verdict.failed}


@pytest.mark.parametrize(("modulation", "switches"), [(1.15, 16), (0.55, 8), (1.1, 20)])
def test_amplitudes_that_no_train_has_are_proven_to_be_out_of_reach(modulation, switches):
    result = lfo.solve(published(modulation, switches), throw=False)
    assert result.status == "infeasible"
    assert result.trajectory is None


@pytest.mark.parametrize("third", seeds([(-np.inf, 0.02), (-0.02, np.inf), (-np.inf, np.inf)]))
def test_amplitudes_may_have_no_limit(third):
    given = lfo.library.pulse_pattern(kind="opp")
    ends = (given.terminal_state.lower, given.terminal_state.upper)
    end = [np.append(part[:-1], last) for part, last in zip(ends, third, strict=True)]
    states = (given.state_set.lower, given.state_set.upper)
    sides = [np.append(part[:-1], sign * np.inf) for part, sign in zip(states, (-1, 1), strict=True)]
    result = lfo.solve(replace(given, terminal_state=lfo.Box(*end), state_set=lfo.Box(*sides)))
    assert result.status == "optimal"
    assert result.lower_bound <= result.cost <= lfo.solve(given).cost + 1e-9


def test_without_amplitudes_the_level_that_stays_at_zero_is_the_best(monkeypatch):
    """Its cost is zero to rounding, which no search over ever smaller parts improves."""
    parts, quarter = [], np.pi / 2
    substitute(monkeypatch, "methods.hybrid.nearest_train", lambda *given: parts.append(given) or nearest_train(*given))
    problem = lfo.OptimalControlProblem(
        lfo.dynamics.PulseTrain(step=1.0, orders=[]),
        horizon=3,
        cost=lfo.QuadraticCost(p=[0, 0, 0, 1]),
        control_set=lfo.Box([0, -1], [quarter, 1]),
        state_set=lfo.Box([0, -1, -quarter, 0], [quarter, 1, quarter, 4]),
        initial_state=lfo.Box([0, 0, -quarter, 0], [0, 0, quarter, 0]),
        terminal_state=lfo.Box([quarter, -1, 0, 0], [quarter, 1, 0, 4]),
    )
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(0.0, abs=1e-9)
    assert len(parts) < 100


def test_an_interrupt_leaves_a_bound_of_all_trains(monkeypatch):
    """The part that was looked at when it came is not lost."""
    problem, calls = published(0.05, 16), [0]
    least = 5.72745681664e-05  # the cost without an interrupt

    def interrupt_the_second_call(*given: object) -> float:
        calls[0] += 1
        if calls[0] == 2:
            raise KeyboardInterrupt
        return bound_near(*given)

    substitute(monkeypatch, "methods.hybrid.bound_near", interrupt_the_second_call)
    result = lfo.solve(problem, throw=False)
    assert calls[0] == 2
    assert result.status != "optimal"
    assert result.lower_bound <= least


def test_without_enough_switches_there_is_none():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", switches=4), throw=False)
    assert result.status == "infeasible"
    assert "no pulse train satisfies the constraints" in result.message


def test_a_time_limit_keeps_what_was_found():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", switches=16), time_limit=1e-9, throw=False)
    assert result.status == "limit"
    assert "time limit" in result.message


@expensive
@pytest.mark.at_tolerance("no time is left to refine the answer")
@pytest.mark.parametrize("limit", [2.0, 6.0])
def test_a_search_over_five_angles_ends_in_time_with_the_bound_it_has(limit):
    """Every look at the clock takes a second: each part, each cut and each step of Newton's method looks at it."""
    problem, clock = lfo.library.pulse_pattern(kind="opp", switches=20), Clock(1.0)
    start = lfo.solve(lfo.library.pulse_pattern(kind="opp", switches=8)).trajectory.x[1:-1, 0]
    # a train of eight switches: three more steps at the end
    dwells = np.diff(np.concatenate([[0.0], start, [np.pi / 2], [np.pi / 2] * 3]))
    x, u = np.zeros((7, 6)), np.stack([dwells, [1, 1, -1, 1, -1, 1]], axis=1)
    x[1:, 0] = dwells.cumsum()
    with use_clock(clock):
        result = lfo.solve(problem, time_limit=limit, start=Trajectory(x, u), throw=False)
    assert clock.seconds <= limit + 20  # the judge looks some twenty times
    assert result.status in ("limit", "locally_optimal")
    assert f"time limit of {limit:g} s" in result.message
    assert result.certificate.feasible
    assert -1e-16 <= result.lower_bound <= result.cost


@expensive
@pytest.mark.parametrize("switches", [8, 12])
@pytest.mark.parametrize("modes_only", [False, True])
def test_a_start_is_where_the_search_begins(switches, modes_only):
    problem = lfo.library.pulse_pattern(kind="opp", switches=switches)
    best = lfo.solve(problem).trajectory
    start = (best.u[:, 1] < 0).astype(int) if modes_only else best
    with use_clock(Clock(1.0)):  # no time for boxes
        result = lfo.solve(problem, start=start, time_limit=1.0, throw=False)
    assert result.certificate.feasible
    assert result.cost == pytest.approx(problem.value(best.x, best.u), rel=1e-6)
    assert lfo.solve(problem, start=start).status == "optimal"


@expensive
@pytest.mark.parametrize(("modulation", "switches"), [(0.3, 12), (0.9, 8), (1.0, 12)])
def test_an_optimum_is_certified_with_its_multipliers_and_without(modulation, switches):
    problem = lfo.library.pulse_pattern(kind="opp", modulation=modulation, switches=switches)
    result = lfo.solve(problem, gap=1e-4)
    assert result.status == "optimal"
    assert lfo.certify(problem, result).pmp == "satisfied"
    assert lfo.certify(problem, result.trajectory).pmp == "satisfied"


@expensive
def test_many_starts_are_solved_and_a_loop_ends_where_no_train_begins():
    """The measured state replaces the bounds of the first level, which is zero."""
    problem = lfo.library.pulse_pattern(kind="opp")
    start = lfo.solve(problem).trajectory.x[0]
    assert [one.status for one in lfo.solve_many(problem, initial_states=[start, start])] == ["optimal", "optimal"]
    loop = lfo.RecedingHorizon(problem).run(start, 2)
    assert len(loop.steps) == 1
    assert "another start than theta = 0 at level 0" in str(loop)


@expensive
def test_files_hold_the_train(tmp_path):
    problem = lfo.library.pulse_pattern(kind="opp")
    lfo.write_problem(problem, tmp_path / "train.toml")
    again = lfo.read_problem(tmp_path / "train.toml")
    assert again.dynamics.orders == (1, 3)
    assert again.dynamics.step == 0.5
    result = lfo.solve(again)
    assert result.cost == lfo.solve(problem).cost
    result.save(tmp_path / "train.npz")
    np.testing.assert_array_equal(lfo.load(tmp_path / "train.npz").trajectory.x, result.trajectory.x)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"kind": "sheep"}, "kind"),
        ({"kind": "shep", "samples": 15}, "samples"),
        ({"kind": "shep", "tolerance": 0.0}, "tolerance"),
        ({"kind": "opp", "modulation": 1.3}, "modulation"),
        ({"kind": "opp", "modulation": 0.0}, "modulation"),
        ({"kind": "opp", "switches": 6}, "switches"),
        ({"kind": "opp", "exactly": True}, "exactly"),
        ({"kind": "opp", "least_dwell": 0.1}, "exactly"),
        ({"kind": "opp", "least_dwell": -0.1, "exactly": True}, "least_dwell"),
        ({"kind": "opp", "least_dwell": 0.8, "exactly": True}, "least_dwell"),
    ],
)
def test_bad_parameters_are_named(given, field):
    with pytest.raises(ProblemError, match=field):
        lfo.library.pulse_pattern(**given)


@pytest.mark.parametrize("given", [{"step": 0.0, "orders": [1]}, {"step": 0.5, "orders": [2]}])
def test_bad_trains_are_named(given):
    with pytest.raises(ProblemError, match="PulseTrain"):
        lfo.dynamics.PulseTrain(**given)


@pytest.mark.parametrize(
    ("field", "component", "ends", "words"),
    [
        ("initial_state", 2, (0.5, 0.5), r"integral of the level is -0\.93613 at t = 0, not 0\.5"),
        ("state_set", 2, (-0.1, 0.1), r"integral of the level is -0\.93613 at t = 0, not -0\.1 to 0\.1"),
        ("control_set", 0, (0.0, 0.3), r"dwell \[rad\] is 0\.99913 at t = 1, not 0 to 0\.3"),
    ],
)
def test_a_bound_that_the_search_does_not_take_is_named(field, component, ends, words):
    problem = lfo.library.pulse_pattern(kind="opp", modulation=0.9, switches=8)
    box = getattr(problem, field)
    lower, upper = np.array(box.lower), np.array(box.upper)
    lower[..., component], upper[..., component] = ends
    with pytest.raises(lfo.errors.NumericalError, match="the search takes bounds on levels.*" + words):
        lfo.solve(replace(problem, **{field: lfo.Box(lower, upper)}))


def test_explain_says_that_it_takes_no_pulse_trains():
    with pytest.raises(lfo.errors.UnsupportedError, match="explain: got a pulse train, whose search over angles needs"):
        lfo.explain(lfo.library.pulse_pattern(kind="opp", modulation=1.27, switches=8))
