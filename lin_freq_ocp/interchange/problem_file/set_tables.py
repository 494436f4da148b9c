"""Sets as tables: ``kind`` is the kind of set, the other keys are its arguments; without a kind it is a box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.interchange.keys import require_keys
from lin_freq_ocp.interchange.places import placed
from lin_freq_ocp.problem.sets.base import Intersection
from lin_freq_ocp.problem.sets.box import Box, stacked
from lin_freq_ocp.problem.sets.convex import Ball, Ellipsoid, Polyhedron, SecondOrderCone, Soft

PLAIN: dict[str, tuple[Any, tuple[str, ...], tuple[str, ...]]] = {
    "box": (Box, (), ("lower", "upper")),
    "polyhedron": (Polyhedron, ("F", "g"), ()),
    "ball": (Ball, ("radius",), ("centre",)),
    "ellipsoid": (Ellipsoid, ("W",), ("radius", "centre")),
    "second_order_cone": (SecondOrderCone, ("F", "g", "h"), ("d",)),
}
"""Sets whose arguments are numbers: class, required and optional arguments, which are also its attributes."""

SET_KINDS = (*PLAIN, "intersection", "soft")


def set_from_table(place: str, table: Any) -> Any:
    """Return the set of a table; ``place`` is where the table stands in the file."""
    require_keys(place, table, optional=table if isinstance(table, Mapping) else ())
    kind = table.get("kind", "box")
    if not isinstance(kind, str) or kind not in SET_KINDS:
        raise ProblemError(f"{place}.kind", brief(kind), f"one of {', '.join(SET_KINDS)}", suggestion(kind, SET_KINDS))
    arguments = {key: value for key, value in table.items() if key != "kind"}
    if kind == "intersection":
        require_keys(place, arguments, required=("sets",))
        if not isinstance(arguments["sets"], list):
            raise ProblemError(f"{place}.sets", brief(arguments["sets"]), "a list of tables")
        members = [set_from_table(f"{place}.sets[{i}]", one) for i, one in enumerate(arguments["sets"])]
        with placed(place, "Intersection"):
            return Intersection(members)
    if kind == "soft":
        require_keys(place, arguments, required=("set", "penalty"))
        member = set_from_table(f"{place}.set", arguments["set"])
        with placed(place, "Soft"):
            return Soft(member, arguments["penalty"])
    maker, required, optional = PLAIN[kind]
    require_keys(place, arguments, required, optional)
    with placed(place, maker.__name__):
        if kind == "box":
            return Box(arguments.get("lower"), arguments.get("upper"))
        return maker(**arguments)


def table_from_set(place: str, one: Any) -> dict[str, Any]:
    """Return the table from which ``set_from_table`` makes the same set; ``place`` is where it stands."""
    if not one.members:
        return {"lower": one.lower, "upper": one.upper}
    if isinstance(one, Intersection):
        return {"kind": "intersection", "sets": [table_from_set(place, member) for member in one.sets]}
    if isinstance(one, Soft):
        return {"kind": "soft", "set": table_from_set(place, one.soft_set), "penalty": one.penalty}
    kind = next((kind for kind, entry in PLAIN.items() if type(one) is entry[0]), None)
    if kind is None:
        raise ProblemError(place, brief(one), f"a set that a problem file can hold: {', '.join(SET_KINDS)}")
    _, required, optional = PLAIN[kind]
    return {"kind": kind, **{key: getattr(one, key) for key in (*required, *optional)}}


def sets_from_tables(field: str, tables: Mapping[str, Any]) -> Any:
    """Return what stands in a field: a set, a list of sets (one per time), or None."""
    given = tables.get(field)
    if isinstance(given, list):
        return [set_from_table(f"{field}[{i}]", one) for i, one in enumerate(given)]
    return None if given is None else set_from_table(field, given)


def tables_from_sets(field: str, given: Any, dimension: int, times: int) -> Any:
    """Return a table, a list of tables, or None; a list of boxes becomes one table with bounds per time."""
    if given is None:
        return None
    if not isinstance(given, (list, tuple)):
        return table_from_set(field, given)
    if not any(one.members for one in given):
        return table_from_set(field, stacked(field, given, dimension, times))
    return [table_from_set(f"{field}[{i}]", one) for i, one in enumerate(given)]
