"""Where modes meet: the joint inclusion, flip-stationarity and the printed form, each where it holds and where not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

import lin_freq_ocp as lfo
from helpers import kinks
from helpers.borders import changed, multipliers_of, peak_optimum
from helpers.random.kinks import KINDS, random_map
from helpers.seeds import expensive
from lin_freq_ocp.certificate import Bound, judge, trajectory_sizes
from lin_freq_ocp.methods.hybrid import multipliers_with_weights
from lin_freq_ocp.problem.hybrid import REGION


def failures(certificate, label, name=""):
    return [one for one in certificate.failed if one.label == label and name in one.name]


def fact(certificate, label, name=""):
    return next(one for one in certificate.borders.conditions if one.label == label and name in one.name)


# --- by hand ---------------------------------------------------------------------------------------------------------


def test_at_a_concave_kink_all_facts_hold_with_the_weights_by_hand():
    problem, trajectory, multipliers = peak_optimum()
    certificate = judge(problem, trajectory, multipliers)
    facts = certificate.borders
    assert certificate.pmp == "satisfied"
    assert (facts.joint, facts.flip_stationary, facts.printed, facts.regular, facts.elsewhere) == (True,) * 5
    assert (facts.times, facts.flips, facts.jumping) == ((1,), (), None)
    assert facts.weights == pytest.approx(np.array([[5 / 8, 3 / 8]]), abs=1e-7)
    assert multipliers.eta[:, 0] == pytest.approx([0.5, 2.0], abs=1e-6)
    assert REGION not in multipliers.stage


@pytest.mark.parametrize("sequence", [(0, 0), (0, 1)])
def test_region_multipliers_are_weights_times_the_kink(sequence):
    """lambda = alpha_2 <g, eta>, with g = 2 for rising - falling."""
    problem = kinks.peak()
    (border,) = problem.borders
    result = lfo.solve(problem.with_modes(sequence))
    weights = multipliers_with_weights(problem, result.trajectory, np.array(sequence), result.multipliers).weights
    other = weights[1, 1 - sequence[1]]
    slope = float(border.g @ result.multipliers.eta[1])
    assert slope == pytest.approx(4.0)
    assert result.multipliers.stage[REGION][1, 0] == pytest.approx(other * slope, rel=1e-6)


def test_at_a_convex_kink_the_joint_inclusion_accepts_what_every_flip_improves():
    problem = kinks.valley()
    certificate = lfo.certify(problem, [[-1.0], [4.0]])
    facts = certificate.borders
    assert certificate.pmp == "satisfied"
    assert facts.joint
    assert not facts.flip_stationary
    assert not facts.printed
    assert not facts.regular
    assert {(flip.time, flip.mode, flip.improves) for flip in facts.flips} == {(1, 0, True), (1, 1, True)}
    assert facts.weights == pytest.approx(np.array([[5 / 8, 3 / 8]]), abs=1e-6)
    assert certificate.descent.slope < 0
    for sequence in ([0, 0], [0, 1]):
        assert lfo.solve(problem.with_modes(sequence)).cost < certificate.cost - 1


def test_the_rate_of_a_flip_is_the_fall_of_the_cost():
    """From x_1 = 1, one unit of u_0 up and x_2 rises at 1: the cost falls at 2 + 1/2, down at 2 - 1/2."""
    problem = kinks.valley()
    certificate = lfo.certify(problem, [[-1.0], [4.0]])
    rates = {flip.mode: flip.rate for flip in certificate.borders.flips}
    x = lfo.simulate(problem, [[-1.0], [4.0]])
    size = trajectory_sizes(problem, x)[
        0
    ].item()  # the direction goes along x alone: eta_0 and the cost of u_0 are in p
    assert rates == pytest.approx({1: 2.5 * size, 0: 1.5 * size}, rel=1e-6)
    step = 1e-4
    for mode, sign in ((1, 1.0), (0, -1.0)):
        moved = lfo.simulate(problem, [[-1.0 + sign * step], [4.0]])
        fall = certificate.cost - problem.value(moved.x, moved.u)
        assert fall / step == pytest.approx(rates[mode] / size, rel=1e-3)


def test_the_kink_of_a_fixed_state_is_an_optimum_but_not_as_printed():
    problem = kinks.absolute_value()
    certificate = lfo.certify(problem, [[0.5]])
    facts = certificate.borders
    assert certificate.pmp == "satisfied"
    assert facts.flip_stationary  # no direction leaves x_0 = 0
    assert not facts.printed
    assert not fact(certificate, "printed", "C-iii").passed  # |y| - mu y <= 0 for all y has no solution mu
    assert fact(certificate, "printed", "C-v").passed
    for u in np.linspace(-1, 2, 31):
        moved = lfo.simulate(problem, [[u]])
        assert problem.value(moved.x, moved.u) >= certificate.cost - 1e-12


def test_a_concave_kink_of_a_fixed_state_is_as_printed():
    """With the sign of the cost of x_1 changed, eta_0 = -1 and mu_0 in [-1, 1] will do, whatever the given one is."""
    problem = kinks.absolute_value(cost=lfo.QuadraticCost(R=2.0, p=[1.0]))
    certificate = judge(problem, lfo.simulate(problem, [[-0.5]]), multipliers_of(problem, -1.0, [0.3, 0.0], 0.0))
    assert certificate.pmp == "satisfied"
    assert certificate.borders.printed
    assert certificate.borders.regular
    assert certificate.borders.weights == pytest.approx(np.array([[0.35, 0.65]]))


def test_the_kink_of_an_inner_state_is_an_optimum_but_not_as_printed_and_no_multipliers_are_common():
    problem = kinks.inner_absolute_value()
    certificate = lfo.certify(problem, [[0.0], [0.5]])
    facts = certificate.borders
    assert certificate.pmp == "satisfied"
    assert not facts.printed
    assert not facts.regular
    assert not facts.flip_stationary  # eta_0 >= 1 for one mode, eta_0 <= -1 for the other
    assert facts.flips
    assert all(flip.improves is False for flip in facts.flips)  # which is no descent: each has multipliers of its own
    assert certificate.descent is None
    for eta in np.linspace(-1.5, 1.5, 7):  # whatever eta_0 is, and nu_0 = eta_0 - 2 <= 0 with it
        given = multipliers_of(problem, [eta, 1.0], np.zeros(3), [eta - 2, 0.0])
        judged = judge(problem, lfo.simulate(problem, [[0.0], [0.5]]), given)
        assert (judged.pmp == "satisfied") == (abs(eta) <= 1)
        assert not judged.borders.printed
        assert not judged.borders.flip_stationary
    costs = [problem.value(*signals(problem, [[a], [b]])) for a in (0, 0.1, 0.5, 1) for b in (-1, 0, 0.4, 0.5, 0.6, 1)]
    assert min(costs) >= certificate.cost - 1e-12


def signals(problem, u):
    trajectory = lfo.simulate(problem, u)
    return trajectory.x, trajectory.u


def test_only_the_joint_inclusion_holds_at_the_optimum_of_max_and_min():
    """With rho = 1/4, p = (-1/4, 1/4): neither p_x is in [0, 1] nor p_u in [-1, 0], but p is in the triangle."""
    problem = kinks.max_of_min()
    trajectory = lfo.simulate(problem, np.zeros((2, 1)))
    certificate = judge(problem, trajectory, multipliers_of(problem, [0.25, -1.0], np.zeros(3), np.zeros(2), 0.25))
    assert certificate.pmp == "satisfied"
    assert not fact(certificate, "printed", "in x").passed
    assert not fact(certificate, "printed", "in u").passed
    assert fact(certificate, "printed", "in x").residual == pytest.approx(0.25)
    assert fact(certificate, "printed", "in u").residual == pytest.approx(0.25)
    ways = [(v, problem.value(*signals(problem, [[v], [-v]]))) for v in np.linspace(-1, 1, 9)]
    assert min(cost for _, cost in ways) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("rho", [-1.1, -0.9, -0.2, -0.1, 0.0, 0.2, 0.25, 0.4, 0.5, 0.6, 0.8, 1.6])
def test_no_multiplier_makes_both_partial_inclusions_hold(rho):
    """p = (rho - 1/2, rho): p_x in [0, 1] asks for rho >= 1/2, p_u in [-1, 0] for rho <= 0; both in the triangle."""
    problem = kinks.max_of_min()
    given = multipliers_of(problem, [rho, -1.0], np.zeros(3), np.zeros(2), rho)
    certificate = judge(problem, lfo.simulate(problem, np.zeros((2, 1))), given)
    assert fact(certificate, "printed", "in x").passed == (0.5 - 1e-9 <= rho <= 1.5 + 1e-9)
    assert fact(certificate, "printed", "in u").passed == (-1 - 1e-9 <= rho <= 1e-9)
    assert not certificate.borders.printed
    corners = np.array([[-1.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    assert (certificate.pmp == "satisfied") == in_hull(np.array([rho - 0.5, rho]), corners)


def in_hull(point, corners):
    rows = np.vstack([corners.T, np.ones(len(corners))])
    return linprog(np.zeros(len(corners)), A_eq=rows, b_eq=np.append(point, 1.0)).status == 0


# --- every check fails where it must ---------------------------------------------------------------------------------


class TestEachCheckFails:
    """One error each in the optimum of the peak, at whose border x_1 = 1 both modes have a weight."""

    def judge(self, trajectory=None, **fields):
        problem, honest, multipliers = peak_optimum()
        return judge(problem, trajectory or honest, changed(multipliers, **fields))

    def test_weights_of_another_convex_sum(self):
        certificate = self.judge(weights=[[1.0, 0.0], [0.5, 0.5]])
        assert failures(certificate, "C-iii", "adjoint")[0].time == 1
        assert not failures(certificate, "N-f")
        assert not certificate.borders.joint
        assert certificate.borders.flip_stationary  # which knows no weights

    def test_a_weight_below_zero(self):
        failed = failures(self.judge(weights=[[1.0, 0.0], [1.25, -0.25]]), "N-f")[0]
        assert (failed.time, failed.component, failed.residual) == (1, 1, 0.25)

    def test_weights_that_do_not_sum_to_one(self):
        failed = failures(self.judge(weights=[[1.0, 0.0], [0.625, 0.5]]), "N-f")[0]
        assert (failed.time, failed.residual) == (1, 0.125)

    def test_a_weight_on_a_mode_that_does_not_hold(self):
        failed = failures(self.judge(weights=[[0.9, 0.1], [0.625, 0.375]]), "N-f")[0]
        assert (failed.time, failed.component) == (0, 1)
        assert failed.residual == pytest.approx(0.1)

    def test_adjoint_of_the_wrong_sign(self):
        _, _, multipliers = peak_optimum()
        certificate = self.judge(eta=-multipliers.eta, weights=None)
        assert failures(certificate, "C-iv", "at T")
        assert not certificate.borders.regular  # -<eta, f> has a concave kink then
        assert not certificate.borders.flip_stationary
        assert not certificate.borders.printed
        assert not certificate.borders.elsewhere

    def test_adjoint_before_the_border_outside_the_hull(self):
        """eta_0 in [-2, 2] lies in the hull of slopes, and nothing else does; u_0 has a cost that fits."""
        problem, trajectory, multipliers = peak_optimum()
        for eta, inside in ((1.9, True), (2.1, False), (-1.9, True), (-2.1, False)):
            cost = lfo.QuadraticCost(R=0.5, r=[[eta - 0.5], [0.0]], p=[-2.0])
            given = changed(multipliers, eta=[[eta], [2.0]], mu=[[eta], [0.0], [0.0]], weights=None)
            certificate = judge(replace(problem, cost=cost), trajectory, given)
            facts = certificate.borders
            assert (facts.joint, facts.flip_stationary, facts.printed) == (inside,) * 3
            assert bool(failures(certificate, "C-iii", "adjoint")) == (not inside)
            assert [flip.mode for flip in facts.flips] == ([] if inside else [1] if eta < 0 else [0])
            assert facts.regular

    def test_region_multiplier_scaled(self):
        """Three times lambda = alpha <g, eta>, 9/8 of <g, eta>: more than a weight can explain, and a flip."""
        problem = kinks.peak()
        result = lfo.solve(problem.with_modes([0, 0]))
        eta = result.multipliers.eta.copy()
        stage = {REGION: 3 * result.multipliers.stage[REGION]}
        eta[0] = 2.0 - stage[REGION][1]  # what stationarity of the rising sequence makes of it
        scaled = changed(result.multipliers, eta=eta, stage=stage)
        certificate = judge(
            problem, result.trajectory, multipliers_with_weights(problem, result.trajectory, np.zeros(2, int), scaled)
        )
        assert failures(certificate, "C-iii", "adjoint")[0].time == 1
        assert [(flip.time, flip.mode) for flip in certificate.borders.flips] == [(1, 1)]
        assert certificate.borders.weights == pytest.approx(np.array([[0.0, 1.0]]), abs=1e-9)

    def test_next_state_of_another_mode(self):
        problem = kinks.peak()
        x = [[0.0], [0.5], [0.5]]  # 2 - x_1 would be 1.5
        certificate = judge(problem, lfo.Trajectory(x, [[0.5], [-1.0]]), peak_optimum()[2])
        assert failures(certificate, "C-iii", "state equation")[0].time == 1
        assert not certificate.feasible

    def test_next_state_of_an_average(self):
        """Between the images of two modes that jump, the averaged dynamics hold, and the map does not."""
        problem = kinks.rotation(horizon=1, initial_state=(0.0, 1.0))
        images = problem.dynamics.arrays(1).images(np.array([[0.0, 1.0]]), np.zeros((1, 1)))[0]
        given = multipliers_of(problem, np.zeros(2), np.zeros(4), [0.0], weights=[[0.5, 0.5]])
        for x_1, holds in ((images[0], True), (images[1], True), (images.mean(axis=0), False)):
            certificate = judge(problem, lfo.Trajectory([[0.0, 1.0], x_1], [[0.0]]), given)
            assert bool(failures(certificate, "C-iii", "state equation")) == (not holds)
            assert failures(certificate, "N-f")  # of the two modes, one leads elsewhere

    def test_no_mode_holds(self):
        modes = [mode for mode in kinks.peak().dynamics.modes]
        far = lfo.AffineMode(modes[1].linear.A, modes[1].linear.B, [2.0], G=[[-1.0], [1.0]], h=[-1.0, 20.0])
        problem = replace(kinks.peak(), dynamics=lfo.PiecewiseAffineDynamics([modes[0], far]))
        trajectory = lfo.Trajectory([[0.0], [21.0], [-19.0]], [[21.0], [0.0]])
        certificate = judge(problem, trajectory, peak_optimum()[2])
        failed = failures(certificate, "S-f")[0]
        assert (failed.time, failed.component) == (1, 1)
        assert failed.residual == pytest.approx(1 / 41)
        assert not certificate.feasible


def test_a_border_that_is_missed_by_less_than_the_tolerance_is_met():
    problem, trajectory, multipliers = peak_optimum()
    for miss, meets in ((1e-7, True), (-1e-7, True), (1e-5, False)):
        u = trajectory.u + np.array([[miss], [0.0]])
        assert bool(judge(problem, lfo.simulate(problem, u), multipliers).borders.times) == meets


@pytest.mark.parametrize("shape", [(2, 3), (2, 1)])
def test_weights_of_another_number_of_modes_are_refused(shape):
    problem, trajectory, multipliers = peak_optimum()
    with pytest.raises(lfo.errors.ProblemError, match=r"multipliers\.weights: got shape .*expected shape \(2, 2\)"):
        judge(problem, trajectory, changed(multipliers, weights=np.zeros(shape)))


def test_weights_for_linear_dynamics_are_refused():
    problem, trajectory, multipliers = peak_optimum()
    with pytest.raises(lfo.errors.ProblemError, match="the dynamics are linear"):
        judge(replace(problem, dynamics=problem.dynamics.modes[0].linear), trajectory, multipliers)


@pytest.mark.parametrize("weights", [np.zeros(2), np.zeros((3, 2)), np.zeros((2, 0)), [[np.nan, 1.0]] * 2, "half"])
def test_weights_that_are_none_are_refused(weights):
    with pytest.raises(lfo.errors.ProblemError, match=r"multipliers\.weights"):
        changed(peak_optimum()[2], weights=weights)


def test_without_weights_the_judge_takes_the_nearest():
    problem, trajectory, multipliers = peak_optimum()
    certificate = judge(problem, trajectory, changed(multipliers, weights=None))
    assert certificate.pmp == "satisfied"
    assert certificate.borders.weights == pytest.approx(np.array([[5 / 8, 3 / 8]]), abs=1e-6)


# --- jumps, bounds ---------------------------------------------------------------------------------------------------


def test_a_map_that_jumps_is_outside_the_theorem_and_its_border_is_named():
    problem = kinks.rotation()
    result = lfo.solve(problem.with_modes([0, 1, 0, 1, 0]))
    assert result.cost == pytest.approx(2.8371550, abs=1e-6)  # the optimum over all sequences
    certificate = lfo.certify(problem, result.trajectory)
    assert certificate.pmp == "not_applicable"
    assert certificate.feasible
    assert not certificate.failed  # every condition is still looked at
    border = certificate.borders.jumping
    assert (border.first, border.second) == (0, 1)
    assert np.abs(border.h_x) == pytest.approx([1.0, 0.0])
    assert "jumps between left turn and right turn" in str(certificate.borders)
    spoiled = judge(problem, result.trajectory, multipliers_of(problem, np.ones(10), np.zeros(12), np.zeros(5)))
    assert spoiled.pmp == "not_applicable"
    assert spoiled.failed


def test_a_search_may_add_its_bound():
    problem, trajectory, multipliers = peak_optimum()
    certificate = judge(problem, trajectory, multipliers)
    assert certificate.bound is None
    assert certificate.gap is None
    assert not certificate.globally_optimal
    for below, optimal in ((1e-9, True), (1.0, False)):
        bound = Bound(certificate.cost - below, "rigorous", sets="the leaves of a search tree")
        bounded = replace(certificate, bound=bound)
        assert bounded.gap == pytest.approx(below / certificate.cost_scale)
        assert bounded.globally_optimal == optimal
        assert bounded.stage_gaps is None


def test_flip_stationary_points_are_local_minima():
    """The peak in a sample of trajectories nearby; the valley, where only the joint inclusion holds, is none."""
    rng = np.random.default_rng(2)
    for problem, u, least in ((kinks.peak(), [[1.0], [4.0]], True), (kinks.valley(), [[-1.0], [4.0]], False)):
        here = problem.value(*signals(problem, u))
        nearby = [problem.value(*signals(problem, u + 0.3 * rng.uniform(-1, 1, (2, 1)))) for _ in range(100)]
        assert (min(nearby) >= here) == least


# --- against directional derivatives ---------------------------------------------------------------------------------


SMALL = 1e-3
"""Length of a step from a border: the map is linear along it, and other borders are further away."""


class OneStep:
    """One step from a point on as many borders as there are, with linear costs that make p whatever one wishes."""

    def __init__(self, rng, kind, bounded, joint):
        dynamics = random_map(rng, 1, 1, kind)
        self.arrays, self.eta = dynamics.arrays(1), rng.standard_normal()
        self.point = meeting_point(dynamics, rng)
        self.meets = self.arrays.active(self.point[None, :1], self.point[None, 1:])[0]
        slopes = self.eta * np.hstack([self.arrays.A[0, :, 0], self.arrays.B[0, :, 0]])[self.meets]
        self.required = rng.dirichlet(np.ones(len(slopes))) @ slopes if joint else rng.standard_normal(2)
        self.problem = lfo.OptimalControlProblem(
            dynamics,
            1,
            lfo.QuadraticCost(q=self.required[:1], r=self.required[1:], p=[-self.eta]),
            lfo.Box([self.point[1]], [self.point[1] + 1]) if bounded else None,
        )
        self.joint = in_hull(self.required, slopes)

    def facts(self):
        image = self.problem.dynamics.stepper(1)(0, self.point[:1], self.point[1:])
        trajectory = lfo.Trajectory([self.point[:1], image], [self.point[1:]])
        return judge(self.problem, trajectory, multipliers_of(self.problem, [self.eta], np.zeros(2), [0.0])).borders

    def rise(self, directions):
        """Return the derivatives of <eta, f> - <p, .> along directions, by a step, and the modes that it leads into."""
        there = self.point + SMALL * directions
        x, u = np.vstack([there[:, :1], there[:1, :1]]), there[:, 1:]
        many = self.problem.dynamics.arrays(len(u))
        distance, images = many.distance(x, u), many.images(x, u)[..., 0]
        modes = np.argmin(distance, axis=1)
        here = self.arrays.images(self.point[None, :1], self.point[None, 1:])[0, self.meets, 0][0]
        slopes = self.eta * (images[np.arange(len(u)), modes] - here) / SMALL
        return slopes - directions @ self.required, np.where((distance <= 0).sum(1) == 1, modes, -1)


def meeting_point(dynamics, rng):
    """Return where two facets cross, or else any point of one."""
    rows = np.vstack([np.hstack([mode.region.C, mode.region.D]) for mode in dynamics.modes])
    limits = np.concatenate([mode.region.e for mode in dynamics.modes])
    for row, limit in zip(rows[1:], limits[1:], strict=True):
        pair = np.array([rows[0], row])
        if abs(np.linalg.det(pair)) > 1e-3:
            return np.linalg.solve(pair, [limits[0], limit])
    return rows[0] * limits[0] / (rows[0] @ rows[0]) + rng.standard_normal() * np.array([-rows[0][1], rows[0][0]])


@expensive
@pytest.mark.parametrize(("kind", "bounded"), list(zip(KINDS, [False, True] * 2, strict=True)))
def test_the_facts_are_those_of_directional_derivatives(kind, bounded):
    """Each fact again: by steps of the map itself along many directions, and the joint one by a linear program."""
    angles = np.linspace(0, 2 * np.pi, 3600, endpoint=False)
    around, axes = np.column_stack([np.cos(angles), np.sin(angles)]), np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    seen = set()
    for seed in range(12):
        rng = np.random.default_rng([seed, KINDS.index(kind), bounded])
        case = OneStep(rng, kind, bounded, joint=seed % 2 == 0)
        facts, allowed = case.facts(), around[around[:, 1] >= 0] if bounded else around
        rise, modes = case.rise(allowed)
        assert facts.times == (0,)
        assert facts.flip_stationary == bool(rise.max() <= 1e-9)
        assert {flip.mode for flip in facts.flips} == {int(mode) for mode in modes[rise > 1e-6]} - {-1}
        assert facts.printed == bool(case.rise(axes[:3] if bounded else axes)[0].max() <= 1e-9)
        a, b = around[rng.integers(0, len(around), (2, 4000))]
        assert facts.regular == bool((case.rise(a + b)[0] >= case.rise(a)[0] + case.rise(b)[0] - 1e-9).all())
        assert facts.joint == case.joint
        seen.add((facts.joint, facts.flip_stationary, facts.printed, facts.regular))
    assert len(seen) >= 3
