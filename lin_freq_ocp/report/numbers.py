"""Numbers and units in tables and sentences, beyond what problems describe themselves with."""

from __future__ import annotations

from math import inf

from lin_freq_ocp.phrases import LARGE, SMALL, number, power, split_unit


def aligned(value: float | None, digits: int = 4) -> str:
    """Return a number with exactly so many significant digits, for a column of numbers; 0 remains "0"."""
    if value is None or value == 0 or not SMALL <= abs(value) < LARGE:
        return number(value)
    return number(value) if abs(value) >= 10 ** (digits - 1) else f"{value:#.{digits}g}"


def rough(value: float) -> str:
    """Return a number of which only the size matters, with two digits."""
    return power(value) if 1e3 <= abs(value) < inf else number(value, 2)


def quantity(value: float, name: str, digits: int = 3) -> str:
    """Return a number with the unit of the component of that name."""
    return f"{number(value, digits)} {split_unit(name)[1]}".rstrip()
