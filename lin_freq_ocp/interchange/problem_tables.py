"""A problem as plain tables, and back: the layout of the problem file, without the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.interchange.band_tables import band_from_table, table_from_band
from lin_freq_ocp.interchange.keys import require_keys
from lin_freq_ocp.interchange.places import placed
from lin_freq_ocp.problem.arrays import brief
from lin_freq_ocp.problem.costs import QuadraticCost
from lin_freq_ocp.problem.dynamics import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets import Box, Point, stacked
from lin_freq_ocp.problem.spectrum import Band
from lin_freq_ocp.problem.stage_rows import StageRows

SCHEMA = 1
"""Version of the layout; a file with another one is refused."""

DIMENSIONS_OF_COST = {"Q": 2, "R": 2, "S": 2, "q": 1, "r": 1, "P": 2, "p": 1, "x_ref": 1, "u_ref": 1}
"""The terms of a quadratic cost, with the dimensions of each where it does not depend on time."""


def problem_from_tables(tables: Mapping[str, Any]) -> OptimalControlProblem:
    """Return the problem the tables describe; arrays are nested lists or numpy arrays.

    Raises
    ------
    ProblemError
        With the field as it stands in the file (``"dynamics.A"``).
    """
    require_keys(
        "",
        tables,
        required=("schema", "horizon", "dynamics", "cost"),
        optional=(
            *("name", "initial_state", "terminal_state"),
            *("control_set", "state_set", "control_spectrum", "state_spectrum", "stage_rows"),
        ),
    )
    schema, name = tables["schema"], tables.get("name", "")
    if isinstance(schema, bool) or not isinstance(schema, int) or schema != SCHEMA:
        raise ProblemError("schema", brief(schema), f"{SCHEMA}", "Another version of this package may have written it.")
    if not isinstance(name, str):
        raise ProblemError("name", brief(name), "text in quotes")
    return OptimalControlProblem(
        dynamics=_dynamics(tables["dynamics"]),
        horizon=tables["horizon"],
        cost=_cost(tables["cost"]),
        control_set=_set("control_set", tables),
        state_set=_set("state_set", tables),
        initial_state=_end("initial_state", tables),
        terminal_state=_end("terminal_state", tables),
        control_spectrum=_bands("control_spectrum", tables),
        state_spectrum=_bands("state_spectrum", tables),
        stage_rows=_rows(tables.get("stage_rows")),
        name=name,
    )


def tables_from_problem(problem: OptimalControlProblem) -> dict[str, Any]:
    """Return the tables from which ``problem_from_tables`` makes an equal problem; arrays are numpy arrays."""
    tables = {
        "schema": SCHEMA,
        "name": problem.name,
        "horizon": problem.horizon,
        "initial_state": _table_of_end(problem.initial_state),
        "terminal_state": _table_of_end(problem.terminal_state),
        "dynamics": _table_of_dynamics(problem.dynamics),
        "cost": _table_of_cost(problem.cost),
        "control_set": _table_of_set("control_set", problem.control_set, problem.control_dim, problem.horizon),
        "state_set": _table_of_set("state_set", problem.state_set, problem.state_dim, problem.horizon + 1),
        "control_spectrum": _tables_of_bands(problem.control_spectrum),
        "state_spectrum": _tables_of_bands(problem.state_spectrum),
        "stage_rows": [_table_of_rows(rows) for rows in problem.stage_rows] or None,
    }
    return {key: value for key, value in tables.items() if value is not None}


def _dynamics(table: Any) -> LinearDynamics:
    name_keys = ("state_names", "control_names")
    require_keys("dynamics", table, ("A", "B"), ("offset", "continuous", "sampling_time", *name_keys))
    for key in name_keys:
        if key in table and not isinstance(table[key], list):
            raise ProblemError(f"dynamics.{key}", brief(table[key]), "a list of names")
    arguments = dict(table)
    continuous = arguments.pop("continuous", False)
    if not isinstance(continuous, bool):
        raise ProblemError("dynamics.continuous", brief(continuous), "true or false")
    with placed("dynamics"):
        if not continuous:
            return LinearDynamics(**arguments)
        if "sampling_time" not in arguments:
            raise ProblemError("sampling_time", "nothing", "seconds per step", "A continuous model is sampled with it.")
        return LinearDynamics.from_continuous(**arguments)


def _table_of_dynamics(dynamics: LinearDynamics) -> dict[str, Any]:
    table: dict[str, Any] = {"A": dynamics.A, "B": dynamics.B}
    if dynamics.offset.any() or dynamics.offset.ndim > 1:
        table["offset"] = dynamics.offset
    if dynamics.sampling_time is not None:
        table["sampling_time"] = dynamics.sampling_time
    return table | {"state_names": list(dynamics.state_names), "control_names": list(dynamics.control_names)}


def _cost(table: Any) -> QuadraticCost:
    require_keys("cost", table, optional=DIMENSIONS_OF_COST)
    with placed("cost"):
        return QuadraticCost(**table)


def _table_of_cost(cost: QuadraticCost) -> dict[str, Any]:
    terms = {field: getattr(cost, field) for field in DIMENSIONS_OF_COST}
    return {field: term for field, term in terms.items() if term.any() or term.ndim > DIMENSIONS_OF_COST[field]}


def _set(field: str, tables: Mapping[str, Any]) -> Box | None:
    if field not in tables:
        return None
    table = tables[field]
    require_keys(field, table, optional=("lower", "upper"))
    with placed(field, "Box"):
        return Box(table.get("lower"), table.get("upper"))


def _table_of_set(field: str, given: Box | Sequence[Box] | None, dimension: int, times: int) -> dict[str, Any] | None:
    if given is None:
        return None
    box = given if isinstance(given, Box) else stacked(field, given, dimension, times)
    return {"lower": box.lower, "upper": box.upper}


def _end(field: str, tables: Mapping[str, Any]) -> Box | None:
    if field not in tables or isinstance(tables[field], Mapping):
        return _set(field, tables)
    with placed(field, "Point"):
        return Point(tables[field])


def _table_of_end(end: Box) -> Any:
    if end.fixed.all():
        return end.lower
    free = np.isinf(end.lower).all() and np.isinf(end.upper).all()
    return None if free else {"lower": end.lower, "upper": end.upper}


def _bands(field: str, tables: Mapping[str, Any]) -> Band | list[Band] | None:
    given = tables.get(field)
    if given is None or isinstance(given, Mapping):
        return None if given is None else band_from_table(field, given)
    if not isinstance(given, list):
        raise ProblemError(field, brief(given), f"tables that begin with [[{field}]]")
    return [band_from_table(f"{field}[{i}]", table) for i, table in enumerate(given)]


def _tables_of_bands(given: Band | Sequence[Band] | None) -> list[dict[str, Any]] | None:
    bands = [] if given is None else [given] if isinstance(given, Band) else given
    return [table_from_band(band) for band in bands] or None


def _rows(given: Any) -> StageRows | list[StageRows] | None:
    if given is None or isinstance(given, Mapping):
        return None if given is None else _rows_from_table("stage_rows", given)
    if not isinstance(given, list):
        raise ProblemError("stage_rows", brief(given), "tables that begin with [[stage_rows]]")
    return [_rows_from_table(f"stage_rows[{i}]", table) for i, table in enumerate(given)]


def _rows_from_table(place: str, table: Any) -> StageRows:
    require_keys(place, table, required=("e",), optional=("C", "D", "name"))
    named = {"name": table["name"]} if "name" in table else {}
    with placed(place, "stage_rows"):
        return StageRows(table.get("C"), table.get("D"), table["e"], **named)


def _table_of_rows(rows: StageRows) -> dict[str, Any]:
    """Leave out a matrix of zeros: without it, the same one is made again; but one of the two stays."""
    without_C, without_D = (not part.any() and part.ndim == 2 for part in (rows.C, rows.D))
    table: dict[str, Any] = {"name": rows.name}
    if not without_C:
        table["C"] = rows.C
    if not without_D or without_C:
        table["D"] = rows.D
    return table | {"e": rows.e}
