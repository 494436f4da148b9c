"""Implied bounds hold every trajectory they must hold, and no more than a rounding error else."""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp import certificate as judging
from lin_freq_ocp.base import split_signals, stack_signals
from lin_freq_ocp.certificate import extremal_at, implied_bounds, judge, optimum_box, reachable_bounds
from lin_freq_ocp.testing import reference_problem

T = 30
OF_SCIPY = re.compile(r"^\s*from scipy\.linalg import (?!block_diag$)", re.MULTILINE)


def problem(kind, **changes):
    if kind == "time-varying":
        dynamics = reference_problem("ltv200").dynamics
        A, B = dynamics.A[:T], dynamics.B[:T]
    else:
        A, B = [[0.9, 0.5], [-0.5, 0.9]], [[0.0], [1.0]]
    settings = {
        "dynamics": lfo.LinearDynamics(A, B, offset=[0.1, -0.2]),
        "horizon": T,
        "cost": lfo.QuadraticCost(R=1.0),
        "control_set": [lfo.Box(-1.0 - t / T, 0.5) for t in range(T)] if kind == "time-varying" else lfo.Box(-1, 2),
        "initial_state": lfo.Box([0.0, -0.5], [0.3, 0.5]),
    }
    return lfo.OptimalControlProblem(**(settings | changes))


@pytest.mark.parametrize("kind", ["constant", "time-varying"])
def test_forward_reach_is_the_tight_interval(kind):
    """Against the worst controls and start for each component and time, by the adjoint of the map to that component."""
    task = problem(kind)
    enclosure = reachable_bounds(task)
    assert "forward reach" in enclosure.follows_from
    for t in (1, 7, T):
        for i in range(2):
            normal = np.eye(2)[i]
            worst = np.zeros((T, 1))
            for s in range(t - 1, -1, -1):
                A, B, _ = task.dynamics.at(s)
                worst[s] = np.where(B.T @ normal > 0, task.control_tube.upper[s], task.control_tube.lower[s])
                normal = A.T @ normal
            start = np.where(normal > 0, task.initial_state.upper, task.initial_state.lower)
            highest = lfo.simulate(task, worst, start).x[t, i]
            assert enclosure.bounds[1][t, i] >= highest
            if kind == "constant":  # one radius for all controls: tight only where their bounds do not vary
                assert enclosure.bounds[1][t, i] == pytest.approx(highest, rel=1e-7)


@pytest.mark.parametrize("kind", ["constant", "time-varying"])
def test_forward_reach_holds_random_trajectories(kind):
    task, rng = problem(kind), np.random.default_rng(1)
    lower, upper = (side[:, : task.state_dim] for side in reachable_bounds(task).bounds)
    for _ in range(50):
        u = np.where(rng.random((T, 1)) < 0.5, task.control_tube.lower, task.control_tube.upper)
        x = lfo.simulate(task, u, rng.uniform(task.initial_state.lower, task.initial_state.upper)).x
        assert (x >= lower).all()
        assert (x <= upper).all()


SOUND = {
    "one state without a price": {"initial_state": [1.0, 0.0], "cost": lfo.QuadraticCost(Q=np.diag([1.0, 0]), R=1.0)},
    "box around the start": {
        "initial_state": lfo.Box([0.5, -0.5], [1.0, 0.5]),
        "cost": lfo.QuadraticCost(R=1.0, P=1.0),
    },
    "linear terms": {"initial_state": [1.0, 0.0], "cost": lfo.QuadraticCost(R=1.0, q=[0.3, -0.2], r=[0.5], p=[1.0, 0])},
    "controls without a price": {"initial_state": [1.0, 0.0], "cost": lfo.QuadraticCost(Q=1.0, P=1.0)},
    "controls and the last state without a price": {"initial_state": [1.0, 0.0], "cost": lfo.QuadraticCost(Q=1.0)},
    "the last control by its removed bins alone": {
        "initial_state": [1.0, 0.0],
        "cost": lfo.QuadraticCost(Q=1.0),
        "control_spectrum": lfo.low_pass(2.0),
    },
}


