"""Tables of a problem file: a class is described once, and its reader and its writer follow from that.

A codec converts between an object and its value in the file. The main one is ``Record``: the keys of a table are the
arguments of a constructor, read from its signature. ``SETS.records["ball"] = Record(Ball)`` is all that a class needs.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.files.reading import FileTable, FileValue, at_location, join_location, require_keys


class Codec(Protocol):
    """How an object is stored in a file; ``location`` names its value in errors."""

    def read(self, location: str, given: FileValue, /) -> FileValue:
        """Return the object for a value of the file."""
        ...

    def write(self, location: str, value: FileValue, /) -> FileValue:
        """Return the value for the file, or None if the key is left out."""
        ...


def plain(location: str, value: FileValue) -> FileValue:
    """Return a value with Python's own types in place of numpy's scalars and tuples."""
    if isinstance(value, np.generic):
        return value.item()
    return list(value) if isinstance(value, tuple) else value


@dataclass(frozen=True)
class Value:
    """A codec of two functions; without them that of a number, text, an array or a list of names."""

    read: Callable[[str, FileValue], FileValue] = lambda location, given: given  # the constructor checks it
    write: Callable[[str, FileValue], FileValue] = plain


def checked_value(accepts: Callable[[object], bool], expected: str, advice: str = "") -> Value:
    """Return the codec of a value for which the constructor accepts more than a file does."""

    def read(location: str, given: FileValue) -> FileValue:
        if not accepts(given):
            raise ProblemError(location, brief(given), expected, advice)
        return given

    return Value(read)


def nonzero(dimensions: int) -> Value:
    """Return the codec of an array that is left out if it is zero and has at most so many axes: more include time."""
    return Value(write=lambda location, value: value if value.any() or value.ndim > dimensions else None)


@dataclass(frozen=True)
class Tables:
    """A list of tables; if ``single``, one table is also read."""

    item: Codec
    single: bool = True

    def read(self, location: str, given: FileValue) -> FileValue:
        """Return the objects of all tables, or that of a single one."""
        if self.single and isinstance(given, Mapping):
            return self.item.read(location, given)
        if not isinstance(given, list):
            raise ProblemError(location, brief(given), f"tables that begin with [[{location}]]")
        return [self.item.read(f"{location}[{i}]", entry) for i, entry in enumerate(given)]

    def write(self, location: str, value: FileValue) -> FileValue:
        """Return the tables of all objects."""
        entries = value if isinstance(value, (list, tuple)) else [value]
        return [self.item.write(f"{location}[{i}]", entry) for i, entry in enumerate(entries)] or None


class TableRecord:
    """A table whose keys are the arguments of a constructor.

    Parameters
    ----------
    make : class or function
        Arguments without a default are required keys.
    like : class, optional
        Its arguments are also keys: ``make`` passes them on.
    own : str
        A second name of the object in errors of ``make``.
    classes : tuple of classes, optional
        Those of the objects; default ``like`` or ``make``.
    values : function, optional
        Returns the entries to write, by key; default the attributes named like the arguments, lists of tables last.
    required : sequence of str, optional
        Arguments that have a default, but without which ``make`` fails.
    renamed : mapping, optional
        Keys that differ from their argument.
    codecs
        How arguments are stored; default ``Value``.
    """

    def __init__(
        self,
        make: Callable[..., FileValue],
        own: str = "",
        like: Callable[..., FileValue] | None = None,
        classes: tuple[Callable[..., FileValue], ...] = (),
        values: Callable[[FileValue], Mapping[str, FileValue]] | None = None,
        required: Sequence[str] = (),
        renamed: Mapping[str, str] | None = None,
        **codecs: Codec,
    ):
        like = like or make
        self._make, self._own, self._values, self._classes = make, (make.__name__, own), values, classes or (like,)
        own_parameters = _parameters(make)
        first = {name: True for name, needed in own_parameters.items() if needed}  # the schema is read before all else
        parameters = first | _parameters(like) | own_parameters | dict.fromkeys(required, True)
        self._arguments = {(renamed or {}).get(name, name): name for name in parameters}
        self._codecs: dict[str, Codec] = {key: codecs.get(name, Value()) for key, name in self._arguments.items()}
        self.required = tuple(key for key, name in self._arguments.items() if parameters[name])
        self.optional = tuple(key for key, name in self._arguments.items() if not parameters[name])

    def holds(self, value: object) -> bool:
        """Whether an object has this class; a subclass may be another set."""
        return type(value) in self._classes

    def read(self, location: str, given: FileValue) -> FileValue:
        """Return the object of a table."""
        require_keys(location, given, self.required, self.optional)
        arguments = {
            name: self._codecs[key].read(join_location(location, key), given[key])
            for key, name in self._arguments.items()
            if key in given
        }
        with at_location(location, *self._own):
            return self._make(**arguments)

    def write(self, location: str, value: FileValue) -> FileTable:
        """Return the table of an object."""
        table = {
            key: self._codecs[key].write(join_location(location, key), entry)
            for key, entry in self._entries(value).items()
        }
        return {key: entry for key, entry in table.items() if entry is not None}

    def _entries(self, value: FileValue) -> Mapping[str, FileValue]:
        """Return the entries of an object that are not None, by key, lists of tables last."""
        if self._values is None:
            keys = sorted(self._arguments, key=lambda key: isinstance(self._codecs[key], Tables))
            entries = {key: getattr(value, self._arguments[key], None) for key in keys}
        else:
            entries = self._values(value)
        return {key: entry for key, entry in entries.items() if entry is not None}


def _parameters(make: Callable[..., object]) -> dict[str, bool]:
    """Return the named arguments of a function, and whether each is required."""
    parameters = inspect.signature(make).parameters.values()
    named = [part for part in parameters if part.kind in (part.POSITIONAL_OR_KEYWORD, part.KEYWORD_ONLY)]
    return {part.name: part.default is part.empty for part in named}


class Kinds:
    """Tables of several classes: ``records`` has the record of every kind, by the key ``kind`` of its tables.

    ``what`` is the name of their objects in errors; a table without the key is of the ``default`` kind.
    """

    def __init__(self, what: str, default: str | None = None):
        self._what, self._default = what, default
        self.records: dict[str, TableRecord] = {}

    def read(self, location: str, given: FileValue) -> FileValue:
        """Return the object of a table."""
        if not isinstance(given, Mapping):
            raise ProblemError(location, brief(given), "a table")
        kind = given.get("kind", self._default)
        if not isinstance(kind, str) or kind not in self.records:
            got, expected = "nothing" if kind is None else brief(kind), f"one of {', '.join(self.records)}"
            raise ProblemError(f"{location}.kind", got, expected, suggestion(kind, self.records))
        return self.records[kind].read(location, {key: entry for key, entry in given.items() if key != "kind"})

    def write(self, location: str, value: object) -> FileTable:
        """Return the table of an object."""
        for kind, record in self.records.items():
            if record.holds(value):
                return ({} if kind == self._default else {"kind": kind}) | record.write(location, value)
        expected = f"a {self._what} that a problem file can hold: {', '.join(self.records)}"
        raise ProblemError(location, brief(value), expected)
