"""The small QPs of the exchange against an independent solver, on the spectra that break QP methods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import qpsolvers
from scipy.optimize import nnls

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from lin_freq_ocp.methods.spectral import (
    PIVOTING_STEPS,
    BorderedQp,
    RowQp,
    block_pivoting,
    bounded_qp,
    interior_point,
    predictor_corrector,
)

Qp = tuple[np.ndarray, np.ndarray]


def of_factor(G: np.ndarray, target: np.ndarray) -> Qp:
    """S = G'G and d = -G'target, both of order 1: min |G l - target|^2 / 2 over l >= 0, bounded from below."""
    G = G / np.linalg.norm(G, axis=0)
    d = -G.T @ target
    return G.T @ G, d / np.abs(d).max()


def well_conditioned(count: int, seed: int = 0) -> Qp:
    rng = np.random.default_rng(seed)
    return of_factor(rng.standard_normal((2 * count, count)), rng.standard_normal(2 * count))


def singular(count: int, seed: int = 0) -> Qp:
    """Half the rank that its rows would need: multipliers are not unique."""
    rng = np.random.default_rng(seed)
    return of_factor(rng.standard_normal((count // 2, count)), rng.standard_normal(count // 2))


def nearly_parallel(count: int, seed: int = 0) -> Qp:
    """Samples of a smooth curve, as of a state that rides a bound: neighbours differ by rounding of their squares."""
    rng = np.random.default_rng(seed)
    place, width = np.linspace(0, 1, count), 0.15
    G = np.exp(-(((place - np.linspace(-0.2, 1.2, 400)[:, None]) / width) ** 2))
    return of_factor(G, G @ np.abs(rng.standard_normal(count)) + 0.01 * rng.standard_normal(400))


def smooth(count: int, seed: int) -> Qp:
    """Samples of a state whose neighbours differ: independent rows, of which some hold others back."""
    place, width = np.linspace(0, 1, count), 0.04
    G = np.exp(-(((place - np.linspace(-0.2, 1.2, 400)[:, None]) / width) ** 2))
    return of_factor(G, np.random.default_rng(seed).standard_normal(400))


def bimodal(count: int, seed: int = 0) -> Qp:
    """Arcs of a band-limiting projection, as of a saturated control: eigenvalues 0 and 1, and few between."""
    G = low_passed(2 * count)[:, arcs(count)]
    return of_factor(G, 3 * np.random.default_rng(seed).standard_normal(2 * count))


def low_passed(T: int, share: float = 0.85) -> np.ndarray:
    """Return the projection on the lower share of the spectrum of T samples."""
    spectrum = np.fft.rfft(np.eye(T), axis=0)
    spectrum[int(share * T / 2) :] = 0
    projection = np.fft.irfft(spectrum, T, axis=0)
    return (projection + projection.T) / 2


def arcs(count: int) -> np.ndarray:
    """Return two runs of samples, together ``count``, of 2 count samples."""
    return np.r_[np.arange(count // 2), count + np.arange(count - count // 2)]


FAMILIES = {"well conditioned": well_conditioned, "singular": singular, "parallel": nearly_parallel, "bimodal": bimodal}


def errors(qp: Qp, lam: np.ndarray) -> tuple[float, float]:
    """Return the worst violation of the optimality conditions, and |lam' slope|; l >= 0 must hold exactly."""
    S, d = qp
    assert lam.min() >= 0
    slope = S @ lam + d
    return max(0.0, -slope.min()), abs(lam @ slope)


def value(qp: Qp, lam: np.ndarray) -> float:
    return float(0.5 * lam @ qp[0] @ lam + qp[1] @ lam)


def independent_value(qp: Qp) -> float:
    """The optimal value by PIQP."""
    S, d = qp
    lam = qpsolvers.solve_qp(
        S, d, lb=np.zeros(len(d)), solver="piqp", eps_abs=1e-12, eps_rel=1e-12, eps_duality_gap_abs=1e-12
    )
    return value(qp, lam)


def row_qp(S: np.ndarray, d: np.ndarray, upper: np.ndarray) -> RowQp:
    """Return the QP without a bound of low rank, of rows that no equations decide."""
    return RowQp(S, d, upper, *np.zeros((2, len(d))))


