"""Numbers, vectors, matrices, inequalities and small tables as text for people, from which descriptions are made."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from math import isfinite

import numpy as np

from lin_freq_ocp.base.arrays import NO_BOUND, Array, ComplexArray, Indices

NAME_WITH_UNIT = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\[\]]*)\]\s*")
SMALL, LARGE = 1e-3, 1e6  # numbers outside this range are written with a power of ten
NOTHING = "\N{EN DASH}"  # in place of a missing number
AT_MOST, AT_LEAST = "\N{LESS-THAN OR EQUAL TO}", "\N{GREATER-THAN OR EQUAL TO}"
MOST_ENTRIES, MOST_ROWS, MOST_TEXT = 6, 3, 150  # a longer vector, more rows or a longer text is described by its size


def number(value: float | None, digits: int = 5) -> str:
    """Return a number with at most so many significant digits; a small one is never shown as zero."""
    if value is None:
        return NOTHING
    if not isfinite(value):
        return str(value)
    size, value = abs(value), value + 0.0  # of a negative zero, zero
    if size != 0 and (size < SMALL or size >= LARGE):
        return power(value)
    return f"{value:.0f}" if size >= 10 ** (digits - 1) else f"{value:.{digits}g}"


def power(value: float) -> str:
    """Return a number with two digits and a power of ten."""
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def split_unit(name: str) -> tuple[str, str]:
    """Split ``"position [m]"`` into ``("position", "m")``; without a unit the second is empty."""
    match = NAME_WITH_UNIT.fullmatch(name)
    return (match["name"], match["unit"]) if match else (name, "")


def short_name(name: str) -> str:
    """Return the name of a component without its unit; capitals stay, as V is not v."""
    return split_unit(name)[0]


def join_words(parts: Sequence[str]) -> str:
    """Return "a", "a and b", or "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def first_few(parts: Sequence[str], most: int = MOST_ENTRIES) -> str:
    """Return the first parts as a list, and the number of the others."""
    return join_words(parts) if len(parts) <= most else f"{', '.join(parts[:most])} and {len(parts) - most} more"


def plural(count: int, noun: str) -> str:
    """Return "1 bin" or "24 bins"."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


def count_all(values: Iterable[object]) -> str:
    """Return "97 optimal, 3 infeasible", the most frequent value first."""
    return ", ".join(f"{count} {value}" for value, count in Counter(map(str, values)).most_common()) or "none"


def ordinal(count: int) -> str:
    """Return "1st", "2nd", "3rd", "11th" or "25th"."""
    ending = "th" if count % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(count % 10, "th")
    return f"{count}{ending}"


def runs_in_words(runs: Sequence[tuple[int, int]]) -> str:
    """Return runs of whole numbers as "3, 7 to 9 and 12"."""
    return first_few([f"{first}" if first == last else f"{first} to {last}" for first, last in runs])


def runs_of(numbers: Array | Indices) -> list[tuple[int, int]]:
    """Return (first, last) of every run of neighbours among different whole numbers in ascending order."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    return [(int(run[0]), int(run[-1])) for run in runs if len(run)]


def vector(values: Array) -> str:
    """Return "(1, 0.5)"; the entry, if all are equal; the number of entries and their range, if there are many."""
    if values.ndim == 0:
        return number(float(values))
    if len(values) > 1 and (values == values[0]).all():
        return number(float(values[0])) + " in every component"
    if len(values) > MOST_ENTRIES:
        return f"{len(values)} numbers{span(values)}"
    return f"({', '.join(number(float(value)) for value in values)})"


def matrix(values: Array) -> str:
    """Return "2", "2 I", "diag(1, 2)", "[1 2; 3 4]", or the size of a larger one."""
    square = values.shape[0] == values.shape[1]
    diagonal = np.diagonal(values)
    if square and not (values - np.diag(diagonal)).any() and values.any():
        if (diagonal == diagonal[0]).all():
            value = number(float(diagonal[0]))
            return value if len(values) == 1 else "I" if value == "1" else f"{value} I"
        if len(diagonal) <= MOST_ENTRIES:
            return f"diag({', '.join(number(float(value)) for value in diagonal)})"
        return f"a diagonal of {len(diagonal)} numbers{span(diagonal)}"
    if values.size <= MOST_ENTRIES:
        return f"[{'; '.join(' '.join(number(float(one), 4) for one in row) for row in values)}]"
    return f"a matrix of {values.shape[0]} by {values.shape[1]}"


def datum(name: str, values: Array, dimensions: int) -> str:
    """Return "Q = 2 I" or "x_ref depends on time, from 0 to 1"; an axis beyond ``dimensions`` is that of time."""
    if values.ndim > dimensions:
        if (values != values[0]).any():
            return f"{name} depends on time{span(values, ', ')}"
        values = values[0]
    return f"{name} = {matrix(values) if values.ndim == 2 else vector(values)}"