@pytest.mark.parametrize("name", SOUND)
def test_without_any_bound_the_bound_is_rigorous_and_random_trajectories_cost_more(name):
    """What costs no more than the trajectory stays near it: by curvature, and by the dynamics where there is none."""
    task = problem("constant", **{"control_set": None, "initial_state": None, **SOUND[name]})
    result = lfo.solve(task)
    assert result.status == "optimal"
    assert result.certificate.bound.sets == "trajectories that cost no more than this one"
    rng, (x, u) = np.random.default_rng(4), (result.trajectory.x, result.control)
    for size in 10.0 ** rng.uniform(-8, 3, 60):
        start = x[0] if task.initial_box.fixed.all() else task.initial_box.project(x[0] + size * rng.standard_normal(2))
        change = np.where(task.control_stop, 0.0, np.fft.rfft(rng.standard_normal(u.shape), axis=0))
        other = lfo.simulate(task, u + size * np.fft.irfft(change, T, axis=0), start)
        assert task.value(other.x, other.u) >= result.lower_bound


@pytest.mark.parametrize("seed", seeds(range(24)))
def test_what_costs_nothing_and_changes_nothing_needs_no_bound(seed):
    """One control and the ends of some states, in any units: against least squares in units of 1."""
    rng = np.random.default_rng(seed)
    n, m, length = int(rng.integers(1, 5)), int(rng.integers(1, 4)), int(rng.integers(3, 40))
    A, B = np.eye(n) + 0.3 * rng.standard_normal((n, n)), rng.standard_normal((n, m))
    A /= max(1.0, np.abs(np.linalg.eigvals(A)).max())
    Q, P = np.eye(n), np.diag(rng.choice([0.0, 1.0], n))
    R, start = np.diag([0.0] + [1.0] * (m - 1)), rng.standard_normal(n)
    in_x, in_u, in_J = 10.0 ** rng.uniform(-6, 6, n), 10.0 ** rng.uniform(-6, 6, m), 10.0 ** rng.uniform(-9, 9)
    dynamics = lfo.LinearDynamics(in_x[:, None] * A / in_x, in_x[:, None] * B / in_u)
    weights = {"Q": in_J * Q / in_x**2, "R": in_J * R / in_u**2, "P": in_J * P / in_x**2}
    result = lfo.solve(
        lfo.OptimalControlProblem(dynamics, length, lfo.QuadraticCost(**weights), initial_state=in_x * start)
    )
    assert result.status == "optimal"
    # x = free + forced u, by one power of A after another
    powers = [np.linalg.matrix_power(A, k) for k in range(length + 1)]
    free = np.concatenate([weight @ power @ start for weight, power in zip([*[Q] * length, P], powers, strict=True)])
    forced = np.zeros((length + 1, n, length, m))
    for t in range(1, length + 1):
        for s in range(t):
            forced[t, :, s] = (P if t == length else Q) @ powers[t - 1 - s] @ B
    rows = np.vstack([forced.reshape(len(free), -1), np.kron(np.eye(length), R)])
    right = -np.concatenate([free, np.zeros(length * m)])
    residual = rows @ np.linalg.lstsq(rows, right, rcond=1e-13)[0] - right
    assert result.cost == pytest.approx(in_J * 0.5 * residual @ residual, rel=1e-7)


