"""Maps of a trajectory against plain sums and their adjoints; what the terms of a problem cost, by plain formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lin_freq_ocp as lfo
from helpers.seeds import examples
from lin_freq_ocp.problem import (
    AffineMap,
    FrequencyMap,
    HalfSpaces,
    SpectrogramMap,
    SpectrumMap,
    StageMap,
    SumMap,
    Term,
    TermKind,
    VibrationMap,
    ZeroOrderHoldMap,
)

N, M = 3, 2
DIM = 4
SEEDS = st.integers(0, 2**32 - 1)
quick = settings(max_examples=examples(60), deadline=None, derandomize=True)


def signals(rng: np.random.Generator, T: int) -> tuple[np.ndarray, np.ndarray]:
    return rng.standard_normal((T + 1, N)), rng.standard_normal((T, M))


def some(rng: np.random.Generator, *arrays: np.ndarray) -> list[np.ndarray | None]:
    """Return the arrays, of two perhaps without one of them."""
    left_out = int(rng.integers(3))
    return [None if i == left_out else array for i, array in enumerate(arrays)]


def stage_map(rng: np.random.Generator, T: int) -> StageMap:
    per_time = rng.random() < 0.5
    C, D = some(rng, rng.standard_normal((DIM, N)), rng.standard_normal((DIM, M)))
    times = np.sort(rng.choice(T + (D is None), size=int(rng.integers(1, T + 1)), replace=False))
    if per_time:
        C, D = (None if part is None else part * rng.standard_normal((len(times), 1, 1)) for part in (C, D))
    return StageMap(times, C, D, rng.standard_normal((len(times), DIM) if per_time else DIM))


def spectrum_map(rng: np.random.Generator, T: int, joint: bool = False) -> SpectrumMap:
    C, D = some(rng, rng.standard_normal(N), rng.standard_normal(M))
    samples = T + (D is None)
    points = samples * int(rng.choice([1, 2, 5]))
    bins = np.sort(rng.choice(points // 2 + 1, size=int(rng.integers(1, points // 2 + 2)), replace=False))
    window = rng.standard_normal(samples) if rng.random() < 0.5 else np.ones(samples)
    return SpectrumMap(C, D, window, points, bins, joint)


def joint_map(rng: np.random.Generator, T: int) -> SpectrumMap:
    return spectrum_map(rng, T, joint=True)


def sum_map(rng: np.random.Generator, T: int) -> SumMap:
    Phi, Psi = some(rng, rng.standard_normal((T + 1, DIM, N)), rng.standard_normal((T, DIM, M)))
    parts = [
        StageMap(np.arange(len(one)), *pair, np.zeros(DIM))
        for one, pair in ((Phi, (Phi, None)), (Psi, (None, Psi)))
        if one is not None
    ]
    return SumMap(tuple(parts), rng.standard_normal(DIM))


def spectrogram_map(rng: np.random.Generator, T: int, joint: bool = False) -> SpectrogramMap:
    frame = spectrum_map(rng, int(rng.integers(1, T + 1)), joint)
    length, samples, past = frame.samples, frame.length(T), rng.standard_normal(int(rng.integers(0, 8)))
    starts = np.arange(-min(len(past), length - 1), samples - length + 1, int(rng.integers(1, 4)))
    return SpectrogramMap(frame, starts, past)


def joint_windows(rng: np.random.Generator, T: int) -> SpectrogramMap:
    return spectrogram_map(rng, T, joint=True)


def frequency_map(rng: np.random.Generator, T: int) -> FrequencyMap:
    bins = spectrum_map(rng, T)
    at = np.append(rng.uniform(0, np.pi, int(rng.integers(1, 6))), rng.choice([0.0, np.pi]))
    return FrequencyMap(bins.C, bins.D, bins.window, at)


def held_map(rng: np.random.Generator, T: int) -> ZeroOrderHoldMap:
    bins = spectrum_map(rng, T)
    at = np.append(rng.uniform(0, 20, int(rng.integers(1, 6))), rng.choice([0.0, np.pi]))
    return ZeroOrderHoldMap(bins.C, bins.D, bins.window, at)


def vibration_map(rng: np.random.Generator, T: int) -> VibrationMap:
    bins, count = spectrum_map(rng, T), int(rng.integers(1, 6))
    return VibrationMap(bins.C, bins.D, bins.window, rng.uniform([0.1, 0], [40, 0.9], (count, 2)), 0.01)


MAPS = (stage_map, sum_map, spectrum_map, joint_map, spectrogram_map, joint_windows)
MAPS += (frequency_map, held_map, vibration_map)


def plain_values(one: AffineMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the values by the definition, one sum after the other."""
    if isinstance(one, SumMap):
        return one.constant + sum(plain_values(stage, x, u).sum(0) for stage in one.stages)[None]
    if isinstance(one, StageMap):
        v = np.array(np.broadcast_to(one.constant, one.shape))
        for matrix, signal in ((one.C, x), (one.D, u)):
            for g, t in enumerate(one.times if matrix is not None else ()):
                v[g] += (matrix if matrix.ndim == 2 else matrix[g]) @ signal[t]
        return v
    if isinstance(one, SpectrogramMap):
        frame = one.spectrum
        whole = np.append(one.past, plain_signal(frame, x, u, frame.length(len(u))))
        cut = [whole[len(one.past) + s :][: frame.samples] for s in one.starts]
        return np.concatenate([plain_spectrum(frame, y, s) for y, s in zip(cut, one.starts, strict=True)])
    y = plain_signal(one, x, u, len(one.window))
    if isinstance(one, FrequencyMap):
        values = plain_waves(one) @ (one.window * y)
        return np.column_stack([values.real, values.imag])
    return plain_spectrum(one, y)


