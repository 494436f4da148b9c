"""Conversion of user input to read-only float64 arrays of a known shape, with a ProblemError if that fails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lin_freq_ocp.base.errors import ProblemError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
Entry = TypeVar("Entry", bound=np.generic)
Instance = TypeVar("Instance")
Bound = ArrayLike | Sequence[float | None] | None  # from a user: numbers, and None for no bound
NO_BOUND = 1e20  # larger bounds count as none: other tools write infinity so
SAME = 1e-9  # part of its size by which a value may differ from one that it equals but for rounding
LARGEST_HORIZON = 10**8  # its arrays would fill a large machine: a longer horizon is a typing error


def real_array(
    field: str, value: object, allow_infinite: bool = False, kinds: str = "iuf", dtype: type[complex] = float
) -> Array:
    """Convert to a read-only float64 array; NaN, complex and (by default) infinite entries are refused."""
    expected, advice = "numbers in a rectangular array", "All rows have the same length."
    try:
        array = np.asarray(value)
        if array.size and array.dtype.kind not in kinds:
            advice = {"U": "Numbers have no quotes and no units.", "c": "They must be real."}.get(array.dtype.kind, "")
            raise TypeError(f"entries of type {array.dtype}")
        if array.flags.writeable or not array.flags.owndata or array.dtype != dtype:
            array = np.array(array, dtype=dtype)
    except (TypeError, ValueError, OverflowError):
        raise ProblemError(field, brief(value), expected, advice) from None
    good = ~np.isnan(array) if allow_infinite else np.isfinite(array)
    if not good.all():
        bad = ~good
        where = "".join(f"[{i}]" for i in np.argwhere(bad)[0]) if array.ndim else ""
        expected = "a number" if allow_infinite else "a finite number"
        raise ProblemError(f"{field}{where}", f"{array[bad].flat[0]}", expected)
    array.flags.writeable = False
    return array


def complex_array(field: str, value: object) -> ComplexArray:
    """Convert to a read-only complex128 array; entries that are not finite are refused."""
    return np.asarray(real_array(field, value, kinds="iufc", dtype=complex), dtype=np.complex128)


def to_shape(field: str, value: object, shape: tuple[int, ...], times: int | None = None) -> Array:
    """Convert and require ``shape``, or ``(times, *shape)`` where one value per time is allowed."""
    array = real_array(field, value)
    if array.shape == shape or (times is not None and array.shape == (times, *shape)):
        return array
    expected = f"shape {shape}" + ("" if times is None else f", or {(times, *shape)} with one per time")
    is_diagonal = array.ndim == 1 and shape == 2 * array.shape
    advice = "State a diagonal matrix with its zeros, as numpy.diag returns it." if is_diagonal else ""
    raise ProblemError(field, f"shape {array.shape}" if array.ndim else "a single number", expected, advice)


def one_component(array: Array, size: int) -> Array:
    """Return a single number as a vector if there is one component; any other array as it is."""
    return array.reshape(1) if array.ndim == 0 and size == 1 else array


def row_matrix(field: str, value: object, advice: str = "") -> Array:
    """Require a matrix (rows, n) that is not empty."""
    matrix = real_array(field, value)
    if matrix.ndim != 2 or 0 in matrix.shape:
        raise ProblemError(field, f"shape {matrix.shape}", "a matrix (rows, n)", advice)
    return matrix


def upper_limits(field: str, value: object) -> Array:
    """Convert to upper limits; from ``NO_BOUND`` on they become inf, for none."""
    limits = real_array(field, value, allow_infinite=True)
    if (limits == -np.inf).any():
        entry = "".join(f"[{i}]" for i in np.argwhere(limits == -np.inf)[0])
        raise ProblemError(f"{field}{entry}", "-inf", "a number, or inf for no bound")
    return freeze(np.where(limits >= NO_BOUND, np.inf, limits))


def require_rows_hold(field: str, broken: Mask, limits: Array) -> None:
    """Raise ProblemError if a row without coefficients is ``broken``: its limit excludes 0; (rows,), (times, rows)."""
    if broken.any():
        at = tuple(int(i) for i in np.argwhere(broken)[0])
        when = f" at t = {at[0]}" if broken.ndim == 2 else ""
        got = f"{np.broadcast_to(limits, broken.shape)[at]:g} for row {at[-1]}{when}, which has no coefficients"
        raise ProblemError(field, got, "a row that can hold")


def positive_integer(field: str, value: object) -> int:
    """Require a whole number of at least 1."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= LARGEST_HORIZON:
        raise ProblemError(field, brief(value), f"a whole number from 1 to {LARGEST_HORIZON}")
    return int(value)


def positive_number(field: str, value: object) -> float:
    """Require a finite number above zero."""
    expected = "one number above zero"
    try:
        number = real_array(field, value)
    except ProblemError as error:
        raise ProblemError(field, error.got, expected, error.advice if isinstance(value, str) else "") from None
    if number.ndim or number <= 0:
        raise ProblemError(field, brief(value), expected)
    return float(number)


def known_entries(field: str, entries: object, keys: Sequence[str]) -> dict[str, object]:
    """Require a mapping with these keys only; None is an empty one."""
    if entries is not None and not isinstance(entries, Mapping):
        raise ProblemError(field, type(entries).__name__, f"a mapping with {' and '.join(keys)}")
    for key in entries or {}:
        if key not in keys:
            raise ProblemError(f"{field}.{key}", "an unknown key", f"{' or '.join(keys)}")
    return dict(entries or {})


