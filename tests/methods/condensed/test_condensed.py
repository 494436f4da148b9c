"""The condensed method: proven plans, the same from C and from NumPy, and refusals."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.dense_kernel import DenseKernel
from helpers.loops import LOOPS, pendulum, states
from helpers.random.linear import random_linear
from helpers.seeds import expensive, seeds
from lin_freq_ocp import SpectralSolver
from lin_freq_ocp.certificate import judge, prove_infeasible
from lin_freq_ocp.methods import (
    INFEASIBLE,
    SOLVED,
    CondensedSolver,
    CondensedTables,
    NativeKernel,
    condense,
    extremals_of,
    library,
    unsettled_plan,
)
from lin_freq_ocp.methods.spectral import lti_problem, natural_units
from lin_freq_ocp.transform import Change

FIELDS = ("eta", "mu", "nu", "rho_u")
GAP, APART = 1e-8, 1e-8  # relative gap of a plan; difference of two kernels in units of order 1


def solver_of(problem: lfo.OptimalControlProblem) -> tuple[SpectralSolver, CondensedSolver]:
    spectral = SpectralSolver(problem)
    return spectral, CondensedSolver(spectral.lti, spectral.units)


def tables_of(problem: lfo.OptimalControlProblem) -> CondensedTables:
    return condense(lti_problem(problem, natural_units(problem)))


@cache
def compiled():
    found = library()
    if found is None:
        pytest.skip("no C compiler")
    return found


@needs_kernel
@pytest.mark.parametrize("name", seeds(LOOPS))
def test_plans_are_proven_and_cost_what_the_sparse_program_costs(name):
    problem = LOOPS[name]()
    spectral, solver = solver_of(problem)
    proven = 0
    for k, start in enumerate(states(problem, 12)):
        plan = solver.plan(start, spectral.lti)
        stated = problem.with_ends(start)
        if plan is None or not plan.eta_C:
            assert lfo.solve(stated, "convex", throw=False).status == "infeasible"
            continue
        candidate = plan.candidate(stated)
        certificate = judge(stated, candidate.trajectory, candidate.multipliers)
        assert certificate.pmp == "satisfied"
        assert certificate.gap <= GAP
        np.testing.assert_allclose(candidate.trajectory.u[0], plan.control, atol=1e-12 * np.abs(plan.control).max())
        proven += 1
        if k == 0:
            assert certificate.cost == pytest.approx(lfo.solve(stated, "convex").cost, rel=1e-8)
    assert proven >= 8


@needs_kernel
@pytest.mark.parametrize("name", LOOPS)
def test_plans_in_arrays_are_the_plans_one_by_one(name):
    problem = LOOPS[name]()
    spectral, solver = solver_of(problem)
    starts = states(problem, 6)
    found, interrupted = solver.plan_batch(starts, spectral.lti)
    assert found
    assert not interrupted
    batch = extremals_of(problem, list(found.values()))
    for k, (number, plan) in enumerate(found.items()):
        candidate = plan.candidate(problem.with_ends(starts[number]))
        pairs = [(batch.x[k], candidate.trajectory.x), (batch.u[k], candidate.trajectory.u)]
        pairs += [(getattr(batch, field)[k], getattr(candidate.multipliers, field)) for field in FIELDS]
        pairs += [(batch.stage[term][k], on_term) for term, on_term in candidate.multipliers.stage.items()]
        for values, expected in pairs:
            np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max(initial=0.0))
        assert batch.stage.keys() == candidate.multipliers.stage.keys()


@pytest.mark.parametrize("name", LOOPS)
def test_both_kernels_agree(name):
    problem = LOOPS[name]()
    units, tables = natural_units(problem), tables_of(problem)
    kernels = NativeKernel(tables, compiled()), DenseKernel(tables)
    for start in states(problem, 20, seed=1) * 1.5:
        statuses = [kernel.step(start / units.x) for kernel in kernels]
        assert statuses[0] == statuses[1]
        if statuses[0] == SOLVED:
            np.testing.assert_allclose(kernels[0].plan, kernels[1].plan, atol=APART)
            np.testing.assert_allclose(kernels[0].control, kernels[1].control, atol=APART)
            plans = [
                tables.recover((start / units.x)[None], k.plan[:, None], k.multipliers[..., None]) for k in kernels
            ]
            np.testing.assert_allclose(plans[0].x, plans[1].x, atol=APART)


@pytest.mark.parametrize("kind", ["native", "dense"])
def test_a_warm_step_is_that_of_a_cold_one(kind):
    problem = LOOPS["soft bounds"]()
    units, tables = natural_units(problem), tables_of(problem)

    def kernel():
        return NativeKernel(tables, compiled()) if kind == "native" else DenseKernel(tables)

    warm = kernel()
    for start in states(problem, 15, seed=2) / units.x:
        cold = kernel()
        assert (warm.step(start), cold.step(start)) == (SOLVED, SOLVED)
        np.testing.assert_allclose(warm.plan, cold.plan, atol=APART)


NARROWER = np.array([0.05, 0.03, 0.2, 0.5])
KERNELS = {"native": lambda tables: NativeKernel(tables, compiled()), "dense": DenseKernel}


@expensive
@pytest.mark.parametrize("kind", KERNELS)
@pytest.mark.parametrize("price", [10.0, 300.0])
def test_every_step_ends_at_the_conditions_of_its_program(kind, price):
    """xi = -M'lambda, and each row is within its bounds, on the one of its multiplier, or beyond it at its limit."""
    problem = pendulum(
        20, None, state_set=lfo.sets.Soft(lfo.Box(-NARROWER, NARROWER), price), control_set=lfo.Box(-5, 5)
    )
    units, tables = natural_units(problem), tables_of(problem)
    kernel, rows, exceeded = KERNELS[kind](tables), DenseKernel(tables), np.zeros(2, dtype=int)
    low, high = (np.abs(limit).ravel() for limit in tables.limits)
    for start in 6 * states(problem, 30, seed=4) / units.x:
        assert kernel.step(start) == SOLVED
        multipliers, xi = kernel.multipliers.ravel(), kernel.unknowns
        np.testing.assert_allclose(xi, -rows.gradients.T @ multipliers, atol=APART)
        assert ((multipliers <= high) & (multipliers >= -low)).all()
        y = rows.of_start @ np.append(start, 1.0) + rows.gradients @ xi
        above, below = y - rows.upper, rows.lower - y
        for beyond, normal, limit in ((above, multipliers, high), (below, -multipliers, low)):
            assert (beyond[normal < limit] <= APART).all()
            assert (beyond[normal > 0] >= -APART).all()
        exceeded += [(multipliers == high).sum(), (multipliers == -low).sum()]
    assert (exceeded > 400).all()


