"""A problem as plain tables, and back: the layout of the problem file, without the file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.interchange.keys import require_keys
from lin_freq_ocp.interchange.places import placed
from lin_freq_ocp.interchange.problem_file.dynamics_tables import dynamics_from_table, table_from_dynamics
from lin_freq_ocp.interchange.problem_file.set_tables import sets_from_tables, table_from_set, tables_from_sets
from lin_freq_ocp.interchange.problem_file.spectrum_tables import (
    outputs_from_table,
    spectrum_from_table,
    table_from_outputs,
    table_from_spectrum,
)
from lin_freq_ocp.problem.costs.norms import L1Cost, LInfCost
from lin_freq_ocp.problem.costs.quadratic import Cost, CostSum, QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Point
from lin_freq_ocp.problem.terms.stage_rows import StageRows

SCHEMA = 1
"""Version of the layout; a file with another one is refused."""

DIMENSIONS_OF_COST = {"Q": 2, "R": 2, "S": 2, "q": 1, "r": 1, "P": 2, "p": 1, "x_ref": 1, "u_ref": 1}
"""The terms of a quadratic cost, with the dimensions of each where it does not depend on time."""

NORM_COSTS = {"L1": L1Cost, "Linf": LInfCost}
"""The nonsmooth costs, by their kind in a file."""

NORM_COST_KEYS = ("x", "u", "terminal", "x_ref", "u_ref")

REQUIRED_KEYS = ("schema", "horizon", "dynamics", "cost")

OPTIONAL_KEYS = (
    *("name", "initial_state", "terminal_state"),
    *("control_set", "state_set", "control_spectrum", "state_spectrum", "stage_rows", "output_spectrum"),
)

ROW_KEYS = ("C", "D", "name", "penalty")
"""Of stage rows, beside e."""


def problem_from_tables(tables: Mapping[str, Any]) -> OptimalControlProblem:
    """Return the problem the tables describe; arrays are nested lists or numpy arrays.

    Raises
    ------
    ProblemError
        With the field as it stands in the file (``"dynamics.A"``).
    """
    require_keys("", tables, REQUIRED_KEYS, OPTIONAL_KEYS)
    schema, name = tables["schema"], tables.get("name", "")
    if isinstance(schema, bool) or not isinstance(schema, int) or schema != SCHEMA:
        raise ProblemError("schema", brief(schema), f"{SCHEMA}", "Another version of this package may have written it.")
    if not isinstance(name, str):
        raise ProblemError("name", brief(name), "text in quotes")
    return OptimalControlProblem(
        dynamics=dynamics_from_table(tables["dynamics"]),
        horizon=tables["horizon"],
        cost=_cost(tables["cost"]),
        control_set=sets_from_tables("control_set", tables),
        state_set=sets_from_tables("state_set", tables),
        initial_state=_end("initial_state", tables),
        terminal_state=_end("terminal_state", tables),
        control_spectrum=_each("control_spectrum", tables, spectrum_from_table),
        state_spectrum=_each("state_spectrum", tables, spectrum_from_table),
        stage_rows=_each("stage_rows", tables, _rows_from_table),
        output_spectrum=_each("output_spectrum", tables, outputs_from_table),
        name=name,
    )


def tables_from_problem(problem: OptimalControlProblem) -> dict[str, Any]:
    """Return the tables from which ``problem_from_tables`` makes an equal problem; arrays are numpy arrays."""
    tables = {
        "schema": SCHEMA,
        "name": problem.name,
        "horizon": problem.horizon,
        "initial_state": _table_of_end("initial_state", problem.initial_state),
        "terminal_state": _table_of_end("terminal_state", problem.terminal_state),
        "dynamics": table_from_dynamics(problem.dynamics),
        "cost": _table_of_cost(problem.cost),
        "control_set": tables_from_sets("control_set", problem.control_set, problem.control_dim, problem.horizon),
        "state_set": tables_from_sets("state_set", problem.state_set, problem.state_dim, problem.horizon + 1),
        "control_spectrum": _tables(problem.control_spectrum, table_from_spectrum),
        "state_spectrum": _tables(problem.state_spectrum, table_from_spectrum),
        "stage_rows": _tables(problem.stage_rows, _table_of_rows),
        "output_spectrum": _tables(problem.output_spectrum, table_from_outputs),
    }
    return {key: value for key, value in tables.items() if value is not None}


def _cost(table: Any) -> QuadraticCost | CostSum:
    require_keys("cost", table, optional=(*DIMENSIONS_OF_COST, "norms"))
    given = {key: value for key, value in table.items() if key != "norms"}
    with placed("cost"):
        quadratic = QuadraticCost(**given)
    norms = _each("norms", table, _norm_cost, "cost.")
    if norms is None:
        return quadratic
    return CostSum([quadratic, *(norms if isinstance(norms, list) else [norms])])


def _norm_cost(place: str, table: Any) -> Any:
    require_keys(place, table, required=("kind",), optional=NORM_COST_KEYS)
    kind = table["kind"]
    if not isinstance(kind, str) or kind not in NORM_COSTS:
        known = f"one of {', '.join(NORM_COSTS)}"
        raise ProblemError(f"{place}.kind", brief(kind), known, suggestion(kind, NORM_COSTS))
    with placed(place, NORM_COSTS[kind].__name__):
        return NORM_COSTS[kind](**{key: value for key, value in table.items() if key != "kind"})


def _table_of_cost(cost: Cost) -> dict[str, Any]:
    terms = {field: getattr(cost.quadratic, field) for field in DIMENSIONS_OF_COST}
    table = {field: term for field, term in terms.items() if term.any() or term.ndim > DIMENSIONS_OF_COST[field]}
    return table | ({"norms": [_table_of_norm_cost(one) for one in cost.norms]} if cost.norms else {})


def _table_of_norm_cost(cost: Any) -> dict[str, Any]:
    kind = next((kind for kind, one in NORM_COSTS.items() if type(cost) is one), None)
    if kind is None:
        raise ProblemError("cost", brief(cost), "a cost that a problem file can hold: quadratic, L1Cost or LInfCost")
    given = {key: getattr(cost, key) for key in NORM_COST_KEYS}
    return {"kind": kind, **{key: value for key, value in given.items() if value.any()}}


def _end(field: str, tables: Mapping[str, Any]) -> Any:
    if field not in tables or isinstance(tables[field], Mapping):
        return sets_from_tables(field, tables)
    with placed(field, "Point"):
        return Point(tables[field])


def _table_of_end(field: str, end: Any) -> Any:
    if not end.members and end.fixed.all():
        return end.lower
    free = not end.members and np.isinf(end.lower).all() and np.isinf(end.upper).all()
    return None if free else table_from_set(field, end)


def _each(field: str, tables: Mapping[str, Any], read: Callable[[str, Any], Any], within: str = "") -> Any:
    """Return what a table, or each one of a list of tables, says; None where there is nothing."""
    given, place = tables.get(field), within + field
    if given is None or isinstance(given, Mapping):
        return None if given is None else read(place, given)
    if not isinstance(given, list):
        raise ProblemError(place, brief(given), f"tables that begin with [[{place}]]")
    return [read(f"{place}[{i}]", table) for i, table in enumerate(given)]


def _tables(given: Any, table_of: Callable[[Any], dict[str, Any]]) -> list[dict[str, Any]] | None:
    listed = [] if given is None else given if isinstance(given, (list, tuple)) else [given]
    return [table_of(one) for one in listed] or None


def _rows_from_table(place: str, table: Any) -> StageRows:
    require_keys(place, table, required=("e",), optional=ROW_KEYS)
    named = {key: table[key] for key in ("name", "penalty") if key in table}
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
    return table | {"e": rows.e} | ({} if rows.penalty is None else {"penalty": rows.penalty})
