"""Prices of soft spectral bounds: what their docstrings say, by sums of the definition, in every use of a price."""

from __future__ import annotations

from importlib.util import find_spec

import cvxpy as cp
import numpy as np
import pytest
from scipy.signal import get_window

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.loop import excess
from lin_freq_ocp.spectrum import EnergyBound, LinearConstraint, OutputSpectrum, Spectrogram
from lin_freq_ocp.transform import translation_of

T, CUTOFF, PRICE, LIMIT = 7, 1.2, 0.6, 0.3
LOW = lfo.low_pass(CUTOFF)


def grid(q: int, bins: list[int] | None = None) -> np.ndarray:
    """Return the points of a grid q times as fine in the band, or from each listed bin to a neighbour in the list."""
    k = np.arange(q * T // 2 + 1)
    if bins is None:
        return k[2 * np.pi * k / (q * T) > CUTOFF]
    listed = {*bins, *(T - k for k in bins)}  # with the conjugate of each
    return np.array([j for j in k if j / q in listed or {j // q, j // q + 1} <= listed])


def waves(q: int, window: str | None = None, bins: list[int] | None = None) -> list[np.ndarray]:
    """Return (Re, Im) of the spectrum at each point as rows on the signal, (2, T)."""
    weights = np.ones(T) if window is None else get_window(window, T, fftbins=False)
    angles = 2 * np.pi * np.outer(grid(q, bins), np.arange(T)) / (q * T)
    return list(np.stack([weights * np.cos(angles), -weights * np.sin(angles)], axis=1))


def bounds() -> dict[str, tuple[object, list[np.ndarray], float]]:
    """Return bounds, and for each the matrices G and the limit l with the price PRICE * sum over G of |G u| - l."""
    found = {}
    for q in (1, 4, 16):
        for name, window, bins in (("", None, None), (", window", "hann", None), (", bins", None, [2, 3])):
            fine = {"oversampling": q, "penalty": PRICE, "window": window}
            fine |= {"bins": bins} if bins else {"band": LOW}
            rows, root = waves(q, window, bins), np.sqrt(LIMIT)
            found[f"mask {q}{name}"] = lfo.MagnitudeBound(LIMIT, **fine), rows, LIMIT
            whole = [np.vstack(rows) / np.sqrt(q)]
            found[f"energy {q}{name}"] = EnergyBound(LIMIT, **fine), whole, root
            found[f"windows of energy {q}{name}"] = Spectrogram(EnergyBound(LIMIT, **fine), T), whole, root
    between = lfo.MagnitudeBound(LIMIT, band=LOW, oversampling=4, between=True, penalty=PRICE)
    found["mask between points"] = between, waves(4), LIMIT * np.cos(np.pi / 8)
    line = np.arange(1.0, T + 1)
    found["equation"] = LinearConstraint(line[:, None, None], penalty=PRICE), [line[None]], 0.0
    return found


BOUNDS = bounds()


def problem(bound, **field) -> lfo.OptimalControlProblem:
    cost = lfo.QuadraticCost(R=1.0, u_ref=np.cos(2.0 * np.arange(T))[:, None])
    given = {"control_spectrum": bound} if not field else field
    return lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), T, cost, initial_state=[0.0], **given)


@pytest.mark.parametrize("name", seeds(BOUNDS))
def test_the_price_is_that_of_the_docstring(name):
    bound, rows, limit = BOUNDS[name]
    given, plain = problem(bound), problem(None)
    for seed in range(3):
        u = 0.5 * np.random.default_rng(seed).standard_normal((T, 1))
        x = lfo.simulate(given, u).x
        over = sum(max(np.linalg.norm(G @ u[:, 0]) - limit, 0.0) for G in rows)
        assert given.value(x, u) - plain.value(x, u) == pytest.approx(PRICE * over, rel=1e-12, abs=1e-12)
    assert lfo.certify(given, lfo.Trajectory(x, u)).cost == pytest.approx(given.value(x, u))


@pytest.mark.parametrize("name", seeds([name for name in BOUNDS if "windows" not in name and "16, " not in name]))
def test_solver_export_and_proof_have_the_same_price(name):
    bound, rows, limit = BOUNDS[name]
    given, u = problem(bound), cp.Variable(T)
    priced = cp.sum(cp.hstack([cp.pos(cp.norm(G @ u) - limit) for G in rows]))
    by_hand = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(u - np.cos(2.0 * np.arange(T))) + PRICE * priced))
    expected = by_hand.solve(solver="CLARABEL")
    result, exported = lfo.solve(given), lfo.to_cvxpy(given)
    assert result.certificate.globally_optimal
    assert result.cost == pytest.approx(expected, rel=1e-6)
    assert exported.solve(solver="CLARABEL") == pytest.approx(expected, rel=1e-6)
    if "16" not in name and find_spec("flint"):  # its file has 16 times as many numbers
        assert result.enclosure.lower == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("q", [1, 4, 16])
def test_excess_is_in_the_unit_of_the_limit(q):
    bound, rows, limit = BOUNDS[f"energy {q}"]
    u = np.random.default_rng(1).standard_normal((T, 1))
    given = problem(bound)
    found = excess(translation_of(given), lfo.simulate(given, u))
    assert list(found.values()) == pytest.approx([np.linalg.norm(rows[0] @ u[:, 0]) - limit])


@pytest.mark.parametrize("q", [1, 4])
def test_outputs_have_the_same_price(q):
    bound, rows, limit = BOUNDS[f"energy {q}"]
    given = problem(None, output_spectrum=OutputSpectrum(None, [[2.0]], bound))
    u = np.random.default_rng(2).standard_normal((T, 1))
    over = np.linalg.norm(2 * rows[0] @ u[:, 0]) - limit
    x = lfo.simulate(given, u).x
    assert given.value(x, u) - problem(None).value(x, u) == pytest.approx(PRICE * over)


@pytest.mark.parametrize("window", [None, "hann"])
def test_at_every_frequency_the_price_is_for_the_largest_relative_excess(window):
    bound = lfo.MagnitudeBound(LIMIT, band=LOW, window=window, every_frequency=True, penalty=PRICE)
    given, u = problem(bound), np.random.default_rng(3).standard_normal((T, 1))
    weights = np.ones(T) if window is None else get_window(window, T, fftbins=False)
    w = np.linspace(CUTOFF, np.pi, 20_001)
    largest = np.abs(np.exp(-1j * np.outer(w, np.arange(T))) @ (weights * u[:, 0])).max()
    x = lfo.simulate(given, u).x
    assert given.value(x, u) - problem(None).value(x, u) == pytest.approx(PRICE * (largest / LIMIT - 1), rel=1e-6)