def plain_waves(one: FrequencyMap) -> np.ndarray:
    t = np.arange(len(one.window))
    if isinstance(one, VibrationMap):
        root = np.sqrt(1 - one.at[:, 1] ** 2)
        z = np.exp(2 * np.pi * one.at[:, 0] * (-one.at[:, 1] + 1j * root) * one.sampling_time)
        return ((z - 1) / root)[:, None] * z[:, None] ** t[::-1]
    waves = np.exp(-1j * np.outer(one.at, t))
    return np.sinc(one.at / (2 * np.pi))[:, None] * waves if isinstance(one, ZeroOrderHoldMap) else waves


def plain_signal(one: SpectrumMap | FrequencyMap, x: np.ndarray, u: np.ndarray, samples: int) -> np.ndarray:
    y = np.zeros(samples)
    for row, signal in ((one.C, x), (one.D, u)):
        y += 0 if row is None else signal[:samples] @ row
    return y


def plain_spectrum(one: SpectrumMap, y: np.ndarray, first: int = 0) -> np.ndarray:
    waves = np.exp(-2j * np.pi * np.outer(one.bins, first + np.arange(len(y))) / one.points)
    spectrum = waves @ (one.window * y)
    if not one.joint:
        return np.column_stack([spectrum.real, spectrum.imag])
    real_only = (one.bins == 0) | (2 * one.bins == one.points)
    pairs = [
        [value.real] if real else [value.real, value.imag] for value, real in zip(spectrum, real_only, strict=True)
    ]
    return np.concatenate(pairs)[None]


@given(SEEDS)
@quick
def test_a_term_of_a_batch_is_that_of_every_trajectory(seed):
    rng = np.random.default_rng(seed)
    T, count = int(rng.integers(1, 8)), 3
    one = stage_map(rng, T)
    limits, weights = rng.standard_normal(one.shape), rng.uniform(0.1, 1.0, one.shape)
    penalty = HalfSpaces(limits if rng.random() < 0.5 else limits[0], weights if rng.random() < 0.5 else np.ones(()))
    term, parts = Term("rows", TermKind.STAGE_ROWS, one, penalty), [signals(rng, T) for _ in range(count)]
    x, u = (np.stack(part) for part in zip(*parts, strict=True))
    prices, shapes = rng.standard_normal((count, *one.shape)), (x.shape, u.shape)
    assert term.takes_batches
    np.testing.assert_allclose(term.map.values(x, u), [one.values(*part) for part in parts])
    np.testing.assert_allclose(term.cost(x, u), [term.cost(*part) for part in parts], atol=1e-14)
    pulled = zip(*(one.pull_back(price, (x[0].shape, u[0].shape)) for price in prices), strict=True)
    for found, expected in zip(one.pull_back(prices, shapes), pulled, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-14)
    assert not Term("sum", TermKind.STAGE_ROWS, sum_map(rng, T), penalty).takes_batches