FUEL = {
    "L1": lfo.costs.L1Cost(u=1.0),
    "largest": lfo.costs.LInfCost(u=1.0),
    "L1 of both": lfo.costs.L1Cost(x=[1.0, 0.5], u=0.1),
}


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("name", FUEL)
def test_a_price_on_the_size_of_controls_bounds_them(name, unit):
    """A move of least fuel needs no bound: none of its terms costs more than all."""
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005 * unit], [0.1 * unit]])
    price = replace(FUEL[name], u=np.ravel(FUEL[name].u) * unit)
    task = lfo.OptimalControlProblem(dynamics, 30, price, initial_state=[1.0, 0.3], terminal_state=[0.0, 0.0])
    result = lfo.solve(task)
    assert (result.status, result.certificate.bound.kind) == ("optimal", "rigorous")
    bounded = lfo.solve(replace(task, control_set=lfo.Box(-50.0 / unit, 50.0 / unit)))
    assert result.cost == pytest.approx(bounded.cost, rel=1e-6)
    # a linear price may be negative, and then nothing follows
    cheaper = replace(task, cost=price + lfo.QuadraticCost(r=[-2.0 * unit]), terminal_state=None)
    assert lfo.solve(cheaper, throw=False).status == "unbounded"


def test_no_price_bounds_anything_where_the_cost_may_be_negative():
    """|u| - 0.9 u is 0.1 at u = 1, where the price of |u| alone is 1."""
    cost = lfo.costs.L1Cost(u=1.0) + lfo.QuadraticCost(r=[-0.9])
    task = lfo.OptimalControlProblem(lfo.LinearDynamics([[0.5]], [[1.0]]), 3, cost, initial_state=[0.0])
    best = lfo.solve(task, throw=False)
    np.testing.assert_allclose(best.control, 0.0, atol=1e-9)
    region = optimum_box(extremal_at(task, best.trajectory, best.multipliers), 0.1001)
    moved = lfo.simulate(task, np.array([[1.0], [0.0], [0.0]]))
    assert task.value(moved.x, moved.u) == pytest.approx(0.1)
    lower, upper = (side[:-1, task.state_dim :] for side in region.bounds)
    assert (lower <= moved.u).all()
    assert (moved.u <= upper).all()


def estimation(seed, in_x=1.0, in_J=1.0):
    """Return a fit of one output of 2 to 4 states by a disturbance, from a free start: no state alone has a price."""
    rng = np.random.default_rng(seed)
    n, length = int(rng.integers(2, 5)), int(rng.integers(8, 25))
    A = np.eye(n) + 0.2 * rng.standard_normal((n, n))
    A /= max(1.0, np.abs(np.linalg.eigvals(A)).max())
    B, C = rng.standard_normal((n, 1)), rng.standard_normal(n)
    measured = rng.standard_normal((length + 1, 1)) * C / (C @ C)
    scale = in_x ** np.linspace(-1, 1, n)
    weight = in_J * np.outer(C / scale, C / scale)
    dynamics = lfo.LinearDynamics(scale[:, None] * A / scale, scale[:, None] * B)
    cost = lfo.QuadraticCost(Q=weight, R=in_J, x_ref=scale * measured)
    return lfo.OptimalControlProblem(dynamics, length, cost), rng