def span(values: Array, before: str = " ") -> str:
    """Return " from 0 to 1", the range of the values."""
    low, high = float(values.min()), float(values.max())
    return f"{before}from {number(low)} to {number(high)}"


def combination(row: Array, names: Sequence[str]) -> str:
    """Return "position - 2 speed" for coefficients of the components of these names."""
    text = ""
    for i in map(int, np.flatnonzero(row)):
        value = float(row[i])
        factor = "" if abs(value) == 1 else f"{number(abs(value))} "
        sign = (" - " if value < 0 else " + ") if text else "-" if value < 0 else ""
        text += f"{sign}{factor}{short_name(names[i])}"
    return text or "0"


def inequalities(rows: Array, limits: Array, names: Sequence[str], symbols: str) -> str:
    """Return a few short rows as "position + 2 speed ≤ 1"; of other rows their number, with ``symbols``."""
    bounded = np.flatnonzero(limits < NO_BOUND)
    if 0 < len(bounded) <= MOST_ROWS:
        text = ", ".join(f"{combination(rows[i], names)} {AT_MOST} {number(float(limits[i]))}" for i in bounded)
        if len(text) <= MOST_TEXT:
            return text
    return f"{plural(len(limits), 'row')} {symbols}"


def low_to_high(low: float, high: float) -> str:
    """Return "0.9 to 1.1", or one number if both are written alike."""
    first, last = number(low), number(high)
    return first if first == last else f"{first} to {last}"


def interval(low: float, high: float) -> str:
    """Return "within ±1", "from 0 to 1", "at most 1", or "no bound"."""
    has_low, has_high = low > -NO_BOUND, high < NO_BOUND
    if not (has_low or has_high):
        return "no bound"
    if low == high:
        return f"at {number(low)}"
    if low == -high:
        return f"within \N{PLUS-MINUS SIGN}{number(high)}"
    if not has_low:
        return f"at most {number(high)}"
    return f"at least {number(low)}" if not has_high else f"from {number(low)} to {number(high)}"


def intervals(lower: Array, upper: Array) -> str:
    """Return the ``interval`` of bounds over time, (times,); if they depend on time, the range of each side."""
    if (lower == lower[0]).all() and (upper == upper[0]).all():
        return interval(float(lower[0]), float(upper[0]))
    known = [lower[lower > -NO_BOUND], upper[upper < NO_BOUND]]
    parts = list[str]()
    for side, values in zip(("lower", "upper"), known, strict=True):
        if len(values):
            parts.append(f"{side} {low_to_high(float(values.min()), float(values.max()))}")
    if not parts:
        return "no bound"
    missing = any(0 < len(values) < len(lower) for values in known)
    return f"bounds that depend on time: {', '.join(parts)}{', none at some times' if missing else ''}"


def price(penalty: float | None, of: str = "excess") -> str:
    """Return the price of violating a soft constraint, as the end of a sentence; empty for a hard one."""
    return "" if penalty is None else f"; soft, {number(penalty)} per unit of {of}"


def shape_and_range(values: Array | ComplexArray) -> str:
    """Return "(201, 2) from -1 to 0.5"; of complex numbers, the range of magnitudes; NaN and infinity are left out."""
    real = np.abs(values) if np.iscomplexobj(values) else np.real(values)
    finite = real[np.isfinite(real)]
    extremes = span(finite) if finite.size else ", no finite entry" if values.size else ""
    return f"{values.shape}{' magnitudes' if np.iscomplexobj(values) else ''}{extremes}"


def settings(parameters: Mapping[str, object]) -> str:
    """Return "horizon = 60, cutoff_hz = none"."""
    texts = {key: "none" if value is None else value for key, value in parameters.items()}
    return ", ".join(f"{key} = {number(text) if isinstance(text, float) else text}" for key, text in texts.items())


def term_rows(lines: Iterable[str]) -> list[tuple[str, str]]:
    """Return lines of a term and its text as pairs."""
    return [(term, text.strip()) for term, _, text in (line.partition(" ") for line in lines)]


MOST_TABLE_ROWS = 24  # a longer table ends with the number of the other rows
LABEL = "text-align:left;vertical-align:top;font-weight:normal;opacity:0.7;white-space:nowrap;padding-right:1em"
VALUE = "text-align:left;vertical-align:top;overflow-wrap:anywhere"


def html_table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return a table of terms and values under a title."""
    facts = list(rows)
    shown = facts[:MOST_TABLE_ROWS]
    if len(facts) > len(shown):
        shown.append(("\N{HORIZONTAL ELLIPSIS}", f"{len(facts) - len(shown)} more"))
    body = "".join(
        f'<tr><th style="{LABEL}">{escape(term)}</th><td style="{VALUE}">{escape(value)}</td></tr>'
        for term, value in shown
    )
    caption = f'<caption style="text-align:left;font-weight:bold">{escape(title)}</caption>'
    return f"<table>{caption}<tbody>{body}</tbody></table>"
