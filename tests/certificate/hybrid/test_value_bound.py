"""Bounds by dynamic programming with intervals: enclosures, validity for any multipliers, and how near they come."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp import library, norm, signals
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.certificate.hybrid import (
    CostToGo,
    Lattice,
    Minima,
    OutOfTimeError,
    QuadraticForm,
    taylor_bounds,
    terminal_minorants,
    value_bounds,
)
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.formulas import interval_jets, jets_of, multiply, outward
from lin_freq_ocp.methods.hybrid import LocalSearch, SmoothProgress, smooth_optimum

ROUNDING = 1e-9
BATCH_MEGABYTES = 20  # of what is bounded at once

# --- enclosures -------------------------------------------------------------------------------------------------------


def random_formula(rng, variables, depth):
    if depth == 0:
        return variables[rng.integers(len(variables))] * rng.normal() + rng.normal()
    a, b = (random_formula(rng, variables, depth - 1) for _ in range(2))
    made = [
        lambda: a * b, lambda: a / (b**2 + 1), lambda: norm([a, b]), lambda: a.sin(), lambda: a.cos(),
        lambda: a.sin().exp(), lambda: (a**2 + 1).log(), lambda: (a**2 + 0.5).sqrt(),
        lambda: a ** int(rng.integers(2, 6)), lambda: a + b, lambda: 1 / (b.cos() + 1.5),
    ]  # fmt: skip
    return made[rng.integers(len(made))]()


@pytest.mark.parametrize("seed", seeds(range(80)))
def test_enclosures_contain_values_gradients_and_hessians(seed):
    rng = np.random.default_rng(seed)
    x, u = signals(2, 1)
    formula = random_formula(rng, [*x, *u], 3)
    centre, radius = rng.normal(size=(5, 3)), rng.random((5, 3)) * 10.0 ** rng.uniform(-4, 0)
    found = interval_jets([formula], centre - radius, centre + radius)
    for _ in range(20):
        point = jets_of([formula], centre + radius * rng.uniform(-1, 1, size=(5, 3)))
        for part in ("values", "slopes", "curvatures"):
            (low, high), exact = getattr(found, part), getattr(point, part)
            slack = ROUNDING * (1 + np.abs(exact))
            assert ((low - slack <= exact) & (exact <= high + slack)).all()


def test_enclosures_of_a_norm_contain_its_subdifferential_at_zero():
    x, _ = signals(2, 1)
    found = interval_jets([norm(x)], np.array([[-0.1, -0.1, 0.0]]), np.array([[0.1, 0.1, 0.0]]))
    assert (found.slopes[0][0, 0, :2] <= -1).all()
    assert (found.slopes[1][0, 0, :2] >= 1).all()
    assert np.isinf(found.curvatures[1][0, 0, 0, 0])


@pytest.mark.parametrize("function", [np.tanh, np.arctan])
def test_enclosures_of_tanh_and_arctan_are_tight(function):
    """Against the range over many points: also around the extrema of the second derivative, and without bounds."""
    x, _ = signals(1, 1)
    made = [function(x[0])]
    ends = [(-2.0, 3.0), (-0.7, -0.5), (0.1, 0.2), (0.3, 5.0), (-40.0, -30.0), (0.0, 0.0), (-9.0, 0.6)]
    lower, upper = np.array(ends).T[..., None] * [1.0, 0.0]
    found = interval_jets(made, lower, upper)
    for box, (low, high) in enumerate(ends):
        points = np.linspace(low, high, 4001)[:, None] * [1.0, 0.0]
        exact = jets_of(made, points)
        pairs = [(found.values, exact.values[:, 0]), (found.slopes, exact.slopes[:, 0, 0])]
        for (below, above), values in [*pairs, (found.curvatures, exact.curvatures[:, 0, 0, 0])]:
            below, above = below[box].flat[0], above[box].flat[0]
            assert below <= values.min() + 1e-15
            assert above >= values.max() - 1e-15
            assert values.min() - below + above - values.max() <= 1e-6 * (high - low) + 1e-13
    unbounded = interval_jets(made, np.array([[-np.inf, 0.0]]), np.array([[np.inf, 0.0]]))
    for part in (unbounded.values, unbounded.slopes, unbounded.curvatures):
        assert np.isfinite(part).all()
    assert unbounded.curvatures[1][0, 0, 0, 0] == pytest.approx(exact_extremum(function), rel=1e-12)


def exact_extremum(function):
    return {np.tanh: 4 / 27**0.5, np.arctan: 27**0.5 / 8}[function]


def test_logarithms_outside_of_their_domain_have_unbounded_derivatives():
    x, _ = signals(1, 1)
    found = interval_jets([x[0].log()], np.array([[-1.0, 0.0]]), np.array([[2.0, 0.0]]))
    assert found.values[0][0, 0] == -np.inf
    assert found.values[1][0, 0] >= np.log(2)
    assert np.isinf(found.slopes[0][0, 0, 0])


@pytest.mark.parametrize("seed", seeds(range(20)))
def test_taylor_bounds_are_below_all_values_and_near_for_small_boxes(seed):
    rng = np.random.default_rng(seed)
    x, u = signals(2, 1)
    f = [random_formula(rng, [*x, *u], 2) for _ in range(2)]
    y, r, p = rng.normal(size=(6, 3)), rng.random((6, 3)) * 10.0 ** rng.uniform(-3, 0), np.arange(6)
    root = rng.normal(size=(6, 3, 3))
    hessian, gradient, given = root + root.swapaxes(1, 2), rng.normal(size=(6, 3)), rng.normal(size=6)
    sigma, at = rng.normal(size=(6, 2)), rng.normal(size=(6, 2))

    def bound(radius):
        jets_of = interval_jets(f, y, y, curved=False), interval_jets(f, y - radius, y + radius)
        return taylor_bounds(hessian, gradient, given, sigma, at, radius, *jets_of, p)

    def value(z):
        there = jets_of(f, y + z).values
        own = given + (gradient * z).sum(axis=1) + 0.5 * np.einsum("pi,pij,pj->p", z, hessian, z)
        return own + (sigma * (there - at)).sum(axis=1)

    found = bound(r)
    corners = [r * np.array(signs) for signs in product((-1, 1), repeat=3)]
    for z in [*corners, *(r * rng.uniform(-1, 1, size=(6, 3)) for _ in range(50))]:
        assert (found <= value(z) + ROUNDING * (1 + np.abs(found))).all()
    tiny = np.full((6, 3), 1e-7)
    np.testing.assert_allclose(bound(tiny), value(np.zeros((6, 3))), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("seed", seeds(range(10)))
def test_bounds_that_the_cost_implies_hold_on_its_sublevel_set_and_touch_it(seed):
    rng = np.random.default_rng(seed)
    root, b, above = rng.normal(size=(3, 3)), rng.normal(size=3), 10.0 ** rng.uniform(-3, 3)
    form = QuadraticForm(root @ root.T, root @ root.T @ b)
    assert form.least == pytest.approx(-0.5 * b @ root @ root.T @ b)
    low, high = form.shadow(above)
    unit = rng.normal(size=(5000, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    points = -b + np.sqrt(2 * above) * np.linalg.solve(root.T, unit.T).T
    assert ((low <= points) & (points <= high)).all()
    wide = high - low
    assert (points.max(axis=0) >= high - 0.05 * wide).all()
    assert (points.min(axis=0) <= low + 0.05 * wide).all()


def test_flat_directions_have_no_bounds_and_slopes_along_them_no_least_value():
    level = QuadraticForm(np.diag([2.0, 0.0]), np.array([1.0, 0.0]))
    np.testing.assert_allclose(level.shadow(1.0)[:, 0], [-1.618, 0.618], atol=0.2)
    assert np.isinf(level.shadow(1.0)[:, 1]).all()
    assert QuadraticForm(np.diag([2.0, 0.0]), np.array([1.0, 0.1])).least == -np.inf


def test_what_interval_arithmetic_cannot_tell_is_unbounded():
    nan, one = np.array([np.nan]), np.array([1.0])
    assert outward(nan, nan) == (-np.inf, np.inf)
    low, high = outward(one, one)
    assert low < 1 < high
    unknown = np.array([-np.inf]), np.array([np.inf])
    with np.errstate(invalid="ignore"):
        assert multiply((np.zeros(1), one), unknown) == unknown
        found = multiply((np.zeros(1), np.zeros(1)), unknown)
    assert np.abs(found).max() < 1e-300


# --- cells ------------------------------------------------------------------------------------------------------------


def some_cells(rng, shape):
    places = np.stack(np.unravel_index(np.arange(np.prod(shape)), shape), axis=1)
    lattice = Lattice(np.array([-1.0, 2.0]), np.array([2.0, 3.0]) / shape, np.array(shape), places, np.full(2, 1e-12))
    chosen = rng.random(len(lattice.cells)) < 0.6
    kept = replace(lattice, cells=lattice.cells[chosen])
    values, slopes = rng.normal(size=(chosen.sum(), 2)), rng.normal(size=(chosen.sum(), 2, 2))
    far = np.full(kept.centres.shape, np.inf)
    return CostToGo(kept, values, slopes, -far, far)


@pytest.mark.parametrize("shape", [(1, 7), (6, 5), (16, 16), (1, 1)])
def test_minima_over_ranges_are_below_all_cells_in_them_and_equal_for_one_place(shape):
    rng = np.random.default_rng(0)
    value = some_cells(rng, shape)
    minima, cells = Minima(value), value.lattice.cells
    for _ in range(50):
        ends = np.sort([[rng.integers(size) for size in shape] for _ in range(2)], axis=0)
        inside = ((cells >= ends[0]) & (cells <= ends[1])).all(axis=1)
        found = minima.least(ends[:1], ends[1:])[0]
        assert found <= value.least[inside].min(initial=np.inf)
        if (ends[0] == ends[1]).all():
            assert found == value.least[inside].min(initial=np.inf)


def test_halved_cells_cover_the_kept_ones_and_know_where_they_come_from():
    rng = np.random.default_rng(1)
    value = some_cells(rng, (6, 5))
    lattice = value.lattice
    kept = rng.random(len(lattice.cells)) < 0.5
    fine, parents = lattice.halved(kept)
    assert len(fine.cells) == 4 * kept.sum()
    assert (np.abs(fine.centres - lattice.centres[parents]) <= lattice.width / 4 * (1 + 1e-12)).all()
    points = lattice.centres[kept] + rng.uniform(-0.49, 0.49, size=(kept.sum(), 2)) * lattice.width
    found = fine.numbers(fine.indices(points))
    np.testing.assert_array_equal(parents[found], np.flatnonzero(kept))
    slopes = rng.normal(size=(len(parents), 2, 2))
    most = value.most(parents, fine, slopes)
    for _ in range(20):
        x = fine.centres + rng.uniform(-0.5, 0.5, size=fine.centres.shape) * fine.width
        tilted = value.at(x)[:, None] - np.einsum("psn,pn->ps", slopes, x - fine.centres)
        assert (tilted <= most + 1e-12).all()


def test_a_terminal_cost_that_is_not_convex_is_above_its_minorants():
    """cos(3 x) - x^2 with cells that are wide and small."""
    (x,), _ = signals(1, 1)
    formula, at = (3 * x).cos() - x**2, np.linspace(-0.5, 0.5, 41)[:, None]
    for count in (3, 40):
        lattice = Lattice.full(np.array([-2.0]), np.array([2.0]), np.zeros(1), count)
        values, slopes = terminal_minorants(formula, lattice)
        away = at * lattice.width
        points = (lattice.centres[:, 0] + away).T
        exact = np.cos(3 * points) - points**2
        found = values[:, None] + slopes * away.T
        assert (found <= exact + ROUNDING).all()
        assert (exact - found).max() <= 10 * lattice.width[0] ** 2


# --- bounds -----------------------------------------------------------------------------------------------------------

BUCK, NORM = library.buck_converter, library.norm_dynamics


def multipliers_of(problem, rng=None):
    """Return multipliers of zero, or random ones of what frequency constraints there are."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    rho = np.zeros((T // 2 + 1, m), dtype=complex)
    if rng is not None:
        rho = np.where(problem.control_stop, rng.standard_normal(rho.shape) + 1j * rng.standard_normal(rho.shape), 0)
        rho.imag[[0, *([T // 2] if T % 2 == 0 else [])]] = 0.0
    none = np.zeros(((T + 1) // 2 + 1, n))
    return lfo.results.Multipliers(1.0, np.zeros((T, n)), np.zeros((T + 1, n)), np.zeros((T, m)), rho, none)


def best_bound(problem, cost, gap, multipliers=None):
    """Return the last of the bounds, after a look at all of them."""
    bounds = [level.value for level in value_bounds(problem, multipliers or multipliers_of(problem), cost, gap)]
    assert bounds == sorted(bounds)
    return bounds[-1]


WITH_OPTIMUM = {
    "buck 3": (BUCK(3), 17.345547997984184),
    "buck 4": (BUCK(4), 22.36493035150289),
    "border end": (BUCK(4, terminal_state=[1.0]), 22.400633302541934),
    "wrong sign": (BUCK(2, initial_state=[0.9351278729299871], terminal_state=None), 11.554464138730564),
    "kink": (BUCK(4, terminal_state=None, terminal_price=-40.0), -17.5993666975),
    "as posed": (BUCK(8, v_min=None, v_max=None), 11.221825808084372),
    "losses": (BUCK(2, diode_resistance=0.2), None),
    "norm": (NORM((1.0, 0.0), 3), 1.959023692803284),
    "norm at its kink": (NORM((0.0, 1.0), 2), 1.0),
}


@pytest.mark.parametrize("name", seeds(WITH_OPTIMUM))
def test_the_bound_is_below_the_optimum_and_as_near_as_asked(name):
    problem, optimum = WITH_OPTIMUM[name]
    if optimum is None:
        optimum = lfo.solve(problem, method="nonsmooth").cost
    gap = 1e-4 * max(1.0, abs(optimum))
    bound = best_bound(problem, optimum, gap)
    assert optimum - gap <= bound <= optimum + ROUNDING * abs(optimum)


def drag(states, horizon):
    """Return a mass with drag |v| v; with three states, its force lags behind the control."""

    def f(x, u):
        force = x[2] if states == 3 else u[0]
        moved = [x[0] + 0.3 * x[1], x[1] + 0.3 * (force - 0.5 * x[1] * abs(x[1]))]
        return moved if states == 2 else [*moved, x[2] + 0.5 * (u[0] - x[2])]

    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, states, 1)
    weights = np.diag([2.0, 0.2, 0.1][:states])
    return lfo.OptimalControlProblem(
        dynamics,
        horizon,
        lfo.QuadraticCost(Q=weights, R=0.2, P=2 * weights),
        control_set=lfo.Box(-2, 2),
        state_set=lfo.Box(-3, 3),
        initial_state=[1.0, *[0.0] * (states - 1)],
    )


@expensive
@pytest.mark.parametrize(("states", "horizon", "gap"), [(2, 3, 1e-4), (3, 2, 1e-3)])
def test_states_that_cannot_change_at_once_take_no_cells(states, horizon, gap):
    problem = drag(states, horizon)
    result = lfo.solve(problem, method="nonsmooth")
    bound = best_bound(problem, result.cost, gap * result.cost, result.multipliers)
    assert (1 - gap) * result.cost <= bound <= (1 + ROUNDING) * result.cost


@expensive
@pytest.mark.parametrize("cost", [5.0, 22.2, np.inf])
def test_wrong_costs_give_a_bound_all_the_same(cost):
    problem, optimum = BUCK(4), 22.36493035150289
    bounds = value_bounds(problem, multipliers_of(problem), cost, 0.01)
    found = max(level.value for level, _ in zip(bounds, range(2), strict=False))
    assert found <= optimum
    assert found >= min(cost - 0.01, 17.0)


def random_problem(seed):
    """Return one or two states with kinks of absolute values and norms, and sines."""
    rng = np.random.default_rng(seed)
    n, T, c = int(rng.integers(1, 3)), int(rng.integers(2, 4)), rng.normal(size=6)

    def f(x, u):
        kinked = [0.8 * x[i] + 0.4 * c[i] * u[0] + 0.3 * c[2 + i] * abs(x[i] - c[4] * u[0]) for i in range(n)]
        bent = 0.2 * c[5] * np.sin(x[0]) * u[0] + (0.2 * norm(x) if n == 2 else 0.0)
        return [kinked[0] + bent, *kinked[1:]]

    return lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(f, n, 1),
        T,
        lfo.QuadraticCost(Q=np.eye(n), R=0.1, x_ref=rng.normal(size=n)),
        control_set=lfo.Box(-2, 2),
        state_set=lfo.Box(-4, 4),
        initial_state=rng.normal(size=n),
    )


@expensive
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_random_problems_are_bounded_below_their_optimum_whatever_cost_is_claimed(seed):
    problem = random_problem(seed)
    optimum = lfo.solve(problem, method="nonsmooth").cost
    size = max(1.0, abs(optimum))
    for claimed in (optimum, 1.05 * optimum + 0.05):
        bounds = value_bounds(problem, multipliers_of(problem), claimed, 1e-2 * size)
        found = max(level.value for level, _ in zip(bounds, range(3), strict=False))
        assert claimed - 0.3 * size <= found <= optimum + ROUNDING * size


@expensive
def test_random_trajectories_cost_more():
    problem, rng = BUCK(5, terminal_state=None), np.random.default_rng(0)
    bound = next(value_bounds(problem, multipliers_of(problem), 25.0, 1e-2)).value
    for _ in range(200):
        u = 2.2 + 3.8 * rng.random((5, 1)) ** 4
        try:
            replay = lfo.simulate(problem, u)
        except lfo.errors.NumericalError:
            continue
        if problem.state_boxes.violation(replay.x).max() == 0:
            assert problem.value(replay.x, replay.u) >= bound


@expensive
def test_with_frequency_constraints_any_multipliers_bound_and_the_right_ones_are_best():
    problem = BUCK(4, control_spectrum=[2], terminal_state=None)
    result = lfo.solve(problem, method="nonsmooth")
    best = best_bound(problem, result.cost, 1e-3 * result.cost, result.multipliers)
    assert result.cost - 1e-3 * result.cost <= best <= result.cost
    rng = np.random.default_rng(1)
    for _ in range(3):
        bound = next(value_bounds(problem, multipliers_of(problem, rng), result.cost, 1e-2)).value
        assert bound <= result.cost


def test_a_free_bin_has_no_multiplier():
    problem = BUCK(3)
    nothing = np.zeros((3, 1))
    wrong = lfo.results.Multipliers(1.0, nothing, np.zeros((4, 1)), nothing, np.ones((2, 1)), nothing)
    with pytest.raises(lfo.errors.ProblemError, match="Bin 0 is free"):
        next(value_bounds(problem, wrong, 20.0, 1e-2))


def test_unreachable_ends_have_an_infinite_bound():
    problem = BUCK(2, terminal_state=[0.1])
    assert best_bound(problem, np.inf, 1e-2) == np.inf


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (
            lfo.OptimalControlProblem(
                BUCK(3).dynamics, 3, lfo.QuadraticCost(Q=1.0), state_set=lfo.Box(0, 1), initial_state=[0.5]
            ),
            r"voltage \[V\] is not bounded",
        ),
        (
            lfo.OptimalControlProblem(
                lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [*(x[:3] + u[0]), abs(x[3])], 4, 1),
                2,
                lfo.QuadraticCost(R=1.0),
                control_set=lfo.Box(-1, 1),
                initial_state=[0.0, 0.0, 0.0, 1.0],
            ),
            "got 4 states; expected at most 3",
        ),
    ],
)
def test_what_cannot_be_bounded_is_refused(problem, words):
    with pytest.raises(UnsupportedError, match=words):
        next(value_bounds(problem, multipliers_of(problem), 20.0, 1e-2))


@expensive
@pytest.mark.parametrize("megabytes", [0.5, 1.0])
def test_memory_is_bounded_and_the_bounds_so_far_hold(monkeypatch, megabytes):
    """No cost is known, so that all boxes stay: the search ends by itself, long before its deadline."""
    problem, optimum = BUCK(4), 22.36493035150289
    substitute(monkeypatch, "certificate.hybrid.LEVEL_BYTES", int(megabytes * 2**20))
    tracemalloc.start()
    try:
        with use_clock(Clock(1.0)):
            levels = value_bounds(problem, multipliers_of(problem), np.inf, 1e-9, deadline=100.0)
            bounds = [level.value for level in levels]
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert bounds == sorted(bounds)
    assert 20 <= bounds[-1] <= optimum
    assert peak <= (6 * megabytes + BATCH_MEGABYTES) * 2**20


def test_a_first_level_that_does_not_fit_is_refused(monkeypatch):
    substitute(monkeypatch, "certificate.hybrid.LEVEL_BYTES", 2**17)
    with pytest.raises(UnsupportedError, match="20 steps do not fit into memory"):
        next(value_bounds(BUCK(20), multipliers_of(BUCK(20)), 20.0, 1e-2))


@expensive
def test_many_controls_have_few_samples():
    """A grid over all controls would have 2^24 points."""
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [0.5 * abs(x[0]) + sum(u)], 1, 24),
        2,
        lfo.QuadraticCost(Q=1.0, R=0.1, P=1.0),
        control_set=lfo.Box(-1, 1),
        initial_state=[1.0],
    )
    resting = lfo.simulate(problem, np.zeros((2, 24)))
    bound = next(value_bounds(problem, multipliers_of(problem), np.inf, 1e-2)).value
    assert -10 <= bound <= problem.value(resting.x, resting.u)


