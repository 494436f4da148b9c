"""Why there is no solution: the family cannot spare a block, and each cure helps and is the least that does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.explanation import least_cure
from lin_freq_ocp.solving import solve_judged
from lin_freq_ocp.transform import constraints, drop_limits, stated_sizes

H, T = 0.1, 20
NEEDED = 1.0 / (H * T / 2) ** 2
"""Acceleration that takes the double integrator one metre in T steps, from rest to rest: bang, bang."""


def carriage(**changes: Any) -> lfo.OptimalControlProblem:
    """One metre from rest to rest, with less acceleration than it takes."""
    fields = {
        "dynamics": lfo.LinearDynamics(
            [[1.0, H], [0.0, 1.0]],
            [[H**2 / 2], [H]],
            sampling_time=H,
            state_names=["position [m]", "speed [m/s]"],
            control_names=["acceleration [m/s^2]"],
        ),
        "horizon": T,
        "cost": lfo.QuadraticCost(R=1.0),
        "control_set": lfo.Box(-0.7 * NEEDED, 0.7 * NEEDED),
        "initial_state": [0.0, 0.0],
        "terminal_state": [1.0, 0.0],
    }
    return lfo.OptimalControlProblem(**(fields | changes))


ENDS = ["initial state", "terminal state"]
CONTROL, SPEED = "control bound on acceleration [m/s^2]", "state bound on speed [m/s]"
PLENTY = lfo.Box(-50.0, 50.0)
INFEASIBLE = {  # name: changes, family, {block: amount}
    "a control bound": ({}, [*ENDS, CONTROL], {CONTROL: 0.3 * NEEDED}),
    "a control bound, with others that do not matter": (
        {"state_set": lfo.Box([-5.0, -9.0], [5.0, 9.0]), "control_spectrum": lfo.stop_band(bins=[9])},
        [*ENDS, CONTROL],
        {},
    ),
    "a speed limit": (
        {"control_set": PLENTY, "state_set": lfo.Box([None, -0.3], [None, 0.3])},
        [*ENDS, SPEED],
        {SPEED: 1 / (H * (T - 1)) - 0.3},
    ),
    "a joint row": (
        {"control_set": PLENTY, "stage_rows": lfo.StageRows([[0.0, 1.0]], None, [0.3], name="speed limit")},
        [*ENDS, "row 0 of speed limit"],
        {"row 0 of speed limit": 1 / (H * (T - 1)) - 0.3},
    ),
    "a stop band": (
        {"control_set": None, "control_spectrum": lfo.stop_band(bins=range(1, 11))},
        [*ENDS, "control stop band on acceleration [m/s^2]"],
        {},
    ),
    "bounds per time": (
        {"control_set": lfo.Box(np.full((T, 1), -0.7 * NEEDED), np.linspace(0.5, 0.7, T)[:, None] * NEEDED)},
        [*ENDS, CONTROL],
        {},
    ),
    "an end in a box": (
        {"terminal_state": lfo.Box([1.0, -0.1], [1.2, 0.1]), "control_set": lfo.Box(-0.5 * NEEDED, 0.5 * NEEDED)},
        [*ENDS, CONTROL],
        {},
    ),
}


def feasible(problem: lfo.OptimalControlProblem) -> bool:
    """Another method than the explanation's own, which is our Fourier-domain one here."""
    result = lfo.solve(replace(problem, cost=lfo.QuadraticCost()), method="convex", throw=False)
    assert result.status in ("optimal", "infeasible", "infeasible_claimed")
    return result.status == "optimal"


@cache
def explained(name: str) -> tuple[lfo.OptimalControlProblem, lfo.results.Explanation]:
    problem = carriage(**INFEASIBLE[name][0])
    return problem, lfo.explain(problem)


@pytest.fixture(params=list(INFEASIBLE)[::2])
def case(request) -> tuple[lfo.OptimalControlProblem, lfo.results.Explanation, list[str], dict[str, float]]:
    return *explained(request.param), *INFEASIBLE[request.param][1:]


@expensive
def test_the_family_clashes_and_can_spare_no_block(case):
    problem, explanation, family, _ = case
    assert sorted(explanation.family) == sorted(family)
    assert explanation.irreducible
    named = {block.name: block for block in constraints(problem)}
    others = [block for name, block in named.items() if name not in family]
    assert not feasible(drop_limits(problem, others))
    for name in family:
        assert feasible(drop_limits(problem, [*others, named[name]])), name


def test_a_cure_helps_and_less_does_not(case):
    problem, explanation, _, amounts = case
    named = {block.name: block for block in constraints(problem)}
    cures = {cure.block: cure for cure in explanation.cures}
    assert cures
    for name, cure in cures.items():
        block = named[name]
        if block.whole:
            assert feasible(block.relaxed(problem, cure.amount))
            assert not feasible(block.relaxed(problem, cure.amount - 1))
        elif block.end is None:
            assert feasible(block.relaxed(problem, 1.001 * cure.amount))
            assert not feasible(block.relaxed(problem, 0.98 * cure.amount))
    for name, amount in amounts.items():
        assert cures[name].amount == pytest.approx(amount, rel=1e-3)