@pytest.mark.parametrize("seed", seeds(range(12)))
@pytest.mark.parametrize(("in_x", "in_J"), [(1.0, 1.0), (1e4, 1e-9), (1e-6, 1e9)])
def test_a_cost_that_is_curved_along_all_motions_needs_no_bound(seed, in_x, in_J):
    task, _ = estimation(seed, in_x, in_J)
    result = lfo.solve(task)
    assert (result.status, result.certificate.bound.kind) == ("optimal", "rigorous")
    assert result.certificate.gap < 1e-10


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_the_box_of_such_a_cost_holds_all_that_costs_no_more(seed):
    task, rng = estimation(seed)
    best = lfo.solve(task)
    allowed = best.cost * float(rng.uniform(0.01, 2.0))
    region = optimum_box(extremal_at(task, best.trajectory, best.multipliers), allowed)
    assert "cost no more" in region.follows_from
    for i, t in product(range(task.state_dim), (0, task.horizon // 2, task.horizon)):
        # the most that this state can change for this cost, by the optimum of a cost with a slope on it
        q = np.zeros((task.horizon, task.state_dim))
        slope = {"p": np.eye(task.state_dim)[i]} if t == task.horizon else {"q": q}
        q[min(t, task.horizon - 1), i] = 1.0
        other = lfo.solve(replace(task, cost=replace(task.cost, **slope)))
        along = other.trajectory.x - best.trajectory.x, other.control - best.control
        rise = task.value(other.trajectory.x, other.control) - best.cost
        for far in (-1.0, 1.0):
            step = far * np.sqrt(0.999 * allowed / rise)
            x, u = best.trajectory.x + step * along[0], best.control + step * along[1]
            assert task.value(x, u) <= best.cost + allowed
            lower, upper = region.bounds
            assert (lower <= stack_signals(x, u)).all()
            assert (stack_signals(x, u) <= upper).all()
        assert np.abs(x[t, i] - best.trajectory.x[t, i]) > 0.99 * np.abs(lower[t, i] - best.trajectory.x[t, i])


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_equations_that_depend_on_each_other_leave_the_box_of_such_a_cost(unit):
    """No control moves the third state, whose ends are both fixed: its equations are one too many."""
    dynamics = lfo.LinearDynamics(np.diag([1.0, 1.0, 0.5]), [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    weight = np.zeros((3, 3))
    weight[:2, :2] = [[1.0, -1.0], [-1.0, 1.0]]
    cost = lfo.QuadraticCost(
        Q=weight / unit**2, R=np.ones((2, 2)) / unit**2, P=weight / unit**2, p=[1 / unit, 0.0, 0.0]
    )
    ends = {
        "initial_state": [unit, 0.0, 1.0],
        "terminal_state": lfo.Box([-np.inf, -np.inf, 0.125], [np.inf, np.inf, 0.125]),
    }
    result = lfo.solve(lfo.OptimalControlProblem(dynamics, 3, cost, **ends))
    assert (result.status, result.certificate.bound.kind) == ("optimal", "rigorous")


@pytest.mark.parametrize("last", [0.0, 1e6, 1e13])
def test_a_value_that_costs_nothing_hides_no_cost(last):
    """u_T-1 moves x_T alone, which has no price: its size says nothing about the prices of others."""
    dynamics, cost = lfo.LinearDynamics([[0.9]], [[1.0, 1.0]]), lfo.QuadraticCost(Q=1.0, R=np.diag([0.0, 1.0]))
    task = lfo.OptimalControlProblem(dynamics, 10, cost, initial_state=[1.0])
    best = lfo.solve(task)
    u = best.control.copy()
    u[-1, 0] = last
    moved = lfo.simulate(task, u)
    assert lfo.certify(task, moved).globally_optimal
    u[0, 1] += 0.3
    dearer = lfo.certify(task, lfo.simulate(task, u))
    assert dearer.cost > 1.05 * best.cost
    assert not dearer.globally_optimal


@pytest.mark.parametrize("missed", [0.0, 5e3])
def test_multipliers_of_zero_excuse_no_residual(missed):
    """At rest nothing has a price, and a last value of 1e13 makes any residual small."""
    dynamics, cost = lfo.LinearDynamics([[0.9]], [[1.0, 1.0]]), lfo.QuadraticCost(Q=1.0, R=np.diag([0.0, 1.0]))
    task = lfo.OptimalControlProblem(dynamics, 10, cost, initial_state=[0.0])
    x, u = np.zeros((11, 1)), np.zeros((10, 2))
    u[-1, 0], x[-1] = 1e13, 1e13 + missed
    certificate = lfo.certify(task, lfo.Trajectory(x, u))
    assert certificate.pmp == ("violated" if missed else "satisfied")
    assert [one.label for one in certificate.failed] == (["N-r"] if missed else [])


def test_a_start_that_nothing_holds_leaves_the_bound_numerical():
    """x_0 costs nothing and is held by nothing but x_T, which hardly depends on it: the optimum is far away."""
    far = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.5]], [[1.0]]),
        31,
        lfo.QuadraticCost(R=1.0, p=[1.0]),
        lfo.Box(-1, 1),
        terminal_state=lfo.Box(-0.9, -0.7),
    )
    near = lfo.simulate(far, np.r_[np.zeros(30), -0.7][:, None], [0.0])
    certificate = lfo.certify(far, near)
    assert certificate.bound.kind == "numerical"
    assert not certificate.globally_optimal
    cheaper = lfo.simulate(far, np.zeros((31, 1)), [-0.9 * 2.0**31])
    assert far.value(cheaper.x, cheaper.u) == pytest.approx(-0.9)


