"""Steps with windows over applied samples share matrices and units, and have the answers of steps set up alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.seeds import expensive
from lin_freq_ocp.loop import with_past
from lin_freq_ocp.methods import MOST_PROGRAMS, ProgramCache
from lin_freq_ocp.program import LinearProgram
from lin_freq_ocp.transform import Change

DYNAMICS = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], sampling_time=0.1)
HOP, LENGTH = 4, 12
MASK = lfo.MagnitudeBound(0.4, band=lfo.low_pass(1.2), window="hann")


def windowed(**fields) -> lfo.OptimalControlProblem:
    windows = lfo.spectrum.Spectrogram(MASK, length=LENGTH, hop=HOP, past=np.zeros((LENGTH, 1)))
    given = {"control_set": lfo.Box(-1, 1), "initial_state": [1.0, 0.0], "control_spectrum": windows}
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.1, P=np.diag([10.0, 5.0]))
    return lfo.OptimalControlProblem(**({"dynamics": DYNAMICS, "horizon": 30, "cost": cost} | given | fields))


def after(steps: int, problem: lfo.OptimalControlProblem | None = None) -> lfo.OptimalControlProblem:
    """Return the problem after so many applied samples."""
    rng = np.random.default_rng(steps)
    return with_past(problem or windowed(), np.zeros((steps, 2)), 0.1 * rng.standard_normal((steps, 1)))


@expensive
def test_every_step_has_the_answer_of_its_problem_alone():
    loop, problem, rest = lfo.RecedingHorizon(windowed(), "convex"), windowed(), np.zeros((30, 1))
    rng, x = np.random.default_rng(0), np.array([1.0, 0.0])
    for k in range(3 * HOP):
        u = loop.step(x)
        alone = with_past(problem, np.zeros((k, 2)), np.array(loop.log.controls[:k]), rest).with_ends(x)
        rest = loop.log.steps[-1].plan.u
        rest = np.vstack([rest[1:], rest[-1:]])
        np.testing.assert_allclose(u, lfo.solve(alone).control[0], atol=1e-6)
        x = DYNAMICS.A @ x + DYNAMICS.B @ u + [1e-3, 1e-2] * rng.standard_normal(2)
    assert set(loop.log.statuses) == {"optimal"}
    assert loop.log.gaps.max() < 1e-8


def test_steps_a_hop_apart_have_the_same_matrices():
    cache = ProgramCache()
    first, units = cache.program(after(LENGTH + 1))
    second, same_units = cache.program(after(LENGTH + 1 + HOP))
    assert second.sparse.A is first.sparse.A
    assert same_units is units
    exact = LinearProgram(second.problem).sparse
    for part in ("lower", "upper", "q"):
        np.testing.assert_array_equal(getattr(second.sparse, part), getattr(exact, part))
    np.testing.assert_array_equal(second.sparse.A.toarray(), exact.A.toarray())
    assert (second.sparse.lower != first.sparse.lower).any()  # the past is another
    assert cache.program(after(LENGTH + 2))[0].sparse.A is not first.sparse.A


OTHERS = {
    "weights": {"cost": lfo.QuadraticCost(Q=np.diag([2.0, 0.1]), R=0.1, P=np.diag([10.0, 5.0]))},
    "dynamics": {"dynamics": replace(DYNAMICS, B=[[0.006], [0.1]])},
    "bounded components": {"state_set": lfo.Box([-2.0, -np.inf], [2.0, np.inf])},
    "taper": {
        "control_spectrum": lfo.spectrum.Spectrogram(
            MASK.changed(window="hamming"), length=LENGTH, hop=HOP, past=np.zeros((LENGTH, 1))
        )
    },
    "price": {
        "control_spectrum": lfo.spectrum.Spectrogram(
            MASK.softened(2.0), length=LENGTH, hop=HOP, past=np.zeros((LENGTH, 1))
        )
    },
}


@pytest.mark.parametrize("case", OTHERS)
def test_problems_that_differ_in_more_have_programs_of_their_own(case):
    first, other = LinearProgram(windowed()), LinearProgram(windowed(**OTHERS[case]))
    assert not other.share_matrices(first)


def test_limits_and_references_are_exchanged():
    base = windowed()
    cost = replace(base.cost, x_ref=[0.5, 0.0])
    first = LinearProgram(base)
    for problem in (replace(base, cost=cost), replace(base, control_set=lfo.Box(-0.5, 0.7))):
        other, exact = LinearProgram(problem), LinearProgram(problem).sparse
        assert other.share_matrices(first)
        for part in ("lower", "upper", "q", "constant"):
            np.testing.assert_array_equal(getattr(other.sparse, part), getattr(exact, part))


@expensive
def test_a_cache_forgets_what_was_used_longest_ago():
    cache = ProgramCache()
    problems = [replace(windowed(), dynamics=replace(DYNAMICS, A=DYNAMICS.A * (1 + 1e-3 * k))) for k in range(40)]
    oldest = cache.program(problems[0])[0]
    for problem in problems[1:MOST_PROGRAMS]:
        cache.program(problem)
    again = cache.program(problems[0].with_ends([0.5, 0.0]))[0]
    assert again.sparse.A is oldest.sparse.A
    second = cache.program(problems[1])[0]
    for problem in problems[MOST_PROGRAMS:]:
        cache.program(problem)
    assert cache.program(problems[1].with_ends([0.5, 0.0]))[0].sparse.A is second.sparse.A
    assert len(cache._known) == MOST_PROGRAMS


def test_equal_dynamics_with_another_offset_share_matrices():
    cache, problem = ProgramCache(), windowed(control_spectrum=None)
    first, _ = cache.program(problem)
    moved = replace(problem, dynamics=replace(DYNAMICS, offset=[0.1, 0.0]), initial_state=[0.5, 0.0])
    second, _ = cache.program(moved)
    assert second.sparse.A is first.sparse.A
    exact = LinearProgram(moved).sparse
    for part in ("lower", "upper", "q"):
        np.testing.assert_array_equal(getattr(second.sparse, part), getattr(exact, part))


@needs_kernel
def test_previewed_disturbances_keep_the_matrices():
    """Of windows, whose program is the sparse one, and of the condensed method, which solves a plain problem."""
    expected = 1e-2 * np.random.default_rng(1).standard_normal((30, 2))
    first, other = LinearProgram(windowed()), LinearProgram(Change(disturbance=expected).apply(windowed()))
    assert other.share_matrices(first)
    exact = LinearProgram(Change(disturbance=expected).apply(windowed())).sparse
    for part in ("lower", "upper", "q", "constant"):
        np.testing.assert_array_equal(getattr(other.sparse, part), getattr(exact, part))
    plain = windowed(control_spectrum=None)
    loop, x = lfo.RecedingHorizon(plain), np.array([1.0, 0.0])
    for k in range(6):
        u = loop.step(x, disturbance=expected if k % 2 else None)
        alone = Change(disturbance=expected).apply(plain) if k % 2 else plain
        np.testing.assert_allclose(u, lfo.solve(alone.with_ends(x)).control[0], atol=1e-8)
        x = DYNAMICS.A @ x + DYNAMICS.B @ u
    assert {step.method for step in loop.log.steps} == {"condensed"}
    assert set(loop.log.statuses) == {"optimal"}


def test_previewed_disturbances_move_the_rows_of_a_polyhedron_at_the_end():
    """Such rows act on the step before, whose right-hand side has the disturbance of the last step."""
    corner = lfo.sets.Polyhedron([[1.0, 1.0], [-1.0, 0.0]], [0.2, 0.2])
    problem = windowed(control_spectrum=None, terminal_state=corner)
    loop, expected = lfo.RecedingHorizon(problem), np.array([0.0, 0.02])
    for k in range(4):
        u = loop.step([1.0, 0.0], disturbance=expected if k % 2 else None)
        alone = Change(disturbance=expected).apply(problem) if k % 2 else problem
        np.testing.assert_allclose(u, lfo.solve(alone).control[0], atol=1e-7)
