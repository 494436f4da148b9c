"""Modes by the signs of guards G x_t + H u_t - d: one pattern of signs for each mode."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, brief, real_array
from lin_freq_ocp.base.errors import ProblemError, located_at
from lin_freq_ocp.base.polyhedra import THICKNESS, has_interior
from lin_freq_ocp.problem.dynamics.base import counted, unique_names
from lin_freq_ocp.problem.hybrid.affine_mode import MODE, AffineMode

SIGNS = {"+": -1.0, "-": 1.0}  # factors that make a row <= 0 of G x + H u - d
ANY = "*"


@dataclass(frozen=True, eq=False)
class _Guards:
    """G (guards, n), H (guards, m) and d (guards,), or with one per time in front."""

    G: Array
    H: Array
    d: Array

    @property
    def count(self) -> int:
        return self.d.shape[-1]

    def region(self, pattern: str) -> dict[str, Array]:
        """Return G, H and h of the region G x + H u <= h of a pattern of signs; nothing if it has none."""
        signed = [k for k, sign in enumerate(pattern) if sign != ANY]
        factors = np.array([SIGNS[pattern[k]] for k in signed])
        if not signed:
            return {}
        return {
            "G": factors[:, None] * self.G[..., signed, :] + 0.0,  # and no -0
            "H": factors[:, None] * self.H[..., signed, :] + 0.0,
            "h": factors * self.d[..., signed] + 0.0,
        }

    def occurs(self, pattern: str) -> bool:
        """Whether the points with these signs have an interior at some time."""
        region = self.region(pattern)
        if not region:
            return True
        G, H, h = region["G"], region["H"], region["h"][..., None]
        times = np.broadcast_shapes(*(part.shape[:-2] for part in (G, H, h)))
        rows = np.concatenate([np.broadcast_to(part, (*times, *part.shape[-2:])) for part in (G, H, h)], axis=-1)
        return any(has_interior(at[:, :-1], at[:, -1], THICKNESS) for at in rows.reshape(-1, *rows.shape[-2:]))


def guarded_modes(G: ArrayLike | None, H: ArrayLike | None, d: ArrayLike | None, modes: object) -> list[AffineMode]:
    """Return a mode with its region for every pattern that has one; see ``PiecewiseAffineDynamics.from_guards``."""
    if not isinstance(modes, Mapping) or not any(given is not None for given in modes.values()):
        expected = 'a mapping from signs such as "+-" to modes, of which one at least is not None'
        raise ProblemError("guards.modes", brief(modes), expected)
    maps = {pattern: _mode(f"guards.modes[{pattern!r}]", pattern, given) for pattern, given in modes.items()}
    first = next(mode for mode in maps.values() if mode is not None)
    sizes = first.linear.state_dim, first.linear.control_dim
    for pattern, mode in maps.items():
        got = sizes if mode is None else (mode.linear.state_dim, mode.linear.control_dim)
        if got != sizes:
            expected = f"{sizes[0]} and {sizes[1]}, as in the first"
            raise ProblemError(f"guards.modes[{pattern!r}]", counted(*got), expected)
    guards = _guards(G, H, d, *sizes)
    for pattern in maps:
        if not isinstance(pattern, str) or len(pattern) != guards.count or set(pattern) - {*SIGNS, ANY}:
            expected = f'{guards.count} characters "+", "-" or "*", one for each guard'
            raise ProblemError("guards.modes", brief(pattern), expected)
    _require_one_each(guards, maps)
    kept = {pattern: mode for pattern, mode in maps.items() if mode is not None}
    names = unique_names([mode.name for mode in kept.values()])
    return [
        AffineMode(mode.linear.A, mode.linear.B, mode.linear.offset, **guards.region(pattern), name=name)
        for (pattern, mode), name in zip(kept.items(), names, strict=True)
    ]


def _mode(place: str, pattern: object, given: object) -> AffineMode | None:
    """Return the map of a mode, with its name, and no region yet."""
    if given is None:
        return None
    if isinstance(given, AffineMode):
        if not given.everywhere:
            raise ProblemError(place, "a mode with a region of its own", "one without: the signs say where it holds")
        linear, name = given.linear, given.name or str(pattern)
        return AffineMode(linear.A, linear.B, linear.offset, name=name)
    if not isinstance(given, (tuple, list)) or len(given) not in (2, 3):
        raise ProblemError(place, brief(given), "an AffineMode, (A, B), (A, B, offset), or None")
    with located_at(place, MODE):
        return AffineMode(*given, name=str(pattern))


def _guards(G: ArrayLike | None, H: ArrayLike | None, d: ArrayLike | None, n: int, m: int) -> _Guards:
    given = {
        field: real_array(f"guards.{field}", value)
        for field, value in (("G", G), ("H", H), ("d", d))
        if value is not None
    }
    if not given.keys() & {"G", "H"}:
        raise ProblemError("guards.G", "neither G nor H", "at least one of them")
    lead = given["G" if "G" in given else "H"]
    count = lead.shape[-2] if lead.ndim > 1 else 0
    expected = {"G": (count, n), "H": (count, m), "d": (count,)}
    for field, array in given.items():
        shape = expected[field]
        if not count or array.ndim not in (len(shape), len(shape) + 1) or array.shape[-len(shape) :] != shape:
            right = ", ".join(map(str, shape)) if count else f"guards, {shape[-1]}"
            advice = "A single guard is a matrix with one row: [[g_1, g_2, ...]]." if field != "d" else ""
            wanted = f"shape ({right}), one row per guard, or (T, {right}) with one per time"
            raise ProblemError(f"guards.{field}", f"shape {array.shape}", wanted, advice)
    times = {field: len(array) for field, array in given.items() if array.ndim > len(expected[field])}
    for field, T in times.items():
        if T != max(times.values()):
            raise ProblemError(
                f"guards.{field}", f"{T} times", f"{max(times.values())}, as many as the longest of G, H, d"
            )
    return _Guards(*(given.get(field, np.zeros(shape)) for field, shape in expected.items()))


def _require_one_each(guards: _Guards, modes: Mapping[str, AffineMode | None]) -> None:
    """Raise ProblemError unless all signs that occur have one pattern."""
    patterns = list(modes)
    for i, first in enumerate(patterns):
        for second in patterns[i + 1 :]:
            both = _together(first, second)
            if both is not None and modes[first] is not modes[second] and guards.occurs(both):
                got = f"a pattern that holds together with {first!r}"
                raise ProblemError(f"guards.modes[{second!r}]", got, "one of the two")
    for signs in _without_pattern("", patterns, guards.count):
        if guards.occurs(signs):
            got, expected = f"no pattern for the signs {signs!r}", "a mode for all signs that occur"
            advice = "If they do not occur within the sets of the problem, give None for them."
            raise ProblemError("guards.modes", got, expected, advice)


def _together(first: str, second: str) -> str | None:
    """Return the pattern of the signs that both patterns allow, None if they allow none."""
    pairs = list(zip(first, second, strict=True))
    if any({*pair} == {*SIGNS} for pair in pairs):
        return None
    return "".join(one if two == ANY else two for one, two in pairs)


def _without_pattern(signs: str, patterns: Sequence[str], count: int) -> Iterator[str]:
    """Yield patterns that begin with these signs and that no given pattern shares any signs with."""
    if not patterns:
        yield signs + ANY * (count - len(signs))
    elif not any(set(pattern[len(signs) :]) <= {ANY} for pattern in patterns):
        for sign in SIGNS:
            left = [pattern for pattern in patterns if pattern[len(signs)] in (sign, ANY)]
            yield from _without_pattern(signs + sign, left, count)
