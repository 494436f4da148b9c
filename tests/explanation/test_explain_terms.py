"""Why there is no solution, beyond boxes and bands: sets, masks, energies. Feasibility is CVXPY's word alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.transform import constraints, drop_limits, stated_sizes

H, T = 0.1, 20
NEEDED = 1.0 / (H * T / 2) ** 2
"""Acceleration that takes the double integrator one metre in T steps, from rest to rest: bang, bang."""

BINS = range(T // 2 + 1)
SPEED = [[0.0, 1.0]]


def carriage(**changes: Any) -> lfo.OptimalControlProblem:
    """Return one metre from rest to rest, in two seconds."""
    plant = lfo.LinearDynamics([[1.0, H], [0.0, 1.0]], [[H**2 / 2], [H]], sampling_time=H)
    fields = {"cost": lfo.QuadraticCost(R=1.0), "initial_state": [0.0, 0.0], "terminal_state": [1.0, 0.0]}
    return lfo.OptimalControlProblem(plant, T, **(fields | changes))


LEAST = lfo.solve(carriage())
"""The least control that there is: sum u_t^2 / 2 = LEAST.cost. The sum over all bins of |u_k|^2, each pair once, is
half of T sum u_t^2 and half of bins 0 and T/2, which are single."""

SPECTRUM = np.abs(np.fft.rfft(LEAST.control[:, 0])) ** 2

BOUND, START, END = "control bound on u_0", "initial state", "terminal state"
INFEASIBLE = {  # name: changes, family
    "an energy bound": (
        {"control_spectrum": lfo.spectrum.EnergyBound(0.5 * float(SPECTRUM.sum()), bins=BINS)},
        {START, END, "energy bound on u_0"},
    ),
    "a mask and a bound": (
        {
            "control_set": lfo.Box(-1.02 * NEEDED, 1.02 * NEEDED),
            "control_spectrum": lfo.MagnitudeBound(1.0, bins=range(5, 11)),
        },
        {START, END, BOUND, "mask on u_0"},
    ),
    "a mask on a state": (
        {"state_spectrum": lfo.MagnitudeBound(6.0, bins=BINS, component=1)},
        {START, END, "mask on x_1"},
    ),
    "a mask on an output": (
        {"output_spectrum": lfo.spectrum.OutputSpectrum(SPEED, None, lfo.MagnitudeBound(6.0, bins=BINS))},
        {START, END, "mask on y_0"},
    ),
    "a ball": ({"control_set": lfo.sets.Ball(0.7 * NEEDED)}, {START, END, "control set"}),
    "a polyhedron": (
        {"control_set": lfo.sets.Polyhedron([[1.0], [-1.0]], [0.7 * NEEDED, 0.8 * NEEDED])},
        {START, END, "control set"},
    ),
    "an ellipsoid of states": ({"state_set": lfo.sets.Ellipsoid(SPEED, 0.3)}, {START, END, "state set"}),
    "a terminal ball": (
        {"control_set": lfo.Box(-0.7 * NEEDED, 0.7 * NEEDED), "terminal_state": lfo.sets.Ball(0.1, [1.0, 0.0])},
        {START, END, BOUND},
    ),
    "one of several that do not matter": (
        {
            "control_set": lfo.sets.Ball(3 * NEEDED),
            "state_set": lfo.sets.Ellipsoid(SPEED, 0.3),
            "control_spectrum": lfo.MagnitudeBound(50.0, bins=BINS),
            "output_spectrum": lfo.spectrum.OutputSpectrum(None, [[1.0]], lfo.MagnitudeBound(50.0, bins=BINS)),
        },
        {START, END, "state set"},
    ),
}


def feasible(problem: lfo.OptimalControlProblem) -> bool:
    """Whether CVXPY finds a point, with the least control, so that its answer is a sharp one."""
    program = lfo.to_cvxpy(replace(problem, cost=lfo.QuadraticCost(R=1e-2)))
    program.solve(solver=cp.CLARABEL)
    assert program.status in ("optimal", "infeasible")
    return program.status == "optimal"


EVERY_OTHER = seeds(list(INFEASIBLE)[::2])
"""Each takes seconds; scripts/verify.py explains fifty random problems."""


@cache
def explained(name: str) -> tuple[lfo.OptimalControlProblem, lfo.results.Result, lfo.results.Explanation]:
    problem = carriage(**INFEASIBLE[name][0])
    return problem, lfo.solve(problem, throw=False), lfo.explain(problem)


@expensive
@pytest.mark.parametrize("name", EVERY_OTHER)
def test_the_conflict_names_the_family_and_rests_on_a_proof(name):
    problem, result, explanation = explained(name)
    assert result.status == "infeasible"
    assert prove_infeasible(problem, result.ray).bound.value > 0
    assert set(explanation.family) == INFEASIBLE[name][1]
    assert {one.block for one in result.conflict} >= set(explanation.family)


@expensive
@pytest.mark.parametrize("name", EVERY_OTHER)
def test_the_family_clashes_and_can_spare_no_block(name):
    problem, _, explanation = explained(name)
    assert explanation.irreducible
    named = {block.name: block for block in constraints(problem)}
    assert set(explanation.family) <= set(named)
    others = [block for block in named.values() if block.name not in explanation.family]
    assert not feasible(drop_limits(problem, others))
    for member in explanation.family:
        assert feasible(drop_limits(problem, [*others, named[member]])), member


@pytest.mark.parametrize("name", EVERY_OTHER)
def test_a_cure_cures_and_less_does_not(name):
    problem, _, explanation = explained(name)
    named = {block.name: block for block in constraints(problem)}
    cures = {cure.block: cure for cure in explanation.cures}
    assert set(cures) == set(explanation.family)  # each of them can give way alone
    for block in (named[one] for one in cures):
        if block.end is not None:
            continue  # in the sizes of the states; tried below
        amount = cures[block.name].amount
        assert feasible(block.relaxed(problem, 1.001 * amount)), block.name
        assert not feasible(block.relaxed(problem, 0.95 * amount)), block.name


@pytest.mark.parametrize("name", seeds(["an energy bound", "a mask and a bound", "a ball"]))
def test_an_end_gives_way_by_the_least_that_cures(name):
    """Its amount is the sum of the changes of its components, relative to the sizes that the data state of them."""
    problem, _, explanation = explained(name)
    amount = {cure.block: cure.amount for cure in explanation.cures}[END]
    wanted, sizes = problem.terminal_state.lower, stated_sizes(problem)[0]
    for factor, cures in ((1.001, True), (0.95, False)):
        F = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) / sizes
        end = lfo.sets.Polyhedron(F, factor * amount + F @ wanted)
        assert feasible(replace(problem, terminal_state=end)) is cures


@expensive
def test_limits_are_told_as_they_were_given():
    _, _, energy = explained("an energy bound")
    words = {cure.block: cure.words for cure in energy.cures}["energy bound on u_0"]
    before, after = (float(one) for one in words.removeprefix("limit ").split(" -> "))
    assert before == pytest.approx(0.5 * SPECTRUM.sum(), rel=1e-5)
    cured = carriage(control_spectrum=lfo.spectrum.EnergyBound(1.001 * after, bins=BINS))
    assert feasible(cured)
    assert not feasible(carriage(control_spectrum=lfo.spectrum.EnergyBound(0.95 * after, bins=BINS)))
    _, _, mask = explained("a mask and a bound")
    words = {cure.block: cure.words for cure in mask.cures}["mask on u_0"]
    assert words.startswith("limit 1 -> 1.3")
    _, _, ball = explained("a ball")
    assert "control set: limit 0.7 -> 1.000" in str(ball)


@expensive
def test_known_amounts():
    """What bang, bang needs, and what keeps a speed limit for all but one step."""
    assert {cure.block: cure.amount for cure in explained("a ball")[2].cures}["control set"] == pytest.approx(
        0.3 * NEEDED, rel=1e-3
    )
    limits = explained("an ellipsoid of states")[2]
    assert {cure.block: cure.amount for cure in limits.cures}["state set"] == pytest.approx(
        1 / (H * (T - 1)) - 0.3, rel=1e-3
    )


@expensive
def test_prices_of_soft_constraints_are_no_part_of_a_cure():
    """Whatever they cost: a cure is the least change, not the cheapest point."""
    bounded = lfo.Box(-0.7 * NEEDED, 0.7 * NEEDED)
    plain = {cure.block: cure.amount for cure in lfo.explain(carriage(control_set=bounded)).cures}
    soft = carriage(
        control_set=bounded & lfo.sets.Soft(lfo.sets.Ball(0.1 * NEEDED), 20.0),
        control_spectrum=lfo.MagnitudeBound(0.1, bins=BINS, penalty=20.0),
        output_spectrum=lfo.spectrum.OutputSpectrum(
            SPEED, None, lfo.spectrum.EnergyBound(0.1, bins=BINS, penalty=20.0)
        ),
        stage_rows=lfo.StageRows(SPEED, None, [0.1], penalty=20.0),
    )
    assert {cure.block: cure.amount for cure in lfo.explain(soft).cures} == pytest.approx(plain, rel=1e-3)