@expensive
def test_a_nearest_end_can_be_reached_and_a_nearer_one_cannot():
    problem = carriage()
    cures = {cure.block: cure for cure in lfo.explain(problem).cures}
    text = cures["terminal state"].words.split("-> [")[1].split("]")[0]
    reached = np.array([float(value) for value in text.split(",")])
    assert feasible(replace(problem, terminal_state=reached - np.array([1e-5, 0.0])))
    away = reached - problem.terminal_state.lower
    assert np.abs(away).max() > 0.05
    assert not feasible(replace(problem, terminal_state=problem.terminal_state.lower + 0.9 * away))


@expensive
def test_components_of_an_end_that_need_not_move_stay():
    """The initial speed breaks its bound; at 0.1, the end is reached from any position."""
    speeds, ends = lfo.Box([None, -0.1], [None, 0.1]), {"initial_state": [0.4, 0.55], "terminal_state": [0.5, 0.0]}
    problem = carriage(control_set=PLENTY, state_set=speeds, **ends)
    (cure,) = (cure for cure in lfo.explain(problem).cures if cure.block == "initial state")
    assert cure.words.startswith("[0.4 , 0.55] -> [0.4, 0.1] (least sum of the changes")
    assert cure.amount == pytest.approx(0.45 / stated_sizes(problem)[0][1], rel=1e-5)


@expensive
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_cures_of_ends_do_not_depend_on_the_unit_of_the_state(unit):
    """x_{t+1} = a x_t + u_t: with a = 0.5, the start and the end move as far as 0.1 a step takes them in 5 steps."""
    fields = {"initial_state": [unit], "terminal_state": [unit], "control_set": lfo.Box(-0.1 * unit, 0.1 * unit)}
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[0.5]], [[1.0]]), 5, lfo.QuadraticCost(R=1.0), **fields)
    words = {cure.block: cure.words for cure in lfo.explain(problem).cures}
    reached = {end: float(words[f"{end} state"].split("-> [")[1].split("]")[0]) for end in ("initial", "terminal")}
    steps = 0.1 * (1 - 0.5**5) / (1 - 0.5)
    assert reached["initial"] == pytest.approx((1 - steps) / 0.5**5 * unit, rel=1e-5)
    assert reached["terminal"] == pytest.approx((0.5**5 + steps) * unit, rel=1e-5)


@expensive
def test_an_end_that_has_to_be_zero_is_told_as_zero():
    """A state that doubles in each of 60 steps ends at zero only if it begins there, up to 1e-9 of control."""
    fields = {"initial_state": [1.0], "terminal_state": [0.0], "control_set": lfo.Box(-1e-9, 1e-9)}
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[2.0]], [[1.0]]), 60, lfo.QuadraticCost(R=1.0), **fields)
    (cure,) = (cure for cure in lfo.explain(problem).cures if cure.block == "initial state")
    assert cure.words.startswith("[1.] -> [0.] ")


@expensive
def test_cures_are_told_in_the_units_of_the_problem():
    said = str(explained("a control bound")[1])
    assert f"control bound on acceleration [m/s^2]: [-0.7, 0.7] -> [-{NEEDED:g}" in said
    assert "terminal state: [1., 0.] -> [" in said
    row = explained("a joint row")[1]
    assert any("<= 0.3 -> 0.526" in str(cure) for cure in row.cures)
    varying = explained("bounds per time")[1]
    assert any("bounds wider by" in cure.words for cure in varying.cures)


@expensive
@pytest.mark.parametrize("sampling_time", [H, None])
def test_a_low_pass_is_cured_by_another_cut_off(sampling_time):
    problem = carriage(control_set=lfo.Box(-1.05 * NEEDED, 1.05 * NEEDED), control_spectrum=lfo.low_pass(cutoff=0.4))
    plant = replace(problem.dynamics, sampling_time=sampling_time)
    cures = [cure for cure in lfo.explain(replace(problem, dynamics=plant)).cures if "stop band" in cure.block]
    assert len(cures) == 1
    before, after, unit = cures[0].words.removeprefix("cut-off ").replace("-> ", "").split()
    assert unit == ("Hz" if sampling_time else "rad/sample")
    factor = 2 * np.pi * H if sampling_time else 1.0
    assert float(before) * factor == pytest.approx(2 * np.pi / T, rel=1e-5)  # the highest bin that 0.4 rad lets pass
    cured = replace(problem, control_spectrum=lfo.low_pass(cutoff=float(after) * factor + 1e-4))
    assert feasible(cured)
    assert not feasible(replace(problem, control_spectrum=lfo.low_pass(cutoff=float(after) * factor - 1e-3)))