@pytest.mark.parametrize("make", MAPS)
@given(seed=SEEDS, T=st.integers(1, 12))
@quick
def test_values_are_those_of_the_definition(make, seed, T):
    rng = np.random.default_rng(seed)
    one, (x, u) = make(rng, T), signals(rng, T)
    v = one.values(x, u)
    assert v.shape == one.shape
    np.testing.assert_allclose(v, plain_values(one, x, u), atol=1e-11)


@pytest.mark.parametrize("make", MAPS)
@given(seed=SEEDS, T=st.integers(1, 12))
@quick
def test_pull_back_is_the_adjoint_of_values(make, seed, T):
    rng = np.random.default_rng(seed)
    one, (x, u) = make(rng, T), signals(rng, T)
    multipliers = rng.standard_normal(one.shape)
    of_x, of_u = one.pull_back(multipliers, (x.shape, u.shape))
    assert (of_x.shape, of_u.shape) == (x.shape, u.shape)
    change = one.values(x, u) - one.values(np.zeros_like(x), np.zeros_like(u))
    assert (multipliers * change).sum() == pytest.approx((of_x * x).sum() + (of_u * u).sum(), abs=1e-10)


@pytest.mark.parametrize("make", MAPS)
@given(seed=SEEDS, T=st.integers(1, 12))
@quick
def test_sizes_bound_the_absolute_values(make, seed, T):
    rng = np.random.default_rng(seed)
    one, (x, u) = make(rng, T), signals(rng, T)
    if isinstance(one, (SpectrumMap, SpectrogramMap, FrequencyMap)):  # the norm of the signal
        bound = one.sizes(x, u) * np.sqrt(one.spectrum.samples if isinstance(one, SpectrogramMap) else one.samples)
    else:
        bound = one.sizes(x, u)
    assert (np.abs(one.values(x, u)) <= bound * (1 + 1e-12)).all()
    multipliers = rng.standard_normal(one.shape)
    shapes = x.shape, u.shape
    for pulled, size in zip(one.pull_back(multipliers, shapes), one.pulled_sizes(multipliers, shapes), strict=True):
        assert (np.abs(pulled) <= size * (1 + 1e-12) + 1e-12).all()


@pytest.mark.parametrize("make", MAPS)
@given(seed=SEEDS, T=st.integers(1, 12))
@quick
def test_rows_are_the_map_as_a_matrix(make, seed, T):
    rng = np.random.default_rng(seed)
    one, (x, u) = make(rng, T), signals(rng, T)
    matrix, constant = one.rows(T, N, M)
    values = matrix @ np.concatenate([x.ravel(), u.ravel()]) + constant
    np.testing.assert_allclose(values.reshape(one.shape), one.values(x, u), atol=1e-11)


@given(seed=SEEDS, T=st.integers(1, 12), joint=st.booleans())
@quick
def test_a_single_window_is_a_spectrum_of_the_horizon_plus_a_constant(seed, T, joint):
    rng = np.random.default_rng(seed)
    several, (x, u) = spectrogram_map(rng, T, joint), signals(rng, T)
    one = SpectrogramMap(several.spectrum, several.starts[:1], several.past)
    form, frame = one.spectrum_form(N, M), one.spectrum
    assert form is not None or several.starts[0] + frame.samples > frame.points
    if form is not None:
        later = SpectrumMap(frame.C, frame.D, form.window, form.points, form.bins, joint)
        constant = one.values(np.zeros_like(x), np.zeros_like(u))
        np.testing.assert_allclose(one.values(x, u), later.values(x, u) + constant, atol=1e-11)


@pytest.mark.parametrize("make", MAPS)
def test_extended_precision_stays(make):
    rng = np.random.default_rng(0)
    one = make(rng, 9)
    x, u = (signal.astype(np.longdouble) for signal in signals(rng, 9))
    assert one.values(x, u).dtype == np.longdouble
    pulled = one.pull_back(np.ones(one.shape, dtype=np.longdouble), (x.shape, u.shape))
    assert all(part.dtype == np.longdouble for part in pulled)


# --- the terms of a problem -----------------------------------------------------------------------------------------