def printable(field: str, name: object, empty: str | None = None) -> str:
    """Require a text of printable characters; it may not be ``empty``, if that is given."""
    if not isinstance(name, str) or not name.isprintable() or name.strip() == empty:
        raise ProblemError(field, brief(name), "a name of printable characters")
    return name


def brief(value: object, length: int = 80) -> str:
    """Return a value as text for an error message."""
    try:
        text = repr(value).replace("\n", " ")
    except (ValueError, RecursionError):  # whole numbers of thousands of digits; nesting without end
        text = f"a value of type {type(value).__name__} that cannot be shown"
    return text if len(text) <= length else text[: length - 3] + "..."


def require_bool(field: str, value: object) -> None:
    """Raise ProblemError unless the value is True or False."""
    if not isinstance(value, bool):
        raise ProblemError(field, brief(value), "True or False")


def assign(instance: object, **fields: object) -> None:
    """Set the fields of a frozen dataclass from within its own ``__init__``."""
    for name, value in fields.items():
        object.__setattr__(instance, name, value)


def with_fields(instance: Instance, **fields: object) -> Instance:
    """Return a shallow copy of a frozen dataclass with other fields; nothing is checked, and caches are shared."""
    changed = copy(instance)
    assign(changed, **fields)
    return changed


def freeze(array: NDArray[Entry]) -> NDArray[Entry]:
    """Return the array itself if it is read-only, else a read-only copy."""
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def seal(array: NDArray[Entry]) -> NDArray[Entry]:
    """Return a new array after making it read-only in place: its readers need no copy."""
    array.flags.writeable = False
    return array


def to_long_double(values: ArrayLike) -> NDArray[Any]:
    """Return a copy in the longest float or complex type of the machine, for differences of large terms."""
    array = np.asarray(values)
    return array.astype(np.clongdouble if array.dtype.kind == "c" else np.longdouble)


def times_vectors(matrix: ArrayLike, vectors: Array) -> Array:
    """Return M v_t, or M_t v_t where the matrix has one per time, for vectors (..., T, columns)."""
    matrix = np.asarray(matrix)
    if matrix.ndim == 3:
        return np.einsum("tij,...tj->...ti", matrix, vectors)
    if not np.count_nonzero(matrix):
        return np.zeros((*vectors.shape[:-1], len(matrix)), dtype=vectors.dtype)
    # in extended precision, dot takes two thirds of the time of @; in double precision, @ is faster along further axes
    return vectors.dot(matrix.T) if vectors.ndim == 2 or vectors.dtype != np.float64 else vectors @ matrix.T


def with_products(values: Array, *products: tuple[Array, Array]) -> Array:
    """Return values + matrix @ vector + ..., rounded once: large terms cancel in extended precision.

    values (..., k), each matrix (..., k, n) and vector (n,); infinite values stay.
    """
    total = to_long_double(values)
    for matrix, vector in products:
        total = total + to_long_double(matrix) @ to_long_double(vector)
    return freeze(total.astype(np.float64))


def stack_signals(x: Array, u: Array) -> Array:
    """Return z_t = (x_t, u_t), (..., T+1, n + m), of states (..., T+1, n) and controls (..., T, m), with u_T = 0."""
    n = x.shape[-1]
    z = np.zeros((*x.shape[:-1], n + u.shape[-1]), dtype=np.result_type(x, u))
    z[..., :n], z[..., :-1, n:] = x, u
    return z


def split_signals(z: NDArray[Entry], n: int) -> tuple[NDArray[Entry], NDArray[Entry]]:
    """Return the parts in x (..., T+1, n) and in u (..., T, m) of a stacked array, as views."""
    return z[..., :n], z[..., :-1, n:]


def total(values: Array) -> Array:
    """Return the sum over the last two axes, in double precision."""
    return values.sum((-2, -1)).astype(np.float64)


def largest_over_time(values: Array) -> Array:
    """Return the largest of each component, (..., k), of values (..., T, k) from zero on; 0 without any time.

    NumPy takes several times as long along an axis that is not the last one.
    """
    return values.swapaxes(-1, -2).copy().max(-1, initial=0.0)


def first_largest(values: Array, order: ArrayLike | None = None) -> tuple[int, ...]:
    """Return the index of the first entry, or of the least ``order``, that is the largest up to ``SAME`` of its size.

    Answers name it: which of equal entries is larger by rounding depends on the processor.
    """
    largest = float(values.flat[values.argmax()])
    equal = values >= min((1 - SAME) * largest, (1 + SAME) * largest)
    first = int(equal.argmax() if order is None else np.where(equal, order, np.inf).argmin())
    return (first,) if values.ndim == 1 else divmod(first, values.shape[1])


def with_columns(array: Array, columns: int) -> Array:
    """Return the array with so many zeros appended along its last axis."""
    return np.concatenate([array, np.zeros((*array.shape[:-1], columns))], axis=-1)


def with_rows(matrices: Array, rows: Array) -> Array:
    """Return a matrix, or one per time, with these rows appended."""
    return np.concatenate([matrices, np.broadcast_to(rows, (*matrices.shape[:-2], *rows.shape))], axis=-2)


def real_signal(spectra: ComplexArray, points: int) -> Array:
    """Return sum_k Re(spectrum_k exp(2 pi i k t / N)), (..., N), N = points, of spectra (..., N//2 + 1)."""
    k = np.arange(points // 2 + 1)
    weight = np.where((k == 0) | (2 * k == points), 1.0, 0.5)
    return np.fft.irfft(points * weight * spectra, n=points)
