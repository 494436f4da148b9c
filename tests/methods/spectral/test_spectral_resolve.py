"""Solving again with other ends, references and bounds: the same answers as from scratch, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from helpers.spectral_plants import END, LARGE_BOX, START, TIGHT, T, moving, problem_of, residuals, tube, wave
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.methods.spectral import Rows
from lin_freq_ocp.transform import Change

REFERENCE = {"x_ref": wave(T + 1, 3, 0.3, 1), "u_ref": wave(T, 2, 0.2, 2)}


def base_problem(**changes: Any) -> lfo.OptimalControlProblem:
    cost = lfo.QuadraticCost(Q=0.3, R=[[1.0, 0.2], [0.2, 2.0]], S=0.1 * np.ones((3, 2)), P=1.0, p=[0.1, 0, 0])
    return problem_of(**({"cost": cost, "state_set": LARGE_BOX} | changes))


@pytest.fixture(scope="module")
def solver():
    return lfo.SpectralSolver(base_problem())


def with_cost(problem: lfo.OptimalControlProblem, **terms: Any) -> lfo.OptimalControlProblem:
    names = ("Q", "R", "S", "q", "r", "P", "p", "x_ref", "u_ref")
    old = {name: getattr(problem.cost, name) for name in names}
    return replace(problem, cost=lfo.QuadraticCost(**(old | terms)))


def cost_of(solution: lfo.solvers.SpectralSolution) -> float:
    return solution.problem.cost.value(solution.trajectory.x, solution.trajectory.u)


MOVED = {  # name: arguments of solve
    "start": {"initial_state": 1.1 * START},
    "end": {"terminal_state": 0.5 * END},
    "both ends, as points": {"initial_state": lfo.sets.Point(-START), "terminal_state": lfo.sets.Point(0.5 * END)},
    "a reference": {"references": {"x_ref": REFERENCE["x_ref"]}},
    "both references": {"references": REFERENCE},
    "a constant reference": {"references": {"x_ref": [0.3, -0.2, 0.1]}},
    "control bounds": {"bounds": {"control_set": TIGHT}},
    "control bounds per time": {"bounds": {"control_set": moving(T, 2, 0.38, 3)}},
    "no control bounds": {"bounds": {"control_set": None}, "references": {"x_ref": [5.0, 0, 0]}},
    "state bounds": {"bounds": {"state_set": lfo.Box([-1.15, -0.6, -0.27], [1.1, 0.7, 0.5])}},
    "bounds at some times only": {
        "bounds": {"state_set": [lfo.sets.Everything()] * (T - 2) + [lfo.Box(-1.0, 1.0)] * 3}
    },
    "a disturbance": {"disturbance": wave(T, 3, 0.02, 4)},
    "a constant disturbance": {"disturbance": [0.0, 1e-3, 0.0]},
    "everything": {
        "disturbance": wave(T, 3, 0.01, 5),
        "initial_state": 0.8 * START,
        "terminal_state": 0.8 * END,
        "references": REFERENCE,
        "bounds": {"control_set": lfo.Box(-0.55, 0.55), "state_set": lfo.Box(-1.0, 1.0)},
    },
}


def changed(problem: lfo.OptimalControlProblem, **arguments: Any) -> lfo.OptimalControlProblem:
    """Return what solve(**arguments) is to solve."""
    fields = {name: arguments[name] for name in ("initial_state", "terminal_state") if name in arguments}
    problem = replace(problem, **fields, **arguments.get("bounds", {}))
    problem = with_cost(problem, **arguments.get("references", {}))
    return Change(disturbance=arguments.get("disturbance")).apply(problem)


@pytest.mark.parametrize("name", MOVED)
def test_a_solve_with_other_data_is_that_of_the_other_problem(solver, name):
    again = solver.solve(**MOVED[name])
    problem = changed(solver.problem, **MOVED[name])
    fresh = lfo.SpectralSolver(problem).solve()
    assert again.status == fresh.status == "optimal"
    assert cost_of(again) == pytest.approx(problem.cost.value(fresh.trajectory.x, fresh.trajectory.u), rel=1e-10)
    np.testing.assert_allclose(again.trajectory.u, fresh.trajectory.u, atol=1e-9)
    np.testing.assert_allclose(again.multipliers.eta, fresh.multipliers.eta, atol=1e-8)
    assert max(residuals(problem, again.trajectory).values()) < 1e-11
    assert lfo.certify(problem, again.trajectory, again.multipliers).globally_optimal
    assert abs(cost_of(again) - cost_of(solver.solve())) > 1e-4


@pytest.mark.parametrize("ends", ["free", "boxed", "partly fixed"])
def test_ends_that_are_not_points_move_too(ends):
    def box(centre: np.ndarray) -> lfo.Box:
        wide = {"free": [np.inf] * 3, "boxed": [0.1] * 3, "partly fixed": [0.0, np.inf, 0.2]}[ends]
        return lfo.Box(centre - wide, centre + wide)

    problem = base_problem(initial_state=box(START), terminal_state=box(END))
    solver = lfo.SpectralSolver(problem)
    first = cost_of(solver.solve())
    arguments: dict[str, Any] = {"references": REFERENCE}
    if ends != "free":
        arguments |= {"initial_state": box(0.7 * START), "terminal_state": box(-END)}
    again, fresh = solver.solve(**arguments), lfo.SpectralSolver(changed(problem, **arguments)).solve()
    assert cost_of(again) == pytest.approx(cost_of(fresh), rel=1e-10)
    assert cost_of(again) != pytest.approx(first, rel=1e-3)


def test_values_fixed_inside_move_with_their_bounds():
    def inside(value: float) -> lfo.Box:
        return tube(LARGE_BOX, T + 1, t10_1=value, t15_0=-value)

    solver = lfo.SpectralSolver(base_problem(state_set=inside(0.2)))
    again = solver.solve(bounds={"state_set": inside(-0.1)})
    assert again.trajectory.x[10, 1] == pytest.approx(-0.1, abs=1e-12)
    fresh = lfo.SpectralSolver(base_problem(state_set=inside(-0.1))).solve()
    assert cost_of(again) == pytest.approx(cost_of(fresh), rel=1e-10)


def test_bands_and_joint_rows_stay():
    rows = lfo.StageRows([[1.0, 0, 0.5]], [[1.0, -1.0]], [0.9])
    problem = base_problem(stage_rows=rows, state_spectrum=lfo.stop_band(bins=[4], component=1))
    again = lfo.SpectralSolver(problem).solve(references=REFERENCE, initial_state=0.9 * START)
    fresh = lfo.SpectralSolver(changed(problem, references=REFERENCE, initial_state=0.9 * START)).solve()
    assert cost_of(again) == pytest.approx(cost_of(fresh), rel=1e-10)
    assert again.multipliers.stage["stage rows"].max() > 1e-3


def test_a_solve_leaves_the_solver_as_it_was(solver):
    problem = solver.problem
    before = solver.solve()
    for name in MOVED:
        solver.solve(**MOVED[name])
    solver.solve(initial_state=[1.2, 0.7, 0.5], bounds={"control_set": lfo.Box(-0.01, 0.01)})
    after = solver.solve()
    # the last digit depends on where arrays lie in memory
    np.testing.assert_allclose(after.trajectory.u, before.trajectory.u, rtol=0, atol=1e-13)
    np.testing.assert_allclose(after.multipliers.eta, before.multipliers.eta, rtol=0, atol=1e-12)
    assert solver.problem is problem is after.problem


def test_infeasible_new_data_are_proven_so(solver):
    answer = solver.solve(bounds={"control_set": lfo.Box(-0.05, 0.05)})
    assert answer.status == "infeasible"
    assert answer.trajectory is None
    assert lfo.solve(answer.problem, method="convex", throw=False).status == "infeasible"


@pytest.mark.parametrize("name", MOVED)
def test_a_warm_start_changes_nothing_but_the_rounds(solver, name):
    cold = solver.solve(**MOVED[name])
    warm = solver.solve(**MOVED[name], warm_start=cold)
    assert warm.status == "optimal"
    assert warm.rounds <= cold.rounds
    assert cost_of(warm) == pytest.approx(cost_of(cold), rel=1e-10)
    np.testing.assert_allclose(warm.trajectory.u, cold.trajectory.u, atol=1e-9)


def test_a_warm_start_saves_rounds_where_the_active_rows_stay():
    problem = lfo.library.pendulum()
    solver = lfo.SpectralSolver(problem)
    first = solver.solve()
    start = 0.999 * problem.initial_state.lower
    cold, warm = solver.solve(initial_state=start), solver.solve(initial_state=start, warm_start=first)
    assert (cold.status, warm.status) == ("optimal", "optimal")
    assert warm.rounds < cold.rounds
    assert cost_of(warm) == pytest.approx(cost_of(cold), rel=1e-10)


@expensive
@pytest.mark.parametrize("sampling_time", [0.01, 0.1])
def test_a_chain_of_moved_starts_is_solved_as_from_scratch(sampling_time):
    """From the second solve on, all responses of all bounded values are kept: another path than the first one."""
    problem = lfo.library.pendulum(sampling_time=sampling_time)
    solver, rng = lfo.SpectralSolver(problem), np.random.default_rng(3)
    solution = solver.solve()
    for _ in range(6):
        start = problem.initial_state.lower + np.array([0.001, 0.002, 0.01, 0.02]) * rng.standard_normal(4)
        solution = solver.solve(initial_state=start, warm_start=solution)
        scratch = lfo.SpectralSolver(problem.with_ends(initial_state=start)).solve()
        assert (solution.status, scratch.status) == ("optimal", "optimal")
        assert cost_of(solution) == pytest.approx(cost_of(scratch), rel=1e-10)


@expensive
def test_infeasible_starts_are_proven_so_and_the_next_feasible_one_is_solved():
    problem = lfo.library.pendulum()
    solver, start = lfo.SpectralSolver(problem), problem.initial_state.lower
    solver.solve()
    found = [solver.solve(initial_state=start + np.array([0, 0, speed, 0])) for speed in (-0.6, -0.7, 0.01)]
    assert [one.status for one in found] == ["infeasible", "infeasible", "optimal"]
    for one in found[:2]:
        assert prove_infeasible(one.problem, one.ray).bound.kind == "rigorous"


@pytest.mark.parametrize("terminal", [None, lfo.Box(END - 0.05, END + 0.05), lfo.Box(END, [*END[:2], np.inf])])
def test_ends_that_move_together_are_solved_as_from_scratch(terminal):
    problem = base_problem(terminal_state=terminal, state_spectrum=lfo.stop_band(bins=[4], component=1))
    solver = lfo.SpectralSolver(problem)
    for scale in (1.0, 0.9, 0.8, 1.1):
        moved = {"initial_state": scale * START}
        if scale == 1.1 and terminal is not None:
            moved["terminal_state"] = lfo.Box(0.9 * terminal.lower, 0.9 * terminal.upper)
        again, fresh = solver.solve(**moved), lfo.SpectralSolver(problem.with_ends(**moved)).solve()
        assert again.status == fresh.status == "optimal"
        assert cost_of(again) == pytest.approx(cost_of(fresh), rel=1e-10)


def test_an_end_in_another_box_is_another_bound():
    problem = base_problem(terminal_state=lfo.Box(END - 0.05, END + 0.05))
    single, wider = lfo.SpectralSolver(problem), lfo.Box(END - 0.05, END + 0.3)
    narrow, wide = single.solve(), single.solve(terminal_state=wider)
    scratch = lfo.SpectralSolver(problem.with_ends(terminal_state=wider)).solve()
    assert cost_of(wide) == pytest.approx(cost_of(scratch), rel=1e-10)
    assert cost_of(wide) < cost_of(narrow) * (1 - 1e-4)


def test_a_warm_start_may_name_both_bounds_of_a_row(solver):
    cold = solver.solve(bounds={"control_set": TIGHT})
    t, f, sign, weights = cold.active
    both = Rows(np.tile(t, 2), np.tile(f, 2), np.concatenate([sign, -sign]), np.tile(weights, 2))
    warm = solver.solve(bounds={"control_set": TIGHT}, warm_start=replace(cold, active=both))
    assert cost_of(warm) == pytest.approx(cost_of(cold), rel=1e-10)


def test_a_warm_start_from_far_away_is_harmless(solver):
    far = solver.solve(initial_state=[-1.2, 0.6, -0.3], terminal_state=[1.0, -0.6, 0.3], bounds={"control_set": None})
    tight = solver.solve(bounds={"control_set": TIGHT}, warm_start=far)
    assert cost_of(tight) == pytest.approx(cost_of(solver.solve(bounds={"control_set": TIGHT})), rel=1e-10)
    infeasible = solver.solve(bounds={"control_set": lfo.Box(-0.05, 0.05)})
    assert cost_of(solver.solve(warm_start=infeasible)) == pytest.approx(cost_of(solver.solve()), rel=1e-10)


def test_a_warm_start_may_name_rows_whose_bounds_are_gone(solver):
    tight = solver.solve(bounds={"control_set": TIGHT})
    free = solver.solve(bounds={"control_set": None}, warm_start=tight)
    assert cost_of(free) == pytest.approx(cost_of(solver.solve(bounds={"control_set": None})), rel=1e-10)


REFUSED = {
    "a fixed start set free": ({"initial_state": lfo.Box(START - 0.1, START + 0.1)}, "initial_state"),
    "a fixed end set free": ({"terminal_state": lfo.Box(END, END + np.eye(3)[1])}, "terminal_state"),
    "a start of the wrong size": ({"initial_state": [1.0, 2.0]}, "initial_state"),
    "a start that is not a number": ({"initial_state": [np.nan, 0.0, 0.0]}, "initial_state"),
    "an unknown bound": ({"bounds": {"control_sets": TIGHT}}, "bounds.control_sets"),
    "ends among the bounds": ({"bounds": {"initial_state": START}}, "bounds.initial_state"),
    "an unknown reference": ({"references": {"Q": 1.0}}, "references.Q"),
    "a reference of the wrong size": ({"references": {"x_ref": np.zeros((T, 3))}}, "cost.x_ref"),
    "references in a list": ({"references": [REFERENCE["x_ref"]]}, "references"),
    "bounds that are no mapping": ({"bounds": TIGHT}, "bounds"),
    "bounds of the wrong size": ({"bounds": {"control_set": lfo.Box([-1.0], [1.0])}}, "control_set"),
    "a tolerance below zero": ({"tolerance": -1.0}, "tolerance"),
    "no time at all": ({"time_limit": 0.0}, "time_limit"),
    "a warm start from elsewhere": ({"warm_start": np.zeros(3)}, "warm_start"),
    "values that are now fixed": ({"bounds": {"control_set": lfo.Box([-1.0, 0.0], [1.0, 0.0])}}, "bounds"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_data_that_do_not_fit_are_refused_by_name(solver, name):
    arguments, field = REFUSED[name]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        solver.solve(**arguments)
    assert str(caught.value).startswith(field)
    assert str(caught.value).removeprefix(field)[0] in ":["


@pytest.mark.parametrize(
    "given",
    [{"initial_state": [1.0, 0.9, 0.0]}, {"bounds": {"state_set": lfo.Box(-1.0, [1.0, 0.5, 1.0])}}],
    ids=["a start outside its bounds", "an end outside its new bounds"],
)
def test_an_end_outside_the_state_set_is_infeasible_with_a_ray(solver, given):
    found = solver.solve(**given)
    assert (found.status, found.trajectory) == ("infeasible", None)
    assert prove_infeasible(found.problem, found.ray).bound.kind == "rigorous"


def test_a_free_end_cannot_be_fixed_afterwards():
    solver = lfo.SpectralSolver(base_problem(terminal_state=None))
    with pytest.raises(lfo.errors.ProblemError, match="terminal_state: got other fixed components"):
        solver.solve(terminal_state=END)


def test_values_that_were_fixed_cannot_be_freed_afterwards():
    solver = lfo.SpectralSolver(base_problem(control_set=lfo.Box([-0.7, 0.0], [0.6, 0.0]), terminal_state=None))
    with pytest.raises(lfo.errors.ProblemError, match="bounds: got other values fixed"):
        solver.solve(bounds={"control_set": TIGHT})


@pytest.mark.parametrize(
    "changes", [{"bounds": {"control_set": lfo.sets.Ball(0.01)}}, {"terminal_state": lfo.sets.Ball(0.1)}]
)
def test_new_sets_that_are_no_boxes_are_refused(changes):
    with pytest.raises(lfo.errors.UnsupportedError, match="only boxes"):
        lfo.SpectralSolver(lfo.library.double_integrator()).solve(**changes)


def test_a_disturbance_does_not_fit_rows_on_the_end():
    """They are rows on the step before, with the old offset in their limits."""
    corner = lfo.sets.Polyhedron([[1.0, 1.0, 0.0]], [0.2])
    solver = lfo.SpectralSolver(base_problem(terminal_state=corner))
    assert solver.solve().status == "optimal"
    with pytest.raises(lfo.errors.UnsupportedError, match="a disturbance moves the rows of a polyhedron at the end"):
        solver.solve(disturbance=[0.0, 0.1, 0.0])
    with pytest.raises(lfo.errors.ProblemError, match=r"disturbance: got shape \(2,\)"):
        lfo.SpectralSolver(base_problem()).solve(disturbance=[0.0, 0.1])