def test_a_trajectory_cheaper_than_the_optimum_proves_nothing():
    """u = 0 costs nothing and goes nowhere."""
    task = lfo.library.pendulum(state_bounds=(None,) * 4, control_bound=None)
    result = lfo.solve(task)
    nowhere = lfo.simulate(task, np.zeros((240, 1)))
    certificate = judge(task, nowhere, result.multipliers)
    assert certificate.bound.kind == "numerical" or certificate.bound.value <= certificate.cost
    assert certificate.lower_bound <= result.cost
    assert not certificate.globally_optimal


def test_near_a_trajectory_no_more_than_its_cost_is_proven():
    """Half of the optimal control costs a quarter: what costs more than that was not looked at."""
    task = lfo.library.pendulum(state_bounds=(None,) * 4, control_bound=None)
    result = lfo.solve(task)
    half = lfo.simulate(task, result.control / 2)
    certificate = judge(task, half, result.multipliers)
    assert certificate.cost == pytest.approx(result.cost / 4)
    assert certificate.bound.kind == "numerical" or certificate.bound.value <= certificate.cost
    assert not certificate.globally_optimal


def test_the_bound_depends_on_the_multipliers_only(solved):
    """D at the optimum, at the classical solution (other bins) and at noise (other dynamics) is the same number."""
    result = solved("paper, constrained")
    rng = np.random.default_rng(2)
    noise = lfo.Trajectory(0.1 * rng.standard_normal((241, 4)), 2 * rng.standard_normal((240, 1)))
    optimum = result.certificate.bound
    for other in (solved("paper, classical").trajectory, noise):
        bound = judge(result.problem, other, result.multipliers).bound
        assert abs(bound.frequency_term) > 1
        assert bound.value == pytest.approx(optimum.value, rel=1e-8)
        certificate = judge(result.problem, other, result.multipliers)
        assert certificate.gap < 0
        assert not certificate.globally_optimal  # cheaper than the bound: infeasible, not optimal
    assert abs(bound.dynamics_term) > 1


@pytest.mark.parametrize("seed", seeds(range(3)))
def test_controls_that_nothing_bounds_follow_from_the_states(seed):
    rng, n, m = np.random.default_rng(seed), 3 + seed, 1 + seed
    A, B = np.eye(n) + 0.1 * rng.standard_normal((n, n)), rng.standard_normal((n, m))
    ends = {"initial_state": rng.standard_normal(n), "terminal_state": np.zeros(n)}
    task = lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), 100, lfo.QuadraticCost(Q=np.eye(n)), **ends)
    result = lfo.solve(task, method="convex")
    assert result.certificate.bound.kind == "rigorous"
    assert result.gap < 1e-6


def test_the_judge_solves_by_numpy_alone():
    """SciPy has threads of its own: where both take turns in a loop, each waits for the other, 20 ms a time."""
    found = [path.name for path in Path(judging.__file__).parent.rglob("*.py") if OF_SCIPY.search(path.read_text())]
    assert found == []


@pytest.mark.parametrize("unit", [1.0, 1e5, 1e-5])
def test_states_that_dynamics_determine_are_bounded_in_any_units(unit):
    """Two free states without bounds and costs, which the bounded first one determines over three steps."""
    A, units = np.array([[0.6, 0.5, 0.0], [-0.4, 0.7, 0.5], [0.2, -0.3, 0.8]]), np.array([1.0, unit, 1 / unit])
    task = lfo.OptimalControlProblem(
        lfo.LinearDynamics(units[:, None] * A / units, units[:, None] * np.array([[0.0], [0.0], [1.0]])),
        8,
        lfo.QuadraticCost(q=[1.0, 0.0, 0.0], R=1.0),
        state_set=lfo.Box([-1.0, None, None], [1.0, None, None]),
    )
    result = lfo.solve(task, "convex", throw=False)
    assert (result.status, result.certificate.bound.kind) == ("optimal", "rigorous")


