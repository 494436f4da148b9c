"""Names of the components of signals, values that are stated by these names, and arguments by their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, signature

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, brief, printable, real_array
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.base.phrases import short_name

ByName = Mapping[str, object]  # values by the names of components


def component_names(field: str, stated: str | Sequence[str] | None, count: int, letter: str) -> tuple[str, ...]:
    """Require ``count`` different names, a list or a text with commas; the default is ``x_0 ...``, with the letter."""
    if stated is None:
        return tuple(f"{letter}_{i}" for i in range(count))
    if not isinstance(stated, Sequence):
        raise ProblemError(field, brief(stated), f"a list of {count} names")
    listed = [name.strip() for name in stated.split(",")] if isinstance(stated, str) else stated
    checked = tuple(printable(field, name, "") for name in listed)
    if len(checked) != count or len(set(checked)) != count:
        advice = 'One per component, such as "position [m]".'
        raise ProblemError(field, brief(list(listed)), f"{count} different names", advice)
    return checked


def index_of_name(field: str, name: object, names: Sequence[str], others: str = "") -> int:
    """Return the index of a name, with or without its unit; ``others`` is what else is expected, for errors."""
    matches = [i for i, known in enumerate(names) if name in (known, short_name(known))]
    if len(matches) != 1:
        short = [short_name(known) for known in names]
        expected = f"{others}one of {', '.join(map(repr, names))}"
        raise ProblemError(field, brief(name), expected, suggestion(name, [*names, *short]))
    return matches[0]


def argument_order(
    function: Callable[..., object], values: Sequence[str] = ("x", "u"), on_request: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the order in which a function takes values: those that are names of its parameters, others by position.

    Beside parameters of these names, those with a default keep it.

    Values ``on_request`` go only to parameters of their names; TypeError if it does not take the others, or
    is no function.
    """
    try:
        form = signature(function)
    except ValueError:  # compiled functions may have no signature
        return tuple(values)
    parameters = [name for name, one in form.parameters.items() if one.kind <= one.POSITIONAL_OR_KEYWORD]
    by_position = [value for value in values if value not in parameters]
    named = len(by_position) < len(values)
    order = list[str]()
    for name in parameters:
        if name not in (*values, *on_request):
            if not by_position or (named and form.parameters[name].default is not Parameter.empty):
                break  # it keeps its default
            name = by_position.pop(0)
        order.append(name)
    form.bind(*order)
    if by_position and not any(one.kind is one.VAR_POSITIONAL for one in form.parameters.values()):
        raise TypeError(f"missing a parameter for {', '.join(by_position)}")
    order += by_position
    if missing := {*values, *on_request}.intersection(parameters).difference(order):
        raise TypeError(f"{', '.join(sorted(missing))} after a parameter with a default")
    return tuple(order)


def arrays_or_names(record: str, given: Mapping[str, ArrayLike | ByName]) -> dict[str, Array | ByName]:
    """Return the fields of a record as arrays, except for those that are stated by name."""
    return {
        field: value if isinstance(value, Mapping) else real_array(f"{record}.{field}", value)
        for field, value in given.items()
    }


def fields_by_name(name: str, record: object, names: Mapping[str, Sequence[str]]) -> dict[str, Array]:
    """Return the fields of a record that are stated by name as arrays; ``names`` has the components of each field."""
    return {
        field: values_by_name(f"{name}.{field}", given, components, absent=0.0)
        for field, components in names.items()
        if isinstance(given := getattr(record, field), Mapping)
    }


def values_by_name(
    field: str, given: ByName, names: Sequence[str], absent: float | None, allow_infinite: bool = False
) -> Array:
    """Return the values of components, (n,) or (times, n), from a mapping of names to numbers or (times,) values.

    A component that the mapping does not name has the value ``absent``; if that is None, the mapping names all of them.
    """
    columns = dict[int, Array]()
    for name, value in given.items():
        i = index_of_name(field, name, names)
        if i in columns:
            raise ProblemError(field, f"{names[i]!r} twice", "each name once")
        columns[i] = real_array(f"{field}[{name!r}]", value, allow_infinite)
    missing = [repr(name) for i, name in enumerate(names) if i not in columns]
    if absent is None and missing:
        raise ProblemError(field, f"no value of {', '.join(missing)}", "a value of every component")
    return stack_components(field, [columns.get(i, np.full((), absent, dtype=float)) for i in range(len(names))])


def stack_components(field: str, columns: Sequence[Array]) -> Array:
    """Return the values of components, (n,) or (times, n), each a number or one per time."""
    shapes = {column.shape for column in columns} - {()}
    if len(shapes) > 1 or any(len(shape) > 1 for shape in shapes):
        got = f"values of shape {' and '.join(map(str, sorted(shapes)))}"
        raise ProblemError(field, got, "numbers, or one per time, for the same times")
    return np.stack(np.broadcast_arrays(*columns), axis=-1) if columns else np.empty(0)
