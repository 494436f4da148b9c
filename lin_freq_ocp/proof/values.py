"""The values L v of a term in the format, and multipliers of them: by rows, or by the spectrum of an output.

Of a bin the format has (Re, Im), where a map may leave out an Im that is zero for every signal, or count the phase from
another time: ``written_multipliers`` says the same in the format's values.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import singledispatch

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.terms.frequency_map import FrequencyMap
from lin_freq_ocp.problem.terms.maps import AffineMap
from lin_freq_ocp.problem.terms.spectrogram_map import SpectrogramMap
from lin_freq_ocp.problem.terms.spectrum_map import SpectrumMap
from lin_freq_ocp.proof.lines import Text, encoded

Sizes = tuple[int, int, int]  # T, n, m


@singledispatch
def written_values(values: AffineMap, sizes: Sizes) -> Iterator[Text]:
    """Yield the list of values of each group."""
    matrix, constant = values.rows(*sizes)
    T, n, m = sizes
    columns, starts = matrix.indices.astype(int), matrix.indptr.tolist()
    of_x = columns < (T + 1) * n
    place = np.where(of_x, columns, columns - (T + 1) * n)
    width = np.where(of_x, n, m)
    numbers = zip((place // width).tolist(), (place % width).tolist(), matrix.data.tolist(), strict=True)
    entries = [f'[{t}, {i}, "{value.hex()}"]' for t, i, value in numbers]
    on_x, (groups, dim) = of_x.tolist(), values.shape
    constants = constant.tolist()
    for group in range(groups):
        texts = [
            _row(entries[a:b], on_x[a:b], constants[row])
            for row, a, b in ((row, starts[row], starts[row + 1]) for row in range(group * dim, (group + 1) * dim))
        ]
        yield Text(f"[{', '.join(texts)}]")


def _row(entries: list[str], on_x: list[bool], constant: float) -> str:
    parts = [
        f'"{signal}": [{", ".join(entry for entry, of_x in zip(entries, on_x, strict=True) if of_x == wanted)}]'
        for signal, wanted in (("x", True), ("u", False))
        if wanted in on_x
    ]
    if constant:
        parts.append(f'"constant": "{constant.hex()}"')
    return "{" + ", ".join(parts) + "}"


@written_values.register
def _spectrum(values: SpectrumMap, sizes: Sizes) -> Iterator[Text]:
    output = signal_text(values, 0, sizes)
    bins = [bin_text(output, k, values.points) for k in values.bins.tolist()]
    if values.together:
        yield Text(f"[{', '.join(bins)}]")
    else:
        yield from (Text(f"[{one}]") for one in bins)


@written_values.register
def _spectrogram(values: SpectrogramMap, sizes: Sizes) -> Iterator[Text]:
    if (values.starts < 0).any():
        raise UnsupportedError("a spectrogram of samples before time 0")
    base = values.spectrum
    for start in values.starts.tolist():
        output = signal_text(base, start, sizes)
        bins = [bin_text(output, k, base.points) for k in base.bins.tolist()]
        if base.together:
            yield Text(f"[{', '.join(bins)}]")
        else:
            yield from (Text(f"[{one}]") for one in bins)


@written_values.register
def _frequencies(values: FrequencyMap, sizes: Sizes) -> Iterator[Text]:
    if type(values) is not FrequencyMap:
        raise UnsupportedError(f"a {type(values).__name__}")
    output = signal_text(values, 0, sizes)
    for w in values.at.tolist():
        yield Text(f'[{{{output}, "frequency": {encoded(w)}}}]')


def signal_text(values: SpectrumMap | FrequencyMap, first: int, sizes: Sizes) -> str:
    """Return the fields "output", "first" and "window" of a spectrum."""
    _, n, m = sizes
    of_x = np.zeros(n) if values.C is None else values.C
    of_u = np.zeros(m) if values.D is None else values.D
    plain = bool((values.window == 1.0).all())
    window = json.dumps(len(values.window)) if plain else encoded(values.window)
    return f'"output": {encoded(np.concatenate([of_x, of_u]))}, "first": {first}, "window": {window}'


def bin_text(signal: str, k: int, points: int) -> str:
    """Return the values of one bin."""
    return f'{{{signal}, "frequency": [{k}, {points}]}}'


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
