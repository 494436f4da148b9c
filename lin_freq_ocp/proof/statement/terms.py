"""Terms h(L v) as lines: one for each group of values with a limit; of half-spaces, one for each value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.terms.semi_infinite import Continuum, Frequencies
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.proof.lines import encoded, line
from lin_freq_ocp.proof.statement.functions import function_of
from lin_freq_ocp.proof.statement.values import Sizes, signal_text, written_multipliers, written_values


def term_lines(terms: Sequence[Term], sizes: Sizes) -> Iterator[str]:
    """Yield the lines of all terms; UnsupportedError, naming the field, if the format does not hold one."""
    first = 0
    for term in terms:
        try:
            for index, text in enumerate(_lines(term, sizes), first):
                yield f'{{"term": {index}, {text}}}\n'
                first = index + 1
        except UnsupportedError as error:
            where = "problem" if term.source is None else term.source[0]
            raise UnsupportedError(f"{where}: got {term.name!r}; a proof cannot state {error}.") from None


def multiplier_lines(terms: Sequence[Term], weights: Sequence[Array]) -> Iterator[str]:
    """Yield the multipliers of all terms, (groups, dim) each, that are not zero."""
    first = 0
    for term, given in zip(terms, weights, strict=True):
        if term.everywhere is not None:
            places = term.map.frequencies.tolist()
            for w, pair in zip(places, given, strict=True):
                if pair.any():
                    yield line(multiplier=first, frequency=w, values=pair)
            first += 1
            continue
        written, function = written_multipliers(term.map, given), function_of(term.penalty, term.shape)
        limited = np.isfinite(function.limits)
        units = written[limited][:, None] if function.by_value else written[limited[:, 0]]
        for index, values in enumerate(units, first):
            if values.any():
                yield line(multiplier=index, values=values)
        first += len(units)


def _lines(term: Term, sizes: Sizes) -> Iterator[str]:
    """Yield the fields of each line of a term."""
    if term.everywhere is not None:
        yield _everywhere(term.name, term.everywhere, sizes)
        return
    function = function_of(term.penalty, term.shape)
    head = f'"name": {encoded(term.name)}, "gauge": "{function.gauge}"'
    if function.by_value and term.map.dense_size[0]:
        raise UnsupportedError("half-spaces of a spectrum")
    limits, weights = function.limits.tolist(), function.weights.tolist()
    for values, limit, weight in zip(written_values(term.map, sizes), limits, weights, strict=True):
        units = values if function.by_value else [", ".join(values)]
        for text, most, price in zip(units, limit, weight, strict=True):
            if np.isfinite(most):
                yield f'{head}, "limit": "{most.hex()}", "weight": "{price.hex()}", "values": [{text}]'


def _everywhere(name: str, everywhere: Continuum, sizes: Sizes) -> str:
    """Return the fields of a mask over all frequencies."""
    if type(everywhere) is not Frequencies:
        raise UnsupportedError("the spectrum of a held signal, or a residual vibration")
    limits = everywhere.limits
    table = np.column_stack([limits.low, limits.high, limits.at_low, limits.at_high])
    head = f'"name": {encoded(name)}, "gauge": "all", "weight": {encoded(float(everywhere.price))}'
    return f'{head}, {signal_text(everywhere.map, 0, sizes)}, "limits": {encoded(table)}'