@pytest.mark.parametrize("unit", [1.0, 1e9, 1e-9])
def test_bounds_that_a_step_implies_alone_do_not_grow_from_step_to_step(unit):
    """Two bounded states determine the third and the control; from step to step, their radii grow eight times."""
    A = np.array([[-0.3, -1.25, 0.0], [0.5, 0.57, -0.3], [1.22, 1.07, -0.13]])
    units, far = np.array([1.0, unit, 1.0]), [2.0, np.inf, 2.0]
    task = lfo.OptimalControlProblem(
        lfo.LinearDynamics(units[:, None] * A / units, units[:, None] * np.array([[-0.16], [0.96], [-0.25]])),
        100,
        lfo.QuadraticCost(R=1.0),
        lfo.Box(None, 2.7),
        [lfo.sets.Everything(), *[lfo.Box(-np.array(far), far)] * 99, lfo.sets.Everything()],
        initial_state=np.array([-1.2, -0.4, 1.2]) * units,
        terminal_state=np.array([-16.0, -6.0, -33.0]) * units,
    )
    result = lfo.solve(task, throw=False)
    assert (result.status, result.bound) == ("infeasible", "rigorous")


def one_sided(seed, x=1.0, u=1.0, cost=1.0):
    """States within bounds, controls without a price of their size and with one bound each; units of all three."""
    rng = np.random.default_rng(seed)
    n, m, horizon = rng.integers(1, 4), rng.integers(2, 4), int(rng.integers(3, 9))
    A, B = 0.6 * rng.normal(size=(n, n)), rng.normal(size=(n, m))
    far, below = (np.inf, 1e9 * u, 1e20)[rng.integers(3)], rng.random(m) < 0.5
    q = rng.normal(size=n)
    r = np.where(below, 1, -1) * rng.random(m) * (rng.random() < 0.5)
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B * x / u),
        horizon,
        lfo.QuadraticCost(q=q * cost / x, r=r * cost / u),
        lfo.Box(np.where(below, -u, -far), np.where(below, far, 2 * u)),
        lfo.Box([-5 * x] * n, [5 * x] * n),
        rng.normal(size=n) * 0.4 * x,
    )


def extremes(task, level):
    """Return the box of all (x, u) of a linear cost below a level, by two linear programs a component."""
    T, n = task.horizon, task.state_dim
    map_x = np.kron(np.eye(T + 1), np.eye(n)) - np.kron(np.eye(T + 1, k=-1), task.dynamics.A)
    map_u = np.kron(np.eye(T + 1, T, k=-1), task.dynamics.B)
    start = np.r_[task.initial_box.lower, np.zeros(T * n)]
    bounds = np.vstack(
        [np.c_[low.ravel(), high.ravel()] for low, high in (task.state_tube.bounds, task.control_tube.bounds)]
    )
    row = np.r_[np.tile(task.cost.q, T), np.zeros(n), np.tile(task.cost.r, T)]
    ends = []
    for sign in (1, -1):
        for component in np.eye(len(row)):
            found = linprog(sign * component, row[None], [level], np.hstack([map_x, -map_u]), start, bounds)
            ends.append(found.fun * sign if found.status == 0 else -sign * np.inf)
    return np.split(np.array(ends), 2)


ONE_SIDED = (13, 16, 20, 34, 35, 37, 43, 51, 62, 105, 178, 219)


