"""A problem as plain tables, and back: the layout of the problem file, without the file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lin_freq_ocp.interchange.problem_file.codec import Kinds, Record, Tables, checked, nonzero
from lin_freq_ocp.interchange.problem_file.dynamics import DYNAMICS, without_zeros
from lin_freq_ocp.interchange.problem_file.sets import END_SET, SET_OR_SETS
from lin_freq_ocp.interchange.problem_file.spectrum import OUTPUTS, SPECTRUM
from lin_freq_ocp.problem.costs.norms import L1Cost, LInfCost
from lin_freq_ocp.problem.costs.quadratic import Cost, CostSum, QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.stage_rows import StageRows

SCHEMA = 1
"""Version of the layout; a file with another one is refused."""

NORM_COSTS = Kinds("cost")
NORM_COSTS.records |= {
    kind: Record(make, **dict.fromkeys(("x", "u", "terminal", "x_ref", "u_ref"), nonzero(2)))
    for kind, make in {"L1": L1Cost, "Linf": LInfCost}.items()
}


def _cost(norms: Any = None, **terms: Any) -> Cost:
    quadratic = QuadraticCost(**terms)
    if norms is None:
        return quadratic
    return CostSum([quadratic, *(norms if isinstance(norms, list) else [norms])])


def _terms(cost: Cost) -> dict[str, Any]:
    terms = {key: getattr(cost.quadratic, key) for key in COST.optional if key != "norms"}
    return terms | {"norms": cost.norms}


COST = Record(
    _cost,
    like=QuadraticCost,
    values=_terms,
    norms=Tables(NORM_COSTS),
    **dict.fromkeys(("Q", "R", "S", "P"), nonzero(2)),
    **dict.fromkeys(("q", "r", "p", "x_ref", "u_ref"), nonzero(1)),
)


def _rows(rows: StageRows) -> dict[str, Any]:
    C, D = without_zeros(rows.C, rows.D)
    return {"name": rows.name, "C": C, "D": D, "e": rows.e, "penalty": rows.penalty}


STAGE_ROWS = Record(StageRows, own="stage_rows", required=["e"], values=_rows)


def _problem(schema: int, **fields: Any) -> OptimalControlProblem:
    return OptimalControlProblem(**fields)


def _fields(problem: OptimalControlProblem) -> dict[str, Any]:
    """Return the keys of a problem in the order of the file; a list of boxes becomes one box with bounds per time."""
    keys = ("name", "horizon", "initial_state", "terminal_state", *PROBLEM.required, *PROBLEM.optional)
    fields = {"schema": SCHEMA} | {key: getattr(problem, key) for key in keys if key != "schema"}
    for key, boxes in (("control_set", problem.control_tube), ("state_set", problem.state_boxes)):
        given = fields[key]
        if isinstance(given, (list, tuple)) and not any(one.members for one in given):
            fields[key] = boxes
    return fields


PROBLEM = Record(
    _problem,
    like=OptimalControlProblem,
    values=_fields,
    schema=checked(
        lambda given: type(given) is int and given == SCHEMA,
        f"{SCHEMA}",
        "Another version of this package may have written it.",
    ),
    name=checked(lambda given: isinstance(given, str), "text in quotes"),
    dynamics=DYNAMICS,
    cost=COST,
    initial_state=END_SET,
    terminal_state=END_SET,
    control_set=SET_OR_SETS,
    state_set=SET_OR_SETS,
    control_spectrum=Tables(SPECTRUM),
    state_spectrum=Tables(SPECTRUM),
    stage_rows=Tables(STAGE_ROWS),
    output_spectrum=Tables(OUTPUTS),
)


def problem_from_tables(tables: Mapping[str, Any]) -> OptimalControlProblem:
    """Return the problem the tables describe; arrays are nested lists or numpy arrays.

    Raises
    ------
    ProblemError
        With the field as it stands in the file (``"dynamics.A"``).
    """
    return PROBLEM.read("", tables)


def tables_from_problem(problem: OptimalControlProblem) -> dict[str, Any]:
    """Return the tables from which ``problem_from_tables`` makes an equal problem; arrays are numpy arrays."""
    return PROBLEM.write("", problem)
