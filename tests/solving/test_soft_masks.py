"""Soft masks at every frequency: the price of the largest |V|/l - 1, solved, judged and bounded."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import cost_scale
from lin_freq_ocp.certificate.hybrid import tree_bound
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem import LargestExcess
from lin_freq_ocp.problem.hybrid import ModeNode

MASK = lfo.MagnitudeBound
NAME = "mask on acceleration [m/s^2]"


def problem(price: float | None, limit=1.5, **fields) -> lfo.OptimalControlProblem:
    free = lfo.library.double_integrator(horizon=40, sampling_time=0.1, cutoff_hz=None)
    mask = MASK(limit, band=lfo.low_pass(0.6), every_frequency=True, penalty=price, **fields)
    return replace(free, control_spectrum=mask)


def peak_of(result: lfo.results.Result) -> lfo.results.Peak:
    (peak,) = (one.peak for one in result.certificate.conditions if one.peak is not None)
    return peak


def weight_of(result: lfo.results.Result, limit: float = 1.5) -> float:
    (weights,) = (part for name, part in result.multipliers.stage.items() if name.startswith("mask"))
    return float(limit * np.linalg.norm(weights, axis=1).sum())


@pytest.fixture(scope="module")
def hard():
    return lfo.solve(problem(None))


@pytest.fixture(scope="module")
def cheap(hard):
    return lfo.solve(problem(0.3 * weight_of(hard)))


@expensive
def test_a_violated_limit_is_worth_what_a_higher_one_saves(hard, cheap):
    price, step = 0.3 * weight_of(hard), 1e-2
    higher, lower = (lfo.solve(problem(price, limit=1.5 + change)).cost for change in (step, -step))
    (worth,) = cheap.sensitivities.limits.values()
    assert peak_of(cheap).ratio > 1.05
    assert worth.sum() == pytest.approx((higher - lower) / (2 * step), rel=1e-4)


@expensive
@pytest.mark.parametrize("method", ["auto", "convex", "structured"])
def test_a_price_below_the_multipliers_is_paid(hard, cheap, method):
    price = 0.3 * weight_of(hard)
    result = cheap if method == "auto" else lfo.solve(problem(price), method)
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert abs(result.gap) < 1e-6 * result.cost
    assert weight_of(result) == pytest.approx(price, rel=1e-5)
    raised = peak_of(result).ratio
    assert raised > 1.01
    w = np.linspace(0.6, np.pi, 20_001)
    V = np.exp(-1j * np.outer(w, np.arange(40))) @ result.trajectory.u[:, 0]
    assert np.abs(V).max() / 1.5 == pytest.approx(raised, rel=1e-6)
    x, u = result.trajectory.x, result.trajectory.u
    quadratic = result.problem.quadratic.value(x, u)
    assert result.cost == pytest.approx(quadratic + price * (raised - 1), rel=1e-7)
    assert result.cost == pytest.approx(cheap.cost, rel=1e-7)
    assert result.cost < hard.cost


@expensive
def test_a_price_above_the_multipliers_gives_the_hard_optimum(hard):
    result = lfo.solve(problem(1.5 * weight_of(hard)))
    assert result.cost == pytest.approx(hard.cost, rel=1e-6)
    assert peak_of(result).ratio < 1 + 1e-6


@expensive
def test_the_cost_lies_between_grids_of_an_independent_model(hard, cheap):
    price, given = 0.3 * weight_of(hard), problem(None)
    x, u, s = cp.Variable((41, 2)), cp.Variable((40, 1)), cp.Variable(nonneg=True)
    w = np.linspace(0.6, np.pi, 2000)
    waves = np.outer(w, np.arange(40))
    size = cp.norm(cp.vstack([np.cos(waves) @ u[:, 0], -np.sin(waves) @ u[:, 0]]), axis=0)
    A, B, low, high = given.linear.A, given.linear.B, given.state_tube.lower, given.state_tube.upper
    held = [x[1:].T == A @ x[:-1].T + B @ u.T, size <= 1.5 * (1 + s), x[0] == low[0], x[-1] == low[-1]]
    held += [x[:, i] >= low[:, i] for i in range(2) if np.isfinite(low[:, i]).all()]
    held += [x[:, i] <= high[:, i] for i in range(2) if np.isfinite(high[:, i]).all()]
    held += [cp.abs(u) <= given.control_tube.upper[0, 0]]
    R = float(given.quadratic.R[0, 0])
    assert not given.quadratic.Q.any()
    program = cp.Problem(cp.Minimize(0.5 * R * cp.sum_squares(u) + price * s), held)
    program.solve(solver="CLARABEL")
    assert program.value <= cheap.cost * (1 + 1e-6)
    assert cheap.cost == pytest.approx(program.value, rel=5e-5)  # what a grid of 2000 points misses


@expensive
def test_the_derivative_by_the_price_is_the_excess(hard, cheap):
    price, step = 0.3 * weight_of(hard), 1e-3
    more = lfo.solve(problem(price * (1 + step)))
    slope = (more.cost - cheap.cost) / (price * step)
    assert slope == pytest.approx(peak_of(cheap).ratio - 1, rel=1e-2)


def test_any_atoms_give_a_valid_bound(cheap):
    rng = np.random.default_rng(0)
    for _ in range(5):
        atoms = np.sort(rng.uniform(0.6, np.pi, 3))
        weights = 10.0 ** rng.uniform(-3, 3) * rng.normal(size=(3, 2))
        stage, frequencies = cheap.multipliers.stage | {NAME: weights}, {NAME: atoms}
        given = replace(cheap.multipliers, stage=stage, frequencies=frequencies)
        bound = lfo.certify(cheap.problem, cheap.trajectory, given).lower_bound
        assert bound is None or bound <= cheap.cost * (1 + 1e-9)
    none = replace(cheap.multipliers, stage={NAME: np.zeros((0, 2))}, frequencies={NAME: np.zeros(0)})
    certificate = lfo.certify(cheap.problem, cheap.trajectory, none)
    assert certificate.lower_bound is None or certificate.lower_bound <= cheap.cost
    assert "N-uhat" in {one.label for one in certificate.failed}


@pytest.mark.parametrize("what", ["moved", "turned", "heavier", "more excess"])
def test_what_is_wrong_fails_at_its_label(cheap, what):
    multipliers, trajectory = cheap.multipliers, cheap.trajectory
    weights, atoms = multipliers.stage[NAME].copy(), multipliers.frequencies[NAME].copy()
    heavy = int(np.argmax(np.linalg.norm(weights, axis=1)))
    if what == "moved":
        atoms[heavy] += 0.02
    elif what == "turned":
        turn = np.exp(1e-2j)
        weights[heavy] = weights[heavy] @ np.array([[turn.real, turn.imag], [-turn.imag, turn.real]])
    elif what == "heavier":
        weights *= 1.001
    else:
        u = trajectory.u.copy()
        u[:, 0] += 1e-2 * np.cos(atoms[heavy] * 1.01 * np.arange(len(u)))
        trajectory = lfo.Trajectory(trajectory.x, u)
    given = replace(multipliers, stage=multipliers.stage | {NAME: weights}, frequencies={NAME: atoms})
    certificate = lfo.certify(cheap.problem, trajectory, given)
    assert "N-uhat" in {one.label for one in certificate.failed}


@expensive
def test_verdicts_do_not_depend_on_units(hard, cheap):
    price, unit, cost = 0.3 * weight_of(hard), 1e6, 1e-9
    given = problem(None)
    dynamics = given.linear
    scaled = lfo.OptimalControlProblem(
        lfo.LinearDynamics(dynamics.A, dynamics.B * unit),
        40,
        lfo.QuadraticCost(R=cost * given.quadratic.R),
        control_set=given.control_set,
        state_set=lfo.Box(given.state_boxes.lower[0] * unit, given.state_boxes.upper[0] * unit),
        initial_state=given.initial_box.lower * unit,
        terminal_state=given.terminal_box.lower * unit,
        control_spectrum=MASK(1.5, band=lfo.low_pass(0.6), every_frequency=True, penalty=price * cost),
    )
    result = lfo.solve(scaled)
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert result.cost == pytest.approx(cost * cheap.cost, rel=1e-7)


@expensive
def test_what_a_hard_mask_excludes_a_soft_one_allows():
    assert lfo.solve(problem(None, 1e-3), "convex", throw=False).status == "infeasible"
    result = lfo.solve(problem(1.0, 1e-3), "convex")
    assert result.certificate.pmp == "satisfied"
    assert peak_of(result).ratio > 10


@pytest.mark.parametrize("field", seeds(["points", "window", "state", "output", "two masks"]))
def test_points_windows_states_and_outputs(field):
    fields = {"window": "hann"} if field == "window" else {}
    limit = {"points": [[0.6, 1.0], [np.pi, 0.3]], "window": 0.1}.get(field, 0.5)
    mask = MASK(limit, band=lfo.low_pass(0.6), every_frequency=True, penalty=1e-3, **fields)
    free = replace(problem(None), control_spectrum=None)
    given = {
        "state": {"state_spectrum": MASK(0.1, band=lfo.low_pass(0.6), every_frequency=True, penalty=1e-3, component=0)},
        "output": {"output_spectrum": lfo.spectrum.OutputSpectrum(D=[[1.0]], C=[[0.0, 1.0]], constraints=mask)},
        "two masks": {"control_spectrum": [mask, MASK(60.0, band=lfo.spectrum.high_pass(0.1), every_frequency=True)]},
    }.get(field, {"control_spectrum": mask})
    result = lfo.solve(replace(free, **given))
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    peaks = [one.peak.ratio for one in result.certificate.conditions if one.peak is not None]
    assert max(peaks) > 1.001
    assert len(peaks) == (2 if field == "two masks" else 1)


@expensive
def test_files_words_and_the_report(tmp_path, cheap):
    lfo.io.write_problem(cheap.problem, tmp_path / "problem.toml")
    loaded = lfo.read_problem(tmp_path / "problem.toml")
    assert "soft" in loaded.control_spectrum[0].describe(["u"])
    cheap.save(tmp_path / "solution.npz")
    saved = lfo.load(tmp_path / "solution.npz")
    assert lfo.certify(loaded, saved.trajectory, saved.multipliers).pmp == "satisfied"
    page = lfo.compare(loaded, filters=[]).save(tmp_path / "report")
    assert page.stat().st_size > 0


@pytest.mark.parametrize("price", [0.0, -1.0, np.nan, np.inf])
def test_bad_prices_name_the_field(price):
    with pytest.raises(ProblemError, match=r"MagnitudeBound\.penalty"):
        problem(price)


def test_a_tree_with_atoms_far_from_the_peak_of_the_centre_proves_nothing_more():
    """The reference of the controls exceeds the mask by 7, its spectrum at 1 rad/sample does not."""
    T, step = 8, lfo.PiecewiseAffineDynamics([lfo.AffineMode([[1.0]], [[1.0]])])
    cost = lfo.QuadraticCost(R=1.0, u_ref=np.where(np.arange(T) % 2, 1.0, -1.0)[:, None])
    mask = MASK(1.0, band=lfo.low_pass(0.6), every_frequency=True, penalty=1.0)
    bounds = lfo.Box(-3, 3), lfo.Box(-20, 20)
    result = lfo.solve(lfo.OptimalControlProblem(step, T, cost, *bounds, initial_state=[0], control_spectrum=mask))
    assert result.cost == pytest.approx(result.tree_bound.value) == pytest.approx(3.0625)
    nodes, name = list[ModeNode](), "mask on u_0"
    for node in result.tree.nodes:
        given = node.proof.multipliers
        given = replace(given, stage={**given.stage, name: np.zeros((1, 2))}, frequencies={name: np.array([1.0])})
        nodes.append(replace(node, proof=replace(node.proof, multipliers=given)))
    assert tree_bound(result.problem, replace(result.tree, nodes=nodes)).value <= result.cost


@expensive
def test_modes_at_some_frequencies_are_not_called_optimal(monkeypatch):
    """A soft mask is never violated: what the cost lacks at other frequencies is seen in the gap."""
    T, step = 8, lfo.PiecewiseAffineDynamics([lfo.AffineMode([[1.0]], [[1.0]])])
    cost = lfo.QuadraticCost(R=1.0, u_ref=np.random.default_rng(0).standard_normal((T, 1)))
    mask = MASK(0.5, band=lfo.low_pass(0.6), every_frequency=True, penalty=1.0)
    bounds = lfo.Box(-3, 3), lfo.Box(-20, 20)
    given = lfo.OptimalControlProblem(step, T, cost, *bounds, initial_state=[0], control_spectrum=mask)
    assert lfo.solve(given).status == "optimal"
    substitute(monkeypatch, "solving.ROUNDS", 1)
    result = lfo.solve(given, throw=False)
    assert result.gap > 1e-4
    assert result.status == "numerical_error"


def test_what_gaps_are_relative_to_does_not_count_peaks():
    """An impulse has the same |V| at all frequencies: how many maxima it has, and which is the largest, is rounding."""
    u = np.zeros((8, 1))
    u[0] = 2.0
    plant, mask = (
        lfo.LinearDynamics([[1.0]], [[1.0]]),
        MASK(1.0, band=lfo.low_pass(0.6), every_frequency=True, penalty=1),
    )
    given = lfo.OptimalControlProblem(plant, 8, lfo.QuadraticCost(R=1.0), initial_state=[0], control_spectrum=mask)
    assert cost_scale(given, lfo.simulate(given, u)) == pytest.approx(3.0)
    largest = LargestExcess(np.ones(2), np.asarray(1.0))
    costs = [largest.cost(np.array([[2.0 + by, 0.0], [2.0 - by, 0.0]])) for by in (-1e-12, 1e-12)]
    assert np.abs(costs[1] - costs[0]).sum() < 1e-11