@pytest.mark.parametrize("kind", KERNELS)
def test_rows_contradict_each_other_from_a_millionth_of_their_size_on(kind):
    dynamics, bounds = (
        lfo.LinearDynamics([[1.0]], [[1.0]]),
        {"state_set": lfo.Box(-1, 1), "control_set": lfo.Box(-1, 1)},
    )
    cost = lfo.QuadraticCost(Q=0.1, R=1.0)
    problem = lfo.OptimalControlProblem(horizon=3, dynamics=dynamics, cost=cost, initial_state=[0.0], **bounds)
    units, kernel = natural_units(problem), KERNELS[kind](tables_of(problem))
    for side in (1, -1):
        statuses = [kernel.step(np.array([side * (2 + far)]) / units.x) for far in (-1e-6, 1e-9, 1e-6)]
        assert statuses == [SOLVED, SOLVED, INFEASIBLE]


def test_where_there_is_no_plan_the_last_one_goes_on_with_its_feedback():
    tables = tables_of(LOOPS["two controls"]())
    kernel, m = NativeKernel(tables, compiled()), tables.loop.shape[2]
    assert kernel.step(0.3 * states(LOOPS["two controls"](), 1)[0]) == SOLVED
    plan, far = kernel.plan, np.full(tables.loop.shape[1], 1e3)
    for _ in range(2):
        assert kernel.step(far) == INFEASIBLE
        plan = np.concatenate([plan[m:], plan[-m:]])
        np.testing.assert_array_equal(kernel.plan, plan)
        np.testing.assert_allclose(kernel.control, plan[:m] + tables.loop.K @ far, rtol=1e-12)


@pytest.mark.parametrize("kind", ["native", "dense"])
def test_contradictory_rows_leave_the_next_step_as_it_is(kind):
    problem = LOOPS["low pass"]()
    units, tables = natural_units(problem), tables_of(problem)
    kernel = NativeKernel(tables, compiled()) if kind == "native" else DenseKernel(tables)
    start = states(problem, 1)[0] / units.x
    assert kernel.step(start) == SOLVED
    plan = kernel.plan.copy()
    assert kernel.step(np.array([0.0, 50.0, 0.0, 0.0]) / units.x) == INFEASIBLE
    assert kernel.step(start) == SOLVED
    np.testing.assert_allclose(kernel.plan, plan, atol=APART)


