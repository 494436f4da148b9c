"""The lines of a proof, and its section PROBLEM: an optimal control problem with every number exact.

Lines are JSON objects whose real numbers are hexadecimal strings, exact to the last bit.

Dynamics, cost, bounds and removed bins come first; a line is written at each time at which they change. A term h(L v)
has a line for each group of values with a limit, or of half-spaces for each value. Its function h is in the format
weight max(gauge(v) - limit, 0), and its values L v are given by rows, or by the spectrum of an output.

The format has (Re, Im) of every bin. A map may leave out an Im that is zero for every signal, or count the phase from
another time: ``written_multipliers`` converts multipliers of the map to the values of the format.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.problem.measures import stopped_runs
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.maps import AffineMap, OutputMap
from lin_freq_ocp.problem.terms.penalties import HalfSpaces, NormBall, StandardCone, Within
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.semi_infinite import MagnitudeMask
from lin_freq_ocp.problem.terms.spectrum_maps import FrequencyMap, SpectrumMap
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine

CHUNK = 1 << 16  # numbers turned into text at once: the text of a long signal is never whole in memory
NORMS = {1: "1", 2: "2", np.inf: "inf"}

Sizes = tuple[int, int, int]  # T, n, m

Parts = Mapping[str, tuple[Array, int]]  # by field: values, constant or one per time, and their dimensions at a time


Value = None | str | bool | int | float | Array | list[int] | list[str] | list[list[int]]


class Text(str):
    """A value that is JSON already."""


def line(**fields: Value) -> str:
    """Return a line of the file: names and integers as they are, real numbers in hexadecimal."""
    return "{" + ", ".join(f'"{name}": {encode(value)}' for name, value in fields.items()) + "}\n"


def encode(value: Value) -> str:
    """Return a value as JSON; arrays and floats are real numbers."""
    if isinstance(value, Text):
        return value
    if isinstance(value, np.ndarray):
        if value.ndim > 1:
            return "[" + ", ".join(map(encode, value)) + "]"
        return vector(value) if value.ndim else encode(float(value))
    return f'"{value.hex()}"' if isinstance(value, float) else json.dumps(value)


def vector(values: Array) -> str:
    """Return real numbers (k,) as a list; infinities are "inf" and "-inf"."""
    return '["' + '", "'.join(map(float.hex, values.tolist())) + '"]' if len(values) else "[]"


def rows(values: Array) -> Iterator[Text]:
    """Yield each row of real numbers (k, size) as a list."""
    size = values.shape[1]
    step = max(CHUNK // max(size, 1), 1)
    for begin in range(0, len(values), step):
        part = values[begin : begin + step]
        numbers = list(map(float.hex, part.ravel().tolist()))
        for k in range(len(part)):
            yield Text('["' + '", "'.join(numbers[k * size : (k + 1) * size]) + '"]' if size else "[]")


def exact(mantissa: int, exponent: int) -> str:
    """Return mantissa * 2^exponent as the text of a real number."""
    return f"{'-' if mantissa < 0 else ''}0x{abs(mantissa):x}p{exponent:+d}"


def problem_lines(problem: OptimalControlProblem) -> Iterator[str]:
    """Yield the section PROBLEM; UnsupportedError, naming the field, if the format does not hold something."""
    try:
        modes = _modes(problem)
    except UnsupportedError:
        got = f"dynamics: got {problem.form.words}"
        raise UnsupportedError(f"{got}; a proof states linear or piecewise-affine dynamics.") from None
    yield line(
        section="problem",
        name=problem.name,
        horizon=problem.horizon,
        states=list(problem.state_names),
        controls=list(problem.control_names),
        modes=[name for name, _ in modes],
    )
    for index, (_, parts) in enumerate(modes):
        for t, values in changes_over_time(parts, problem.horizon):
            bounded = np.isfinite(values["h"])
            rows = {name: values[name][bounded] for name in "GHh"}
            yield line(**{"mode": index, "from": t}, A=values["A"], B=values["B"], d=values["d"], **rows)
    yield from _cost_lines(problem)
    yield from _bound_lines(problem)
    yield from _stop_lines(0, problem.state_stop, problem.state_samples)
    yield from _stop_lines(problem.state_dim, problem.control_stop, problem.horizon)
    yield from term_lines(problem.terms, (problem.horizon, problem.state_dim, problem.control_dim))


def _modes(problem: OptimalControlProblem) -> list[tuple[str, Parts]]:
    """Return the name and the data of each mode; of linear dynamics, a single mode without rows."""
    n, m = problem.state_dim, problem.control_dim
    if not problem.mode_names:
        linear = problem.linear
        none = {"G": (np.zeros((0, n)), 2), "H": (np.zeros((0, m)), 2), "h": (np.zeros(0), 1)}
        return [("linear", {"A": (linear.A, 2), "B": (linear.B, 2), "d": (linear.offset, 1), **none})]
    found = piecewise_affine(problem).arrays(problem.horizon)
    named = {"A": (found.A, 2), "B": (found.B, 2), "d": (found.offset, 1), "G": (found.G, 2), "H": (found.H, 2)}
    named["h"] = found.h, 1
    return [
        # An array that memory holds once for all times is stated without its time
        (name, {field: (of[:, i] if of.strides[0] else of[0, i], ndim) for field, (of, ndim) in named.items()})
        for i, name in enumerate(problem.mode_names)
    ]


def _cost_lines(problem: OptimalControlProblem) -> Iterator[str]:
    """Yield the quadratic cost; a line states the parts that change."""
    cost, T = problem.quadratic, problem.horizon
    hessians = cost.stage_hessians
    parts = {
        "hessian": (hessians if len(hessians) > 1 else hessians[0], 2),
        "center": (stack_signals(cost.x_ref, cost.u_ref, T), 1),
        "linear": (stack_signals(cost.q, cost.r, T), 1),
    }
    before = dict[str, Array]()
    for t, values in changes_over_time(parts, T):
        new: dict[str, Value] = {
            name: value for name, value in values.items() if not np.array_equal(value, before.get(name, np.zeros(0)))
        }
        yield line(**{"cost": "stage", "from": t, **new})
        before = values
    x_ref = cost.x_ref[-1] if cost.x_ref.ndim == 2 else cost.x_ref
    yield line(cost="end", hessian=cost.P, center=x_ref, linear=cost.p)


def _bound_lines(problem: OptimalControlProblem) -> Iterator[str]:
    states, controls, T = problem.state_tube, problem.control_tube, problem.horizon
    parts = {
        "lower": (stack_signals(states.lower, controls.lower, T), 1),
        "upper": (stack_signals(states.upper, controls.upper, T), 1),
    }
    for t, values in changes_over_time(parts, T):
        yield line(**{"bounds": "stage", "from": t, **values})
    yield line(bounds="end", lower=states.lower[-1], upper=states.upper[-1])


def _stop_lines(first: int, stop: Mask, samples: int) -> Iterator[str]:
    """Yield the removed bins of components; the first of them is ``first`` of (x, u)."""
    for component in np.flatnonzero(stop.any(axis=0)).tolist():
        bins = [list(run) for run in stopped_runs(stop[:, component])]
        yield line(stop=first + component, samples=samples, bins=bins)


def changes_over_time(parts: Parts, horizon: int) -> Iterator[tuple[int, dict[str, Array]]]:
    """Yield each time t < T at which a part changes, the first one 0, with the values of all parts from then on."""
    changed = np.zeros(horizon, dtype=bool)
    changed[0] = True
    for values, ndim in parts.values():
        if values.ndim > ndim:
            differs = values[1:horizon] != values[: horizon - 1]
            changed[1:] |= differs.any(axis=tuple(range(1, values.ndim)))
    for t in np.flatnonzero(changed).tolist():
        yield t, {name: values[t] if values.ndim > ndim else values for name, (values, ndim) in parts.items()}


def stack_signals(of_x: Array, of_u: Array, T: int) -> Array:
    """Return (x, u), (n + m,) or (T, n + m), of vectors that are constant or one per time (of x, maybe T + 1)."""
    if of_x.ndim == of_u.ndim == 1:
        return np.concatenate([of_x, of_u])
    of_x = of_x[:T] if of_x.ndim == 2 else of_x
    return np.hstack([np.broadcast_to(part, (T, part.shape[-1])) for part in (of_x, of_u)])


def term_lines(terms: Sequence[Term], sizes: Sizes) -> Iterator[str]:
    """Yield the lines of all terms; UnsupportedError, naming the field, if the format does not hold one."""
    first = 0
    for term in terms:
        try:
            for index, text in enumerate(_term_fields(term, sizes), first):
                yield f'{{"term": {index}, {text}}}\n'
                first = index + 1
        except UnsupportedError as error:
            where = "problem" if term.source is None else term.source[0]
            raise UnsupportedError(f"{where}: got {term.name!r}; a proof cannot state {error}.") from None


def _term_fields(term: Term, sizes: Sizes) -> Iterator[str]:
    """Yield the fields of each line of a term."""
    if term.semi_infinite is not None:
        if type(term.semi_infinite) is not MagnitudeMask:
            raise UnsupportedError("the spectrum of a held signal, or a residual vibration")
        limits = term.semi_infinite.limits
        table = np.column_stack([limits.low, limits.high, limits.at_low, limits.at_high])
        head = f'"name": {encode(term.name)}, "gauge": "all", "weight": {encode(float(term.semi_infinite.price))}'
        yield f'{head}, {signal_text(term.semi_infinite.map, 0, sizes)}, "limits": {encode(table)}'
        return
    function = function_of(term.penalty, term.shape)
    head = f'"name": {encode(term.name)}, "gauge": "{function.gauge}"'
    if function.by_value and term.map.dense_size[0]:
        raise UnsupportedError("half-spaces of a spectrum")
    limits, weights = function.limits.tolist(), function.weights.tolist()
    for values, limit, weight in zip(written_values(term.map, sizes), limits, weights, strict=True):
        units = values if function.by_value else [", ".join(values)]
        for text, most, price in zip(units, limit, weight, strict=True):
            if np.isfinite(most):
                yield f'{head}, "limit": "{most.hex()}", "weight": "{price.hex()}", "values": [{text}]'


def multiplier_lines(terms: Sequence[Term], weights: Sequence[Array]) -> Iterator[str]:
    """Yield the multipliers of all terms, (groups, dim) each, that are not zero."""
    first = 0
    for term, given in zip(terms, weights, strict=True):
        if term.semi_infinite is not None:
            places = term.map.locations.tolist()
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


@dataclass(frozen=True, eq=False)
class Function:
    """Its gauge, with limits and weights of groups, (groups, 1), or values, (groups, dim); a limit may be inf."""

    gauge: str
    limits: Array
    weights: Array

    @property
    def by_value(self) -> bool:
        """Whether each value has a line of its own."""
        return self.gauge == "max"


@singledispatch
def function_of(penalty: Penalty, shape: tuple[int, int]) -> Function:
    """Return the function of values (groups, dim); UnsupportedError if the format has none."""
    raise UnsupportedError(f"a {type(penalty).__name__}")


@function_of.register
def _half_spaces_function(penalty: HalfSpaces, shape: tuple[int, int]) -> Function:
    return Function("max", np.broadcast_to(penalty.limit, shape), np.broadcast_to(penalty.weight, shape))


@function_of.register
def _ball_function(penalty: NormBall, shape: tuple[int, int]) -> Function:
    limit, weight = (np.broadcast_to(part, shape[:1])[:, None] for part in (penalty.radius, penalty.weight))
    return Function(NORMS[penalty.order], limit, weight)


@function_of.register
def _within_function(penalty: Within, shape: tuple[int, int]) -> Function:
    return Function("inf", np.full((shape[0], 1), penalty.reach), np.full((shape[0], 1), np.inf))


@function_of.register
def _cone_function(penalty: StandardCone, shape: tuple[int, int]) -> Function:
    return Function("cone", np.zeros((shape[0], 1)), np.full((shape[0], 1), np.inf))


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
    if values.held or (values.starts < 0).any():
        raise UnsupportedError("a spectrogram of samples before time 0, or of a held control")
    for start in values.starts.tolist():
        signal = signal_text(values, start, sizes)
        bins = [f'{{{signal}, "frequency": [{k}, {values.points}]}}' for k in values.bins.tolist()]
        yield from [bins] if values.joint else ([one] for one in bins)


@written_values.register
def _frequencies(values: FrequencyMap, sizes: Sizes) -> Iterator[list[str]]:
    if values.scaled:
        raise UnsupportedError(f"a {type(values).__name__}")
    signal = signal_text(values, 0, sizes)
    for w in values.at.tolist():
        yield [f'{{{signal}, "frequency": {encode(w)}}}']


def signal_text(values: OutputMap, first: int, sizes: Sizes) -> str:
    """Return the fields "output", "first" and "window" of a spectrum."""
    _, n, m = sizes
    of_x = np.zeros(n) if values.C is None else values.C
    of_u = np.zeros(m) if values.D is None else values.D
    plain = bool((values.window == 1.0).all())
    window = json.dumps(len(values.window)) if plain else encode(values.window)
    return f'"output": {encode(np.concatenate([of_x, of_u]))}, "first": {first}, "window": {window}'


@singledispatch
def written_multipliers(values: AffineMap, weights: Array) -> Array:
    """Return multipliers of the written values, (groups, values), from those of the map, (groups, dim)."""
    return weights


@written_multipliers.register
def _spectrum_multipliers(values: SpectrumMap, weights: Array) -> Array:
    pairs = values.pairs(weights).reshape(len(values.starts), -1, 2)
    angles = 2 * np.pi * (np.outer(values.starts, values.bins) % values.points) / values.points
    turned = (pairs[..., 0] + 1j * pairs[..., 1]) * np.exp(1j * angles)
    return np.stack([turned.real, turned.imag], axis=-1).reshape(len(weights), -1)
