"""Null spaces, particular responses and border directions of all bins; kernels against a dense projection."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from lin_freq_ocp.methods.spectral import BinSpaces, CirculantKernels, Lti, LtiUnits, lti_problem
from lin_freq_ocp.program import real_rows

BIN = 3
"""The bin on which undamped modes lie, at any horizon."""


HALF_REACHED = "undamped on a bin, by one control"
"""Where control 0 is stopped at that bin, control 1 passes it, but reaches other states only."""


def rotation(angle: float, damping: float = 1.0) -> np.ndarray:
    return damping * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def jordan(eigenvalue: float, size: int) -> np.ndarray:
    return eigenvalue * np.eye(size) + 0.5 * np.eye(size, k=1)


def plants(T: int) -> dict[str, np.ndarray]:
    on_bin, between = rotation(2 * np.pi * BIN / T), rotation(2 * np.pi * (BIN + 0.5) / T)
    return {
        "stable": block_diag(rotation(1.0, 0.6), jordan(0.5, 2)),
        "integrator chain": jordan(1.0, 4),
        "two integrators": block_diag(np.eye(2), jordan(0.5, 2)),
        "Jordan block off the circle": jordan(0.8, 4),
        "Nyquist mode": block_diag(-1.0, jordan(0.5, 3)),
        "undamped on a bin": block_diag(on_bin, jordan(0.5, 2)),
        "twice undamped on a bin": np.block([[on_bin, 0.3 * np.eye(2)], [np.zeros((2, 2)), on_bin]]),
        "undamped between bins": block_diag(between, jordan(0.5, 2)),
        "nearly undamped, nearly on a bin": block_diag(rotation(2 * np.pi * BIN / T + 1e-8, 1 - 1e-9), jordan(0.5, 2)),
        HALF_REACHED: np.block([[on_bin, 0.2 * np.eye(2)], [np.zeros((2, 2)), np.diag([0.5, 1.0])]]),
        "unstable": np.diag([1.3, 0.5, -1.2, 1.05]),
        "slow": np.diag([1 - 1e-8, 1 - 1e-4, 0.5, 1.0]),
        "dead beat": np.eye(4, k=1),
    }


STOPS = {  # bins stopped for each of two controls
    "no band": ([], []),
    "different bands": ([5, 6, 7], [BIN, 9]),
    "critical bins": ([0, BIN, 12], [0, BIN, 12]),
    "critical bins of one": ([0, BIN], [5]),
    "one control stopped": ([], range(13)),
}
FACTOR = np.array([[1.0, 0.3, 0.0], [0.2, 1.0, -0.5], [0.0, 0.7, 0.1], [0.4, 0.0, 0.6]])
COSTS = {"R": (0.0, 1.0), "Q and R": (FACTOR @ FACTOR.T, np.array([[2.0, 0.5], [0.5, 1.0]]))}
COMBINATIONS = [
    (24, "no band", "R"),
    (24, "no band", "Q and R"),
    (24, "different bands", "R"),
    (24, "critical bins", "Q and R"),
    (24, "critical bins", "R"),
    (24, "critical bins of one", "Q and R"),
    (24, "critical bins of one", "R"),
    (24, "one control stopped", "Q and R"),
    (25, "different bands", "Q and R"),
]


def inputs(kind: str) -> np.ndarray:
    B = np.random.default_rng(0).standard_normal((4, 2))
    return B * [[1, 0], [1, 0], [0, 1], [0, 0]] if kind == HALF_REACHED else B


def lti_of(A: Any, T: int, stops: Any = ([], []), Q: Any = 0.0, R: Any = 1.0, B: Any = None, **more: Any) -> Lti:
    """The problem in the given coordinates, with two controls."""
    n = len(A)
    dynamics = lfo.LinearDynamics(A, inputs("")[:n] if B is None else B)
    problem = lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(Q=Q, R=R), **more)
    rows = sum(family.rows for family in problem.stage_rows)
    lti = lti_problem(problem, LtiUnits(np.ones(n), np.ones(2), np.ones(rows), 1.0))
    passed = np.ones((2, T // 2 + 1), dtype=bool)
    for j, bins in enumerate(stops):
        passed[j, [k for k in bins if k <= T // 2]] = False
    return replace(lti, passed=passed)


@pytest.fixture(scope="module", params=plants(24))
def all_spaces(request):
    kind = request.param
    return [
        BinSpaces(lti_of(plants(T)[kind], T, STOPS[stop], *COSTS[cost], inputs(kind))) for T, stop, cost in COMBINATIONS
    ]


def at_bins(spaces: BinSpaces) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield k, F_k, the columns of N_k that are not zero, and the border directions."""
    lti, n = spaces.lti, spaces.lti.state_dim
    for k, z in enumerate(spaces.z):
        F = np.hstack([z * np.eye(n) - lti.A, -lti.B])
        N = spaces.N[:, :, k]
        yield k, F, N[:, np.abs(N).max(0) > 0], spaces.bordering_vector[:, spaces.bordering_bin == k]


