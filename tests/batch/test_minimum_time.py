"""Minimum time against brute force: linear programs of all horizons, where zeros can be appended and where not."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import linprog

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.batch import Verdict, obstacles, problem_at_horizon, search_horizons
from lin_freq_ocp.solving import Options, solve_judged
from lin_freq_ocp.spectrum import EnergyBound, OutputSpectrum
from lin_freq_ocp.transform import sampled_masks

LAST = 14  # largest horizon of the random problems


def random_problem(seed):
    """Return a problem of two states; with an even seed its end stays put, and zero is an admissible control.

    With an odd seed its end is a state that is reached after some steps.
    """
    random = np.random.default_rng(seed)
    A, B, x = random.normal(size=(2, 2)), random.normal(size=(2, 1)), random.normal(size=2)
    A *= random.uniform(0.8, 1.1) / np.linalg.norm(A, 2)
    stays = seed % 2 == 0
    low, high = random.uniform(-0.3, -0.1 if stays else 0.2), random.uniform(0.2, 0.4)
    end = np.zeros(2) if stays else x
    for u in () if stays else random.uniform(low, high, random.integers(2, 9)):
        end = A @ end + B[:, 0] * u
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B), LAST, lfo.QuadraticCost(R=1.0), lfo.Box(low, high), None, x, end
    )


def feasible(problem, horizon):
    """Whether a linear program over the controls alone has a solution, as HiGHS sees it."""
    A, B, x = problem.dynamics.A, problem.dynamics.B, problem.initial_state.lower
    for _ in range(horizon):
        x = A @ x
    effect = np.hstack([np.linalg.matrix_power(A, horizon - 1 - t) @ B for t in range(horizon)])
    bounds = [(float(problem.control_set.lower), float(problem.control_set.upper))] * horizon
    found = linprog(np.zeros(horizon), A_eq=effect, b_eq=problem.terminal_state.lower - x, bounds=bounds)
    return found.status == 0


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_least_horizons_are_those_of_brute_force(seed):
    problem = random_problem(seed)
    every = [T for T in range(1, LAST + 1) if feasible(problem, T)]
    found = lfo.minimum_time(problem, horizons=(1, LAST), throw=False)
    assert found.horizon == (every[0] if every else None)
    assert found.monotone == (seed % 2 == 0)
    assert found.proven
    assert all((T in every) == (verdict == "feasible") for T, verdict in found.verdicts.items())
    if found.monotone and every:
        assert every == list(range(every[0], LAST + 1))
    if found.horizon is not None and found.horizon > 1:
        assert found.ray is found.rays[found.horizon - 1]


@expensive
def test_the_random_problems_have_all_kinds_of_answers():
    least = [next((T for T in range(1, LAST + 1) if feasible(random_problem(seed), T)), None) for seed in range(12)]
    for parity in (0, 1):
        assert len(set(least[parity::2])) >= 4
    gaps = [[feasible(random_problem(seed), T) for T in range(1, LAST + 1)] for seed in range(1, 12, 2)]
    assert any(one < before for found in gaps for before, one in pairwise(found))


def test_bisection_would_miss_a_horizon_where_feasibility_is_not_monotone():
    """x changes its sign at every step and no control moves it: an end of 1 is met at even horizons only."""
    swinging = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[-1.0]], [[1.0]]), 4, lfo.QuadraticCost(R=1.0), lfo.Box(-0.1, 0.1), None, [1.0], [1.0]
    )
    solve = partial(lambda horizon, any_point: lfo.solve(replace(swinging, horizon=horizon), throw=False))
    assert search_horizons(1, 5, True, solve).horizon is None
    found = lfo.minimum_time(swinging, horizons=(1, 5))
    assert (found.horizon, found.monotone) == (2, False)
    assert found.reason == "with a control of zero the state does not stay at every admissible end (x_0)"


# --- the conditions


def integrator(horizon=6, **fields):
    """Return a double integrator that comes to rest at 0."""
    given = {
        "dynamics": lfo.LinearDynamics([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]], sampling_time=1.0),
        "cost": lfo.QuadraticCost(R=1.0),
        "control_set": lfo.Box(-1, 1),
        "initial_state": [3.0, 0.0],
        "terminal_state": [0.0, 0.0],
    }
    return lfo.OptimalControlProblem(horizon=horizon, **given | fields)


def conditions(**fields):
    return obstacles(partial(problem_at_horizon, integrator(**fields)), 2, 9, same_data=True)


def mask(**options):
    return lfo.MagnitudeBound(1.0, band=lfo.low_pass(1.0), **options)


MONOTONE = {
    "nothing more": {},
    "any place of rest": {"terminal_state": lfo.Box([-1, 0], [1, 0])},
    "rows": {"stage_rows": lfo.StageRows([[1.0, 0.0]], [[1.0]], [5.0])},
    "soft rows": {"stage_rows": lfo.StageRows([[0.0, 0.0]], [[1.0]], [-1.0], penalty=2.0)},
    "a mask of the control": {"control_spectrum": mask(every_frequency=True)},
    "residual vibration": {"control_spectrum": lfo.ResidualVibration((0.5, 1.0), (0.0, 0.1), 0.5)},
    "a soft mask at bins": {"control_spectrum": mask(penalty=1.0)},
    "a mask of states": {"state_spectrum": mask(every_frequency=True)},
    "a mask of outputs": {"output_spectrum": OutputSpectrum([[1.0, 2.0]], [[1.0]], mask(every_frequency=True))},
    "periodic ends at rest": {"terminal_state": lfo.Periodic() & lfo.Box([-9, 0], [9, 0])},
    "balls": {"control_set": lfo.sets.Ball(1.0), "state_set": lfo.sets.Ball(9.0)},
    "ends that contract": {
        "dynamics": lfo.LinearDynamics([[1.0, 0.0], [0.0, 0.5]], [[1.0], [1.0]]),
        "terminal_state": lfo.Box([0, -1], [0, 1]),
    },
}


@pytest.mark.parametrize("name", MONOTONE)
def test_zeros_can_be_appended(name):
    assert conditions(**MONOTONE[name]) == []


ONE = {"terminal_state": [1.0, 0.0]}
OBSTACLES = {
    "does not stay": {"terminal_state": lfo.Box([0, -1], [0, 1])},
    "(x_0)": {"dynamics": lfo.LinearDynamics([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]], [0.1, 0.0])},
    "zero is not an admissible": {"control_set": lfo.Box(0.1, 1)},
    "control at all later times": {"control_set": lfo.sets.Ball(0.5, [1.0])},
    "'stage rows' does not hold": {"stage_rows": lfo.StageRows([[0.0, 0.0]], [[1.0]], [-0.1])},
    "stop band": {"control_spectrum": lfo.low_pass(1.0)},
    "state_spectrum: a stop band": {"state_spectrum": lfo.low_pass(1.0)},
    "mask on u_0: it is about bins": {"control_spectrum": mask()},
    "energy bound on u_0": {"control_spectrum": EnergyBound(9.0, band=lfo.low_pass(1.0))},
    "window": {"control_spectrum": mask(every_frequency=True, window="hann")},
    "mask on x_0: the sample that is appended": {"state_spectrum": mask(every_frequency=True, component=0), **ONE},
    "mask on y_0: the sample": {
        "output_spectrum": OutputSpectrum([[1.0, 2.0]], None, mask(every_frequency=True)),
        **ONE,
    },
}


@pytest.mark.parametrize("words", OBSTACLES)
def test_a_condition_that_fails_is_named(words):
    failing = conditions(**OBSTACLES[words])
    assert len(failing) == 1
    assert words in failing[0]


def test_ends_that_contract_in_a_ball_are_no_proof():
    """The ball limits both states at once: that each of them stays within its bounds is not enough."""
    contracting = lfo.LinearDynamics([[0.5, 0.5], [-0.5, 0.5]], [[1.0], [1.0]])
    (failing,) = conditions(dynamics=contracting, terminal_state=lfo.sets.Ball(1.0, [0.0, 0.0]))
    assert "does not stay at every admissible end (x_0, x_1)" in failing
    assert conditions(dynamics=contracting, terminal_state=lfo.Box([-1, -1], [1, 1])) == []


def rate_limited_move(horizon, **neighbours):
    return lfo.rate_limited(integrator(horizon, initial_state=[6.0, 0.0]), 0.4, **neighbours)


@expensive
def test_a_rate_limited_move_that_ends_at_rest_is_found_by_bisection():
    move = rate_limited_move(16, previous=0, following=0)
    found = lfo.minimum_time(move, horizons=(1, 16))
    assert found.monotone
    statuses = [lfo.solve(rate_limited_move(T, previous=0, following=0), throw=False).status for T in range(1, 17)]
    assert [status == "infeasible" for status in statuses].index(False) + 1 == found.horizon
    assert len(found.verdicts) <= 5
    assert abs(found.result.control[-1, 0]) <= 0.4 + 1e-9


def test_a_rate_limited_move_without_a_following_control_says_what_would_make_it_monotone():
    found = lfo.minimum_time(rate_limited_move(16, previous=0), horizons=(6, 16))
    assert not found.monotone
    assert "'rate limit' does not hold" in found.reason
    assert "following=0 in rate_limited" in found.reason
    moving = obstacles(lambda T: rate_limited_move(T, previous=0, following=0.1), 6, 9, same_data=True)
    assert any("'rate limit' does not hold" in reason for reason in moving)  # zero is too far from 0.1 - 0.4


def shrinking(horizon):
    """Return a problem with less force at longer horizons: feasible at 4 .. 6 only."""
    return integrator(horizon, control_set=lfo.Box(-1, 1) if horizon < 7 else lfo.Box(-0.01, 0.01))


def test_functions_whose_data_depend_on_the_horizon_are_not_monotone():
    found = lfo.minimum_time(shrinking, horizons=(1, 9))
    assert (found.horizon, found.monotone, found.proven) == (4, False, True)
    assert found.reason == "control_set: not the same in the first steps at the horizons 1 and 9"
    steady = lfo.minimum_time(integrator, horizons=(1, 9))
    assert (steady.horizon, steady.monotone) == (4, True)


def per_time(horizon):
    """Return a problem whose state bounds widen with time."""
    bound = np.column_stack([np.full(horizon + 1, 9.0), np.arange(1.0, horizon + 2)])
    return integrator(horizon, state_set=lfo.Box(-bound, bound))


def test_bounds_that_move_are_not_monotone():
    assert lfo.minimum_time(per_time, horizons=(2, 9)).reason == "state_set: it depends on time"


# --- what the search does with horizons that are not decided


class Found:
    """An outcome of a horizon."""

    interrupted, any_point, message, dual = False, False, "", False
    ray = cost = gap = lower_bound = bound = certificate = method = backend = None

    def __init__(self, horizon, verdict):
        self.problem, self.primal = integrator(horizon), verdict == "feasible"
        self.status = lfo.results.Status.INFEASIBLE if verdict == "infeasible" else lfo.results.Status.LIMIT


@pytest.mark.parametrize("monotone", [True, False])
def test_undecided_horizons_are_neither_feasible_nor_infeasible(monotone):
    kinds = {T: "infeasible" if T < 5 else "undecided" if T < 9 else "feasible" for T in range(1, 17)}
    search = search_horizons(1, 16, monotone, lambda horizon, any_point: Found(horizon, kinds[horizon]))
    assert search.horizon == 9
    assert search.of(Verdict.UNDECIDED) == [5, 6, 7, 8]
    assert 4 in search.of(Verdict.INFEASIBLE)


@expensive
def test_a_range_of_undecided_horizons_is_no_infeasible_one(monkeypatch):
    def stopped(problem, *options, **more):
        outcome = solve_judged(problem, Options("convex"))
        return replace(outcome, status=lfo.results.Status.LIMIT, certificate=None, infeasibility=None)

    substitute(monkeypatch, "solving.solve_judged", stopped)
    found = lfo.minimum_time(integrator, horizons=(1, 9), throw=False)
    assert (found.horizon, found.proven, found.ray) == (None, False, None)
    assert found.proof == "nothing is proven of 1 to 9"
    with pytest.raises(lfo.errors.LimitError):
        lfo.minimum_time(integrator, horizons=(1, 9))


def test_ctrl_c_keeps_what_is_decided():
    def stop(horizon, verdict):
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append((horizon, verdict))

    seen = []
    found = lfo.minimum_time(integrator, horizons=(1, 100), progress=stop)
    assert found.interrupted
    assert seen[0] == (100, "feasible")
    assert len(found.verdicts) == 3
    assert found.horizon == min(T for T, verdict in found.verdicts.items() if verdict == "feasible")
    assert not found.proven
    assert "nothing is proven of" in found.proof


# --- masks at every frequency: any feasible trajectory is an answer, but at the least horizon


def masked_move(limit=0.2, horizon=40, **fields):
    """Return a move from rest to rest whose spectrum is limited at every frequency of a band."""
    mover = lfo.library.double_integrator(horizon=horizon, sampling_time=0.1, cutoff_hz=None)
    mask = lfo.MagnitudeBound(limit, band=lfo.low_pass(cutoff_hz=1.0), every_frequency=True, **fields)
    return replace(mover, control_spectrum=mask)


def rounds_of(monkeypatch):
    """Return a list that gets the horizon of each problem at sampled frequencies."""
    rounds = []

    def counted(problem, *points):
        rounds.append(problem.horizon)
        return sampled_masks(problem, *points)

    substitute(monkeypatch, "transform.sampled_masks", counted)
    return rounds


@expensive
@pytest.mark.parametrize("source", [masked_move(), lfo.library.printer_move(40, 0.0025)], ids=["mask", "vibration"])
def test_masks_at_every_frequency_are_decided_by_any_feasible_trajectory(source, monkeypatch, tmp_path):
    path, rounds, told = tmp_path / "horizons.jsonl", rounds_of(monkeypatch), []
    found = lfo.minimum_time(source, (20, 80), path=path, progress=lambda *given: told.append(given))
    searched = len(rounds)
    optima = {T: lfo.solve(replace(source, horizon=T), throw=False) for T in found.verdicts}
    assert found.verdicts == {T: "feasible" if one.primal else one.status for T, one in optima.items()}
    best, row = optima[found.horizon], lfo.load_sweep(path).rows
    assert (found.result.status, found.proven) == ("optimal", True)
    assert np.array_equal(found.result.control, best.control)
    assert (found.result.cost, found.result.message, found.result.any_point) == (best.cost, "", False)
    assert searched < 0.8 * (len(rounds) - searched)
    # the file has the optimum, and of other horizons that there is a trajectory, with a higher cost
    by_horizon = {one["parameters"]["horizon"]: one for one in row}
    assert {T: one["status"] for T, one in by_horizon.items() if one["status"] != "infeasible"} == {
        T: "optimal" if T == found.horizon else "limit" for T, one in optima.items() if one.primal
    }
    for T, one in by_horizon.items():
        assert one["cost"] is None or one["cost"] >= optima[T].cost * (1 - 1e-9)
        assert one["status"] != "limit" or "no optimum was asked for" in one["message"]
    assert dict(told) == found.verdicts
    again = lfo.minimum_time(source, (20, 80), path=path)
    assert (again.verdicts, again.result.cost) == (found.verdicts, found.result.cost)


@expensive
@pytest.mark.at_tolerance("of the soft problem, the largest |V| alone counts")
@pytest.mark.parametrize("margin", [1e-2, 1e-3, 1e-5, 1e-7, -1e-7, -1e-5, -1e-3, -1e-2])
def test_near_the_least_limit_a_point_is_found_where_there_is_an_optimum(margin):
    """The least limit with a trajectory is the largest |V| of a soft mask at a high price."""
    soft = replace(masked_move(1.0, penalty=1e4), cost=lfo.QuadraticCost(R=1e-6))
    least = max(reading.value for reading in lfo.solve(soft).readings)
    problem = masked_move(least * (1 + margin))
    optimum, point = lfo.solve(problem, throw=False), solve_judged(problem, any_point=True)
    assert point.primal == optimum.primal
    if abs(margin) > 1e-6:  # the tolerance of peaks: within it, the last of all rounds may be the point
        assert point.any_point == point.primal == (margin > 0)
    assert point.primal or point.status == optimum.status == "infeasible"


def test_soft_masks_and_masks_at_bins_need_no_round(monkeypatch):
    rounds = rounds_of(monkeypatch)
    soft = masked_move(0.01, penalty=1.0)
    found = lfo.minimum_time(soft, (18, 60))
    assert found.horizon == lfo.minimum_time(replace(soft, control_spectrum=None), (18, 60)).horizon
    feasible = [T for T, verdict in found.verdicts.items() if verdict == "feasible" and T > found.horizon + 1]
    assert feasible
    assert all(rounds.count(T) == 1 for T in feasible)


def test_ctrl_c_during_the_optimum_keeps_the_feasible_trajectory(monkeypatch):
    """Of 20 to 61, the horizon 46 is decided before 45 is."""

    def solve_until_interrupted(problem, *options, any_point=False, **more):
        if not any_point and problem.horizon == 46:
            raise KeyboardInterrupt
        return solve_judged(problem, *options, any_point=any_point, **more)

    whole = lfo.minimum_time(masked_move(), (20, 61))
    substitute(monkeypatch, "solving.solve_judged", solve_until_interrupted)
    found = lfo.minimum_time(masked_move(), (20, 61))
    assert (found.interrupted, found.horizon, found.proof) == (True, 46, whole.proof)
    assert (found.result.status, found.result.any_point) == ("limit", True)
    assert "interrupted" in str(found)
    assert found.result.certificate.feasible
    assert found.result.cost > whole.result.cost


class FoundPoint(Found):
    """A feasible trajectory that is no optimum."""

    any_point = True


@pytest.mark.parametrize(("optimum", "least"), [("feasible", 8), ("undecided", 8), ("infeasible", 9)])
def test_the_solve_for_the_optimum_decides_last(optimum, least):
    """Rounding may prove that there is no trajectory where one has been found within the tolerances of the judge."""
    solved = []

    def solve(horizon, any_point):
        solved.append((horizon, any_point))
        if any_point:
            return FoundPoint(horizon, "feasible" if horizon >= 8 else "infeasible")
        return Found(horizon, "infeasible" if horizon < 8 else optimum if horizon == 8 else "feasible")

    search = search_horizons(1, 16, True, solve)
    assert search.horizon == least
    assert search.best.problem.horizon == least
    assert isinstance(search.best, FoundPoint) == (optimum == "undecided")
    assert solved.count((8, False)) == 1


# --- ends of the range, and bad input


def test_ends_of_the_range():
    at_once = lfo.minimum_time(integrator(), horizons=(5, 9))
    assert (at_once.horizon, at_once.ray, at_once.proven) == (5, None, True)
    assert at_once.proof == "5 is feasible; shorter horizons are outside of the range"
    with pytest.raises(
        lfo.errors.InfeasibleError,
        match=r"No horizon from 1 to 3 is feasible: 3 is proven.*At 3: .* In conflict: .*initial state",
    ) as caught:
        lfo.minimum_time(integrator(), horizons=(1, 3))
    assert caught.value.result.problem.horizon == 3
    assert caught.value.result.ray is not None
    never = lfo.minimum_time(integrator(), horizons=(1, 3), throw=False)
    assert (never.horizon, never.proven, never.ray is never.rays[3]) == (None, True, True)
    assert "none is known to be feasible" in str(never)


@pytest.mark.parametrize("horizons", [(5, 4), (0, 4), (1, 2, 3), 7, (1.0, 4), (True, 4), "12"])
def test_ranges_that_are_none_are_refused(horizons):
    with pytest.raises(lfo.errors.ProblemError, match="horizons: got"):
        lfo.minimum_time(integrator, horizons=horizons)


def test_problems_that_cannot_be_stated_at_another_horizon_are_refused():
    with pytest.raises(lfo.errors.ProblemError, match=r"control_set: .*horizon 9; give a function of the horizon"):
        lfo.minimum_time(integrator(control_set=[lfo.Box(-1, 1)] * 6), horizons=(3, 9))
    with pytest.raises(lfo.errors.ProblemError, match=r"problem\.horizon: got no parameter of that name"):
        lfo.minimum_time(lambda steps: integrator(steps), horizons=(3, 9))
    with pytest.raises(lfo.errors.ProblemError, match="a problem of the horizon 9"):
        lfo.minimum_time(lambda horizon: integrator(6), horizons=(3, 9))
    with pytest.raises(lfo.errors.ProblemError, match="an OptimalControlProblem"):
        lfo.minimum_time(7, horizons=(3, 9))


def test_a_numerical_ray_is_no_proof():
    """Without bounds on two equal controls, the ray of a stop band excludes trajectories up to a size alone."""
    h = 0.1
    dynamics = lfo.LinearDynamics([[1.0, h], [0.0, 1.0]], [[h * h / 2] * 2, [h] * 2], sampling_time=h)
    band = lfo.low_pass(cutoff_hz=0.35)  # of 28 steps, only constant controls pass; of 29, one more bin
    cost = lfo.QuadraticCost(R=1.0)
    free = lfo.OptimalControlProblem(dynamics, 30, cost, None, None, [0, 0], [1, 0], control_spectrum=band)
    found = lfo.minimum_time(free, (28, 29))
    assert (found.horizon, found.proven, list(found.rays)) == (29, False, [])
    assert found.proof.endswith(
        "a solver claims without a proof that no trajectory exists at 28; nothing is proven of 28"
    )
    bounded = lfo.minimum_time(replace(free, control_set=lfo.Box(-9, 9)), (28, 29))
    assert (bounded.horizon, bounded.proven) == (29, True)
    assert "28 is proven infeasible" in bounded.proof


def decay(horizon):
    """Return a move to 0.2 by dynamics of two modes."""
    left = lfo.AffineMode([[0.9]], [[1.0]], G=[[1.0]], h=[0.0])
    right = lfo.AffineMode([[0.5]], [[1.0]], G=[[-1.0]], h=[0.0])
    dynamics, bounds = lfo.PiecewiseAffineDynamics([left, right]), lfo.Box(-0.3, 0.3)
    return lfo.OptimalControlProblem(dynamics, horizon, lfo.QuadraticCost(R=1.0), bounds, None, [-2.0], [0.2])


@expensive
def test_proofs_by_search_trees_count(tmp_path):
    path = tmp_path / "horizons.jsonl"
    found = lfo.minimum_time(decay, horizons=(2, 12), path=path)
    assert (found.horizon, found.proven, dict(found.rays)) == (6, True, {})
    assert found.proof == "6 is feasible; each of 2 to 5 is proven infeasible"
    assert lfo.minimum_time(decay, horizons=(2, 12), path=path).proof == found.proof
    with pytest.raises(lfo.errors.InfeasibleError, match=r"each of 2 to 5 is .*At 5: proven by a search tree"):
        lfo.minimum_time(decay, horizons=(2, 5))


def narrow(horizon):
    """Return a move against a mask between two frequencies, between which few horizons have a bin."""
    mask = lfo.MagnitudeBound(0.02, band=lfo.spectrum.notch(1.4, 0.2))
    dynamics, bounds = lfo.LinearDynamics([[1.0]], [[1.0]]), lfo.Box(-1.0, 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.BandWarning)
        return lfo.OptimalControlProblem(
            dynamics, horizon, lfo.QuadraticCost(R=1.0), bounds, None, [0.0], [2.5], control_spectrum=mask
        )


@expensive
@pytest.mark.parametrize("longest", [9, 10, 11])
def test_a_mask_without_bins_holds_and_horizons_are_then_solved_one_by_one(longest):
    with_bins = [T for T in range(1, longest + 1) if narrow(T).terms]
    assert 0 < len(with_bins) < longest
    with pytest.warns(lfo.errors.BandWarning, match="of 3 samples"):  # of the answer alone
        found = lfo.minimum_time(narrow, horizons=(1, longest))
    every = [T for T in range(1, longest + 1) if lfo.solve(narrow(T), throw=False).primal]
    assert (found.horizon, found.proven, found.monotone) == (every[0], True, False)


NARROW = lfo.spectrum.notch(1.4, 0.1)  # of the horizons to 11, 9 alone has a bin there
WIDE = lfo.MagnitudeBound(9.0, band=lfo.low_pass(2.5), every_frequency=True)
WITHOUT_BINS = {
    "stop band": {"control_spectrum": NARROW},
    "mask": {"control_spectrum": lfo.MagnitudeBound(0.02, band=NARROW)},
    "energy": {"state_spectrum": EnergyBound(0.02, band=lfo.spectrum.notch(1.25, 0.02))},  # 10 samples at 9 steps
    "mask beside another": {"control_spectrum": [WIDE, lfo.MagnitudeBound(0.02, band=NARROW)]},
    "mask of an output": {"output_spectrum": OutputSpectrum(None, [[1.0]], lfo.MagnitudeBound(0.02, band=NARROW))},
    "stop band beside a mask of outputs": {"output_spectrum": OutputSpectrum(None, [[1.0]], [WIDE, NARROW])},
}


@pytest.mark.filterwarnings("ignore::lin_freq_ocp.base.errors.BandWarning")
@pytest.mark.parametrize("name", WITHOUT_BINS)
def test_bins_at_a_horizon_before_the_longest_are_an_obstacle(name):
    """A horizon without a bin is feasible where the next one, with a bin, may not be."""
    problem = replace(integrator(11), **WITHOUT_BINS[name])
    assert obstacles(partial(problem_at_horizon, problem), 1, 11, same_data=True)
    soft = replace(integrator(11), control_spectrum=[WIDE, lfo.MagnitudeBound(0.02, band=NARROW, penalty=1.0)])
    assert obstacles(partial(problem_at_horizon, soft), 1, 11, same_data=True) == []


# --- recorded, resumed, and on other processes


@expensive
@pytest.mark.parametrize("source", [integrator, random_problem(1)], ids=["monotone", "from below"])
def test_a_recorded_search_is_resumed_without_solving_again(source, tmp_path, monkeypatch):
    path, solved = tmp_path / "horizons.jsonl", []

    def counted(problem, *options, **more):
        solved.append(problem.horizon)
        return solve_judged(problem, *options, **more)

    substitute(monkeypatch, "solving.solve_judged", counted)
    first = lfo.minimum_time(source, horizons=(1, LAST), path=path)
    assert {row["parameters"]["horizon"] for row in lfo.load_sweep(path).rows} == set(first.verdicts)
    solved.clear()
    again = lfo.minimum_time(source, horizons=(1, LAST), path=path)
    assert (again.horizon, again.proof, again.verdicts) == (first.horizon, first.proof, first.verdicts)
    assert sorted(solved) == [first.horizon - 1, first.horizon]  # for the answer and its ray, which the file has not
    assert again.result.cost == pytest.approx(first.result.cost, rel=1e-9)
    assert again.ray is not None
    with pytest.raises(lfo.errors.ProblemError, match="other options"):
        lfo.minimum_time(source, horizons=(1, LAST), path=path, time_limit=9.0)


@expensive
def test_a_search_goes_on_after_ctrl_c(tmp_path):
    def stop(horizon, verdict):
        raise KeyboardInterrupt

    path = tmp_path / "horizons.jsonl"
    cut = lfo.minimum_time(integrator, horizons=(1, 100), path=path, progress=stop)
    assert cut.interrupted
    assert list(cut.verdicts) == [100]
    whole = lfo.minimum_time(integrator, horizons=(1, 100), path=path)
    assert (whole.horizon, whole.proven, whole.proof) == (4, True, lfo.minimum_time(integrator, (1, 100)).proof)


@expensive
@pytest.mark.parametrize("seed", [0, 1])
def test_an_executor_finds_the_same(seed):
    problem = random_problem(seed)
    here = lfo.minimum_time(problem, horizons=(1, LAST), throw=False)
    with ThreadPoolExecutor(3) as executor:
        there = lfo.minimum_time(problem, horizons=(1, LAST), throw=False, executor=executor)
    assert (there.horizon, there.proven, there.monotone) == (here.horizon, here.proven, here.monotone)
    assert there.proof == here.proof or here.monotone
    assert set(here.verdicts.items()) <= set(there.verdicts.items()) or here.monotone
    with pytest.raises(lfo.errors.ProblemError, match="executor"):
        lfo.minimum_time(problem, horizons=(1, LAST), executor=7)


def test_a_lost_horizon_is_undecided():
    class Losing(ThreadPoolExecutor):
        def submit(self, task, given, attempt):
            return super().submit((lambda *_: 1 / 0) if given[0] == 3 else task, given, attempt)

    with Losing(1) as executor:
        found = lfo.minimum_time(integrator, horizons=(3, 9), executor=executor)
    assert (found.horizon, found.proven) == (4, False)
    assert found.verdicts[3] == "undecided"


def test_a_recorded_range_without_a_feasible_horizon_has_its_ray_again(tmp_path):
    path = tmp_path / "horizons.jsonl"
    first = lfo.minimum_time(integrator, horizons=(1, 3), path=path, throw=False)
    again = lfo.minimum_time(integrator, horizons=(1, 3), path=path, throw=False)
    assert (again.horizon, again.proven, again.proof) == (None, True, first.proof)
    assert again.result.problem.horizon == 3
    assert again.ray is not None


def test_a_search_goes_on_from_the_file_of_a_sweep(tmp_path):
    path = tmp_path / "sweep.jsonl"
    lfo.sweep(integrator, {"horizon": [3, 5]}, path=path)
    found = lfo.minimum_time(integrator, horizons=(1, 9), path=path)
    assert (found.horizon, found.proven) == (4, True)
    assert found.verdicts[5] == "feasible"
    assert {row["parameters"]["horizon"] for row in lfo.load_sweep(path).rows} >= {3, 4, 5}


def filtered(random):
    """Return a problem whose state follows bounded controls through filters, with rows on both."""
    n = 2
    A, B = np.diag(random.uniform(0.2, 0.9, n)), random.uniform(-1, 1, (n, 2))
    rows = lfo.StageRows(random.normal(size=(3, n)), random.normal(size=(3, 2)), random.uniform(0.5, 3.0, 3), "rows")
    # of the states alone, from (A x + B u) with a margin: rows that the step before may imply
    C = random.normal(size=(1, n))
    kept = lfo.StageRows(C @ A, C @ B, [random.uniform(0.3, 1.5)], "filtered")
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B),
        6,
        lfo.QuadraticCost(R=1.0),
        lfo.Box(-1, 1),
        lfo.Box(-9, 9),
        [0, 0],
        stage_rows=[rows, kept],
    )


def largest_after_a_step(problem, C):
    """Return the largest C x_T over all ends that a step within rows and bounds reaches, by HiGHS."""
    A, B = problem.dynamics.A, problem.dynamics.B
    F = np.vstack([np.hstack([one.C, one.D]) for one in problem.stage_rows] + [s * np.hstack([A, B]) for s in (1, -1)])
    g = np.concatenate([one.e for one in problem.stage_rows] + [np.full(2, 9.0)] * 2)
    found = linprog(-np.hstack([C @ A, C @ B]), F, g, bounds=[(-9, 9)] * 2 + [(-1, 1)] * 2)
    return -found.fun


@expensive
@pytest.mark.parametrize("seed", range(4))
def test_rows_that_the_step_before_implies_are_those_of_linear_programs(seed):
    random, answers = np.random.default_rng(seed), set()
    for _ in range(15):
        problem = filtered(random)
        found = obstacles(partial(problem_at_horizon, problem), 2, 6, same_data=True)
        for rows in problem.stage_rows:
            margins = [rows.e[j] - largest_after_a_step(problem, rows.C[j]) for j in range(len(rows.e))]
            if min(map(abs, margins)) > 1e-6:
                implied = min(margins) > 0
                answers.add(implied)
                assert implied != any(f"'{rows.name}'" in words for words in found)
    assert answers == {True, False}


def test_rows_that_change_at_the_end_are_not_implied_by_the_step_before():
    """The row of the last steps is narrower than that of the step before them."""

    def problem(widths):
        rows = lfo.StageRows([[0.5]], [[0.5]], np.array(widths)[:, None], name="filtered")
        plant = lfo.LinearDynamics([[0.5]], [[0.5]])
        return lfo.OptimalControlProblem(
            plant, len(widths), lfo.QuadraticCost(R=1.0), lfo.Box(-1, 1), lfo.Box(-4, 4), [0], stage_rows=rows
        )

    def found(widths):
        return obstacles(lambda T: problem(widths[:T]), 3, len(widths), same_data=False)

    assert found([0.8] * 6) == []
    assert any("'filtered'" in words for words in found([0.8, 0.8, 0.8, 0.7, 0.7, 0.7]))
    assert found([0.7, 0.7, 0.8, 0.8, 0.8, 0.8]) == []


def test_a_useless_band_is_told_of_once():
    """Of the horizon that is the answer, and not of each that the search tries."""
    band = lfo.spectrum.notch(centre=3.1411, width=0.0002)
    free = lfo.library.double_integrator(cutoff_hz=None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.BandWarning)
        given = replace(free, control_spectrum=band)
    with pytest.warns(lfo.errors.BandWarning, match="removes no bin of a signal of 182 samples") as warned:
        assert lfo.minimum_time(given, horizons=(180, 190)).horizon == 182
    assert len(warned) == 1
