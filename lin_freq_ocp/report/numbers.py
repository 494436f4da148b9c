"""Numbers and units as people read them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import inf, isfinite

NAME_WITH_UNIT = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\[\]]*)\]\s*")

SMALL, LARGE = 1e-3, 1e6
"""Numbers outside this range are written with a power of ten."""

NOTHING = "\N{EN DASH}"
"""What stands where there is no number."""


def number(value: float | None, digits: int = 5) -> str:
    """Return a number with up to so many significant digits; nothing small is called zero."""
    if value is None:
        return NOTHING
    if not isfinite(value):
        return str(value)
    size = abs(value)
    if size != 0 and (size < SMALL or size >= LARGE):
        return _power(value)
    return f"{value:.0f}" if size >= 10 ** (digits - 1) else f"{value:.{digits}g}"


def aligned(value: float | None, digits: int = 4) -> str:
    """Return a number with exactly so many significant digits, for a column of numbers; 0 remains "0"."""
    if value is None or value == 0 or not SMALL <= abs(value) < LARGE:
        return number(value)
    return number(value) if abs(value) >= 10 ** (digits - 1) else f"{value:#.{digits}g}"


def rough(value: float) -> str:
    """Return a number of which only the size matters, with two digits."""
    return _power(value) if 1e3 <= abs(value) < inf else number(value, 2)


def _power(value: float) -> str:
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def split_unit(name: str) -> tuple[str, str]:
    """Split ``"position [m]"`` into ``("position", "m")``; without a unit the second is empty."""
    match = NAME_WITH_UNIT.fullmatch(name)
    return (match["name"], match["unit"]) if match else (name, "")


def quantity(value: float, name: str, digits: int = 3) -> str:
    """Return a number with the unit of the component of that name."""
    return f"{number(value, digits)} {split_unit(name)[1]}".rstrip()


def listed(parts: Sequence[str]) -> str:
    """Return "a", "a and b", or "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def plural(count: int, noun: str) -> str:
    """Return "1 bin" or "24 bins"."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


def runs_in_words(runs: Sequence[tuple[int, int]]) -> str:
    """Return runs of whole numbers as "3, 7 to 9 and 12"."""
    return listed([f"{first}" if first == last else f"{first} to {last}" for first, last in runs])
