"""Terms h(L v) as lines: the function, and the values of each group that has a limit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.terms.continuum import Continuum, Frequencies
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.proof.functions import function_of
from lin_freq_ocp.proof.lines import encoded, line
from lin_freq_ocp.proof.values import Sizes, signal_text, written_values


def term_lines(terms: Sequence[Term], sizes: Sizes) -> Iterator[str]:
    """Yield the lines of all terms; UnsupportedError, naming the field, if the format does not hold one."""
    for index, term in enumerate(terms):
        try:
            yield from _lines(index, term, sizes)
        except UnsupportedError as error:
            where = "problem" if term.source is None else term.source[0]
            raise UnsupportedError(f"{where}: got {term.name!r}; a proof cannot state {error}.") from None


def _lines(index: int, term: Term, sizes: Sizes) -> Iterator[str]:
    """Yield the line of a term and those of its groups."""
    if term.everywhere is not None:
        yield _everywhere_line(index, term.name, term.everywhere, sizes)
        return
    function = function_of(term.penalty, term.shape)
    yield line(term=index, name=term.name, function=function.name, **function.common)
    number = 0
    for group, values in enumerate(written_values(term.map, sizes)):
        if function.kept[group]:
            yield line(group=number, values=values, **function.of_group(group))
            number += 1


def _everywhere_line(index: int, name: str, everywhere: Continuum, sizes: Sizes) -> str:
    """Return the line of a mask over all frequencies."""
    if type(everywhere) is not Frequencies:
        raise UnsupportedError("the spectrum of a held signal, or a residual vibration")
    limits = everywhere.limits
    table = np.column_stack([limits.low, limits.high, limits.at_low, limits.at_high])
    head = line(term=index, name=name, function="everywhere", weight=float(everywhere.price))
    return f'{head[:-2]}, {signal_text(everywhere.map, 0, sizes)}, "limits": {encoded(table)}}}\n'
