"""The grid of a sweep: its points, the problem at each point, and the fingerprints of problems and points."""

from __future__ import annotations

import inspect
import json
import math
import pickle
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import fields, is_dataclass, replace
from functools import partial
from hashlib import sha256
from itertools import product
from typing import Any

import numpy as np

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.transform.limits import CUTOFFS, changed_fields, cutoff_band, numbers

# What a sweep varies: a problem, whose fields are replaced, or a function that builds one from keywords.
Source = OptimalControlProblem | Callable[..., OptimalControlProblem]
Parameters = dict[str, object]  # the value of every swept parameter at one point
LARGEST_GRID = 10**6  # points of one grid: more are likely a mistake, and would not fit into memory
FINGERPRINT_LENGTH = 16  # hexadecimal digits: 64 bits, so that collisions are not expected


def grid_values(source: Source, grid: object) -> dict[str, list[object]]:
    """Return the values of each parameter; ProblemError unless they are sequences of different values."""
    if not callable(source):
        require_problem(source)
    if not isinstance(grid, Mapping) or not grid:
        raise ProblemError("grid", brief(grid), "a mapping from names of parameters to sequences of values")
    require_parameters(source, grid, "grid.")
    values = dict[str, list[object]]()
    for name, given in grid.items():
        if isinstance(given, (str, bytes, Mapping)) or not isinstance(given, Iterable):
            raise ProblemError(f"grid.{name}", brief(given), "a sequence of values", "For a single one: [value].")
        values[name] = list(given)
        keys = Counter(json.dumps(plain(value)) for value in values[name])
        repeated = [key for key, count in keys.items() if count > 1]
        if not keys or repeated:
            got = f"{repeated[0]} twice" if repeated else "nothing"
            raise ProblemError(f"grid.{name}", got, "one value or more, all different")
    return values


def grid_points(values: Mapping[str, Sequence[object]]) -> dict[str, Parameters]:
    """Return the points of the full product, by their keys; the last parameter changes fastest."""
    count = math.prod(map(len, values.values()))
    if count > LARGEST_GRID:
        raise ProblemError("grid", f"{count} points", f"at most {LARGEST_GRID}", "Sweep parts of it one after another.")
    points = [dict(zip(values, combination, strict=True)) for combination in product(*values.values())]
    return {point_key(plain_parameters(point)): point for point in points}


def problem_at(source: Source, parameters: Mapping[str, Any]) -> OptimalControlProblem:
    """Return the problem at one point: of a problem, with other fields, and with numbers of its limits by their keys.

    ``cutoff`` (rad/sample) and ``cutoff_hz`` are low passes of its controls.
    """
    if callable(source):
        problem = source(**parameters)
        require_problem(problem)
        return problem
    own, changes, moved = _field_names(source), dict[str, object](), dict[str, float]()
    for name, value in parameters.items():
        if name in CUTOFFS:
            changes["control_spectrum"] = cutoff_band(name, value)
        elif name in own:
            changes[name] = value
        else:
            moved[name] = value
    problem = replace(source, **changes)
    return replace(problem, **changed_fields(problem, moved)) if moved else problem


def _field_names(problem: OptimalControlProblem) -> list[str]:
    return [field.name for field in fields(problem)]


def plain_parameters(parameters: Mapping[str, object]) -> Parameters:
    """Return the values as JSON has them; of objects, their kind and a fingerprint."""
    return {name: plain(value) for name, value in parameters.items()}


def plain(value: object) -> object:
    """Return a value as JSON has it; of an object, its kind and a fingerprint."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return (
        value
        if isinstance(value, (bool, int, float, str, type(None)))
        else f"{type(value).__name__} {fingerprint(value)}"
    )


def point_key(parameters: Mapping[str, object]) -> str:
    """Return the text that identifies a point, given by plain values."""
    return json.dumps(parameters, sort_keys=True)


def require_executor(executor: object, source: Source, grid: Mapping[str, object]) -> None:
    """Raise ProblemError unless this is None, or an executor whose processes can get the source and the values."""
    if executor is None:
        return
    if not isinstance(executor, Executor):
        advice = "Of a Dask client: client.get_executor()."
        raise ProblemError("executor", brief(executor), "a concurrent.futures.Executor, or None", advice)
    for field, value in (("problem", source), *((f"grid.{name}", value) for name, value in grid.items())):
        try:
            pickle.dumps(value)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            advice = "Define functions at the top level of a module; functools.partial gives them fixed arguments."
            expected = f"something that can be pickled, for other processes ({error})"
            raise ProblemError(field, brief(value), expected, advice) from None


def require_parameters(source: Source, names: Iterable[str], prefix: str) -> None:
    """Raise ProblemError unless a source takes these parameters; errors name them after the prefix, "grid."."""
    if callable(source):
        known = _keyword_names(source)
    else:
        known = list(dict.fromkeys((*_field_names(source), *CUTOFFS, *numbers(source))))
        same = [name for name in names if name in ("control_spectrum", *CUTOFFS)]
        if len(same) > 1:
            raise ProblemError(f"{prefix}{same[1]}", f"a grid with {same[0]}, too", "one of them", "Both set the same.")
    for name in names:
        if known is not None and name not in known:
            expected = f"some of {', '.join(known)}"
            raise ProblemError(f"{prefix}{name}", "no parameter of that name", expected, suggestion(name, known))


def _keyword_names(function: Callable[..., object]) -> list[str] | None:
    """Return the keywords that a function takes; None if it takes any, or has no signature."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return None
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return None
    by_keyword = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [parameter.name for parameter in parameters if parameter.kind in by_keyword]


def fingerprint(value: object) -> str:
    """Return a text that tells values apart, the same in every process.

    Arrays count by their numbers, dataclasses by their fields (but those without ``compare``), mappings and sequences
    by their entries, a ``functools.partial`` by its function and arguments, and functions by module and name: not by
    their code.
    """
    return sha256(_text_of(value).encode()).hexdigest()[:FINGERPRINT_LENGTH]


def _text_of(value: object) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes)):
        return repr(value)
    if isinstance(value, np.ndarray):
        content = np.ascontiguousarray(value)
        return f"array({content.dtype.str}, {content.shape}, {sha256(content.tobytes()).hexdigest()})"
    if isinstance(value, Mapping):
        entries = sorted(f"{_text_of(key)}: {_text_of(entry)}" for key, entry in value.items())
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_text_of, value))}]"
    if isinstance(value, partial):
        return f"partial({_text_of(value.func)}, {_text_of(value.args)}, {_text_of(value.keywords)})"
    if is_dataclass(value) and not isinstance(value, type):
        entries = (f"{field.name}={_text_of(getattr(value, field.name))}" for field in fields(value) if field.compare)
        return f"{_qualified_name(type(value))}({', '.join(entries)})"
    if hasattr(value, "__qualname__"):
        return _qualified_name(value)
    return f"{_qualified_name(type(value))}({_text_of(getattr(value, '__dict__', {}))})"


def _qualified_name(value: object) -> str:
    """Return module and name; names of this package count without their module, which may move."""
    module = getattr(value, "__module__", "") or ""
    package = __name__.partition(".")[0]
    return f"{package if module.partition('.')[0] == package else module}.{getattr(value, '__qualname__', '')}"