def solved(
    S: np.ndarray, d: np.ndarray, start: np.ndarray, upper: float | np.ndarray = np.inf, diagonal_bound: float = 0.0
) -> tuple[np.ndarray, bool]:
    """Solve a QP whose rows no equations decide."""
    upper, diagonal_bound = np.broadcast_to(upper, len(d)), np.full(len(d), diagonal_bound)
    return bounded_qp(RowQp(S, d, upper, diagonal_bound, np.zeros(len(d))), start)


@pytest.mark.parametrize("count", [5, 70, 130, 320])
@pytest.mark.parametrize("family", FAMILIES)
def test_an_answer_is_optimal(family, count):
    qp = FAMILIES[family](count)
    lam, accurate = solved(*qp, np.zeros(len(qp[1])))
    violation, complementarity = errors(qp, lam)
    assert accurate
    assert violation < 2e-9
    assert complementarity < 1e-9
    assert value(qp, lam) == pytest.approx(independent_value(qp), rel=1e-7, abs=1e-9)


def test_a_textbook_answer():
    lam, accurate = solved(np.diag([2.0, 4.0, 1.0]), np.array([-2.0, 3.0, -5.0]), np.zeros(3))
    np.testing.assert_allclose(lam, [1, 0, 5], rtol=1e-14)
    assert accurate


def test_an_answer_is_that_of_nonnegative_least_squares():
    rng = np.random.default_rng(3)
    for _ in range(10):
        G, target = rng.standard_normal((40, 25)), rng.standard_normal(40)
        lam, _ = solved(G.T @ G, -G.T @ target, np.zeros(25))
        np.testing.assert_allclose(lam, nnls(G, target)[0], atol=1e-12)


@pytest.mark.parametrize("family", FAMILIES)
def test_units_of_rows_do_not_matter(family):
    S, d = FAMILIES[family](40)
    units = 10.0 ** np.random.default_rng(2).uniform(-6, 6, 40)
    plain, _ = solved(S, d, np.zeros(40))
    scaled, accurate = solved(1e3 * S * units * units[:, None], d * units, np.zeros(40))
    assert accurate
    assert value((S, d), 1e3 * scaled * units) == pytest.approx(value((S, d), plain), rel=1e-8)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_warm_start_does_not_change_the_answer(family):
    qp = FAMILIES[family](120)
    optimum = value(qp, solved(*qp, np.zeros(120))[0])
    wrong = np.where(np.arange(120) % 3 == 0, 5.0, 0.0)
    assert value(qp, solved(*qp, wrong)[0]) == pytest.approx(optimum, rel=1e-8)


def test_rows_that_nothing_restricts_get_exact_zeros():
    S, d = well_conditioned(30)
    lam, _ = solved(S, np.abs(d), np.zeros(30))
    assert not lam.any()


def test_block_pivoting_settles_or_gives_up():
    qp = well_conditioned(60)
    lam = block_pivoting(row_qp(*qp, np.full(60, np.inf)), np.zeros(60))
    assert max(errors(qp, lam)) < 1e-12
    assert block_pivoting(row_qp(*nearly_parallel(60), np.full(60, np.inf)), np.ones(60)) is None


@pytest.mark.parametrize("seed", [6, 21, 40])
def test_block_pivoting_leaves_a_cycle_by_the_worst_rows(seed, monkeypatch):
    qp = smooth(60, seed)
    lam = block_pivoting(row_qp(*qp, np.full(60, np.inf)), np.zeros(60))
    assert max(errors(qp, lam)) < 1e-11
    assert block_pivoting(row_qp(*qp, np.full(60, 1e9)), np.zeros(60)) == pytest.approx(lam, rel=1e-9, abs=1e-12)
    substitute(monkeypatch, "methods.spectral.STEPS_OF_ALL", PIVOTING_STEPS)
    assert block_pivoting(row_qp(*qp, np.full(60, np.inf)), np.zeros(60)) is None


def test_a_conflict_is_no_answer():
    """Two opposite rows with a gap between them: the QP has no lower bound, and its weights say so."""
    lam, accurate = solved(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([-1.0, -1.0]), np.zeros(2))
    assert np.isfinite(lam).all()
    assert not accurate or lam.min() > 1e9


@pytest.mark.parametrize("family", FAMILIES)
def test_an_interior_point_is_polished_to_rounding(family):
    qp = FAMILIES[family](150)
    lam, accurate = interior_point(row_qp(*qp, np.full(150, np.inf)), np.zeros(150))
    assert accurate
    assert max(errors(qp, lam)) < 1e-7


