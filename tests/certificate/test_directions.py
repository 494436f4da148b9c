"""certify() of trajectories that come without multipliers: optima are proven, all else has a checked way down."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import control
import control.optimal
import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.random.convex import random_problem
from helpers.random.mixed import Model, problem_of, random_model
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import CONDITION_TOLERANCE, descent_direction

ALONE = (5, 11)
"""Seeds whose constraints leave a single trajectory, or nearly so: that of least control is the optimum, too."""

LEFT_OUT = (4, 10)
"""No direction is found that is accurate enough (unstable over 106 steps, a cost of 3e8); infeasible."""

SEEDS = pytest.mark.parametrize("seed", seeds(range(12)))


@cache
def mixed(seed: int) -> tuple[Model, lfo.OptimalControlProblem, lfo.results.Result]:
    model = random_model(seed)
    problem = problem_of(model)
    return model, problem, lfo.solve(problem)


def moved(point: lfo.Trajectory, along: Any, step: float) -> lfo.Trajectory:
    return lfo.Trajectory(point.x + step * along.x, point.u + step * along.u)


def value(problem: lfo.OptimalControlProblem, point: lfo.Trajectory) -> float:
    return problem.value(point.x, point.u)


def violation(problem: lfo.OptimalControlProblem, point: lfo.Trajectory) -> float:
    """Return by how much a point violates any constraint, by what the problem itself says of it."""
    x, u = point.x, point.u
    bins = [np.abs(np.fft.rfft(u, axis=0))[problem.control_stop], np.abs(np.fft.rfft(x, axis=0))[problem.state_stop]]
    return max(
        float(np.abs(x[1:] - problem.dynamics.successors(x, u)).max()),
        float(problem.state_tube.violation(x).max()),
        float(problem.control_tube.violation(u).max()),
        *(float(part.max(initial=0.0)) for part in bins),
        *(float(term.violation(x, u).max()) for term in problem.terms if term.hard),
    )


@expensive
@SEEDS
def test_an_optimum_is_proven_without_its_multipliers(seed):
    _, problem, result = mixed(seed)
    assert result.certificate.pmp == "satisfied"
    certificate = lfo.certify(problem, result.trajectory)
    assert (certificate.pmp, certificate.normal) == ("satisfied", True)
    assert certificate.descent is None
    assert certificate.globally_optimal


@SEEDS
def test_no_way_down_is_seen_from_an_optimum(seed):
    """Nor does the cost fall towards the point around which the problem was made, which is feasible."""
    model, problem, result = mixed(seed)
    point = result.trajectory
    other = lfo.Trajectory(model.x_near - point.x, model.u_near - point.u)
    assert descent_direction(problem, point, other) is None


@SEEDS
def test_a_feasible_point_that_is_not_optimal_has_a_way_down(seed):
    """Half way between the optimum and the point around which the problem was made."""
    model, problem, result = mixed(seed)
    point = moved(
        result.trajectory, lfo.Trajectory(model.x_near - result.trajectory.x, model.u_near - result.trajectory.u), 0.5
    )
    certificate = lfo.certify(problem, point)
    assert certificate.pmp == "violated"
    assert certificate.feasible
    along = certificate.descent
    assert along.slope < 0
    assert along.residual < CONDITION_TOLERANCE
    step = 1e-6
    fallen = value(problem, moved(point, along, step)) - value(problem, point)
    assert fallen == pytest.approx(step * along.slope, rel=0.05)
    # Everything is linear or of second order along it, and what is not active is farther away than the step.
    assert violation(problem, moved(point, along, step)) <= violation(problem, point) + 1e-3 * step


@pytest.mark.parametrize("seed", seeds(sorted(set(range(16)) - set(LEFT_OUT))))
def test_in_a_polyhedron_a_small_step_down_stays_feasible(seed):
    """Boxes, stop bands and ends: the trajectory of least control, judged by another cost."""
    _, problem = random_problem(seed)
    least = lfo.solve(replace(problem, cost=lfo.QuadraticCost(R=1.0)))
    point = least.trajectory
    certificate = lfo.certify(problem, point)
    if certificate.descent is None:
        assert certificate.pmp == "satisfied"
        assert seed in ALONE
        return
    assert certificate.pmp == "violated"
    for step in (1e-5, 1e-7):
        there = moved(point, certificate.descent, step)
        assert violation(problem, there) <= violation(problem, point) + 1e-6 * step
        assert value(problem, there) < value(problem, point)


class TestOthersSolutions:
    def test_a_model_of_cvxpy(self):
        """A ball and a sparse control, as somebody would write it who knows nothing of this library."""
        T = 25
        A, B, start = np.array([[1.0, 0.2], [-0.1, 0.95]]), np.array([[0.1, 0.0], [0.2, 0.3]]), np.array([2.0, -1.0])
        x, u = cp.Variable((2, T + 1)), cp.Variable((2, T))
        cost = 0.5 * cp.sum_squares(x) + 0.05 * cp.sum_squares(u) + 0.4 * cp.norm1(u)
        rules = [x[:, 0] == start, x[:, 1:] == A @ x[:, :-1] + B @ u, cp.norm(u, axis=0) <= 0.8]
        accurate = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-10)
        cp.Problem(cp.Minimize(cost), rules).solve(solver="CLARABEL", **accurate)
        problem = lfo.OptimalControlProblem(
            lfo.LinearDynamics(A, B),
            T,
            lfo.QuadraticCost(Q=1.0, R=0.1, P=1.0) + lfo.costs.L1Cost(u=0.4),
            control_set=lfo.sets.Ball(0.8),
            initial_state=start,
        )
        sizes = np.linalg.norm(u.value, axis=0)
        assert (np.abs(sizes - 0.8) < 1e-6).any()  # the ball acts
        assert (np.abs(u.value) < 1e-6).any()  # and so does the L1 cost
        certificate = lfo.certify(problem, lfo.Trajectory(x.value.T, u.value.T))
        assert (certificate.pmp, certificate.normal) == ("satisfied", True)
        assert certificate.globally_optimal
        assert certificate.cost == pytest.approx(float(cost.value), rel=1e-9)
        softer = replace(problem, cost=lfo.QuadraticCost(Q=1.0, R=0.1, P=1.0) + lfo.costs.L1Cost(u=0.39))
        assert lfo.certify(softer, lfo.Trajectory(x.value.T, u.value.T)).descent.slope < 0

    def by_python_control(self, **options: Any) -> tuple[lfo.OptimalControlProblem, np.ndarray]:
        A, B, T, step = np.array([[1.0, 0.2], [0.0, 1.0]]), np.array([[0.02], [0.2]]), 8, 0.2
        Q, R, P, start = np.diag([1.0, 0.1]), np.array([[0.2]]), 5 * np.eye(2), [1.0, 0.0]
        plant = control.ss(A, B, np.eye(2), 0, dt=step)
        answer = control.optimal.solve_ocp(
            plant,
            step * np.arange(T + 1),
            start,
            control.optimal.quadratic_cost(plant, Q, R),
            trajectory_constraints=[control.optimal.input_range_constraint(plant, [-0.8], [0.8])],
            terminal_cost=control.optimal.quadratic_cost(plant, P, 0 * R),
            print_summary=False,
            **options,
        )
        assert answer.success
        problem = lfo.OptimalControlProblem(
            lfo.LinearDynamics(A, B, sampling_time=step),
            T,
            lfo.QuadraticCost(Q=2 * Q, R=2 * R, P=2 * P),  # python-control's costs have no 1/2
            control_set=lfo.Box(-0.8, 0.8),
            initial_state=start,
        )
        return problem, answer.inputs[:, :T].T  # its last input, at T, acts on nothing

    @expensive
    def test_a_solution_of_python_control(self):
        """Its SLSQP with central differences reaches 3e-9, relative to the terms of D_u H."""
        accurate = {"minimize_options": {"ftol": 1e-14, "maxiter": 500}, "minimize_kwargs": {"jac": "3-point"}}
        problem, u = self.by_python_control(minimize_method="SLSQP", **accurate)
        certificate = lfo.certify(problem, u)
        assert (np.abs(u) > 0.8 - 1e-8).any()
        assert certificate.pmp == "satisfied"
        assert certificate.globally_optimal

    def test_its_default_accuracy_is_worth_little(self):
        """By default it stops where controls are right to 5e-4, and the cost to 3e-8."""
        problem, u = self.by_python_control()
        certificate = lfo.certify(problem, u)
        assert (certificate.pmp, certificate.globally_optimal) == ("satisfied", True)
        assert 1e-9 < certificate.worst.relative < 1e-7
        assert certificate.worst.relative < 2 * certificate.gap

    def test_a_coarse_tolerance_leaves_a_way_down(self):
        problem, u = self.by_python_control(minimize_options={"ftol": 1e-3})
        certificate = lfo.certify(problem, u)
        assert certificate.pmp == "violated"
        assert 1e-6 < certificate.worst.relative < 1e-2
        assert certificate.descent.slope < 0


def test_the_filtered_pendulum_is_violated_with_times_and_a_way_down():
    problem = lfo.library.pendulum()
    spectrum = np.fft.fft(lfo.solve(lfo.library.pendulum(cutoff=None)).control[:, 0])
    spectrum[97:144] = 0
    filtered = np.fft.ifft(spectrum).real[:, None]
    certificate = lfo.certify(problem, filtered)
    assert certificate.pmp == "violated"
    assert not certificate.feasible
    failed = {one.label: one for one in certificate.failed}
    assert failed["S-x"].time == problem.horizon  # it misses its end
    assert failed["S-u"].time in (0, 1, 2, 237, 238, 239)  # and exceeds its bound at both ends
    assert all(one.time is not None for one in certificate.failed if one.label != "N-r")
    along = certificate.descent
    assert along.slope < 0
    assert np.abs(np.fft.fft(along.u[:, 0])[97:144]).max() < 1e-9
    point = lfo.simulate(problem, filtered)
    there = moved(point, along, 1e-6)
    assert value(problem, there) < value(problem, point)
    assert violation(problem, there) <= violation(problem, point) + 1e-9
    # The constrained optimum, filtered in the same way, is itself.
    assert lfo.certify(problem, lfo.solve(problem).control).descent is None


class TestRefused:
    """One direction that is accepted, and one change for each check that only this check can see."""

    T = 16
    PLANT = lfo.LinearDynamics([[1.0, 0.2], [0.0, 1.0]], [[0.02], [0.2]], offset=[0.0, 0.01])
    U = 0.3 * np.sin(2 * np.pi * np.arange(T) / T)[:, None] - 0.1

    def problem(self, **fields: Any) -> lfo.OptimalControlProblem:
        cost = lfo.QuadraticCost(Q=[[1.0, 0], [0, 0.1]], R=0.1)
        return lfo.OptimalControlProblem(**({"dynamics": self.PLANT, "horizon": self.T, "cost": cost} | fields))

    def point(self) -> lfo.Trajectory:
        return lfo.simulate(self.problem(), self.U, [1.0, -0.2])

    def along(self) -> lfo.Trajectory:
        """Return a constant push downwards, from a fixed start."""
        linear = replace(self.PLANT, offset=np.zeros(2))
        return lfo.simulate(self.problem(dynamics=linear), -0.1 * np.ones((self.T, 1)), np.zeros(2))

    def accepted(self, along: lfo.Trajectory | None = None, **fields: Any) -> bool:
        return descent_direction(self.problem(**fields), self.point(), along or self.along()) is not None

    def test_it_is_accepted(self):
        assert self.accepted()
        assert self.accepted(initial_state=[1.0, -0.2])

    def test_its_sign_flipped(self):
        along = self.along()
        assert not self.accepted(lfo.Trajectory(-along.x, -along.u))

    def test_off_the_dynamics(self):
        along = self.along()
        x = along.x.copy()
        x[7:, 0] -= 1e-4 * np.abs(x).max()
        assert not self.accepted(lfo.Trajectory(x, along.u))
        assert not self.accepted(lfo.Trajectory(along.x, 0.999 * along.u))

    def test_nothing_at_all(self):
        along = self.along()
        assert not self.accepted(lfo.Trajectory(0 * along.x, 0 * along.u))

    def test_from_a_start_that_is_fixed(self):
        linear = replace(self.PLANT, offset=np.zeros(2))
        along = lfo.simulate(self.problem(dynamics=linear), -0.1 * np.ones((self.T, 1)), np.array([-0.1, 0.0]))
        assert self.accepted(along)
        assert not self.accepted(along, initial_state=[1.0, -0.2])

    @pytest.mark.parametrize(("slack", "accepted"), [(1e-3, True), (0.0, False), (-1e-3, False)])
    def test_out_of_a_control_bound(self, slack, accepted):
        """Active where it is touched or violated: there a direction must not make it worse."""
        assert self.accepted(control_set=lfo.Box([float(self.U.min()) - slack], None)) is accepted
        assert self.accepted(control_set=lfo.Box(None, [float(self.U.max())]))

    @pytest.mark.parametrize(("slack", "accepted"), [(1e-3, True), (0.0, False)])
    def test_out_of_a_state_bound(self, slack, accepted):
        lowest = float(self.point().x[1:, 1].min())
        sets = [lfo.sets.Everything(), *[lfo.Box([None, lowest - slack], None)] * self.T]
        assert self.accepted(state_set=sets) is accepted

    @pytest.mark.parametrize(("slack", "accepted"), [(1e-3, True), (0.0, False)])
    def test_out_of_the_terminal_state(self, slack, accepted):
        end = self.point().x[-1]
        assert self.accepted(terminal_state=lfo.Box(end - slack, end + slack)) is accepted

    @pytest.mark.parametrize(("bins", "accepted"), [([3, 5], True), ([0], False)])
    def test_out_of_a_stop_band(self, bins, accepted):
        assert self.accepted(control_spectrum=lfo.stop_band(bins=bins)) is accepted

    def test_a_small_part_in_a_stop_band(self):
        """A second control moves by 1e-7 of its size, in its stopped bin alone: no direction that is found does so."""
        wave = np.sin(2 * np.pi * 3 * np.arange(self.T) / self.T)[:, None]
        fields = {
            "dynamics": lfo.LinearDynamics(self.PLANT.A, [[0.02, 0.0], [0.2, 0.0]], offset=[0.0, 0.01]),
            "cost": lfo.QuadraticCost(Q=[[1.0, 0], [0, 0.1]], R=0.1, u_ref=[0.0, 1.0]),
            "control_spectrum": lfo.stop_band(bins=[3], component=1),
        }
        point, along = self.point(), self.along()
        point = lfo.Trajectory(point.x, np.hstack([self.U, 0 * wave]))
        for size, accepted in ((0.0, True), (1e-7, False)):
            there = lfo.Trajectory(along.x, np.hstack([along.u, size * wave]))
            found = descent_direction(self.problem(**fields), point, there)
            assert not accepted or found is not None
            part = np.zeros(self.T) if found is None else found.u[:, 1]
            assert np.abs(np.fft.rfft(part))[3] <= CONDITION_TOLERANCE * np.linalg.norm(part)

    def test_out_of_a_state_stop_band(self):
        assert not self.accepted(state_spectrum=lfo.stop_band(bins=[2], component=0))

    @pytest.mark.parametrize(("factor", "accepted"), [(1.01, True), (1.0, False), (0.9, False)])
    def test_out_of_a_mask(self, factor, accepted):
        mean = abs(float(self.U.sum()))
        assert self.accepted(control_spectrum=lfo.MagnitudeBound(factor * mean, bins=[0])) is accepted

    @pytest.mark.parametrize(("factor", "accepted"), [(1.01, True), (1.0, False)])
    def test_out_of_an_energy_bound(self, factor, accepted):
        energy = float((np.abs(np.fft.rfft(self.U[:, 0])) ** 2)[:3].sum())
        assert self.accepted(control_spectrum=lfo.spectrum.EnergyBound(factor * energy, bins=[0, 1, 2])) is accepted

    @pytest.mark.parametrize(("slack", "accepted"), [(1e-3, True), (0.0, False)])
    def test_out_of_a_ball(self, slack, accepted):
        farthest = float(np.abs(self.U).max())  # at the lowest control, which is pushed down
        assert self.accepted(control_set=lfo.sets.Ball(farthest + slack)) is accepted

    @pytest.mark.parametrize(("slack", "accepted"), [(1e-3, True), (0.0, False)])
    def test_out_of_a_cone(self, slack, accepted):
        farthest = float(np.abs(self.U).max())
        cone = lfo.sets.SecondOrderCone(
            [[1.0]], [0.0], [0.1], 1.1 * farthest + slack
        )  # |u| <= 0.1 u + d, u = -farthest
        assert self.accepted(control_set=cone) is accepted

    @pytest.mark.parametrize(("slack", "accepted"), [(1e-3, True), (0.0, False)])
    def test_out_of_a_joint_row(self, slack, accepted):
        values = -self.point().x[:-1, 0] - self.U[:, 0]
        rows = lfo.StageRows([[-1.0, 0.0]], [[-1.0]], [float(values.max()) + slack])
        assert self.accepted(stage_rows=rows) is accepted

    @pytest.mark.parametrize(("slack", "accepted"), [(1e-3, True), (0.0, False)])
    def test_out_of_a_polyhedron(self, slack, accepted):
        assert self.accepted(control_set=lfo.sets.Polyhedron([[-1.0]], [-float(self.U.min()) + slack])) is accepted

    @pytest.mark.parametrize(("penalty", "accepted"), [(1e-3, True), (1e3, False)])
    def test_into_a_price(self, penalty, accepted):
        """The slope is that of all costs: a soft bound that the direction leaves, an L1 cost that it raises."""
        lower = lfo.Box([float(self.U.min())], None)
        assert self.accepted(control_set=lfo.sets.Soft(lower, penalty)) is accepted
        cost = lfo.QuadraticCost(Q=[[1.0, 0], [0, 0.1]], R=0.1)
        assert self.accepted(cost=cost + lfo.costs.L1Cost(u=penalty, u_ref=self.U)) is accepted

    def test_the_slope_is_the_derivative_of_the_cost(self):
        problem, point = self.problem(), self.point()
        found = descent_direction(problem, point, self.along())
        step = 1e-6
        difference = (value(problem, moved(point, found, step)) - value(problem, moved(point, found, -step))) / (
            2 * step
        )
        assert found.slope == pytest.approx(difference, rel=1e-6)
        again = descent_direction(problem, point, lfo.Trajectory(1e6 * found.x, 1e6 * found.u))
        assert again.slope == pytest.approx(found.slope)  # per unit, however long it is given