@pytest.mark.parametrize("method", ["structured", "convex"])
@pytest.mark.parametrize("seed", seeds(ONE_SIDED))
def test_one_sided_bounds_that_imply_a_box_are_a_box_in_every_unit(seed, method):
    """Bounds of states, or the cost along what they leave open, hold the controls: no sign of a slope loses much."""
    for units in ((1, 1, 1), (1e3, 1e-6, 1e-4), (1e-5, 1e6, 1e9)):
        task = one_sided(seed, *units)
        result = lfo.solve(task, method)
        assert result.bound == "rigorous"
        noise = 1e-13 * np.random.default_rng(seed).normal(size=result.multipliers.eta.shape)
        spoiled = replace(result.multipliers, eta=result.multipliers.eta * (1 + noise))
        assert judge(task, result.trajectory, spoiled).bound.kind == "rigorous"


@pytest.mark.parametrize("seed", seeds(ONE_SIDED))
def test_a_box_of_one_sided_bounds_holds_all_that_it_claims(seed):
    """Against the extreme trajectories, with multipliers that are wrong by much more than rounding."""
    task = one_sided(seed)
    result = lfo.solve(task)
    noise = 1e-7 * np.random.default_rng(seed).normal(size=result.multipliers.eta.shape)
    extremal = extremal_at(task, result.trajectory, replace(result.multipliers, eta=result.multipliers.eta + noise))
    allowed = 1e-4 * (1 + abs(result.cost))
    region = optimum_box(extremal, allowed)
    for box, level in ((region, result.cost + allowed), (implied_bounds(task), 1e12)):
        least, most = extremes(task, level)
        sides = (split_signals(side, task.state_dim) for side in box.bounds)
        lower, upper = (np.r_[x.ravel(), u.ravel()] for x, u in sides)
        assert (lower <= least + 1e-6).all()
        assert (upper >= most - 1e-6).all()
        assert box is not region or np.isfinite([lower, upper]).all() == np.isfinite([least, most]).all()


@pytest.fixture
def steps_looked_at(monkeypatch):
    """Return the list of the times at which the judge reads the dynamics of one step."""
    at, times = lfo.LinearDynamics.at, list[int]()

    def noting(dynamics, t):
        times.append(t)
        return at(dynamics, t)

    monkeypatch.setattr(lfo.LinearDynamics, "at", noting)
    return times


def test_equal_steps_that_imply_no_radius_are_looked_at_once(steps_looked_at):
    """Free controls, a constant cost: every step has the same unknown sides, and implies none of them."""
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]])
    ends = {"initial_state": [0.0, 0.0], "terminal_state": [0.0, 0.0]}
    flat = lfo.OptimalControlProblem(dynamics, 400, lfo.QuadraticCost(r=[-1.0]), **ends)
    shapes = {"eta": (400, 2), "mu": (401, 2), "nu": (400, 1), "rho_u": (201, 1), "rho_x": (201, 2)}
    multipliers = lfo.results.Multipliers(1.0, **{name: np.zeros(shape) for name, shape in shapes.items()})
    extremal = extremal_at(flat, lfo.simulate(flat, np.zeros((400, 1))), multipliers)
    steps_looked_at.clear()
    optimum_box(extremal, 1e-6)
    assert 0 < len(steps_looked_at) < 430  # the equations of all times together read each step once, too


def test_a_step_that_implies_radii_is_looked_at_although_others_imply_none():
    """A box around x_9 reaches earlier states backwards, as far as controls are bounded; the horizon is too long for
    the equations of all times together.
    """
    dynamics, T = lfo.LinearDynamics([[1.0, 0.1], [-0.1, 0.9]], [[0.0], [0.1]]), 1000
    upper = np.full((T, 1), np.inf)
    upper[3:9] = 1.0
    sets = [lfo.sets.Everything() if t != 9 else lfo.Box(-2.0, 2.0) for t in range(T + 1)]
    problem = lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(R=1.0), lfo.Box(-upper, upper), sets)
    known = np.isfinite(implied_bounds(problem).bounds)[:, :, :2].all(axis=(0, 2))
    np.testing.assert_array_equal(np.flatnonzero(known), np.arange(3, 10))
