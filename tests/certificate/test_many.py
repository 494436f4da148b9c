"""Many trajectories judged at once: the figures of the judge, and no proof that it would not give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.certificate.many import Extremals, batch_judge_takes, judge_batch
from lin_freq_ocp.certificate.rays import infeasibility_certificate, prove_infeasible
from lin_freq_ocp.certificate.verdict import judge

COST = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.5, S=[[0.1], [0.0]], P=2.0, q=[0.1, 0.0], x_ref=[0.1, 0.0])
PROBLEMS = {
    "pendulum": lambda: lfo.library.pendulum(horizon=120, sampling_time=0.02),
    "states, references and linear terms": lambda: replace(
        lfo.library.double_integrator(horizon=40, sampling_time=0.1, cutoff_hz=2.0), cost=COST, terminal_state=None
    ),
}


@pytest.fixture(scope="module", params=PROBLEMS)
def solved(request) -> tuple[lfo.OptimalControlProblem, np.ndarray, Extremals]:
    problem = PROBLEMS[request.param]()
    starts = problem.initial_state.lower + 1e-3 * np.random.default_rng(0).standard_normal((4, problem.state_dim))
    found = [lfo.solve(problem.with_ends(start), method="spectral") for start in starts]
    signals = [[getattr(one.trajectory, name) for one in found] for name in ("x", "u")]
    signals += [[getattr(one.multipliers, name) for one in found] for name in ("eta", "mu", "nu", "rho_u")]
    return problem, starts, Extremals(*map(np.array, signals))


def test_figures_are_those_of_the_judge(solved):
    problem, starts, given = solved
    assert batch_judge_takes(problem)
    found = judge_batch(problem, starts, given)
    assert found.proven.all()
    for i, start in enumerate(starts):
        rho_x = np.zeros(problem.state_stop.shape, dtype=complex)
        multipliers = lfo.results.Multipliers(1.0, given.eta[i], given.mu[i], given.nu[i], given.rho_u[i], rho_x)
        certificate = judge(problem.with_ends(start), lfo.Trajectory(given.x[i], given.u[i]), multipliers)
        assert found.costs[i] == pytest.approx(certificate.cost, rel=1e-14)
        assert found.bounds[i] == pytest.approx(certificate.lower_bound, abs=1e-14 * certificate.cost_scale)
        assert found.gaps[i] == pytest.approx(certificate.gap, abs=1e-14)


WRONG = {
    "a control": ("u", lambda u: u + 1e-3 * np.abs(u).max()),
    "a state": ("x", lambda x: x * (1 + 1e-4)),
    "an adjoint": ("eta", lambda eta: eta * 1.01),
    "no adjoint": ("eta", np.zeros_like),
    "a frequency multiplier": ("rho_u", np.negative),
    "not a number": ("u", lambda u: np.full_like(u, np.nan)),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_not_proven(solved, name):
    problem, starts, given = solved
    field, changed = WRONG[name]
    values = getattr(given, field).copy()
    values[1] = changed(values[1])
    found = judge_batch(problem, starts, replace(given, **{field: values}))
    assert found.proven.tolist() == [True, False, True, True]


def test_another_initial_state_is_not_proven(solved):
    problem, starts, given = solved
    moved = starts.copy()
    moved[2] += 1e-3
    assert judge_batch(problem, moved, given).proven.tolist() == [True, True, False, True]


def test_a_control_in_its_stop_band_is_not_proven():
    problem = lfo.library.pendulum(horizon=120, sampling_time=0.02)
    without = replace(problem, control_spectrum=None)
    result = lfo.solve(without)
    parts = [result.trajectory.x, result.trajectory.u]
    parts += [getattr(result.multipliers, name) for name in ("eta", "mu", "nu", "rho_u")]
    given = Extremals(*(part[None] for part in parts))
    starts = problem.initial_state.lower[None]
    assert judge_batch(without, starts, given).proven.all()
    assert not judge_batch(problem, starts, given).proven.any()


def test_what_a_ray_proves_of_other_initial_states_is_what_its_bound_says_there():
    problem = lfo.library.pendulum(horizon=60, sampling_time=0.04).with_ends([-0.15, 0.1, -1.5, 0.0])
    ray = lfo.solve(problem, throw=False).ray
    proven = infeasibility_certificate(problem, ray)
    seen = set()
    for state in problem.initial_state.lower + np.random.default_rng(2).standard_normal((30, 4)) * [
        0.01,
        0.02,
        0.8,
        0.4,
    ]:
        value = proven.value + proven.slope @ (state - proven.start)
        proof = prove_infeasible(problem.with_ends(state), ray)
        assert (proof is not None) == (value > 0)
        if proof is not None:
            assert proof.bound.value == pytest.approx(value, rel=1e-9)
        seen.add(proven.applies_to(state))
        assert proof is not None or not proven.applies_to(state)
    assert seen == {True, False}
    assert infeasibility_certificate(problem.with_ends([-0.15, 0.1, 0.0, 0.0]), ray) is None


def test_other_kinds_of_problems_are_for_the_judge_alone():
    problem = lfo.library.pendulum()
    others = [
        problem.with_ends(initial_state=lfo.Box(-0.2, 0.2)),
        replace(problem, stage_rows=lfo.StageRows([[1.0, 0, 0, 0]], [[0.1]], [1.0])),
        replace(problem, state_spectrum=lfo.stop_band(bins=[3], component=0)),
        lfo.library.elliptic_rendezvous(),
    ]
    assert not any(map(batch_judge_takes, others))