@pytest.mark.parametrize("name", seeds(["low pass", "rate limit", "fixed end", "two controls", "joint rows"]))
def test_contradictory_rows_are_a_ray_that_the_judge_proves(name):
    compiled()
    problem = LOOPS[name]()
    spectral, solver = solver_of(problem)
    proven = 0
    for scale in (1.0, 4.0, 10.0, 30.0):
        for start in scale * states(problem, 4, seed=3):
            answer = solver.plan(start, spectral.lti)
            if answer is None or answer.eta_C:
                continue
            stated = problem.with_ends(start)
            candidate = answer.candidate(stated)
            assert candidate.trajectory is None
            assert candidate.ray.eta_C == 0
            proof = prove_infeasible(stated, candidate.ray)
            assert proof is not None
            assert proof.bound.kind == "rigorous"
            proven += 1
            assert prove_infeasible(problem.with_ends(0.1 * states(problem, 1)[0]), candidate.ray) is None
    assert proven >= 3


def test_a_ray_is_none_of_a_step_with_a_plan():
    tables = tables_of(LOOPS["low pass"]())
    for kernel in (NativeKernel(tables, compiled()), DenseKernel(tables)):
        assert kernel.step(np.array([0.0, 50.0, 0.0, 0.0])) == INFEASIBLE
        assert kernel.ray is not None
        np.testing.assert_allclose(np.tensordot(kernel.ray.ravel(), DenseKernel(tables).gradients, 1), 0, atol=1e-9)
        for state, status in ((np.full(4, 0.01), SOLVED), (np.full(4, np.nan), INFEASIBLE)):
            assert kernel.step(state) == status
            assert kernel.ray is None


def test_a_state_that_is_not_finite_changes_nothing():
    tables = tables_of(LOOPS["low pass"]())
    for kernel in (NativeKernel(tables, compiled()), DenseKernel(tables)):
        assert kernel.step(np.full(4, 0.01)) == SOLVED
        plan = kernel.plan.copy()
        assert kernel.step(np.full(4, np.nan)) == INFEASIBLE
        assert kernel.step(np.full(4, 0.01)) == SOLVED
        np.testing.assert_allclose(kernel.plan, plan, atol=APART)


@needs_kernel
def test_other_references_offsets_bounds_and_ends():
    problem = LOOPS["fixed end"]()
    spectral, solver = solver_of(problem)
    start = 0.3 * states(problem, 1)[0]
    changes = {
        "x_ref": dict(references={"x_ref": np.linspace(0, 0.02, 121)[:, None] * [1, 0, 0, 0]}),
        "end": dict(terminal_state=[0.01, 0.0, 0.0, 0.0]),
        "bounds": dict(bounds={"control_set": lfo.Box(-1.5, 2.0)}),
        "disturbance": dict(disturbance=1e-4 * np.sin(np.arange(120))[:, None] * np.ones(4)),
        "nothing": {},
        "another end alone": dict(terminal_state=[0.005, 0.0, 0.0, 0.0]),
    }
    for name, change in changes.items():
        stated, lti = spectral.changed_problem(Change(start, **change))
        plan = solver.plan(start, lti)
        assert plan is not None
        assert plan.eta_C, name
        candidate = plan.candidate(stated)
        certificate = judge(stated, candidate.trajectory, candidate.multipliers)
        assert (certificate.feasible, certificate.gap <= GAP) == (True, True), name


@needs_kernel
def test_the_rest_of_a_plan_repeats_its_last_move():
    problem = LOOPS["low pass"]()
    spectral, solver = solver_of(problem)
    plan = solver.plan(states(problem, 1)[0], spectral.lti)
    last = plan.trajectory
    rest = replace(plan, start=last.x[1]).following(last)
    np.testing.assert_allclose(rest.v, np.append(plan.v[1:], plan.v[-1]), atol=1e-12)
    np.testing.assert_allclose(rest.control, last.u[1], atol=1e-12)
    np.testing.assert_allclose(rest.trajectory.u[:-1], last.u[1:], atol=1e-9)


def test_the_worth_of_a_plan_is_its_cost_with_prices():
    problem = pendulum(20, None, state_set=lfo.sets.Soft(lfo.Box(-NARROWER, NARROWER), 5.0))
    problem = problem.with_references({"x_ref": [0.01, 0.0, 0.0, 0.0], "u_ref": [0.1]})
    spectral, tables = SpectralSolver(problem), tables_of(problem)
    start, v = states(problem, 1)[0], 0.1 * np.random.default_rng(0).standard_normal(20)
    plan = unsettled_plan(tables, spectral.units, start, v, 0)
    x, u = plan.trajectory.x, plan.trajectory.u
    cost = (tables.worth(start / spectral.units.x, v)[1] + spectral.lti.constant) * spectral.units.cost
    assert problem.value(x, u) > problem.quadratic.value(x, u)
    assert cost == pytest.approx(problem.value(x, u), rel=1e-9)