@expensive
def test_solve_proves_that_an_end_is_out_of_reach():
    result = lfo.solve(BUCK(1, terminal_state=[0.1]), throw=False)
    assert (result.status, result.primal, result.dual) == ("infeasible", False, True)
    assert "proven by dynamic programming" in result.message


@expensive
def test_the_time_is_kept():
    """It ends at the first look at the clock after its deadline."""
    problem, clock = BUCK(8), Clock(1.0)
    given = problem, multipliers_of(problem), 44.68, 1e-5
    with use_clock(clock), pytest.raises(OutOfTimeError):
        list(value_bounds(*given, 20.0))
    assert clock.seconds == 21.0


class OneStart(LocalSearch):
    """A local search that looks at one start only, with half the control and in the second mode at all times."""

    def run(self):
        problem = self.problem
        start = lfo.simulate(problem, 0.5 * (problem.control_tube.lower + problem.control_tube.upper))
        self.best, _ = smooth_optimum(problem, start, np.ones(problem.horizon, dtype=np.intp))
        self.tried = 1
        if self.progress is not None:
            self.progress(SmoothProgress(self.best.cost, -np.inf, self.tried))
        return self


@expensive
def test_the_bound_leads_out_of_a_poor_local_optimum(monkeypatch):
    substitute(monkeypatch, "methods.hybrid.LocalSearch", OneStart)
    assert lfo.solve(BUCK(4), method="nonsmooth").cost > 25
    told = []
    result = lfo.solve(BUCK(4), progress=told.append)
    assert abs(result.cost - 22.36493035150289) < 1e-8
    assert result.gap <= 1e-4
    assert result.certificate.pmp == "satisfied"
    assert [step.tried for step in told] == sorted(step.tried for step in told)
    assert (told[0].level, told[0].lower_bound) == (0, -np.inf)
    assert told[-1].lower_bound > 20
    assert "bound 22.3" in str(told[-1])


@expensive
def test_comparisons_bound_the_constrained_answer_only():
    found = lfo.compare(BUCK(2, control_spectrum=[1], terminal_state=None), ["brickwall"])
    assert found.classical.certificate.bound is None
    assert found.constrained.certificate.bound.kind == "rigorous"
    assert "no global bound was asked for" in found.classical.message


@expensive
def test_solve_adds_the_bound_and_says_what_is_left():
    result = lfo.solve(BUCK(3))
    assert (result.status, result.message) == ("optimal", "")
    assert 0 <= result.gap <= 1e-4
    assert result.certificate.bound.kind == "rigorous"
    with use_clock(Clock(1.0)):
        quick = lfo.solve(BUCK(3), tolerance=1e-13, time_limit=1180.0)
    assert "the global bound leaves a gap of" in quick.message
    assert quick.status == "locally_optimal"
