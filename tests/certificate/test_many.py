"""Many trajectories judged at once: the figures of the judge, and no proof that it would not give."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import batch_judge_takes, infeasibility_certificate, judge, judge_batch, prove_infeasible
from lin_freq_ocp.problem import Extremals
from lin_freq_ocp.results import Certificate

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


@expensive
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
@pytest.mark.parametrize("seed", seeds(range(6)))
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


@expensive
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


def test_costs_are_those_of_the_problem():
    """With a linear term of each kind, at any trajectory."""
    cost = replace(COST, q=[0.1, -0.3], r=[0.7], p=[0.4, -0.2], u_ref=[0.3])
    problem = replace(PROBLEMS["states, references and linear terms"](), cost=cost)
    rng, (T, n, m) = np.random.default_rng(5), (problem.horizon, problem.state_dim, problem.control_dim)
    x, u = rng.standard_normal((3, T + 1, n)), rng.standard_normal((3, T, m))
    zeros = (
        np.zeros((3, T, n)),
        np.zeros((3, T + 1, n)),
        np.zeros((3, T, m)),
        np.zeros((3, *problem.control_stop.shape)),
    )
    found = judge_batch(problem, x[:, 0], Extremals(x, u, *zeros, {}))
    assert found.costs == pytest.approx([problem.value(*signals) for signals in zip(x, u, strict=True)], rel=1e-12)


def integrator(controls: lfo.Box, side: float, gain: float = 1.0, offset: float = 0.0) -> lfo.OptimalControlProblem:
    """Return x_{t+1} = gain x_t + u_t + offset from 0 with the cost -side (x_0 + .. + x_4), and nothing on states."""
    cost, plant = lfo.QuadraticCost(q=[-side], p=[-side]), lfo.LinearDynamics([[gain]], [[1.0]], offset=[offset])
    return lfo.OptimalControlProblem(plant, 4, cost, controls, initial_state=[0.0])


def bound_without_multipliers(problem: lfo.OptimalControlProblem, x: np.ndarray, start: float = 0.0) -> float:
    """Return D of states x (T+1,) and of controls that are 0: the cost at the edge of the reachable states."""
    zero = [np.zeros((1, *shape)) for shape in ((4, 1), (4, 1), (5, 1), (4, 1), (3, 1))]
    return float(judge_batch(problem, np.full((1, 1), start), Extremals(x.reshape(1, 5, 1), *zero, {})).bounds[0])


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_states_that_controls_reach_on_the_farther_side_count(side):
    """Controls are between -1 and 3, or -3 and 1."""
    problem = integrator(lfo.Box(*np.sort([-side, 3 * side])), side)
    farthest = lfo.simulate(problem, np.full((4, 1), 3 * side))
    assert -np.inf < bound_without_multipliers(problem, np.zeros(5)) <= problem.value(farthest.x, farthest.u)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_states_that_residuals_and_other_starts_reach_count(side):
    """The states are 0, but the only feasible ones are t and 1, or -t and -1."""
    still = np.zeros((4, 1))
    driven, plain = (integrator(lfo.Box(0, 0), side, offset=offset) for offset in (side, 0.0))
    feasible = lfo.simulate(driven, still)
    assert bound_without_multipliers(driven, np.zeros(5)) <= driven.value(feasible.x, feasible.u)
    feasible = lfo.simulate(plain, still, [side])
    assert bound_without_multipliers(plain, np.zeros(5), side) <= plain.value(feasible.x, feasible.u)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_states_that_rounding_of_residuals_reaches_count(monkeypatch, side):
    """With a rounding of 1e-3, unstable dynamics may have an offset of 1e-3 of the largest state."""
    substitute(monkeypatch, "certificate.RADIUS_MARGIN", 1 + 1e-3)
    x = 10.0 ** np.arange(5)
    problem = replace(integrator(lfo.Box(0, 0), side, 10.0), dynamics=lfo.LinearDynamics([[10.0]], [[0.0]]))
    hidden = replace(problem, dynamics=lfo.LinearDynamics([[10.0]], [[0.0]], offset=[side * 1e-3 * x.max()]))
    apart = lfo.simulate(hidden, np.zeros((4, 1))).x
    expected = problem.value(x[:, None] + apart, np.zeros((4, 1)))
    assert bound_without_multipliers(problem, x, 1.0) <= expected


def test_starts_outside_of_the_bounds_of_states_are_not_proven():
    """x_1 = u_0 = 0 is best from any start, but x_0 = 2 is none."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.0]], [[1.0]]), 1, lfo.QuadraticCost(Q=1.0, R=1.0), state_set=lfo.Box(-1, 1)
    )
    problem, starts = problem.with_ends([1.0]), np.array([[1.0], [2.0]])
    x = np.concatenate([starts[:, :, None], np.zeros((2, 1, 1))], axis=1)
    mu = -x  # of the fixed start
    zero = np.zeros((2, 1, 1))
    given = Extremals(x, zero, zero, mu, zero, np.zeros((2, 1, 1), dtype=complex), {})
    assert judge_batch(problem, starts, given).proven.tolist() == [True, False]


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_is_below_the_exact_one_where_its_terms_cancel(seed):
    """Everything is fixed, and x_{t+1} = 0 is violated by x_{t+1}: D = sum eta_t x_{t+1}, about 0, in exact numbers."""
    rng, T = np.random.default_rng(seed), 64
    x, u, eta = rng.standard_normal((T + 1, 1)), np.zeros((T, 1)), rng.standard_normal((T, 1))
    eta[-1] = -(eta[:-1] * x[1:-1]).sum() / x[-1]
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.0]], [[0.0]]),
        T,
        lfo.QuadraticCost(r=[1.0]),
        control_set=lfo.Box(0, 0),
        state_set=[lfo.Box(value, value) for value in x],
        initial_state=x[0],
    )
    exact = sum(Fraction(a) * Fraction(b) for a, b in zip(eta[:, 0].tolist(), x[1:, 0].tolist(), strict=True))
    zero = np.zeros((1, T + 1, 1)), np.zeros((1, T, 1)), np.zeros((1, T // 2 + 1, 1), dtype=complex)
    given = Extremals(x[None], u[None], eta[None], *zero, {})
    assert Fraction(judge_batch(problem, x[:1], given).bounds[0]) <= exact
    assert Fraction(judge_single(problem, x[0], given, 0).bound.value) <= exact


def test_the_bound_holds_for_all_offsets_that_rounding_may_hide(monkeypatch):
    """D = -1 is the offset times eta: with a rounding of 1e-3, it may be -1.001."""
    substitute(monkeypatch, "certificate.unit_rounding", lambda problem: 1e-3)
    plant, fixed = lfo.LinearDynamics([[0.0]], [[0.0]], offset=[1.0]), lfo.Box(0, 0)
    problem = lfo.OptimalControlProblem(plant, 1, lfo.QuadraticCost(), fixed, state_set=fixed, initial_state=[0.0])
    zero, one = np.zeros((1, 1, 1)), np.ones((1, 1, 1))
    given = Extremals(np.zeros((1, 2, 1)), zero, one, np.zeros((1, 2, 1)), zero, zero.astype(complex), {})
    assert judge_batch(problem, np.zeros((1, 1)), given).bounds[0] <= -1.001
