"""Solves again and again by the active rows, against the embedding."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.methods import Candidate
from lin_freq_ocp.methods.structured import (
    Coupling,
    Embedding,
    End,
    Equations,
    Inequalities,
    RowResponses,
    StepSystem,
    System,
    Targets,
    can_compile,
    loops,
    range_space_solver,
    solve_active,
)
from lin_freq_ocp.results import Status
from lin_freq_ocp.solvers import Structured
from lin_freq_ocp.solving import Request, SolverCache
from lin_freq_ocp.transform import Change, translation_of
from tests.methods.structured.examples import spectrum, stages

COMPILED = [False, pytest.param(True, marks=pytest.mark.skipif(not can_compile(), reason="no C compiler"))]


def coupled(seed):
    """A stop band, inequalities on a spectrum, and a fixed entry of x_T."""
    T, rng = 12, np.random.default_rng(seed)
    band, limited = spectrum([5, 6], T), spectrum([1, 2], T)
    band.kept[3] = False
    return Coupling(
        np.array([2]),
        np.array([1]),
        0.1 * rng.standard_normal(1),
        (Equations(band, np.zeros(3)),),
        (Inequalities(limited, np.full(4, 0.3)),),
    )


def moved(problem, seed, size=0.3):
    """The same stages from another state."""
    move = size * np.random.default_rng(seed).standard_normal(problem.states)
    return replace(problem, initial=problem.initial + move)


def embedded(problem, compiled=False):
    system = System(problem, loops(compiled))
    return Embedding(system, StepSystem(system, range_space_solver(problem, system.loops)), Targets()).run()


def responses(problem, compiled=False):
    system = System(problem, loops(compiled))
    return RowResponses(system, range_space_solver(problem, system.loops))


@pytest.mark.parametrize("compiled", COMPILED)
@pytest.mark.parametrize("seed", seeds(range(8)))
def test_answers_are_those_of_the_embedding(seed, compiled):
    problem = stages(seed, bound=0.8, coupling=coupled(seed))
    kept, near, rows_held = responses(problem, compiled), np.zeros(problem.h.shape), 0
    for k in range(4):
        other = moved(problem, 100 * seed + k)
        expected = embedded(other, compiled)
        found = solve_active(System(other, loops(compiled)), kept, Targets(), near)
        if expected.end is not End.OPTIMAL:
            assert found is None
            continue
        assert found is not None
        assert np.abs(found.y - expected.y).max() < 1e-5
        assert max(found.errors) < 1e-10
        rows_held += np.count_nonzero(found.z[2] > 0) + np.count_nonzero(found.z[4] > 0)
        near = found.y
    assert rows_held > 0


@pytest.mark.parametrize("seed", seeds(range(4)))
def test_both_kinds_of_loops_find_the_same_to_rounding(seed):
    if not can_compile():
        pytest.skip("no C compiler")
    problem = stages(seed, bound=0.8, coupling=coupled(seed))
    near = np.zeros(problem.h.shape)
    plain, fast = (
        solve_active(System(problem, loops(compiled)), responses(problem, compiled), Targets(), near)
        for compiled in (False, True)
    )
    assert plain is not None
    assert fast is not None
    np.testing.assert_allclose(plain.y, fast.y, rtol=0, atol=1e-9)


def test_a_far_start_is_no_obstacle():
    problem = stages(3, bound=0.8, coupling=coupled(3))
    expected = embedded(problem)
    for far in (np.full(problem.h.shape, 5.0), np.full(problem.h.shape, -5.0)):  # every upper, every lower bound
        found = solve_active(System(problem, loops(False)), responses(problem), Targets(), far)
        assert found is not None
        assert np.abs(found.y - expected.y).max() < 1e-5


def test_no_answer_without_room_for_the_responses(monkeypatch):
    problem = stages(3, bound=0.8)
    near = np.full(problem.h.shape, 5.0)
    assert solve_active(System(problem, loops(False)), responses(problem), Targets(), near) is not None
    substitute(monkeypatch, "methods.structured.MOST_NUMBERS", 100)
    assert solve_active(System(problem, loops(False)), responses(problem), Targets(), near) is None


def test_finding_responses_ends_with_the_time(monkeypatch):
    """The clock stands still until the first response is found; two solves are that and the point without rows."""
    problem, clock, solves = stages(3, bound=0.8), iter([0.0, 0.0]), []
    near, kept = np.full(problem.h.shape, 5.0), responses(problem)
    solve = kept.step.solve
    monkeypatch.setattr(kept.step, "solve", lambda *given: solves.append(given) or solve(*given))
    with use_clock(lambda: next(clock, 2.0)):
        assert solve_active(System(problem, loops(False)), kept, Targets(end=1.0), near) is None
    assert len(solves) == 2


def touching(T=80):
    """A double integrator that meets a bound on its position at few times."""
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], sampling_time=0.1)
    return lfo.OptimalControlProblem(
        dynamics,
        T,
        lfo.QuadraticCost(R=0.1, Q=np.diag([0.0, 1e-3])),
        control_set=lfo.Box(-2, 2),
        state_set=lfo.Box([-1.0, -10.0], [0.4, 10.0]),
        initial_state=[0.0, 1.0],
        terminal_state=[0.0, -1.0],
    )


def again(kept, change, tolerance=None):
    problem = change.apply(kept.problem)
    return Structured(tolerance).solve(problem, Request(cached=(kept, change)))


@expensive
def test_solves_again_are_by_active_rows_and_as_from_scratch(monkeypatch):
    problem, ends = touching(), []

    def recorded(*given):
        ends.append(solve_active(*given))
        return ends[-1]

    substitute(monkeypatch, "methods.structured.solve_active", recorded)
    kept = SolverCache(translation_of(problem))
    again(kept, Change())
    assert not ends  # nothing is near
    for k in range(10):
        state = [0.01 * k, 1.0 - 0.02 * k]
        found, expected = again(kept, Change(state)), lfo.solve(problem.with_ends(state), method="structured")
        assert found.status == expected.status == "optimal"
        assert found.cost == pytest.approx(expected.cost, rel=1e-8)
        np.testing.assert_allclose(found.trajectory.u, expected.control, atol=1e-5)
        assert found.certificate.gap < 1e-9
    assert len(ends) == 10
    assert None not in ends


def test_what_is_kept_can_be_copied():
    problem = touching()
    kept = SolverCache(translation_of(problem))
    expected = [again(kept, Change([0.01 * k, 1.0])).trajectory.u for k in range(3)][-1]
    kept.stage_cache = pickle.loads(pickle.dumps(kept.stage_cache))
    np.testing.assert_allclose(again(kept, Change([0.02, 1.0])).trajectory.u, expected, atol=1e-5)


def test_references_are_exchanged():
    problem, matrices = touching(), set()
    kept = SolverCache(translation_of(problem))
    for k, aim in enumerate((0.0, 0.1, 0.3, -0.2)):
        references = {"x_ref": np.tile([aim, 0.2 * aim], (81, 1)), "u_ref": [0.1 * aim]}
        change = Change([0.01 * k, 1.0], references=references)
        found, expected = again(kept, change), lfo.solve(change.apply(problem), method="structured")
        assert found.status == expected.status == "optimal"
        assert found.cost == pytest.approx(expected.cost, rel=1e-7, abs=1e-9)
        np.testing.assert_allclose(found.trajectory.u, expected.control, atol=1e-5)
        matrices.add(id(kept.stage_cache.assembly(change.apply(problem)).stages.G))
    assert len(matrices) == 1


@expensive
def test_verdicts_are_those_from_scratch():
    problem, statuses = touching(), []
    kept = SolverCache(translation_of(problem))
    for state in ([0.0, 1.0], [0.3, 3.0], [0.0, 0.9], [0.39, 2.0], [-0.9, 1.0]):
        found, expected = (
            again(kept, Change(state)),
            lfo.solve(problem.with_ends(state), method="structured", throw=False),
        )
        assert found.status == expected.status
        statuses.append(found.status)
    assert {"optimal", "infeasible"} == set(statuses)


def test_single_changes_suffice(monkeypatch):
    problem = stages(9, bound=0.8, coupling=coupled(9))
    expected, near = embedded(problem), np.zeros(problem.h.shape)
    substitute(monkeypatch, "methods.structured.TRIES", 0)
    found = solve_active(System(problem, loops(False)), responses(problem), Targets(), near)
    assert found is not None
    assert np.abs(found.y - expected.y).max() < 1e-5


def test_a_wrong_answer_is_repaired_to_a_proven_one_or_solved_from_scratch(monkeypatch):
    problem = touching()
    kept = SolverCache(translation_of(problem))
    expected = again(kept, Change())
    wrong = replace(expected.trajectory, u=1.01 * expected.trajectory.u)
    substitute(
        monkeypatch,
        "methods.structured.solve_from_warm_start",
        lambda *given: Candidate(Status.OPTIMAL, wrong, expected.multipliers),
    )
    found = again(kept, Change())
    assert (found.status, found.certificate.globally_optimal) == ("optimal", True)
    assert found.cost == pytest.approx(expected.cost, rel=1e-6)
    np.testing.assert_allclose(found.trajectory.u, expected.trajectory.u, atol=1e-4)