@needs_kernel
def test_bounds_that_stand_for_none_loosen_nothing():
    problem = pendulum(20, control_set=lfo.Box(-0.8, 1e9))
    spectral, solver = solver_of(problem)
    start = np.array([0.04, 0.0, 0.1, 0.0])
    plan = solver.plan(start, spectral.lti)
    candidate = plan.candidate(problem.with_ends(start))
    assert candidate.trajectory.u.min() >= -0.8 - 1e-8
    assert judge(problem.with_ends(start), candidate.trajectory, candidate.multipliers).gap <= GAP


@pytest.mark.parametrize("seed", [5, 11, 27, 58, 149, 168, 203, 230, 240, 516, 547])
def test_random_problems_in_any_units(seed):
    sample = random_linear(seed)
    for problem in (sample.good, sample.problem):
        try:
            spectral, solver = solver_of(problem)
        except lfo.errors.UnsupportedError:
            continue
        plan = solver.plan(spectral.problem.initial_box.lower, spectral.lti)
        if plan is not None and plan.eta_C:
            candidate = plan.candidate(spectral.problem)
            certificate = judge(spectral.problem, candidate.trajectory, candidate.multipliers)
            assert certificate.feasible
            assert certificate.gap <= 1e-6


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (lambda: replace(pendulum(20), initial_state=None), "initial state is not fixed"),
        (lambda: pendulum(1200, None), "it takes 600"),
        (lambda: pendulum(30, 0.05 * np.pi, terminal_state=np.zeros(4)), "contradict each other"),
    ],
)
def test_refusals_say_why(problem, words):
    stated = problem()
    with pytest.raises(lfo.errors.UnsupportedError, match=words):
        condense(lti_problem(stated, natural_units(stated)))


@needs_kernel
def test_a_solver_can_be_copied_and_shared():
    problem = LOOPS["low pass"]()
    spectral, solver = solver_of(problem)
    starts = states(problem, 16, seed=3)
    expected = [solver.plan(start, spectral.lti).control for start in starts]
    again, copy = pickle.loads(pickle.dumps((spectral, solver)))
    for start, control in zip(starts, expected, strict=True):
        np.testing.assert_allclose(copy.plan(start, again.lti).control, control, atol=1e-8)
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(lambda start: solver.plan(start, spectral.lti).control, starts))
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_without_a_compiler_the_method_refuses_and_a_loop_goes_on(no_compiler):
    problem, starts = LOOPS["low pass"](), states(LOOPS["low pass"](), 3, seed=1)
    with no_compiler("kernel.c could not be compiled"):
        with pytest.raises(lfo.errors.UnsupportedError, match="needs a C compiler"):
            solver_of(problem)
        controller = lfo.RecedingHorizon(problem)
        controls = [controller.step(start) for start in starts]
    by_kernel = lfo.RecedingHorizon(problem)
    np.testing.assert_allclose(controls, [by_kernel.step(start) for start in starts], atol=1e-6)


@pytest.mark.parametrize("kind", ["C", "NumPy"])
def test_rows_that_are_nearly_parallel_hold_as_exactly_as_others(kind):
    """u_1 + 0.7 u_2 <= 1 <= u_1 + (0.7 + a) u_2 - a are active at the point (0.3, 1) alone, for a = 1e-6."""
    a = 1e-6
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(0.5 * np.eye(2), [[1.0, 0.3], [0.2, 1.0]]),
        3,
        lfo.QuadraticCost(Q=1.0, R=1.0, P=1.0, u_ref=[2.0, 2.0]),
        stage_rows=lfo.StageRows(None, [[1.0, 0.7], [-1.0, -0.7 - a]], [1.0, -1.0 - a]),
        initial_state=[0.1, 0.2],
    )
    tables, start = tables_of(problem), np.array([0.1, 0.2])
    kernel = NativeKernel(tables, compiled()) if kind == "C" else DenseKernel(tables)
    units = natural_units(problem)
    assert kernel.step(start / units.x) == SOLVED
    np.testing.assert_allclose(kernel.control * units.u, [0.3, 1.0], atol=1e-7)