@expensive
def test_time_varying_dynamics_and_state_bands_are_explained_too():
    A = np.broadcast_to(carriage().dynamics.A, (T, 2, 2)) * np.linspace(1.0, 0.99, T)[:, None, None]
    plant = lfo.LinearDynamics(A, carriage().dynamics.B)
    problem = carriage(dynamics=plant, state_spectrum=lfo.stop_band(bins=[1], component=1))
    explanation = lfo.explain(problem)
    assert explanation.irreducible
    named = {block.name: block for block in constraints(problem)}
    others = [block for name, block in named.items() if name not in explanation.family]
    assert not feasible(drop_limits(problem, others))
    assert all(feasible(drop_limits(problem, [*others, named[name]])) for name in explanation.family)


def test_a_problem_with_a_solution_is_not_explained():
    with pytest.raises(lfo.errors.UnsupportedError, match="with the status 'optimal'; expected one"):
        lfo.explain(carriage(control_set=None))


def looks(call: Callable[[], object]) -> float:
    """Return how often a call looks at the clock."""
    clock = Clock(1.0)
    with use_clock(clock):
        call()
    return clock.seconds


def test_without_time_no_more_is_claimed_than_is_known():
    """The time is over soon after the proof that there is no solution."""
    problem = carriage()
    proof = looks(lambda: lfo.solve(problem, time_limit=1e9, throw=False))
    with use_clock(Clock(1.0)):
        explanation = lfo.explain(problem, time_limit=proof + 5)
    assert not explanation.irreducible
    assert "perhaps fewer" in str(explanation)


@expensive
def test_a_cure_that_does_not_help_when_tried_is_none():
    problem = carriage()
    assert all(least_cure(problem, block, lambda cured: False) is None for block in constraints(problem))


def test_after_ctrl_c_nothing_more_is_tried(monkeypatch):
    solved = []

    def interrupted(problem, *given, **options):
        solved.append(problem)
        result = solve_judged(problem, *given, **options)
        return replace(result, interrupted=True) if len(solved) == 3 else result

    substitute(monkeypatch, "solving.solve_judged", interrupted)
    explanation = lfo.explain(carriage())
    assert len(solved) == 3
    assert not explanation.irreducible
    assert explanation.cures == ()


@expensive
def test_a_repair_needs_no_more_digits_than_its_margin(monkeypatch):
    """The least change of an end ends as optimal, where the usual tolerance would end seconds later as not proven."""
    cart = [[0, 0, 1, 0], [0, 0, 0, 1], [0, -0.9645933, 0, 0], [0, 19.934928, 0, 0]]
    force = [[0], [0], [0.38277512], [-0.65618592]]
    problem = replace(
        lfo.library.pendulum(),
        dynamics=lfo.LinearDynamics.from_continuous(cart, force, sampling_time=0.01),
        control_spectrum=lfo.low_pass(cutoff_hz=5.6),
    )
    end = next(one for one in constraints(problem) if one.name.startswith("initial state"))
    endings = []

    def record_the_ending(*given, **options):
        result = solve_judged(*given, **options)
        endings.append((given[1].method, result.status))
        return result

    substitute(monkeypatch, "solving.solve_judged", record_the_ending)
    assert least_cure(problem, end, lambda cured: True).amount > 0
    assert endings == [("structured", "optimal")]


@expensive
def test_the_error_names_the_least_change():
    with (
        pytest.raises(
            lfo.errors.InfeasibleError, match=r"Smallest change that restores feasibility: .*\[-0\.7, 0\.7\] -> \[-1"
        ) as caught,
        use_clock(Clock()),
    ):
        lfo.solve(carriage())
    assert caught.value.result.explanation.irreducible


def test_without_throw_nothing_more_is_solved():
    assert lfo.solve(carriage(), throw=False).explanation is None


@expensive
def test_a_busy_machine_takes_no_cure_away():
    """Every look costs a second on the wall, and a thousandth of one of the processor: solve explains all the same."""
    problem = lfo.library.double_integrator(cutoff_hz=0.3, horizon=24, sampling_time=0.1)
    with use_clock(Clock(1.0), Clock(1e-3)):
        with pytest.raises(lfo.errors.InfeasibleError) as caught:
            lfo.solve(problem)
        given = caught.value.result.explanation
        limited = lfo.explain(problem, time_limit=30.0)
    idle = lfo.explain(problem)
    assert (given.family, given.irreducible) == (idle.family, True)
    assert [cure.block for cure in given.cures] == [cure.block for cure in idle.cures]
    assert len(limited.cures) < len(given.cures)


def test_processor_time_ends_an_explanation():
    problem = lfo.library.double_integrator(cutoff_hz=0.3)
    with use_clock(Clock(0.0), Clock(1.0)):
        found = lfo.explain(problem, processor_time=4.0)
    assert not found.irreducible
    with pytest.raises(lfo.errors.ProblemError, match="processor_time"):
        lfo.explain(problem, processor_time=0.0)
