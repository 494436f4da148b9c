"""Many trajectories judged at once: the figures of the judge, and no proof that it would not give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.certificate.many import batch_judge_takes, judge_batch
from lin_freq_ocp.certificate.rays import infeasibility_certificate, prove_infeasible
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.problem.trajectory import Extremals

COST = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.5, S=[[0.1], [0.0]], P=2.0, q=[0.1, 0.0], x_ref=[0.1, 0.0])
PROBLEMS = {
    "pendulum": lambda: lfo.library.pendulum(horizon=120, sampling_time=0.02),
    "states, references and linear terms": lambda: replace(
        lfo.library.double_integrator(horizon=40, sampling_time=0.1, cutoff_hz=2.0), cost=COST, terminal_state=None
    ),
    "soft bounds and joint rows": lambda: plant_with_rows(0),
}
UNITS = {"as they are": (1.0, 1.0), "small": (1e-6, 1e-3), "large": (1e6, 1e4)}


def plant_with_rows(seed: int, of_x: float = 1.0, of_u: float = 1.0) -> lfo.OptimalControlProblem:
    """Return a random plant with soft bounds on its states, and joint rows, hard and soft ones in turns, in units."""
    rng = np.random.default_rng(seed)
    n, m, T = 3, 1 + seed % 2, 24
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.8, 1.05) / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = (rng.standard_normal(shape) for shape in ((n, m), (2, n), (2, m)))
    rows = lfo.StageRows(C / of_x, D / of_u, [0.8, 1.2], penalty=0.5 if seed % 3 == 2 else None)
    bounds, weights = rng.uniform(0.2, 0.5, n) * of_x, rng.uniform(0.1, 1.0, n) / of_x**2
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B * of_x / of_u),
        T,
        lfo.QuadraticCost(Q=np.diag(weights), R=0.1 / of_u**2, P=np.diag(weights)),
        control_set=lfo.Box(-of_u, of_u),
        state_set=lfo.sets.Soft(lfo.Box(-bounds, bounds), 0.3 / of_x),
        initial_state=rng.uniform(-0.6, 0.6, n) * of_x,
        stage_rows=rows,
        control_spectrum=lfo.stop_band(bins=[9, 10, 11]),
    )


def extremals_from(problem: lfo.OptimalControlProblem, starts: np.ndarray) -> Extremals:
    """Return the solutions of a problem from initial states."""
    found = [lfo.solve(problem.with_ends(start), method="spectral") for start in starts]
    signals = [[getattr(one.trajectory, name) for one in found] for name in ("x", "u")]
    signals += [[getattr(one.multipliers, name) for one in found] for name in ("eta", "mu", "nu", "rho_u")]
    names = [term.name for term in problem.terms]
    stage = {name: np.array([one.multipliers.stage[name] for one in found]) for name in names}
    return Extremals(*map(np.array, signals), stage)


def judge_single(problem: lfo.OptimalControlProblem, start: np.ndarray, given: Extremals, i: int) -> Certificate:
    """Return the certificate of one of the trajectories."""
    rho_x, stage = np.zeros(problem.state_stop.shape, dtype=complex), {name: on[i] for name, on in given.stage.items()}
    multipliers = lfo.results.Multipliers(1.0, given.eta[i], given.mu[i], given.nu[i], given.rho_u[i], rho_x, stage)
    return judge(problem.with_ends(start), lfo.Trajectory(given.x[i], given.u[i]), multipliers)


@pytest.fixture(scope="module", params=PROBLEMS)
def solved(request) -> tuple[lfo.OptimalControlProblem, np.ndarray, Extremals]:
    problem = PROBLEMS[request.param]()
    starts = problem.initial_state.lower + 1e-3 * np.random.default_rng(0).standard_normal((4, problem.state_dim))
    return problem, starts, extremals_from(problem, starts)


def test_figures_are_those_of_the_judge(solved):
    problem, starts, given = solved
    assert batch_judge_takes(problem)
    found = judge_batch(problem, starts, given)
    assert found.proven.all()
    for i, start in enumerate(starts):
        certificate = judge_single(problem, start, given, i)
        assert found.costs[i] == pytest.approx(certificate.cost, rel=1e-14)
        assert found.bounds[i] == pytest.approx(certificate.lower_bound, abs=1e-14 * certificate.cost_scale)
        assert found.gaps[i] == pytest.approx(certificate.gap, abs=1e-14)


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("seed", range(6))
def test_verdicts_on_soft_and_joint_rows_are_those_of_the_judge(seed, units):
    """The solutions, and the same with one part wrong by more and by less than the judge allows."""
    problem = plant_with_rows(seed, *UNITS[units])
    assert problem.terms
    starts = problem.initial_state.lower * (1 + 0.01 * np.arange(3)[:, None])
    right = extremals_from(problem, starts)
    parts = ["x", "u", "eta", *right.stage]
    for part in [None, *parts]:
        for by in (1e-10, 1e-2) if part else (0.0,):
            signals = {name: getattr(right, name) for name in ("x", "u", "eta")}
            changed = {name: value.copy() for name, value in (signals | dict(right.stage)).items()}
            if part:
                changed[part][1] += by * np.abs(changed[part][1]).max()
            stage = {name: changed[name] for name in right.stage}
            given = replace(right, x=changed["x"], u=changed["u"], eta=changed["eta"], stage=stage)
            proven = judge_batch(problem, starts, given).proven.tolist()
            single = [judge_single(problem, start, given, i).globally_optimal for i, start in enumerate(starts)]
            assert proven == single
            wrong = by == 1e-2 and part and np.abs(changed[part][1]).max() > 0
            assert proven == [True, not wrong, True]


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


@pytest.mark.parametrize("seed", [0, 1])
def test_states_without_bounds_and_costs_are_bounded_by_what_controls_reach(seed):
    """A soft bound is no bound: l_t is flat in these states, and its minimum over all of them would be -inf."""
    problem = replace(plant_with_rows(seed), cost=lfo.QuadraticCost(Q=0.0, R=1.0, P=1.0))
    starts = problem.initial_state.lower * (1 + 0.01 * np.arange(3)[:, None])
    given = extremals_from(problem, starts)
    found = judge_batch(problem, starts, given)
    assert found.proven.all()
    assert all(judge_single(problem, start, given, i).globally_optimal for i, start in enumerate(starts))
    without = replace(problem, control_set=None)
    assert not judge_batch(without, starts, given).proven.any()
    wrong = replace(given, eta=given.eta * np.array([1.0, 1.5, 1.0])[:, None, None])
    assert judge_batch(problem, starts, wrong).proven.tolist() == [True, False, True]


def test_a_control_in_its_stop_band_is_not_proven():
    problem = lfo.library.pendulum(horizon=120, sampling_time=0.02)
    without = replace(problem, control_spectrum=None)
    result = lfo.solve(without)
    parts = [result.trajectory.x, result.trajectory.u]
    parts += [getattr(result.multipliers, name) for name in ("eta", "mu", "nu", "rho_u")]
    given = Extremals(*(part[None] for part in parts), {})
    starts = problem.initial_state.lower[None]
    assert judge_batch(without, starts, given).proven.all()
    assert not judge_batch(problem, starts, given).proven.any()


def test_multipliers_of_free_bins_prove_nothing():
    """A control without the band of another problem is not optimal because that band has a price."""
    problem = lfo.library.pendulum(horizon=120, sampling_time=0.02)
    starts = problem.initial_state.lower[None]
    given = extremals_from(problem, starts)
    assert judge_batch(problem, starts, given).proven.all()
    assert not judge_batch(replace(problem, control_spectrum=None), starts, given).proven.any()


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
        assert proof is not None or value <= 0  # over the reach, a ray may prove more
        if value > 0:
            assert proof.bound.value == pytest.approx(value, rel=1e-9)
        seen.add(proven.applies_to(state))
        assert proof is not None or not proven.applies_to(state)
    assert seen == {True, False}
    assert infeasibility_certificate(problem.with_ends([-0.15, 0.1, 0.0, 0.0]), ray) is None


def test_other_kinds_of_problems_are_for_the_judge_alone():
    problem = lfo.library.pendulum()
    others = [
        problem.with_ends(initial_state=lfo.Box(-0.2, 0.2)),
        replace(problem, state_set=lfo.sets.Ball(1.0)),
        replace(problem, state_set=lfo.sets.Polyhedron([[1.0, 1.0, 0, 0]], [1.0])),  # a row at time 0, or none
        replace(problem, cost=lfo.costs.L1Cost(u=1.0)),
        replace(problem, state_spectrum=lfo.stop_band(bins=[3], component=0)),
        lfo.library.elliptic_rendezvous(),
    ]
    assert not any(map(batch_judge_takes, others))