def largest(array: np.ndarray) -> float:
    return float(np.abs(array).max(initial=0.0))


def test_null_vectors_obey_the_dynamics_and_the_bands(all_spaces):
    for spaces in all_spaces:
        for k, F, N, border in at_bins(spaces):
            assert largest(F @ N) <= 1e-13 * largest(F) * max(1.0, largest(N))
            stopped = spaces.lti.state_dim + np.flatnonzero(~spaces.lti.passed[:, k])
            assert largest(N[stopped]) == 0
            assert largest(border[stopped]) == 0


def test_null_vectors_are_orthonormal_in_the_cost(all_spaces):
    for spaces in all_spaces:
        for _, _, N, border in at_bins(spaces):
            weighted = N.conj().T @ spaces.lti.M
            np.testing.assert_allclose(weighted @ N, np.eye(N.shape[1]), atol=1e-12)
            assert largest(weighted @ border) <= 1e-12 * max(1.0, largest(weighted))


def test_no_direction_is_lost_and_none_counted_twice(all_spaces):
    for spaces in all_spaces:
        for k, F, N, border in at_bins(spaces):
            singular = [one for one in spaces.compatibility if one.k == k]
            assert N.shape[1] + border.shape[1] == spaces.lti.passed[:, k].sum() + len(singular)
            directions = np.hstack([N, border])
            directions = directions / np.linalg.norm(directions, axis=0)
            assert np.linalg.matrix_rank(directions, tol=1e-6) == directions.shape[1]
            places = {int(np.flatnonzero(spaces.bordering_bin == k)[j]): j for j in range(border.shape[1])}
            for one in singular:
                j = places.pop(one.direction)
                np.testing.assert_allclose(F @ border[:, j], one.sigma * one.left, atol=1e-13 * largest(F))
            for j in places.values():
                assert largest(F @ border[:, j]) <= 1e-13 * largest(F)


def test_particular_responses_solve_all_but_the_singular_equations(all_spaces):
    rng = np.random.default_rng(1)
    for spaces in all_spaces:
        n = spaces.lti.state_dim
        rhs = rng.standard_normal((n, 2, len(spaces.z))) + 1j * rng.standard_normal((n, 2, len(spaces.z)))
        response = spaces.particular(rhs)
        for k, F, N, _ in at_bins(spaces):
            expected, y = rhs[:, :, k].copy(), response[:, :, k]
            for one in spaces.compatibility:
                if one.k == k:
                    expected -= np.outer(one.left, one.left.conj() @ rhs[:, :, k])
            np.testing.assert_allclose(F @ y, expected, atol=1e-10 * max(1.0, largest(y)))
            assert largest(N.conj().T @ spaces.lti.M @ y) <= 1e-12 * max(1.0, largest(y)) * max(1.0, largest(N))
            assert largest(y[n:][~spaces.lti.passed[:, k]]) == 0


def test_signals_of_real_bins_are_real(all_spaces):
    for spaces in all_spaces:
        real = np.flatnonzero(spaces.multiplicity == 1)
        assert len(real) == 2 - spaces.lti.horizon % 2
        rhs = np.ones((spaces.lti.state_dim, 1, len(spaces.z)), dtype=complex)
        at_real = [spaces.N[:, :, real], spaces.particular(rhs)[:, :, real]]
        at_real.append(spaces.bordering_vector[:, np.isin(spaces.bordering_bin, real)])
        for part in at_real:
            assert largest(part.imag) <= 1e-14 * max(1.0, largest(part.real))


@pytest.mark.parametrize(
    ("kind", "k", "count"),
    [("integrator chain", 0, 1), ("two integrators", 0, 2), ("undamped on a bin", BIN, 1), ("Nyquist mode", 12, 1)],
)
def test_a_singular_value_of_rounding_is_an_exact_zero(kind, k, count):
    """As a number it would decide the answer: sigma xi = rhs with sigma = 1e-17 has a solution, 0 xi = rhs has none."""
    spaces = BinSpaces(lti_of(plants(24)[kind], 24, STOPS["critical bins"]))
    assert [one.sigma for one in spaces.compatibility if one.k == k] == [0.0] * count
    passed = BinSpaces(lti_of(plants(24)[kind], 24))
    assert not any(one.k == k for one in passed.compatibility)