@pytest.mark.parametrize("left", [0.0, 5e-324, 1e-310])
def test_no_step_is_left_where_the_products_have_vanished(left):
    """Rows in conflict keep their defect while l z falls by 1e-8 a step, until it is zero in floating point."""
    weights, z = np.array([2.0, 1.0]), np.array([left, 0.0])
    other, *after, length = predictor_corrector(lambda target: (np.ones(3), target), weights, z, float(weights @ z) / 2)
    assert length == 0
    assert not other.any()
    assert np.array_equal(after, [weights, z])


@pytest.mark.parametrize("share", [0.85, 0.2])
def test_the_factor_of_low_rank_gives_the_same_answer(share):
    """Rows of a low-passed control with cost u'u / 2 on arcs: S, or the identity less S, is of low rank."""
    S = low_passed(600, share)[np.ix_(arcs(300), arcs(300))]
    qp = S, -S @ (np.random.default_rng(0).standard_normal(300) + 0.5)
    assert np.linalg.matrix_rank(np.eye(300) - S if share > 0.5 else S, tol=1e-12) < 150
    for diagonal_bound in (np.ones(300), np.zeros(300)):
        lam, accurate = interior_point(RowQp(*qp, np.full(300, np.inf), diagonal_bound, np.zeros(300)), np.zeros(300))
        assert accurate
        assert max(errors(qp, lam)) < 1e-9
    cheap, _ = solved(*qp, np.zeros(300), diagonal_bound=1.0)
    assert value(qp, cheap) == pytest.approx(independent_value(qp), rel=1e-9)


@pytest.mark.parametrize("count", [5, 70, 130, 320])
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("most", ["low", "some infinite"])
def test_an_answer_with_upper_bounds_is_optimal(family, count, most):
    S, d = FAMILIES[family](count)
    free = solved(S, d, np.zeros(count))[0]
    upper = np.full(count, 0.3 * float(np.median(free[free > 0])))
    upper[:: 2 if most == "some infinite" else count + 1] = np.inf
    for start in (np.zeros(count), np.minimum(free, upper)):
        lam, accurate = solved(S, d, start, upper=upper)
        slope = S @ lam + d
        assert accurate
        assert lam.min() >= 0
        assert (lam <= upper).all()
        parallel = family == "parallel"  # its multipliers are not unique, and none need be at its bound
        assert (lam == upper).any() or count == 5 or parallel
        assert np.where(lam < upper, slope, 0.0).min() > (-2e-7 if parallel else -2e-9)
        assert np.where(lam > 0, slope, 0.0).max() < 2e-7


@pytest.mark.parametrize("method", [block_pivoting, None])
def test_a_textbook_answer_with_upper_bounds(method):
    S, d, upper = np.diag([2.0, 4.0, 1.0]), np.array([-2.0, 3.0, -5.0]), np.array([np.inf, 1.0, 2.0])
    qp = row_qp(S, d, upper)
    lam = interior_point(qp, np.zeros(3))[0] if method is None else method(qp, np.zeros(3))
    np.testing.assert_allclose(lam, [1, 0, 2], rtol=1e-12)


def bordered(size: int, equations: int, count: int, hessian: float, seed: int = 0) -> tuple[BorderedQp, dict]:
    """min theta'H theta/2 + h'theta + v'v/2 over E theta + F v = e, G theta + W v <= limit; y and l are forces on v."""
    rng = np.random.default_rng(seed)
    dimension = 3 * count
    E, G = rng.standard_normal((equations, size)), rng.standard_normal((count, size))
    F, W = rng.standard_normal((equations, dimension)) / 8, rng.standard_normal((count, dimension)) / 8
    root = rng.standard_normal((size, size))
    H, h = hessian * (root @ root.T + np.eye(size)), hessian * rng.standard_normal(size)
    theta, v = rng.standard_normal(size), 0.3 * rng.standard_normal(dimension)
    e, limit = E @ theta + F @ v, G @ theta + W @ v + 0.1 * rng.random(count)
    qp = BorderedQp(
        size=size,
        K=np.block([[H, E.T], [E, -F @ F.T]]),
        C=np.vstack([G.T, -F @ W.T]),
        S_W=W @ W.T,
        defects=np.concatenate([-h, e]),
        slack=limit,
        weights=np.zeros(count),
        prices=np.full(count, np.inf),
    )
    return qp, {"H": H, "h": h, "E": E, "F": F, "e": e, "G": G, "W": W, "limit": limit}


