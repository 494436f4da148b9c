"""Infeasible and unbounded only by proof: what is known to be feasible, or bounded, is never called otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import rays
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.api import raise_for
from lin_freq_ocp.base import stack_signals
from lin_freq_ocp.certificate import implied_bounds, prove_infeasible, reachable_bounds, unbounded_direction
from lin_freq_ocp.methods import Candidate, steepest_recession
from lin_freq_ocp.program import REGISTER, Claim, backend
from lin_freq_ocp.solving import judge_candidate, verified_direction
from lin_freq_ocp.transform import translated_by

H = 0.1
DOUBLE = lfo.LinearDynamics([[1.0, H], [0.0, 1.0]], [[H * H / 2], [H]], sampling_time=H)


def growing(a: float, T: int, unit: float = 1.0, bound: float = 1.0) -> lfo.OptimalControlProblem:
    """Return x+ = a x + u, |u| <= 1, x_0 = 5 in other units: every control has a trajectory."""
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics([[a]], [[1.0]]),
        T,
        lfo.QuadraticCost(Q=2.0 / unit**2, R=2.0 / unit**2, P=2.0 / unit**2),
        control_set=lfo.Box(-bound * unit, bound * unit),
        initial_state=[5.0 * unit],
    )


@pytest.mark.parametrize(("a", "T"), [(1.3, 50), (2.0, 25)])
@pytest.mark.parametrize("unit", seeds([1e-9, 1.0, 1e9]))
def test_a_weak_control_on_an_unstable_plant_is_no_contradiction(a, T, unit):
    problem = growing(a, T, unit)
    result = lfo.solve(problem)
    down = lfo.simulate(problem, np.full((T, 1), -unit))
    assert result.status == "optimal"
    assert result.lower_bound <= result.cost + result.certificate.worth_of_residuals  # of rounded states
    assert result.cost <= (1 + 1e-9) * problem.value(down.x, down.u)


def test_one_feasible_trajectory_refutes_the_claim_of_a_solver():
    result = lfo.solve(growing(1.3, 60), "convex", throw=False)
    assert (result.status, result.primal, result.ray) == ("numerical_error", True, None)
    assert "the controls nearest to zero satisfy all constraints" in result.message


@expensive
@pytest.mark.parametrize("soft", [False, True])
def test_a_pendulum_that_falls_is_no_contradiction(soft):
    plant = lfo.LinearDynamics.from_continuous([[0, 1], [9.81, 0]], [[0], [1.0]], sampling_time=0.02)
    states = lfo.sets.Soft(lfo.Box(-1, 1), 10.0) if soft else None
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, P=1.0)
    result = lfo.solve(lfo.OptimalControlProblem(plant, 250, cost, lfo.Box(-1, 1), states, [0.3, 0]), throw=False)
    assert not result.status.startswith("infeasible")
    assert result.primal


@expensive
@pytest.mark.parametrize("seed", [1, 4])
def test_a_compact_problem_is_not_unbounded(seed):
    """Directions that fade away backwards from a fixed end hold all rows to 1e-6 of their largest terms."""
    assert rays.compact(seed)[1] == []


def rank_one() -> lfo.OptimalControlProblem:
    """Return a problem whose cost falls along a control without curvature that no row limits."""
    A = [[-0.4248823339820571, 0.2913292977827127], [0.17594883487129026, 0.18238342890599854]]
    B = [
        [-0.7801019204393277, -0.5411307589199351, -0.2431511730503049],
        [-0.7777476895603467, 1.6473711165652343, -0.497937902891404],
    ]
    curved = np.array([1.5765250009423346, -1.481788850209, -0.37798897])
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B),
        25,
        lfo.QuadraticCost(R=np.outer(curved, curved), r=[0.6352437293911782, -2.085586694435359, -0.05810937914330843]),
        initial_state=lfo.Box([-0.5563263789144567, None], [-0.5563263789144567, None]),
        control_spectrum=[
            lfo.stop_band(bins=range(5, 13), component=0),
            lfo.stop_band(bins=range(10, 13), component=1),
        ],
    )


@pytest.mark.parametrize("shift", seeds([0.0, 1e6, 1e8]))
@pytest.mark.parametrize("method", ["auto", "convex"])
def test_an_unbounded_problem_is_unbounded_wherever_zero_is(shift, method):
    problem = translated_by(rank_one(), np.array([-shift, 0.5 * shift])).problem
    result = lfo.solve(problem, method, throw=False)
    assert result.status == "unbounded"
    assert result.direction.residual < 1e-13


def test_an_unbounded_problem_is_no_problem_of_too_few_iterations(monkeypatch):
    entry, honest = REGISTER["clarabel"], backend("clarabel")

    def stop_early(program, tolerance, time_limit):
        solution, z = honest(program, tolerance, time_limit), np.zeros(program.A.shape[1])
        unfinished = replace(solution, claim=Claim.LIMIT, z=z, y=0 * program.lower)
        return unfinished if solution.claim is Claim.UNBOUNDED else solution

    monkeypatch.setitem(REGISTER, "clarabel", replace(entry, load=lambda member: stop_early))
    problem = lfo.OptimalControlProblem(DOUBLE, 5, lfo.QuadraticCost(r=[1.0]), initial_state=[1.0, 0.0])
    assert lfo.solve(problem, "convex", throw=False).status == "unbounded"


class TestDirections:
    """A direction holds every row at every time up to rounding of its own terms there."""

    FADING = lfo.LinearDynamics([[0.5]], [[1.0]])

    def problem(self, end=None):
        return lfo.OptimalControlProblem(self.FADING, 40, lfo.QuadraticCost(q=[1.0], R=1.0), terminal_state=end)

    def test_a_fading_direction_needs_a_free_end(self):
        """At the end it is 1e-12 of its largest value; no tolerance relative to that tells both problems apart."""
        along = lfo.Trajectory(-(0.5 ** np.arange(41.0))[:, None], np.zeros((40, 1)))
        assert unbounded_direction(self.problem(), along) is not None
        stopped = lfo.Trajectory(np.where(np.arange(41)[:, None] < 40, along.x, 0.0), along.u)
        assert unbounded_direction(self.problem([3.0]), stopped) is None
        assert verified_direction(self.problem([3.0]), stopped) is None

    def test_a_row_that_misses_by_a_thousandth_of_a_billionth_is_refused(self):
        along = lfo.Trajectory(-(0.5 ** np.arange(41.0))[:, None], np.zeros((40, 1)))
        wrong = along.x.copy()
        wrong[20] *= 1 + 1e-12
        assert unbounded_direction(self.problem(), lfo.Trajectory(wrong, along.u)) is None
        assert verified_direction(self.problem(), lfo.Trajectory(wrong, along.u)) is not None  # as it is corrected

    def test_a_bound_is_kept_exactly(self):
        along = lfo.Trajectory(-(0.5 ** np.arange(41.0))[:, None], np.zeros((40, 1)))
        bounded = replace(self.problem(), state_set=[lfo.sets.Everything()] * 40 + [lfo.Box([-1.0], None)])
        assert unbounded_direction(bounded, along) is None

    def test_without_a_recession_noise_is_not_one(self):
        problem = replace(self.problem(), initial_state=[1.0], control_set=lfo.Box(-1, None))
        along = steepest_recession(problem)
        assert along is None or verified_direction(problem, along) is None


def from_rest_to_rest(T: int, r: object) -> lfo.OptimalControlProblem:
    ends, band = {"initial_state": [0, 0], "terminal_state": [0, 0]}, lfo.low_pass(cutoff=0.5)
    return lfo.OptimalControlProblem(DOUBLE, T, lfo.QuadraticCost(r=r), control_spectrum=band, **ends)


@pytest.fixture
def without_dense_rows(monkeypatch):
    """Let every problem of bounds, ends and stop bands count as long."""
    monkeypatch.setitem(REGISTER, "clarabel", None)  # no sparse program
    substitute(monkeypatch, "methods.LONGEST_FACTOR", 0.0)


def test_a_long_problem_with_a_stop_band_is_unbounded_without_dense_rows(without_dense_rows):
    problem = from_rest_to_rest(80, -np.cos(0.1 * np.arange(80))[:, None])
    assert verified_direction(problem, steepest_recession(problem)).slope < 0
    result = lfo.solve(problem, "structured", throw=False)
    assert (result.status, result.has_trajectory) == ("unbounded", True)


@expensive
def test_a_long_direction_leads_to_the_end():
    """Rounding of 2000 controls leaves more of the end than its own terms round."""
    problem = from_rest_to_rest(2000, -np.cos(0.1 * np.arange(2000))[:, None])
    assert verified_direction(problem, steepest_recession(problem)).slope < 0


@expensive
def test_a_long_problem_whose_ends_determine_the_cost_has_no_direction(without_dense_rows):
    """Of the slope, the recession cone leaves rounding alone; the sparse program is not asked for another answer."""
    problem = from_rest_to_rest(200, [-1.0])
    assert steepest_recession(problem) is None
    assert lfo.solve(problem, throw=False).status == "locally_optimal"


def constant_control(bound: float | None, controls: int = 2) -> lfo.OptimalControlProblem:
    """Return a move from rest to rest with constant controls, which is impossible.

    That is proven if they are bounded, or if there is one: two that do the same may be of any size.
    """
    band = lfo.stop_band(bins=range(1, 11))
    box = None if bound is None else lfo.Box(-bound, bound)
    dynamics = lfo.LinearDynamics(DOUBLE.A, np.repeat(DOUBLE.B, controls, axis=1), sampling_time=H)
    cost = lfo.QuadraticCost(R=1.0)
    return lfo.OptimalControlProblem(dynamics, 20, cost, box, None, [0, 0], [1, 0], control_spectrum=band)


def test_a_control_that_its_spectrum_and_the_ends_determine_needs_no_bound():
    result = lfo.solve(constant_control(None, controls=1), throw=False)
    assert (result.status, result.bound, result.dual) == ("infeasible", "rigorous", True)


@pytest.mark.parametrize("method", ["spectral", "structured"])
def test_a_ray_over_unbounded_components_says_how_far_it_holds(method):
    free = lfo.solve(constant_control(None), method, throw=False)
    assert (free.status, free.bound, free.dual) == ("infeasible_claimed", "numerical", False)
    assert free.message.startswith("no trajectory with |x_0| <= ")
    assert {"initial state", "terminal state", "control stop band on u_0"} <= {one.block for one in free.conflict}
    with pytest.raises(lfo.errors.InfeasibleError, match="Larger ones are not excluded") as caught:
        raise_for(free)
    assert not caught.value.proven
    bounded = lfo.solve(constant_control(1e6), method, throw=False)
    assert (bounded.status, bounded.bound, bounded.dual) == ("infeasible", "rigorous", True)


@pytest.mark.parametrize("none", [None, 1e20])
def test_the_number_for_no_bound_does_not_matter(none):
    ray = lfo.solve(constant_control(None), throw=False).ray
    proof = prove_infeasible(constant_control(none), ray)
    assert proof.bound.kind == "numerical"
    assert 1.0 < proof.bound.multiple < np.inf
    assert proof.bound.value > 0


def test_a_ray_holds_up_to_the_size_that_it_states():
    """The farthest size is halfway to where the ray proves nothing: ten times as far, it does not."""
    problem = constant_control(None)
    ray = lfo.solve(problem, throw=False).ray
    spoiled = replace(ray, eta=ray.eta * (1 + 1e-6 * np.cos(np.arange(20.0)))[:, None])
    proof = prove_infeasible(problem, spoiled)
    assert proof.bound.multiple < 1e8
    size = proof.bound.multiple * np.array([1.0, 1.0])  # at least, as no size in the data is below
    assert np.isfinite(size).all()
    nearer = replace(problem, control_set=lfo.Box(-1e-3 * size[0], 1e-3 * size[0]))
    assert prove_infeasible(nearer, spoiled).bound.kind == "rigorous"
    farther = replace(problem, control_set=lfo.Box(-1e6 * size[0], 1e6 * size[0]))
    assert prove_infeasible(farther, spoiled) is None


BINS = range(11)
SPEED = [[0.0, 1.0]]
BOUNDED = {
    "a ball": {"control_set": lfo.sets.Ball(2.0)},
    "an ellipsoid of states": {"state_set": lfo.sets.Ellipsoid(SPEED, 0.3)},
    "an energy bound": {"control_spectrum": lfo.spectrum.EnergyBound(3.0, bins=BINS)},
    "a mask": {"control_spectrum": lfo.MagnitudeBound(0.5, bins=BINS)},
    "a polyhedron": {"control_set": lfo.sets.Polyhedron([[1.0], [-1.0]], [1.0, 2.0])},
}


@expensive
@pytest.mark.parametrize("name", BOUNDED)
def test_other_constraints_bound_signals_as_boxes_do(name):
    """Whatever bounds the controls, a ray is rigorous; and the largest controls and states are inside the bounds."""
    cost = lfo.QuadraticCost(R=1.0)
    far = lfo.OptimalControlProblem(DOUBLE, 20, cost, None, None, [0, 0], [9, 0])
    result = lfo.solve(replace(far, **BOUNDED[name]), throw=False)
    assert (result.status, result.bound) == ("infeasible", "rigorous")
    problem = replace(far, terminal_state=None, **BOUNDED[name])
    region = implied_bounds(problem)
    lower, upper = region.bounds
    assert np.isfinite(lower).all()
    assert np.isfinite(upper).all()
    for r, q in (([1.0], [0.0, 0.0]), ([0.0], [-1.0, 0.0]), ([0.0], [0.0, 1.0])):
        extreme = lfo.solve(replace(problem, cost=lfo.QuadraticCost(r=r, q=q)), throw=False).trajectory
        assert (stack_signals(extreme.x, extreme.u) >= lower - 1e-6).all()
        assert (stack_signals(extreme.x, extreme.u) <= upper + 1e-6).all()


def test_components_that_an_unbounded_control_does_not_reach_keep_their_reach():
    two = lfo.LinearDynamics([[0.9, 0.0], [0.0, 0.8]], np.eye(2))
    held = lfo.Box([-0.1, None], [0.1, None])
    problem = lfo.OptimalControlProblem(two, 10, lfo.QuadraticCost(R=1.0), held, initial_state=[0.0, 0.0])
    lower, upper = reachable_bounds(problem).bounds
    assert upper[-1, 0] == pytest.approx(0.1 * sum(0.9**k for k in range(10)))
    assert np.isinf(upper[1:, 1]).all()
    assert np.isinf(lower[1:, 1]).all()
    coupled = replace(problem, dynamics=lfo.LinearDynamics([[0.9, 1e-300], [0.0, 0.8]], np.eye(2)))
    assert np.isinf(reachable_bounds(coupled).bounds[1][2:, 0]).all()


def test_multipliers_of_a_failed_solve_prove_only_what_is_rigorous():
    problem = constant_control(None)
    ray = lfo.solve(problem, throw=False).ray
    failed = Candidate(lfo.results.Status.NUMERICAL_ERROR, multipliers=ray, message="failed")
    assert judge_candidate(problem, failed, "", None, None).status == "numerical_error"
    assert judge_candidate(constant_control(1e6), failed, "", None, None).status == "infeasible"