def test_a_mode_that_no_control_reaches_is_singular_at_its_bin_though_nothing_is_stopped():
    A = block_diag(1.0, 0.5)
    lti = replace(lti_of(A, 24), B=np.array([[0.0, 0.0], [1.0, 1.0]]))
    assert [(one.k, one.sigma) for one in BinSpaces(lti).compatibility] == [(0, 0.0)]


def test_directions_without_cost_are_border_directions():
    free = BinSpaces(lti_of(np.diag([1.0, 0.5]), 24))
    weighted = BinSpaces(lti_of(np.diag([1.0, 0.5]), 24, Q=1.0))
    assert list(free.bordering_bin) == [0]
    np.testing.assert_allclose(np.abs(free.bordering_vector[:, 0]), [1, 0, 0, 0], atol=1e-12)
    assert len(weighted.bordering_bin) == 0


def test_a_cost_that_does_not_see_an_allowed_direction_is_refused():
    with pytest.raises(lfo.errors.UnsupportedError, match="give every control a cost"):
        BinSpaces(lti_of(np.diag([0.5, 0.3]), 24, R=np.diag([1.0, 0.0])))
    BinSpaces(lti_of(np.diag([0.5, 0.3]), 24, ([], range(13)), R=np.diag([1.0, 0.0])))


def projection(lti: Lti) -> np.ndarray:
    """What all F_f y_t lose by unit forces on all F_g y_s, ((rows T) x (rows T)), by dense linear algebra in time.

    Forces p act on the periodic problem: minimise sum y'My / 2 + p'y over x_{t+1 mod T} = A x_t + B u_t and the bands.
    """
    T, n, m = lti.horizon, lti.state_dim, lti.control_dim
    size = n + m
    dynamics = np.zeros((T, n, T, size))
    for t in range(T):
        dynamics[t, :, t] -= np.hstack([lti.A, lti.B])
        dynamics[t, :, (t + 1) % T, :n] += np.eye(n)
    equations = [dynamics.reshape(T * n, T * size)]
    for j in range(m):
        rows = real_rows(T, ~lti.passed[j])
        band = np.zeros((len(rows), T, size))
        band[:, :, n + j] = rows
        equations.append(band.reshape(len(rows), T * size))
    Z = null_space(np.vstack(equations))
    M = np.kron(np.eye(T), lti.M)
    FZ = np.kron(np.eye(T), lti.F) @ Z
    return FZ @ np.linalg.solve(Z.T @ M @ Z, FZ.T)


ROWS = lfo.StageRows([[1.0, 0, 0, -1.0], [0, 0, 0, 0]], [[0.5, 0], [1.0, -2.0]], [1.0, 1.0])


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("T", [8, 9])
@pytest.mark.parametrize(
    ("kind", "stops", "cost"),
    [
        ("stable", "no band", "R"),
        ("stable", "different bands", "Q and R"),
        ("unstable", "critical bins", "R"),
        ("integrator chain", "no band", "Q and R"),
        ("undamped on a bin", "no band", "Q and R"),
        ("dead beat", "one control stopped", "R"),
    ],
)
def test_kernels_are_a_dense_projection(monkeypatch, kind, stops, cost, T, together):
    if not together:
        substitute(monkeypatch, "methods.spectral.SMALL_TABLE", 0)
    lti = lti_of(plants(T)[kind], T, STOPS[stops], *COSTS[cost], stage_rows=ROWS)
    spaces = BinSpaces(lti)
    assert len(spaces.bordering_bin) == 0
    rows = len(lti.F)
    t, f = (index.ravel() for index in np.divmod(np.arange(T * rows), rows))
    table = CirculantKernels(lti, spaces)
    gram, expected = table.gram(t, f, t, f), projection(lti)
    np.testing.assert_allclose(gram, expected, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_array_equal(gram, gram.T)
    np.testing.assert_allclose(
        table.free_response(np.zeros(rows, dtype=int), np.arange(rows)),
        np.diagonal(expected)[:rows],
        rtol=1e-9,
        atol=1e-11,
    )


def test_a_kernel_does_not_depend_on_what_was_asked_before(monkeypatch):
    substitute(monkeypatch, "methods.spectral.SMALL_TABLE", 0)
    lti = lti_of(plants(16)["stable"], 16, STOPS["different bands"], stage_rows=ROWS)
    spaces = BinSpaces(lti)
    asked, fresh = CirculantKernels(lti, spaces), CirculantKernels(lti, spaces)
    t, one, other = np.array([3, 0, 11]), np.array([0, 5, 6]), np.array([6, 1, 0])
    asked.free_response(np.zeros(2, dtype=int), np.array([6, 0]))
    asked.gram(t, other, t, one)
    np.testing.assert_allclose(asked.gram(t, one, t, other), fresh.gram(t, one, t, other), rtol=0, atol=1e-15)