def bordered_errors(qp: BorderedQp, step: np.ndarray, weights: np.ndarray) -> float:
    change = weights - qp.weights
    z = qp.slack - qp.C.T @ step + qp.S_W @ change
    defects = [np.abs(qp.K @ step + qp.C @ change - qp.defects).max(), -z.min(), np.abs(weights * z).max()]
    assert weights.min() >= 0
    return float(max(defects))


@pytest.mark.parametrize("hessian", [1.0, 1e-4, 1e-9])
@pytest.mark.parametrize(("size", "equations", "count"), [(3, 2, 10), (8, 8, 40), (2, 4, 60), (6, 0, 25)])
def test_a_bordered_answer_is_optimal(size, equations, count, hessian):
    qp, data = bordered(size, equations, count, hessian)
    step, weights, accurate = qp.solve()
    assert accurate
    assert bordered_errors(qp, step, weights) < 1e-9
    v = -data["F"].T @ step[size:] - data["W"].T @ weights
    cost = 0.5 * step[:size] @ data["H"] @ step[:size] + data["h"] @ step[:size] + 0.5 * v @ v
    P = np.zeros((size + len(v), size + len(v)))
    P[:size, :size], P[size:, size:] = data["H"], np.eye(len(v))
    linear = np.concatenate([data["h"], np.zeros(len(v))])
    equal = (np.hstack([data["E"], data["F"]]), data["e"]) if equations else (None, None)
    rows = np.hstack([data["G"], data["W"]])
    point = qpsolvers.solve_qp(
        P, linear, rows, data["limit"], *equal, solver="piqp", eps_abs=1e-11, eps_rel=1e-11, eps_duality_gap_abs=1e-11
    )
    assert cost == pytest.approx(0.5 * point @ P @ point + linear @ point, rel=1e-6, abs=1e-8)


def test_a_bordered_answer_does_not_depend_on_the_weights_before():
    qp, _ = bordered(4, 3, 30, 1e-3)
    step, weights, _ = qp.solve()
    before = np.random.default_rng(1).random(30) * weights.max()
    warm = replace(qp, defects=qp.defects - qp.C @ before, slack=qp.slack + qp.S_W @ before, weights=before)
    same_step, same, accurate = warm.solve()
    assert accurate
    np.testing.assert_allclose(same, weights, atol=1e-9 * weights.max())
    np.testing.assert_allclose(same_step, step, atol=1e-9 * np.abs(step).max())


def test_a_bordered_step_from_its_answer_is_none():
    qp, _ = bordered(4, 3, 30, 1e-3)
    step, weights, _ = qp.solve()
    change = qp.C @ weights
    again = replace(
        qp,
        defects=qp.defects - qp.K @ step - change,
        slack=qp.slack - qp.C.T @ step + qp.S_W @ weights,
        weights=weights,
    )
    further, same, accurate = again.solve()
    assert accurate
    assert np.abs(further).max() < 1e-8 * np.abs(step).max()
    np.testing.assert_allclose(same, weights, atol=1e-8 * weights.max())


def test_a_bordered_answer_with_upper_bounds_is_optimal():
    qp, _ = bordered(4, 3, 30, 1e-3)
    free = qp.solve()[1]
    prices = np.where(np.arange(30) % 3 == 0, np.inf, 0.5 * free.max())
    qp = replace(qp, prices=prices)
    step, weights, accurate = qp.solve()
    assert accurate
    assert (weights <= prices).all()
    assert (weights == prices).any()
    z = qp.slack - qp.C.T @ step + qp.S_W @ weights
    assert np.abs(qp.K @ step + qp.C @ weights - qp.defects).max() < 1e-9
    assert np.where(weights < prices, z, 0.0).min() > -1e-9
    assert np.where(weights > 0, z, 0.0).max() < 1e-9


def test_an_active_set_of_bounds_alone_has_a_thin_factor_of_no_columns():
    """All 500 controls end at a bound that nothing else moves: the matrix of their prices is that of the cost."""
    cost = lfo.QuadraticCost(R=np.eye(2), r=[1.2, 1.2])
    two = lfo.LinearDynamics(np.diag([0.5, 0.4]), np.eye(2))
    result = lfo.solve(lfo.OptimalControlProblem(two, 250, cost, lfo.Box([-1, -1], None), None, [0, 0]), "spectral")
    assert result.status == "optimal"
    np.testing.assert_allclose(result.control, -1.0)
