"""Costs without a lower bound: the direction that proves it is checked by hand, and wrong ones are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.random.unbounded import random_unbounded, with_cost_times
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import unbounded_direction

T = 10
ONE = lfo.LinearDynamics([[1.0]], [[1.0]])
TWO = lfo.LinearDynamics([[0.9, 0.0], [0.0, 0.8]], np.eye(2))
CART = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]])
STABLE = lfo.LinearDynamics([[0.9]], [[1.0]])
Cost = lfo.QuadraticCost


def problem_of(dynamics: lfo.LinearDynamics, cost: Any, start: Any = "rest", **fields: Any):
    initial = np.zeros(dynamics.state_dim) if isinstance(start, str) else start
    return lfo.OptimalControlProblem(dynamics, T, cost, initial_state=initial, **fields)


SLANTED = [[1.0, -1.0], [-1.0, 1.0]]
CONE = lfo.sets.SecondOrderCone([[1, 0]], [0], [0, 1], 1.0)
UNBOUNDED = {
    "bounded on the other side": problem_of(ONE, Cost(r=[1.0]), control_set=lfo.Box(None, [2.0])),
    "a state that falls": problem_of(CART, Cost(q=[1.0, 0]), [0.0, 1.0], control_set=lfo.Box(None, [1.0])),
    "steeper than its L1 cost": problem_of(ONE, Cost(r=[1.0]) + lfo.costs.L1Cost(u=0.9)),
    "steeper than its Linf cost": problem_of(TWO, Cost(r=[1.0, -1.0]) + lfo.costs.LInfCost(u=1.5)),
    "steeper than its penalty": problem_of(ONE, Cost(r=[1.0]), control_set=lfo.sets.Soft(lfo.Box(-1, 1), 0.5)),
    "a mask lets the mean pass": problem_of(
        ONE, Cost(q=[1.0]), control_spectrum=lfo.MagnitudeBound(1.0, bins=range(1, 6))
    ),
    "an energy bound lets the mean pass": problem_of(
        CART, Cost(q=[1.0, 0]), control_spectrum=lfo.spectrum.EnergyBound(1.0, bins=range(1, 6))
    ),
    "a stop band lets the mean pass": problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.stop_band(bins=[1, 2])),
    "an output mask on a difference": problem_of(
        TWO,
        Cost(r=[1.0, 1.0]),
        output_spectrum=lfo.spectrum.OutputSpectrum(None, [[1.0, -1.0]], lfo.MagnitudeBound(1.0, bins=range(6))),
    ),
    "a free initial state": problem_of(STABLE, Cost(q=[1.0], R=1.0), None),
    "between two rows": problem_of(TWO, Cost(r=[1.0, 1.0]), control_set=lfo.sets.Polyhedron(SLANTED, [1.0, 1.0])),
    "along a cone": problem_of(TWO, Cost(r=[0.0, -1.0]), control_set=CONE),
    "joint rows on one side": problem_of(ONE, Cost(p=[1.0]), stage_rows=lfo.StageRows([[1.0]], [[1.0]], [1.0])),
    "the control without curvature": problem_of(TWO, Cost(r=[1.0, 1.0], R=np.diag([1.0, 0.0]))),
}
BOUNDED = {
    "bounded on this side": problem_of(ONE, Cost(r=[1.0]), control_set=lfo.Box([-2.0], None)),
    "a state that cannot fall": problem_of(CART, Cost(q=[1.0, 0]), [0.0, 1.0], control_set=lfo.Box([-1.0], None)),
    "less steep than its L1 cost": problem_of(ONE, Cost(r=[1.0]) + lfo.costs.L1Cost(u=1.1, u_ref=0.5)),
    "less steep than its Linf cost": problem_of(TWO, Cost(r=[1.0, -1.0]) + lfo.costs.LInfCost(u=2.1, u_ref=0.5)),
    "less steep than its penalty": problem_of(ONE, Cost(r=[1.0]), control_set=lfo.sets.Soft(lfo.Box(-1, 1), 1.5)),
    "a mask on the mean, too": problem_of(ONE, Cost(q=[1.0]), control_spectrum=lfo.MagnitudeBound(1.0, bins=range(6))),
    "a stop band on the mean": problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.stop_band(bins=[0])),
    "a bounded initial state": problem_of(STABLE, Cost(q=[1.0], R=1.0), lfo.Box([-1.0], None)),
    "across two rows": problem_of(TWO, Cost(r=[1.0, -1.0]), control_set=lfo.sets.Polyhedron(SLANTED, [1.0, 1.0])),
    "into a cone": problem_of(TWO, Cost(r=[0.0, 1.0]), control_set=CONE),
    "the control with curvature": problem_of(TWO, Cost(r=[1.0, 0.0], R=np.diag([1.0, 0.0]))),
}
METHODS = pytest.mark.parametrize("method", ["auto", "convex"])


def a_feasible_point(problem: lfo.OptimalControlProblem) -> lfo.Trajectory:
    """Return the trajectory of least controls."""
    return lfo.solve(replace(problem, cost=Cost(Q=0.01, R=1.0))).trajectory


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


@METHODS
@pytest.mark.parametrize("name", seeds(UNBOUNDED))
def test_the_cost_falls_for_ever_along_a_verified_direction(name, method):
    problem = UNBOUNDED[name]
    result = lfo.solve(problem, method=method, throw=False)
    assert result.status == "unbounded"
    assert "along a verified direction" in result.message
    assert result.dual
    along = result.direction
    assert along.slope < 0
    assert unbounded_direction(problem, lfo.Trajectory(along.x, along.u)) is not None
    start = a_feasible_point(problem)
    allowed, before = violation(problem, start), problem.value(start.x, start.u)
    assert allowed < 1e-6
    assert along.residual < 1e-9
    for step in (1.0, 1e3, 1e6):
        there = lfo.Trajectory(start.x + step * along.x, start.u + step * along.u)
        assert violation(problem, there) <= allowed + 1e-8 * step
        fallen = problem.value(there.x, there.u) - before
        assert fallen < 0
    assert fallen / step == pytest.approx(along.slope, rel=1e-3)
    with pytest.raises(lfo.errors.UnboundedError, match="no lower bound"):
        lfo.solve(problem, method=method)


@METHODS
@pytest.mark.parametrize("name", seeds(BOUNDED))
def test_a_bounded_problem_that_looks_alike_has_an_optimum(name, method):
    result = lfo.solve(BOUNDED[name], method=method, throw=False)
    assert result.status in ("optimal", "locally_optimal")  # the sets of some are bounded by what is no box
    assert result.direction is None
    assert result.gap < 1e-5


@pytest.mark.parametrize("name", sorted(set(UNBOUNDED) - {"a free initial state"}))
def test_a_direction_with_its_sign_flipped_is_refused(name):
    along = lfo.solve(UNBOUNDED[name], throw=False).direction
    assert unbounded_direction(UNBOUNDED[name], lfo.Trajectory(-along.x, -along.u)) is None


@pytest.mark.parametrize(
    ("growth", "horizon", "cost"),
    [(0.5, 100, Cost(q=[1.0], R=1.0)), (10.0, 20, Cost(p=[1.0], R=1.0))],
    ids=["decays to 1e-30", "grows to 1e20"],
)
def test_a_direction_holds_to_rounding_of_each_time(growth, horizon, cost):
    """In one unit for all times, most of it would be zero: the decaying one is simulated, the other has its own."""
    dynamics = lfo.LinearDynamics([[growth]], [[1.0]])
    along = lfo.solve(lfo.OptimalControlProblem(dynamics, horizon, cost), throw=False).direction
    np.testing.assert_allclose(along.x[1:], growth * along.x[:-1] + along.u, rtol=1e-12)
    assert along.x.all()


def moving(problem: lfo.OptimalControlProblem, u: Any, start: Any = None) -> lfo.Trajectory:
    """Return the direction of these changes of the controls (T, m), or of one for all times."""
    linear = replace(problem.dynamics, offset=np.zeros(problem.state_dim))
    free = lfo.OptimalControlProblem(linear, T, Cost())
    controls = np.broadcast_to(np.asarray(u, dtype=float), (T, problem.control_dim))
    return lfo.simulate(free, controls, np.zeros(problem.state_dim) if start is None else start)


DOWN = moving(problem_of(ONE, Cost()), [-1.0])
REFUSED = {  # name: accepted problem, problem that refuses, direction
    "curved": (problem_of(ONE, Cost(r=[1.0])), problem_of(ONE, Cost(r=[1.0], R=1e-3)), DOWN),
    "curved in the state": (problem_of(ONE, Cost(r=[1.0])), problem_of(ONE, Cost(r=[1.0], P=1e-2)), DOWN),
    "a control bound": (
        problem_of(ONE, Cost(r=[1.0]), control_set=lfo.Box(None, [9.0])),
        problem_of(ONE, Cost(r=[1.0]), control_set=lfo.Box([-9.0], None)),
        DOWN,
    ),
    "a state bound, at one time": (
        problem_of(ONE, Cost(r=[1.0])),
        problem_of(
            ONE,
            Cost(r=[1.0]),
            state_set=[lfo.Box([-9.0], None) if t == 7 else lfo.sets.Everything() for t in range(T + 1)],
        ),
        DOWN,
    ),
    "the terminal state": (
        problem_of(ONE, Cost(r=[1.0])),
        problem_of(ONE, Cost(r=[1.0]), terminal_state=lfo.Box([-9.0], None)),
        DOWN,
    ),
    "a fixed initial state": (
        problem_of(STABLE, Cost(q=[1.0]), None),
        problem_of(STABLE, Cost(q=[1.0])),
        moving(problem_of(STABLE, Cost()), [0.0], [-1.0]),
    ),
    "the sign": (problem_of(ONE, Cost(r=[1.0])), problem_of(ONE, Cost(r=[-1.0])), DOWN),
    "no slope": (problem_of(ONE, Cost(r=[1.0])), problem_of(ONE, Cost()), DOWN),
    "an L1 cost": (problem_of(ONE, Cost(r=[1.0])), problem_of(ONE, Cost(r=[1.0]) + lfo.costs.L1Cost(u=1.01)), DOWN),
    "a penalty": (
        problem_of(ONE, Cost(r=[1.0]), control_set=lfo.sets.Soft(lfo.sets.Ball(5.0), 0.9)),
        problem_of(ONE, Cost(r=[1.0]), control_set=lfo.sets.Soft(lfo.sets.Ball(5.0), 1.01)),
        DOWN,
    ),
    "a ball": (
        problem_of(ONE, Cost(r=[1.0]), control_set=lfo.sets.Soft(lfo.sets.Ball(5.0), 0.9)),
        problem_of(ONE, Cost(r=[1.0]), control_set=lfo.sets.Ball(5.0)),
        DOWN,
    ),
    "a cone": (
        problem_of(TWO, Cost(r=[-1.0, -1.0]), control_set=CONE),
        problem_of(TWO, Cost(r=[-1.0, -1.0]), control_set=lfo.sets.SecondOrderCone([[1, 0]], [0], [0, 0.9], 1.0)),
        moving(problem_of(TWO, Cost()), [1.0, 1.0]),
    ),
    "a row": (
        problem_of(ONE, Cost(r=[1.0]), stage_rows=lfo.StageRows(None, [[1.0]], [1.0])),
        problem_of(ONE, Cost(r=[1.0]), stage_rows=lfo.StageRows(None, [[-1.0]], [1.0])),
        DOWN,
    ),
    "a stop band": (
        problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.stop_band(bins=[1])),
        problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.stop_band(bins=[0])),
        DOWN,
    ),
    "a mask": (
        problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.MagnitudeBound(5.0, bins=[1])),
        problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.MagnitudeBound(5.0, bins=[0])),
        DOWN,
    ),
    "an energy bound": (
        problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.spectrum.EnergyBound(5.0, bins=[1, 2])),
        problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.spectrum.EnergyBound(5.0, bins=[0, 1])),
        DOWN,
    ),
    "an equation over all times": (
        problem_of(
            ONE, Cost(r=[1.0]), control_spectrum=lfo.spectrum.LinearConstraint(np.ones((T, 1, 1)), [5.0], penalty=0.5)
        ),
        problem_of(ONE, Cost(r=[1.0]), control_spectrum=lfo.spectrum.LinearConstraint(np.ones((T, 1, 1)), [5.0])),
        DOWN,
    ),
    "the dynamics": (problem_of(ONE, Cost(r=[1.0])), problem_of(STABLE, Cost(r=[1.0])), DOWN),
}


@pytest.mark.parametrize("name", REFUSED)
def test_each_check_refuses_what_only_it_can_see(name):
    accepting, refusing, along = REFUSED[name]
    assert unbounded_direction(accepting, along) is not None
    assert unbounded_direction(refusing, along) is None


def test_a_direction_is_measured_in_the_sizes_of_the_data():
    """However long it is given, the slope and the residual are those per unit."""
    problem = UNBOUNDED["bounded on the other side"]
    found = [unbounded_direction(problem, lfo.Trajectory(size * DOWN.x, size * DOWN.u)) for size in (1e-9, 1.0, 1e9)]
    assert [one.slope for one in found] == pytest.approx([found[1].slope] * 3)
    assert unbounded_direction(problem, lfo.Trajectory(0 * DOWN.x, 0 * DOWN.u)) is None


FAR = lfo.Box([9.0, None], None)
HELD = lfo.Box([-0.1, None], [0.1, None])
BOTH = {
    "a control bound": problem_of(TWO, Cost(r=[1.0, 1.0], R=np.diag([1.0, 0.0])), control_set=HELD, terminal_state=FAR),
    "an L1 cost": problem_of(
        TWO, Cost(r=[1.0, 1.0]) + lfo.costs.L1Cost(u=[2.0, 0.5]), control_set=HELD, terminal_state=FAR
    ),
    "a mask": problem_of(
        TWO,
        Cost(r=[0.0, 1.0], R=np.diag([1.0, 0.0])),
        control_spectrum=lfo.MagnitudeBound(0.1, bins=range(6), component=0),
        terminal_state=FAR,
    ),
}


@METHODS
@pytest.mark.parametrize("name", BOTH)
def test_what_is_infeasible_and_unbounded_ends_as_infeasible(name, method):
    problem = BOTH[name]
    result = lfo.solve(problem, method=method, throw=False)
    assert result.status == "infeasible"
    assert result.ray is not None
    assert result.direction is None
    within_reach = lfo.solve(replace(problem, terminal_state=None), method=method, throw=False)
    assert within_reach.status == "unbounded"
    assert within_reach.direction is not None


ALL_REMOVED = pytest.mark.filterwarnings("ignore::lin_freq_ocp.base.errors.BandWarning")


@expensive
@ALL_REMOVED
@pytest.mark.parametrize("seed", [21, 54, 67, 80, 85, 96, 111, 128, 136, 178])
def test_the_verdict_does_not_depend_on_the_unit_of_the_cost(seed):
    """Solvers stop at states of 1e24, at which every condition holds relative to what it is made of."""
    unbounded, bounded = random_unbounded(seed)
    for factor in (1e-8, 1e8):
        result = lfo.solve(with_cost_times(unbounded, factor), throw=False)
        assert result.status == "unbounded"
        assert result.direction.slope < 0
        assert lfo.solve(with_cost_times(bounded, factor)).status == "optimal"


@expensive
@ALL_REMOVED
@pytest.mark.parametrize("method", ["spectral", "structured", "convex"])
@pytest.mark.parametrize("seed", [21, 67])
def test_every_method_finds_the_direction(seed, method):
    unbounded, _ = random_unbounded(seed)
    for factor in (1e-8, 1e8):
        assert lfo.solve(with_cost_times(unbounded, factor), method, throw=False).status == "unbounded"
