"""The values L v of a term in the format, and multipliers of them: by rows, or by the spectrum of an output.

Of a bin the format has (Re, Im), where a map may leave out an Im that is zero for every signal, or count the phase from
another time: ``written_multipliers`` says the same in the format's values.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import singledispatch

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.terms.maps import AffineMap
from lin_freq_ocp.problem.terms.spectrum_maps import FrequencyMap, SpectrogramMap, SpectrumMap
from lin_freq_ocp.proof.lines import encoded

Sizes = tuple[int, int, int]  # T, n, m


@singledispatch
def written_values(values: AffineMap, sizes: Sizes) -> Iterator[list[str]]:
    """Yield the values of each group."""
    matrix, constant = values.rows(*sizes)
    T, n, m = sizes
    columns, starts = matrix.indices.astype(int), matrix.indptr.tolist()
    of_x = columns < (T + 1) * n
    place = np.where(of_x, columns, columns - (T + 1) * n)
    width = np.where(of_x, n, m)
    component = place % width + np.where(of_x, 0, n)
    numbers = zip((place // width).tolist(), component.tolist(), matrix.data.tolist(), strict=True)
    entries = [f'[{t}, {i}, "{value.hex()}"]' for t, i, value in numbers]
    constants, (groups, dim) = constant.tolist(), values.shape
    for group in range(groups):
        yield [
            f'{{"row": [{", ".join(entries[starts[row] : starts[row + 1]])}], "constant": "{constants[row].hex()}"}}'
            for row in range(group * dim, (group + 1) * dim)
        ]


@written_values.register
def _spectrum(values: SpectrumMap, sizes: Sizes) -> Iterator[list[str]]:
    yield from _of_window(values, 0, sizes)


@written_values.register
def _spectrogram(values: SpectrogramMap, sizes: Sizes) -> Iterator[list[str]]:
    if (values.starts < 0).any():
        raise UnsupportedError("a spectrogram of samples before time 0")
    for start in values.starts.tolist():
        yield from _of_window(values.spectrum, start, sizes)


def _of_window(values: SpectrumMap, start: int, sizes: Sizes) -> Iterator[list[str]]:
    """Yield the bins of each group, of samples from a time on."""
    signal = signal_text(values, start, sizes)
    bins = [f'{{{signal}, "frequency": [{k}, {values.points}]}}' for k in values.bins.tolist()]
    if values.together:
        yield bins
    else:
        yield from ([one] for one in bins)


@written_values.register
def _frequencies(values: FrequencyMap, sizes: Sizes) -> Iterator[list[str]]:
    if type(values) is not FrequencyMap:
        raise UnsupportedError(f"a {type(values).__name__}")
    signal = signal_text(values, 0, sizes)
    for w in values.at.tolist():
        yield [f'{{{signal}, "frequency": {encoded(w)}}}']


def signal_text(values: SpectrumMap | FrequencyMap, first: int, sizes: Sizes) -> str:
    """Return the fields "output", "first" and "window" of a spectrum."""
    _, n, m = sizes
    of_x = np.zeros(n) if values.C is None else values.C
    of_u = np.zeros(m) if values.D is None else values.D
    plain = bool((values.window == 1.0).all())
    window = json.dumps(len(values.window)) if plain else encoded(values.window)
    return f'"output": {encoded(np.concatenate([of_x, of_u]))}, "first": {first}, "window": {window}'


@singledispatch
def written_multipliers(values: AffineMap, weights: Array) -> Array:
    """Return multipliers of the written values, (groups, values), from those of the map, (groups, dim)."""
    return weights


@written_multipliers.register
def _of_spectrum(values: SpectrumMap, weights: Array) -> Array:
    return values.pairs(weights).reshape(len(weights), -1)


@written_multipliers.register
def _of_spectrogram(values: SpectrogramMap, weights: Array) -> Array:
    base, pairs = values.spectrum, values.pairs(weights).reshape(len(values.starts), -1, 2)
    angles = 2 * np.pi * (np.outer(values.starts, base.bins) % base.points) / base.points
    turned = (pairs[..., 0] + 1j * pairs[..., 1]) * np.exp(1j * angles)
    return np.stack([turned.real, turned.imag], axis=-1).reshape(len(weights), -1)
