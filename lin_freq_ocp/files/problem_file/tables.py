"""A problem as plain tables, and back: the layout of the problem file, without the file."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.files.locations import OTHER_VERSION, FileTable, FileValue, located, readable, versions
from lin_freq_ocp.files.problem_file.codec import Kinds, Record, Tables, Value, checked, nonzero
from lin_freq_ocp.files.problem_file.dynamics import DYNAMICS, without_zeros
from lin_freq_ocp.problem.costs.norms import L1Cost, LInfCost
from lin_freq_ocp.problem.costs.quadratic import Cost, CostSum, QuadraticCost
from lin_freq_ocp.problem.hybrid.finite import FiniteSet
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import Intersection
from lin_freq_ocp.problem.sets.box import Box, Everything, Point
from lin_freq_ocp.problem.sets.convex import Ball, Ellipsoid, Polyhedron, SecondOrderCone, Soft
from lin_freq_ocp.problem.sets.linked_ends import LinkedEnds, Periodic
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import Band, LinearConstraint, band_pass, high_pass, low_pass, notch, stop_band
from lin_freq_ocp.problem.spectrum.base import OutputSpectrum
from lin_freq_ocp.problem.spectrum.bounds import NO_LOWER_MASK, EnergyBound, MagnitudeBound
from lin_freq_ocp.problem.spectrum.residual_vibration import ResidualVibration
from lin_freq_ocp.problem.spectrum.spectrogram import Spectrogram

SCHEMA = 2  # version of the layout; earlier ones are read, as what was added since is optional

SETS = Kinds("set", default="box")
SETS.records |= {
    "box": Record(Box, classes=(Box, Point, Everything)),
    "polyhedron": Record(Polyhedron),
    "ball": Record(Ball),
    "ellipsoid": Record(Ellipsoid),
    "second_order_cone": Record(SecondOrderCone),
    "intersection": Record(Intersection, sets=Tables(SETS, single=False)),
    "finite_set": Record(FiniteSet),
    "linked_ends": Record(LinkedEnds),
    "periodic": Record(Periodic),
    "soft": Record(Soft, renamed={"soft_set": "set"}, soft_set=SETS),
}
SET_TABLES = Tables(SETS)


def _read_sets(location: str, given: FileValue) -> FileValue:
    return (SET_TABLES if isinstance(given, list) else SETS).read(location, given)


def _write_sets(location: str, value: FileValue) -> FileValue:
    return (SET_TABLES if isinstance(value, (list, tuple)) else SETS).write(location, value)


def _read_end(location: str, given: FileValue) -> FileValue:
    if isinstance(given, Mapping):
        return SETS.read(location, given)
    with located(location, "Point"):
        return Point(given)


def _write_end(location: str, value: Box) -> FileValue:
    if not value.members and value.fixed.all():
        return value.lower
    free = not value.members and np.isinf(value.lower).all() and np.isinf(value.upper).all()
    return None if free else SETS.write(location, value)


SET_OR_SETS = Value(_read_sets, _write_sets)  # one set for all times, or a list with one per time
# The set of an end of the horizon: a point, which is an array in the file, a table, or nothing for a free end.
END_SET = Value(_read_end, _write_end)

BINS = checked(lambda given: isinstance(given, (list, np.ndarray)), "a list of whole numbers")


class _Band(Record):
    """A kind of band: its edges from ``first`` on are these arguments, in rad/sample or, with _hz, in Hz."""

    def __init__(self, make: Callable[..., Band], *edges: str, first: int = 0):
        super().__init__(make, values=self._keys, bins=BINS)
        self._kind, self._edges, self._first = make.__name__, edges, first

    def holds(self, value: object) -> bool:
        """Whether an object is a band of this kind."""
        return isinstance(value, Band) and value.kind == self._kind

    def _keys(self, band: Band) -> FileTable:
        if band.unit == "bins":
            return {"bins": np.array(band.edges, dtype=np.int64), "component": band.component}
        keys = [f"{name}_hz" if band.unit == "Hz" else name for name in self._edges]
        edges = zip(keys, band.edges[self._first :], strict=False)
        return {key: float(edge) for key, edge in edges} | {"component": band.component}


BANDS = Kinds("band")
BANDS.records |= {
    "low_pass": _Band(low_pass, "cutoff", first=1),  # its first edge is 0
    "high_pass": _Band(high_pass, "cutoff"),  # its second edge is inf
    "band_pass": _Band(band_pass, "lower", "upper"),
    "notch": _Band(notch, "centre", "width"),
    "stop_band": _Band(stop_band),
}


def _bound(bound: MagnitudeBound | EnergyBound) -> FileTable:
    """Return the keys of a bound: bins as a stop band, and a component only where the band does not have it."""
    return {
        "limit": bound.limit,
        "band": bound.band,
        "component": bound.component if bound.band.component is None else None,
        "oversampling": bound.oversampling if bound.oversampling != 1 else None,
        "between": getattr(bound, "between", False) or None,
        "every_frequency": bound.every_frequency or None,
        "hold": getattr(bound, "hold", False) or None,
        "penalty": bound.penalty,
        "window": bound.window,
    }


NO_LOWER = checked(lambda given: False, "an upper limit", NO_LOWER_MASK)
SPECTRUM = Kinds("frequency constraint")
SPECTRUM.records |= BANDS.records
SPECTRUM.records |= {
    "magnitude_bound": Record(MagnitudeBound, own="stop_band", values=_bound, bins=BINS, band=BANDS, at_least=NO_LOWER),
    "energy_bound": Record(EnergyBound, own="stop_band", values=_bound, bins=BINS, band=BANDS),
    "linear_constraint": Record(LinearConstraint),
    "residual_vibration": Record(ResidualVibration),
}
BOUNDS = Kinds("mask or energy bound")
BOUNDS.records |= {kind: SPECTRUM.records[kind] for kind in ("magnitude_bound", "energy_bound")}
SPECTRUM.records["spectrogram"] = Record(Spectrogram, bound=BOUNDS)
OUTPUTS = Record(OutputSpectrum, own="output_spectrum", required=["constraints"], constraints=Tables(SPECTRUM))

NORM_COSTS = Kinds("cost")
NORM_COSTS.records |= {
    kind: Record(make, **dict.fromkeys(("x", "u", "terminal", "x_ref", "u_ref"), nonzero(2)))
    for kind, make in {"L1": L1Cost, "Linf": LInfCost}.items()
}


def _cost(norms: FileValue = None, **terms: FileValue) -> Cost:
    quadratic = QuadraticCost(**terms)
    if norms is None:
        return quadratic
    return CostSum([quadratic, *(norms if isinstance(norms, list) else [norms])])


def _terms(cost: Cost) -> FileTable:
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


def _rows(rows: StageRows) -> FileTable:
    C, D = without_zeros(rows.C, rows.D)
    return {"name": rows.name, "C": C, "D": D, "e": rows.e, "penalty": rows.penalty}


STAGE_ROWS = Record(StageRows, own="stage_rows", required=["e"], values=_rows)


def _problem(schema: int, **fields: FileValue) -> OptimalControlProblem:
    return OptimalControlProblem(**fields)


def _fields(problem: OptimalControlProblem) -> FileTable:
    """Return the keys of a problem in the order of the file; a list of boxes becomes one box with bounds per time."""
    keys = ("name", "horizon", "initial_state", "terminal_state", *PROBLEM.required, *PROBLEM.optional)
    fields = {"schema": SCHEMA} | {key: getattr(problem, key) for key in keys if key != "schema"}
    dynamics, finite = problem.dynamics.given
    if finite is not None:
        if problem.control_set is not finite.hull:
            got, expected = brief(problem.control_set), "the FiniteSet of the dynamics' levels"
            raise ProblemError("control_set", got, expected, "A file has one control set: another cannot stand beside.")
        fields |= {"dynamics": dynamics, "control_set": finite}
    for key, boxes in (("control_set", problem.control_tube), ("state_set", problem.state_boxes)):
        given = fields[key]
        if isinstance(given, (list, tuple)) and not any(member.members for member in given):
            fields[key] = boxes
    return fields


PROBLEM = Record(
    _problem,
    like=OptimalControlProblem,
    values=_fields,
    schema=checked(lambda given: readable(given, SCHEMA), versions(SCHEMA), OTHER_VERSION),
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


def problem_from_tables(tables: Mapping[str, FileValue]) -> OptimalControlProblem:
    """Return the problem of tables with arrays as nested lists or numpy arrays; ProblemError names the field there."""
    return PROBLEM.read("", tables)
