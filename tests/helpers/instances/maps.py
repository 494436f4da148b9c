"""Affine maps of random data, of every class, and their values by the definition."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import singledispatch

import numpy as np

from helpers.own_kinds import Changes
from lin_freq_ocp.problem import (
    AffineMap,
    FrequencyMap,
    JoinedMap,
    SpectrumMap,
    StageMap,
    SumMap,
    VibrationMap,
    ZeroOrderHoldMap,
)

N, M = 3, 2
DIM = 4


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


def sum_map(rng: np.random.Generator, T: int) -> SumMap:
    Phi, Psi = some(rng, rng.standard_normal((T + 1, DIM, N)), rng.standard_normal((T, DIM, M)))
    parts = [
        StageMap(np.arange(len(one)), *pair, np.zeros(DIM))
        for one, pair in ((Phi, (Phi, None)), (Psi, (None, Psi)))
        if one is not None
    ]
    return SumMap(tuple(parts), rng.standard_normal(DIM))


def both_ends(rng: np.random.Generator, T: int) -> SumMap:
    """Return equations on both ends, as linked ends have them."""
    stages = [StageMap(np.array([t]), rng.standard_normal((DIM, N)), None, np.zeros(DIM)) for t in (0, T)]
    return SumMap(tuple(stages), rng.standard_normal(DIM))


def spectrum_map(rng: np.random.Generator, T: int, joint: bool = False) -> SpectrumMap:
    C, D = some(rng, rng.standard_normal(N), rng.standard_normal(M))
    samples = T + (D is None)
    points = samples * int(rng.choice([1, 2, 5]))
    bins = np.sort(rng.choice(points // 2 + 1, size=int(rng.integers(1, points // 2 + 2)), replace=False))
    window = rng.standard_normal(samples) if rng.random() < 0.5 else np.ones(samples)
    return SpectrumMap(C, D, window, points, bins, joint)


def windowed_map(rng: np.random.Generator, T: int, joint: bool = False) -> SpectrumMap:
    frame = spectrum_map(rng, int(rng.integers(1, T + 1)), joint)
    length, samples, past = frame.samples, frame.length(T), rng.standard_normal(int(rng.integers(0, 8)))
    starts = np.arange(-min(len(past), length - 1), samples - length + 1, int(rng.integers(1, 4)))
    if rng.random() < 0.3:
        starts = starts[:1]
    return replace(frame, starts=starts, past=past)


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


def own_map(rng: np.random.Generator, T: int) -> Changes:
    return Changes(T, rng.standard_normal(M))


MAPS: dict[str, Callable[[np.random.Generator, int], AffineMap]] = {
    "stages": stage_map,
    "sum": sum_map,
    "both ends": both_ends,
    "spectrum": spectrum_map,
    "joint spectrum": lambda rng, T: spectrum_map(rng, T, joint=True),
    "windows": windowed_map,
    "joined": lambda rng, T: JoinedMap((stage_map(rng, T), spectrum_map(rng, T), both_ends(rng, T))),
    "joint windows": lambda rng, T: windowed_map(rng, T, joint=True),
    "frequencies": frequency_map,
    "zero-order hold": held_map,
    "vibrations": vibration_map,
    "of a user": own_map,
}


@singledispatch
def plain_values(one: AffineMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the values by the definition, one sum after the other."""
    raise NotImplementedError(type(one))


@plain_values.register
def _(one: StageMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    v = np.array(np.broadcast_to(one.constant, one.shape))
    for matrix, signal in ((one.C, x), (one.D, u)):
        for g, t in enumerate(one.times if matrix is not None else ()):
            v[g] += (matrix if matrix.ndim == 2 else matrix[g]) @ signal[t]
    return v


@plain_values.register
def _(one: SumMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return one.constant + sum(plain_values(stage, x, u).sum(0) for stage in one.stages)[None]


@plain_values.register
def _(one: JoinedMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.concatenate([plain_values(part, x, u).ravel() for part in one.parts])[None]


@plain_values.register
def _(one: SpectrumMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    whole = np.append(one.past, plain_signal(one, x, u, one.length(len(u))))
    cut = [whole[len(one.past) + s :][: one.samples] for s in one.starts]
    return np.concatenate([plain_spectrum(one, y, s) for y, s in zip(cut, one.starts, strict=True)])


@plain_values.register
def _(one: FrequencyMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    values = plain_waves(one) @ (one.window * plain_signal(one, x, u, one.samples))
    return np.column_stack([values.real, values.imag])


@plain_values.register
def _(one: Changes, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.array([one.size * (u[t + 1] - u[t]) for t in range(one.steps - 1)]).reshape(one.shape)


def plain_waves(one: FrequencyMap) -> np.ndarray:
    t = np.arange(one.samples)
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