def value(T: int = 8, **fields) -> tuple[np.ndarray, np.ndarray, float]:
    """Return a random trajectory of a problem without quadratic cost, and J."""
    rng = np.random.default_rng(3)
    dynamics = lfo.LinearDynamics(np.eye(N), rng.standard_normal((N, M)))
    problem = lfo.OptimalControlProblem(dynamics, T, **({"cost": lfo.QuadraticCost()} | fields))
    x, u = signals(rng, T)
    return x, u, problem.value(x, u)


def test_costs_of_norms_by_their_formulas():
    weights, reference = np.array([1.0, 0.0, 2.0]), np.linspace(-1, 1, 27).reshape(9, 3)
    x, u, cost = value(cost=lfo.costs.L1Cost(x=weights, u=0.5, terminal=3.0, x_ref=reference, u_ref=[1, 2]))
    stages = (weights * np.abs(x - reference)[:-1]).sum() + 0.5 * np.abs(u - [1, 2]).sum()
    assert cost == pytest.approx(stages + 3 * np.abs(x - reference)[-1].sum())
    x, u, cost = value(cost=lfo.costs.LInfCost(x=weights, u=0.5, terminal=3.0, x_ref=reference, u_ref=[1, 2]))
    stages = (weights * np.abs(x - reference)[:-1]).max(1).sum() + 0.5 * np.abs(u - [1, 2]).max(1).sum()
    assert cost == pytest.approx(stages + 3 * np.abs(x - reference)[-1].max())


def test_the_sum_of_a_list_of_costs_is_a_cost():
    costs = [
        lfo.QuadraticCost(R=2.0),
        lfo.costs.L1Cost(u=0.5),
        lfo.costs.LInfCost(x=3.0),
        lfo.costs.L1Cost(terminal=1.0) + lfo.costs.LInfCost(u=1.0),
    ]
    for some in (costs, costs[::-1], costs[3:], costs[1:2], costs[:1]):
        _, _, together = value(cost=sum(some))
        assert together == pytest.approx(sum(value(cost=one)[2] for one in some), rel=1e-12)


@pytest.mark.parametrize("start", [None, [1.0, 2.0, 0.0]])
def test_soft_sets_count_at_all_times_that_of_a_fixed_state_too(start):
    x, _, cost = value(state_set=lfo.sets.Soft(lfo.sets.Ball(0.5, 1.0), 2.0), initial_state=start)
    assert cost == pytest.approx(2 * np.maximum(np.linalg.norm(x - 1, axis=1) - 0.5, 0).sum())
    _, u, cost = value(control_set=lfo.sets.Soft(lfo.Box([None, -0.3], 0.2), 2.0))
    assert cost == pytest.approx(2 * (np.maximum(u - 0.2, 0).sum() + np.maximum(-0.3 - u[:, 1], 0).sum()))
    x, _, cost = value(terminal_state=lfo.sets.Soft(lfo.sets.Polyhedron([[1, 1, 1]], [-5]), 2.0), initial_state=start)
    assert cost == pytest.approx(2 * max(x[-1].sum() + 5, 0))


def test_the_optimum_where_a_fixed_state_lies_outside_a_soft_set():
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 3, lfo.QuadraticCost(R=1.0), [lfo.Box(-0.5, 0.5)] * 3,
        state_set=lfo.sets.Soft(lfo.Box(-1, 1), 10.0), initial_state=[3.0],
    )  # fmt: skip
    result = lfo.solve(problem)
    np.testing.assert_allclose(result.control[:, 0], [-0.5, -0.5, -0.5], atol=1e-7)
    assert result.cost == pytest.approx(3 * 0.125 + 10 * (2 + 1.5 + 1 + 0.5))


def test_soft_frequency_constraints_by_their_formulas():
    x, u, cost = value(
        control_spectrum=lfo.MagnitudeBound([0.5, 1.5, np.inf], bins=[0, 2, 4], component=1, penalty=2.0)
    )
    assert cost == pytest.approx(2 * np.maximum(np.abs(np.fft.rfft(u[:, 1]))[[0, 2]] - [0.5, 1.5], 0).sum())
    window = np.hanning(9)
    bound = lfo.spectrum.EnergyBound(0.4, bins=[1, 3], component=0, penalty=2.0, window=window, oversampling=4)
    x, u, cost = value(state_spectrum=bound)
    energy = (np.abs(np.fft.rfft(window * x[:, 0], 36))[[4, 12]] ** 2).sum() / 4
    assert cost == pytest.approx(2 * max(np.sqrt(energy) - np.sqrt(0.4), 0))
