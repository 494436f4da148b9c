"""One problem solved again and again: the answers of ``solve``, whatever was kept of solves before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.methods.structured import assemble_stages
from lin_freq_ocp.solving import Resolver
from lin_freq_ocp.transform import Change

PENDULUM = lfo.library.pendulum(horizon=60, sampling_time=0.04)
SHORT = lfo.library.double_integrator(horizon=30, sampling_time=0.1, cutoff_hz=2.0, speed_bound=0.5)
TIMES = np.arange(30)
VARYING = replace(
    SHORT,
    dynamics=lfo.LinearDynamics(
        SHORT.dynamics.A + 0.02 * np.sin(TIMES)[:, None, None], SHORT.dynamics.B, sampling_time=0.1
    ),
)
IN_A_DIAMOND = replace(SHORT, state_set=lfo.sets.Polyhedron([[1.0, 1.0], [-1.0, 1.0]], [1.3, 1.3]))
SOFT = replace(SHORT, state_set=lfo.sets.Soft(lfo.Box([-1, -0.2], [1, 0.2]), 1.0))
CASES = {
    "spectral": (PENDULUM, "auto"),
    "a polyhedron": (IN_A_DIAMOND, "auto"),
    "structured": (VARYING, "structured"),
    "in turn": (VARYING, "auto"),
    "soft": (SOFT, "structured"),
    "convex": (SHORT, "convex"),
}


@pytest.mark.parametrize("name", seeds(CASES))
def test_answers_are_those_of_solve(name):
    problem, method = CASES[name]
    solver, start = lfo.Solver(problem, method), problem.initial_state.lower
    size = np.abs(problem.terminal_state.lower - start).max()
    for scale in (0.0, 0.003, -0.002):
        move = {"initial_state": start + scale * size, "terminal_state": problem.terminal_state.lower - scale * size}
        again, fresh = solver.solve(**move), lfo.solve(problem.with_ends(**move), method)
        assert (again.status, again.reason) == (fresh.status, fresh.reason)
        assert again.method in (fresh.method, "condensed")
        assert again.certificate.globally_optimal
        assert again.cost == pytest.approx(fresh.cost, rel=1e-7)
        assert again.options == fresh.options


@pytest.mark.parametrize("method", ["spectral", "structured"])
def test_references_change_and_come_back(method):
    problem = replace(SHORT, cost=lfo.QuadraticCost(Q=np.eye(2), R=0.1), terminal_state=None)
    solver = lfo.Solver(problem, method)
    before = solver.solve()
    moved = solver.solve(references={"x_ref": [0.2, 0.0]}, initial_state=[0.1, 0.0])
    fresh = lfo.solve(problem.with_references({"x_ref": [0.2, 0.0]}).with_ends([0.1, 0.0]), method)
    assert moved.cost == pytest.approx(fresh.cost, rel=1e-8)
    assert moved.problem.cost.x_ref.tolist() == [0.2, 0.0]
    assert solver.solve().cost == pytest.approx(before.cost, rel=1e-8)
    assert abs(moved.cost - before.cost) > 1e-3


def test_an_end_in_another_kind_of_set_is_solved_from_scratch():
    problem = replace(SHORT, terminal_state=lfo.Box([0.2, -0.1], [0.3, 0.1]))
    solver, ball = lfo.Solver(problem), lfo.sets.Ball(0.05, centre=[0.25, 0.0])
    solver.solve()
    assert solver.solve(terminal_state=ball).cost == pytest.approx(
        lfo.solve(problem.with_ends(None, ball)).cost, rel=1e-6
    )


BOUNDS = {"control_set": [lfo.Box(-2, 2)] * 5 + [lfo.Box(0, 0)] * 25}
FIXED = {
    "a start in a box": (SHORT, Change(lfo.Box([-0.1, -0.1], [0.1, 0.1]))),
    "an end of which one component is free": (SHORT, Change(None, lfo.Box([0.2, -np.inf], [0.2, np.inf]))),
    "controls that are off": (replace(SHORT, terminal_state=None), Change([0.0, 0.1], bounds=BOUNDS)),
}


@pytest.mark.parametrize(("problem", "change"), FIXED.values(), ids=FIXED)
def test_other_fixed_values_are_solved_from_scratch(problem, change):
    resolver = Resolver(problem)
    resolver.solve(Change())
    again, fresh = resolver.solve(change), lfo.solve(change.apply(problem))
    assert again.status == fresh.status == "optimal"
    assert again.cost == pytest.approx(fresh.cost, rel=1e-7)


def test_infeasible_states_do_not_spoil_the_next():
    solver, start = lfo.Solver(PENDULUM), PENDULUM.initial_state.lower
    cost = solver.solve().cost
    far = start + np.array([0, 0, -1.5, 0])
    for bad in (far, start + np.array([1.0, 0, 0, 0])):
        assert solver.solve(initial_state=bad, throw=False).status == "infeasible"
    assert solver.solve().cost == pytest.approx(cost, rel=1e-10)


def test_the_structured_method_assembles_once(monkeypatch):
    count, honest = [], assemble_stages
    substitute(monkeypatch, "methods.structured.assemble_stages", lambda problem: count.append(1) or honest(problem))
    solver = lfo.Solver(VARYING, "structured")
    for move in (0.0, 0.01, 0.02):
        solver.solve(initial_state=VARYING.initial_state.lower + move)
    assert len(count) == 1


def test_modes_are_solved_each_time():
    problem = lfo.library.buck_affine(horizon=4)
    solver = lfo.Solver(problem)
    assert solver.solve(throw=False).status == lfo.solve(problem, throw=False).status


def test_bad_calls_say_what_is_wrong():
    solver = lfo.Solver(PENDULUM)
    for given, words in (
        ({"initial_state": [1.0, 2.0]}, "initial_state: got shape"),
        ({"initial_state": [np.nan, 0, 0, 0]}, "initial_state"),
        ({"references": {"Q": 1.0}}, "references.Q: got an unknown key"),
        ({"references": [1.0]}, "references: got list"),
    ):
        with pytest.raises(lfo.errors.ProblemError, match=words):
            solver.solve(**given)
    with pytest.raises(lfo.errors.UnsupportedError, match="method: got 'spektral'"):
        lfo.Solver(PENDULUM, "spektral")
    with pytest.raises(lfo.errors.UnsupportedError, match="depends on time"):
        lfo.Solver(VARYING, "spectral").solve()
    with pytest.raises(lfo.errors.ProblemError, match="references: got some for"):
        lfo.Solver(replace(SHORT, cost=lfo.costs.L1Cost(u=1.0)), "structured").solve(references={"x_ref": 0.0})


@expensive
def test_masks_at_every_frequency_are_judged_by_the_tolerance_of_the_method():
    mask = lfo.MagnitudeBound(1.5, band=lfo.low_pass(0.6), every_frequency=True)
    problem = replace(lfo.library.double_integrator(horizon=100, sampling_time=0.04), control_spectrum=mask)
    structured = lfo.solvers.Structured(tolerance=1e-4)
    results = [
        lfo.solve(problem, "structured", tolerance=1e-4),
        lfo.solve(problem, structured),
        lfo.Solver(problem, structured).solve(),
    ]
    tolerances = [[one.tolerance for one in result.certificate.conditions] for result in results]
    assert tolerances[0] == tolerances[1] == tolerances[2]
    assert max(tolerances[0]) == 1e-4


def test_states_that_hardly_move_do_not_set_the_method_up_again():
    problem = lfo.library.pendulum(horizon=20, terminal_state=None)
    solver, start = Resolver(problem), np.array([0.02, 0.0, 0.0, 0.0])
    caches = set()
    for _ in range(3):  # the position moves by less than a hundredth of what it is
        solver.solve(Change(start))
        caches.add(id(solver.cache_for(problem.with_ends(start))))
    assert len(caches) == 1
