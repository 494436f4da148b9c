"""Sets as tables: a table without a kind is a box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lin_freq_ocp.interchange.locations import located
from lin_freq_ocp.interchange.problem_file.codec import Kinds, Record, Tables, Value
from lin_freq_ocp.problem.sets.base import Intersection
from lin_freq_ocp.problem.sets.box import Box, Everything, Point
from lin_freq_ocp.problem.sets.convex import Ball, Ellipsoid, Polyhedron, SecondOrderCone, Soft

SETS = Kinds("set", default="box")
SETS.records |= {
    "box": Record(Box, classes=(Box, Point, Everything)),
    "polyhedron": Record(Polyhedron),
    "ball": Record(Ball),
    "ellipsoid": Record(Ellipsoid),
    "second_order_cone": Record(SecondOrderCone),
    "intersection": Record(Intersection, sets=Tables(SETS, single=False)),
    "soft": Record(Soft, renamed={"soft_set": "set"}, soft_set=SETS),
}


def _read_sets(location: str, given: Any) -> Any:
    return SET_TABLES.read(location, given) if isinstance(given, list) else SETS.read(location, given)


def _write_sets(location: str, value: Any) -> Any:
    return SET_TABLES.write(location, value) if isinstance(value, (list, tuple)) else SETS.write(location, value)


def _read_end(location: str, given: Any) -> Any:
    if isinstance(given, Mapping):
        return SETS.read(location, given)
    with located(location, "Point"):
        return Point(given)


def _write_end(location: str, value: Any) -> Any:
    if not value.members and value.fixed.all():
        return value.lower
    free = not value.members and np.isinf(value.lower).all() and np.isinf(value.upper).all()
    return None if free else SETS.write(location, value)


SET_TABLES = Tables(SETS)

SET_OR_SETS = Value(_read_sets, _write_sets)
"""One set for all times, or a list with one per time."""

END_SET = Value(_read_end, _write_end)
"""The set of an end of the horizon: a point, which is an array in the file, a table, or nothing for a free end."""
