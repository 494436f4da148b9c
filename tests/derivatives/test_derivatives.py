"""Derivatives of optima by every datum, against central differences of exact optima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks.derivatives import (
    LINEAR,
    MATRICES,
    check,
    differences,
    exact,
    inner,
    kink,
    moved,
    random_change,
    random_problem,
    units,
    weights_of,
)
from helpers.compilers import needs_kernel
from helpers.seeds import expensive, seeds
from lin_freq_ocp.derivatives import SolutionDerivatives, data_of, with_data

T = 24
A, B = np.array([[0.9, 0.3], [-0.2, 0.85]]), np.array([[0.1, 0.5], [1.0, -0.3]])
TIMES = np.arange(T + 1) / T
WISH = np.stack([1.5 * np.sin(2 * np.pi * 2.2 * TIMES), 0.7 * np.cos(2 * np.pi * 3.1 * TIMES)], axis=1)
COST = lfo.QuadraticCost(Q=np.diag([1.0, 0.5]), R=np.diag([0.2, 0.4]), P=2.0, x_ref=WISH)


def tracking(**fields: object) -> lfo.OptimalControlProblem:
    """Two states follow a wish."""
    dynamics = lfo.LinearDynamics(A, B, offset=[0.02, -0.01], sampling_time=0.1)
    given = {"dynamics": dynamics, "horizon": T, "cost": COST, "initial_state": [0.45, -0.2]}
    return lfo.OptimalControlProblem(**(given | fields))


def response(padded: bool) -> lfo.OptimalControlProblem:
    """Return a resonance with a bounded force, on a periodic or a zero-padded record."""
    N = 2 * T if padded else T
    w = 2 * np.pi * np.arange(N // 2 + 1) / N
    G = np.exp(-1j * w) / (1 - 0.8 * np.exp(-1j * w)) if padded else 1 / (0.6 - w**2 + 0.25j * w)
    G[[0, -1]] = G[[0, -1]].real
    dynamics = lfo.FrequencyResponse(G, mode="zero-padded" if padded else "periodic")
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=WISH[:, :1])
    return lfo.OptimalControlProblem(dynamics, T, cost, control_set=lfo.Box(-0.4, 0.4))


SETS = lfo.sets
LINEAR_CLASS = {
    "fixed ends": lambda: tracking(terminal_state=[0.3, 0.1]),
    "free ends": lambda: tracking(initial_state=None),
    "periodic ends": lambda: tracking(initial_state=None, terminal_state=lfo.Periodic()),
    "linked ends": lambda: tracking(
        initial_state=None, terminal_state=SETS.LinkedEnds([[1.0, 0.5]], [[0.3, -1.0]], [0.2])
    ),
    "bounds": lambda: tracking(control_set=lfo.Box(-0.4, 0.4), state_set=lfo.Box([-0.8, -9.0], [0.8, 9.0])),
    "polyhedron": lambda: tracking(control_set=SETS.Polyhedron([[1, 1], [1, -1], [-1, 0.2]], [0.5, 0.6, 0.7])),
    "ball": lambda: tracking(control_set=SETS.Ball(0.5)),
    "soft bounds": lambda: tracking(state_set=SETS.Soft(lfo.Box(-0.5, 0.5), 0.3)),
    "soft ball": lambda: tracking(control_set=SETS.Soft(SETS.Ball(0.3), 0.2)),
    "soft rows": lambda: tracking(stage_rows=lfo.StageRows([[0.2, 0]], [[1, 1]], [0.3], name="sum", penalty=0.2)),
    "L1 cost": lambda: tracking(cost=COST + lfo.costs.L1Cost(u=0.2)),
    "bins of controls": lambda: tracking(control_spectrum=lfo.stop_band(bins=[2, 3, 12])),
    "bins of states": lambda: tracking(state_spectrum=lfo.stop_band(bins=[3, 4], component=1)),
    "mask": lambda: tracking(control_spectrum=lfo.MagnitudeBound(1.0, bins=[2, 3, 4])),
    "mask of states": lambda: tracking(state_spectrum=lfo.MagnitudeBound(2.0, bins=[2, 3])),
    "mask in decibels": lambda: tracking(control_spectrum=lfo.MagnitudeBound(db=-12.0, reference=1.0, bins=[2, 3])),
    "soft mask": lambda: tracking(control_spectrum=lfo.MagnitudeBound(0.4, bins=[2, 3], penalty=0.05)),
    "energy": lambda: tracking(control_spectrum=lfo.spectrum.EnergyBound(2.0, bins=[2, 3, 4])),
    "rate limit": lambda: lfo.rate_limited(tracking(), 0.3, previous=0.0),
    "periodic response": lambda: response(padded=False),
    "zero-padded response": lambda: response(padded=True),
}
"""The features of the linear class, each with active rows; names of data follow from the problem."""

OF_COST = ("Q", "R", "S", "q", "r", "p", "x_ref", "u_ref")


def close(found: float, wanted: float, size: float) -> bool:
    return abs(found - wanted) <= 1e-7 * max(abs(wanted), size)


@pytest.mark.parametrize("seed", seeds(range(9)))
def test_a_random_problem_has_the_derivatives_of_differences(seed):
    found = check(seed)
    assert found.outcome in ("compared", "no common step"), found
    assert found.transposed < 1e-11
    if found.outcome == "compared":
        assert max(found.vjp, found.cost) < 1e-6
        assert not found.affine > 1e-10
        assert found.beyond


@pytest.mark.parametrize("name", seeds((*LINEAR, *MATRICES, "terminal_state"), always=("A", "u_ref")))
def test_each_datum_by_itself(name):
    problem, rng = random_problem(7), np.random.default_rng(7)
    found, weights = exact(problem), weights_of(problem, rng)
    change = random_change(found, (name,), rng)
    optimum, cost = differences(problem, change, weights)
    gradient = found.vjp(**weights)
    assert gradient.exists
    assert inner(gradient, change) == pytest.approx(optimum, rel=1e-8, abs=1e-10)
    assert found.jvp(**change).cost == pytest.approx(cost, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("feature", seeds(LINEAR_CLASS, always=("mask", "linked ends")))
def test_each_feature_of_the_linear_class(feature):
    problem = LINEAR_CLASS[feature]()
    rng = np.random.default_rng(0)
    found, weights = exact(problem), weights_of(problem, rng)
    gradient = found.vjp(**weights)
    assert gradient.exists, gradient
    for name in gradient:  # every datum, levels of bins and limits of masks included
        change = random_change(found, (name,), rng)
        if name == "response":
            change[name][[0, -1]] = change[name][[0, -1]].real
        if name in ("initial_state", "terminal_state"):
            change[name] = np.nan_to_num(change[name] * (gradient[name] == gradient[name]))
        step = found.jvp(**change)
        along = float((weights["x"] * step.x).sum() + (weights["u"] * step.u).sum())
        size = float(np.nanmax(np.abs(gradient[name]), initial=0.0))
        assert along == pytest.approx(inner(gradient, change), rel=1e-10, abs=1e-10 * size + 1e-15), name
    names = ("response", *OF_COST) if "response" in gradient else ("A", "B", "P", *OF_COST)
    if feature == "rate limit":  # weights of zero have one side: others are not convex
        names = tuple(name for name in names if name not in ("Q", "S", "P"))
    change = random_change(found, names, rng)
    if "response" in change:
        change["response"][[0, -1]] = change["response"][[0, -1]].real
    optimum, cost = differences(problem, {name: 0.03 * d for name, d in change.items()}, weights)
    assert 0.03 * inner(gradient, change) == pytest.approx(optimum, rel=1e-6)
    assert 0.03 * found.jvp(**change).cost == pytest.approx(cost, rel=1e-6)


def limited(name: str, level: float) -> lfo.OptimalControlProblem:
    """Return a problem with a limit of this level, by the name of its term."""
    made = {
        "mask on u_0": {"control_spectrum": lfo.MagnitudeBound(level, bins=[2, 3, 4], component=0)},
        "energy bound on u_0": {"control_spectrum": lfo.spectrum.EnergyBound(level**2, bins=[2, 3, 4], component=0)},
        "mask on x_1": {"state_spectrum": lfo.MagnitudeBound(level, bins=[2, 3], component=1)},
        "control set": {"control_set": SETS.Ball(level)},
        "sum": {"stage_rows": lfo.StageRows([[0.2, 0]], [[1, 1]], [level], name="sum")},
    }
    return tracking(**made[name])


@expensive
@pytest.mark.parametrize(
    ("name", "level"),
    [("mask on u_0", 1.0), ("energy bound on u_0", 1.4), ("mask on x_1", 2.0), ("control set", 0.5), ("sum", 0.3)],
)
def test_limits_by_differences(name, level):
    found, weights = exact(limited(name, level)), weights_of(tracking(), np.random.default_rng(0))
    gradient, step = found.vjp(**weights), 1e-4

    def central(size: float) -> np.ndarray:
        pair = [exact(limited(name, level + sign * size)) for sign in (1, -1)]
        sums = [(weights["x"] * one.trajectory.x).sum() + (weights["u"] * one.trajectory.u).sum() for one in pair]
        costs = [one.problem.value(one.trajectory.x, one.trajectory.u) for one in pair]
        return np.array([sums[0] - sums[1], costs[0] - costs[1]]) / (2 * size)

    wanted = (4 * central(step / 2) - central(step)) / 3
    assert gradient[name].sum() == pytest.approx(wanted[0], rel=1e-6)
    assert found.jvp(**{name: np.ones(gradient[name].shape)}).cost == pytest.approx(wanted[1], rel=1e-6)


@expensive
@pytest.mark.parametrize("k", [0, 3, 12])
@pytest.mark.parametrize("part", [1.0, 1.0j])
def test_the_derivative_by_a_bin_of_a_response(k, part):
    problem = response(padded=False)
    found, weights = exact(problem), weights_of(problem, np.random.default_rng(0))
    if part == 1.0j and k in (0, 12):
        with pytest.raises(lfo.errors.ProblemError, match="real"):
            found.jvp(response=np.eye(1, 13, k)[0][:, None, None] * part)
        return
    change = {"response": 0.01 * np.eye(1, 13, k)[0][:, None, None] * part}
    optimum, cost = differences(problem, change, weights)
    assert inner(found.vjp(**weights), change) == pytest.approx(optimum, rel=1e-8, abs=1e-12)
    sensitivities = lfo.solve(problem, tolerance=1e-12).sensitivities
    assert inner({"response": sensitivities.response}, change) == pytest.approx(cost, rel=1e-8, abs=1e-12)


def test_a_level_of_a_removed_bin():
    problem = tracking(control_spectrum=lfo.stop_band(bins=[3], component=0))
    change = np.zeros((13, 2), dtype=complex)
    change[3, 0] = 1 + 2j
    step = exact(problem).jvp(control_bins=change)
    np.testing.assert_allclose(np.fft.rfft(step.u, axis=0)[3, 0], 1 + 2j, rtol=1e-12)


@needs_kernel
@pytest.mark.parametrize("method", ["spectral", "structured", "convex", "condensed"])
def test_methods_are_alike(method):
    problem = tracking(control_set=lfo.Box(-0.4, 0.4), control_spectrum=lfo.stop_band(bins=[2, 3]))
    starts = [[0.4, -0.2], [0.45, -0.2]]
    result = lfo.solve_many(problem, starts)[1] if method == "condensed" else lfo.solve(problem, method)
    assert result.method == method
    weights = weights_of(problem, np.random.default_rng(0))
    known, found = exact(problem).vjp(**weights), result.derivatives.vjp(**weights)
    assert found.exists
    for name in known:
        scale = np.nanmax(np.abs(known[name]), initial=0.0)
        np.testing.assert_allclose(found[name], known[name], rtol=1e-9, atol=1e-9 * scale + 1e-20)


def test_weights_of_multipliers_give_second_derivatives_of_the_cost():
    """The derivative of dJ*/dx_0 = -mu_0 by the offset is that of dJ*/dd = -eta by x_0."""
    problem = random_problem(1)
    found = exact(problem)
    zero = found.jvp(initial_state=np.zeros(3)).multipliers
    mu = zero.mu.copy()
    mu[0] = [1.0, -2.0, 0.5]
    gradient = found.vjp(multipliers=replace_multipliers(zero, mu=mu))
    step = found.jvp(initial_state=np.array([1.0, -2.0, 0.5]))
    np.testing.assert_allclose(gradient["offset"], step.multipliers.eta, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("name", seeds((*LINEAR, *MATRICES), always=("x_ref", "A")))
def test_second_derivatives_of_the_cost(name):
    problem, rng = random_problem(7), np.random.default_rng(7)
    found = exact(problem)
    one, other = (random_change(found, (datum,), rng) for datum in (name, "x_ref"))
    along, back = found.prices_along(**one), found.prices_along(**other)
    assert inner(along, other) == pytest.approx(inner(back, one), rel=1e-9, abs=1e-14)
    ahead, behind = (exact(moved(problem, other, h)).prices for h in (1e-3, -1e-3))
    assert inner(back, one) == pytest.approx((inner(ahead, one) - inner(behind, one)) / 2e-3, rel=1e-6, abs=1e-10)


def replace_multipliers(given: lfo.results.Multipliers, **fields: np.ndarray) -> lfo.results.Multipliers:
    names = ("eta", "mu", "nu", "rho_u", "rho_x", "stage")
    return lfo.results.Multipliers(1.0, **({name: getattr(given, name) for name in names} | fields))


def test_weights_that_are_no_multipliers_of_the_problem_are_refused():
    found, other = exact(random_problem(1)), exact(tracking()).multipliers
    with pytest.raises(lfo.errors.ProblemError, match="multipliers: got 3; expected Multipliers"):
        found.vjp(multipliers=3)
    with pytest.raises(lfo.errors.ProblemError, match=r"multipliers: got eta \(.*\); expected eta \("):
        found.vjp(multipliers=other)


def test_weights_of_the_multipliers_of_a_mask_by_differences():
    rng = np.random.default_rng(0)
    found = exact(limited("mask on u_0", 1.0))
    stage = {"mask on u_0": rng.standard_normal((3, 2))}
    zero = {name: np.zeros_like(getattr(found.multipliers, name)) for name in ("eta", "mu", "nu", "rho_u", "rho_x")}
    gradient = found.vjp(multipliers=lfo.results.Multipliers(1.0, **zero, stage=stage))
    pair = [exact(limited("mask on u_0", 1.0 + h)).multipliers.stage["mask on u_0"] for h in (1e-5, -1e-5)]
    wanted = float((stage["mask on u_0"] * (pair[0] - pair[1])).sum()) / 2e-5
    assert gradient["mask on u_0"].sum() == pytest.approx(wanted, rel=1e-7)


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_units_change_nothing(seed):
    found = units(seed)
    assert found.same
    assert not found.apart > 1e-8


def test_neither_a_far_set_point_nor_the_unit_of_the_cost():
    far = np.array([1e6, -1e3])
    near = tracking(state_set=lfo.Box([-0.8, -0.9], [0.8, 0.9]))
    offset = near.dynamics.offset + (np.eye(2) - A) @ far
    shifted = replace(
        near,
        dynamics=replace(near.dynamics, offset=offset),
        cost=replace(near.cost, x_ref=WISH + far),
        initial_state=near.initial_state.lower + far,
        state_set=lfo.Box(near.state_set.lower + far, near.state_set.upper + far),
    )
    weights = weights_of(near, np.random.default_rng(0))
    known, found = exact(near).vjp(**weights), exact(shifted).vjp(**weights)
    assert known.exists
    assert found.exists
    for name in ("offset", "x_ref", "u_ref", "B", "R", "initial_state", "state_upper"):
        np.testing.assert_allclose(found[name], known[name], rtol=0, atol=1e-7 * np.abs(known[name]).max())
    for unit in (1e-9, 1e9):
        cost = lfo.QuadraticCost(Q=unit * COST.Q, R=unit * COST.R, P=unit * 2.0, x_ref=WISH)
        found = exact(replace(near, cost=cost)).vjp(**weights)
        np.testing.assert_allclose(unit * found["q"], known["q"], rtol=0, atol=1e-8 * np.abs(known["q"]).max())


def two_sided() -> lfo.OptimalControlProblem:
    """min 1/2 |u|^2, u_0 + u_1 = 1, u_0 - 2 u_1 <= -1/2: the row is met exactly, with multiplier zero."""
    rows = lfo.StageRows(None, [[1.0, -2.0]], [-0.5], name="row")
    ends = {"initial_state": [0.0], "terminal_state": [1.0]}
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0, 1.0]]), 1, lfo.QuadraticCost(R=1.0), stage_rows=rows, **ends
    )


def test_a_kink_has_two_sides():
    found = exact(two_sided())
    step = found.jvp(terminal_state=[1.0])
    assert not step.exists
    assert step.rows == ("row, component 0, upper",)
    np.testing.assert_allclose(step.left.u, [[2 / 3, 1 / 3]], rtol=1e-12)
    np.testing.assert_allclose(step.right.u, [[0.5, 0.5]], rtol=1e-12)
    assert step.cost == pytest.approx(0.5, rel=1e-12)
    assert "no: active with multiplier zero" in repr(step)


def test_existence_is_a_property_of_the_weights():
    found = exact(two_sided())
    seen = found.vjp(u=[[1.0, 0.0]])
    assert not seen.exists
    assert "no: active" in repr(seen)
    unseen = found.vjp(u=[[1.0, 1.0]])
    assert unseen.exists
    assert unseen["terminal_state"] == pytest.approx([1.0], rel=1e-12)


@pytest.mark.parametrize("seed", seeds(range(9), always=[5]))
def test_a_bound_at_the_value_of_a_free_control(seed):
    found = kink(seed)
    assert found.outcome in ("two sides", "dependent", "unsolved")
    if found.outcome == "two sides":
        assert found.named
        assert found.error < 1e-9


def test_a_mask_that_is_met_with_multiplier_zero_has_two_sides():
    free = exact(tracking())
    level = float(np.abs(np.fft.rfft(free.trajectory.u[:, 0])[2]))
    problem = tracking(control_spectrum=lfo.MagnitudeBound(level, bins=[2], component=0))
    multipliers = lfo.solve(problem).multipliers
    found = SolutionDerivatives(problem, free.trajectory, multipliers)
    change = {"x_ref": np.stack([np.cos(np.arange(T + 1)), np.zeros(T + 1)], axis=1)}
    step = found.jvp(**change)
    assert not step.exists
    for side, h in ((step.left, -1e-5), (step.right, 1e-5)):
        there = exact(replace(problem, cost=replace(COST, x_ref=WISH + h * change["x_ref"]))).trajectory.u
        np.testing.assert_allclose((there - free.trajectory.u) / h, side.u, rtol=0, atol=1e-4 * np.abs(side.u).max())
    assert np.abs(step.left.u - step.right.u).max() > 1e-2


@pytest.mark.parametrize("eps", [1e-3, 1e-6, 1e-9])
def test_nearly_parallel_rows_are_not_damped(eps):
    dynamics = lfo.LinearDynamics(np.eye(2), [[1.0, 0.0], [1.0, eps]])
    ends = {"initial_state": [0.0, 0.0], "terminal_state": [1.0, 1.0]}
    step = exact(lfo.OptimalControlProblem(dynamics, 1, lfo.QuadraticCost(R=1.0), **ends)).jvp(
        terminal_state=[1.0, 0.0]
    )
    assert step.exists
    np.testing.assert_allclose(step.u, [[1.0, -1 / eps]], rtol=1e-11)


def test_the_same_bound_twice_has_no_derivative():
    base = tracking(control_set=lfo.Box([-0.4, -9.0], [0.4, 9.0]))
    rows = [lfo.StageRows(None, [[1.0, 0.0]], [0.4], name="one"), lfo.StageRows(None, [[2.0, 0.0]], [0.8], name="two")]
    twice = replace(base, control_set=None, stage_rows=rows)
    gradient = exact(twice).vjp(u=np.ones((T, 2)))
    assert not gradient.exists
    assert "depend on each other" in gradient.reason
    assert {row.split(",")[0] for row in gradient.rows} == {"one", "two"}


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_more_active_bounds_than_bins_that_are_left_have_no_derivative(unit):
    """Six bounds fix one number: rounding of the rows of the DFT made K a matrix with an inverse of 1e16."""
    slopes = np.where(np.arange(12) % 2, 0.0, 3.0 / unit)[:, None]
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.9]], [[1 / unit]]),
        12,
        lfo.QuadraticCost(Q=0.1, R=1 / unit**2, r=slopes, x_ref=[0.5]),
        lfo.Box(-unit, unit),
        initial_state=[-4.0],
        control_spectrum=lfo.spectrum.stop_band(bins=range(1, 6)),
    )
    result = lfo.solve(problem)
    np.testing.assert_allclose(result.control[::2], -unit)
    assert np.abs(result.control[1::2]).max() < 0.99 * unit
    found = SolutionDerivatives(problem, result.trajectory, result.multipliers).vjp(u=np.ones((12, 1)))
    assert not found.exists
    assert "depend on each other" in found.reason


def test_an_optimum_that_is_not_unique_has_no_derivative():
    problem = tracking(cost=lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), x_ref=WISH))
    gradient = exact(problem).vjp(u=np.ones((T, 2)))
    assert not gradient.exists
    assert "not unique" in gradient.reason


def test_both_ends_of_an_affine_piece_are_named():
    problem = tracking(control_set=lfo.Box(-0.4, 0.4))
    step = exact(problem).jvp(initial_state=[1.0, 0.0])
    below, above = step.holds
    assert below < 0 < above
    for reach, end in zip(step.holds, step.ends, strict=True):
        inside = exact(problem.with_ends([0.45 + 0.99 * reach, -0.2]))
        np.testing.assert_allclose(
            inside.trajectory.u, exact(problem).trajectory.u + 0.99 * reach * step.u, rtol=0, atol=1e-12
        )
        t = int(end.split("t = ")[1].split(",")[0])
        nu = [exact(problem.with_ends([0.45 + f * reach, -0.2])).multipliers.nu[t] for f in (0.99, 1.01)]
        assert (np.sign(nu[0]) != np.sign(nu[1])).any()


def test_a_bound_that_moves_to_a_free_control_ends_the_piece():
    found = exact(tracking(control_set=lfo.Box(-0.4, 0.4)))
    room = 0.4 - found.trajectory.u
    t, j = np.argwhere(room > 0.1)[0]
    change = np.zeros((T, 2))
    change[t, j] = -1.0
    step = found.jvp(control_upper=change)
    assert step.holds == pytest.approx((-np.inf, room[t, j]), rel=1e-10)
    assert step.ends == (None, f"control set, t = {t}, component {j}, upper")


@pytest.mark.parametrize("name", seeds((*LINEAR, *MATRICES, "terminal_state"), always=("sum.C",)))
def test_a_problem_with_other_data_has_them(name):
    problem = random_problem(1)
    change = random_change(exact(problem), (name,), np.random.default_rng(0))
    found = exact(problem)
    gradient = found.vjp(u=np.ones((T, 2)))
    again = with_data(problem, {name: data_of(problem)[name] + change[name]})
    np.testing.assert_array_equal(data_of(again)[name], data_of(problem)[name] + change[name])
    assert gradient[name].shape == data_of(problem)[name].shape


@pytest.mark.parametrize("value", [0.5, -0.5, 0.0])
@pytest.mark.parametrize("signal", ["control", "state"])
def test_both_bounds_of_a_fixed_value_move_it(signal, value):
    """vjp, jvp and the prices agree, with each other and with differences; each bound has the part of its sign."""
    t, horizon = 5, 12

    def solved(d: float = 0.0) -> lfo.Result:
        x, u = np.full((2, horizon + 1, 2), np.inf), np.ones((2, horizon, 1))
        x[0], u[0] = -np.inf, -1.0
        (x if signal == "state" else u)[:, t, 0] = value + d
        dynamics, cost = lfo.LinearDynamics([[1.0, 0.3], [-0.3, 0.9]], [[0.0], [0.5]]), lfo.QuadraticCost(Q=1, R=0.5)
        start = [0.0, 0.0] if value == 0 else [1.0, 0.0]
        fields = {"state_set": lfo.Box(*x), "initial_state": start}
        return lfo.solve(lfo.OptimalControlProblem(dynamics, horizon, cost, lfo.Box(*u), **fields))

    result, weights, step = solved(), np.cos(np.arange(horizon))[:, None], 1e-3
    derivatives, sides = result.derivatives, (f"{signal}_lower", f"{signal}_upper")
    change = np.zeros((horizon + 1, 2) if signal == "state" else (horizon, 1))
    change[t, 0] = 1.0
    moves = [derivatives.jvp(**{side: change}) for side in sides]
    both, gradient = derivatives.jvp(**dict.fromkeys(sides, change)), derivatives.vjp(u=weights)
    ahead, behind = solved(step), solved(-step)
    np.testing.assert_allclose(both.u, (ahead.control - behind.control) / (2 * step), atol=1e-6)
    assert both.cost == pytest.approx((ahead.cost - behind.cost) / (2 * step), abs=1e-6)
    for side, move in zip(sides, moves, strict=True):
        assert gradient[side][t, 0] == pytest.approx((weights * move.u).sum(), abs=1e-9)
        assert getattr(result.sensitivities, side)[t, 0] == pytest.approx(move.cost, abs=1e-9)
    assert sum(float(np.abs(move.u).max() > 0) for move in moves) == 1
