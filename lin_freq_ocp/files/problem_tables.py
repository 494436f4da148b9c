"""A problem as plain tables, and back: the layout of the problem file, without the file.

Each class has one record, from which its reader and its writer follow: first the kinds of dynamics (A and B of a linear
model, one table for each mode of a piecewise model, formulas, a frequency response, a pulse train), then sets, bands,
frequency constraints, costs and joint rows, and last the problem itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, brief, positive_integer, real_array
from lin_freq_ocp.base.errors import ProblemError, rename_field
from lin_freq_ocp.files.codec import Kinds, TableRecord, Tables, Value, checked_value, nonzero
from lin_freq_ocp.files.reading import OTHER_VERSION, FileTable, FileValue, at_location, readable, versions
from lin_freq_ocp.formulas.nodes import Formula, nodes_in_order
from lin_freq_ocp.formulas.text import formula_from_text, read_definitions, require_formula, with_definitions
from lin_freq_ocp.problem.costs.formula_cost import SmoothCost
from lin_freq_ocp.problem.costs.norms import L1Cost, LInfCost
from lin_freq_ocp.problem.costs.quadratic import Cost, CostSum, QuadraticCost
from lin_freq_ocp.problem.dynamics.base import Dynamics, entry_for
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.affine_mode import MODE, AffineMode
from lin_freq_ocp.problem.hybrid.levels import FiniteSet
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode
from lin_freq_ocp.problem.hybrid.pulse_train import PulseTrain
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import Intersection
from lin_freq_ocp.problem.sets.box import Box, Everything, Point
from lin_freq_ocp.problem.sets.convex import Ball, Ellipsoid, Polyhedron, SecondOrderCone, Soft
from lin_freq_ocp.problem.sets.linked_ends import LinkedEnds, Periodic
from lin_freq_ocp.problem.sets.path_constraint import PathConstraint
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import Band, LinearConstraint, band_pass, high_pass, low_pass, notch, stop_band
from lin_freq_ocp.problem.spectrum.base import OutputSpectrum
from lin_freq_ocp.problem.spectrum.bounds import NO_LOWER_MASK, EnergyBound, MagnitudeBound
from lin_freq_ocp.problem.spectrum.residual_vibration import ResidualVibration
from lin_freq_ocp.problem.spectrum.spectrogram import Spectrogram
from lin_freq_ocp.transform.reformulations import rate_limited
from lin_freq_ocp.uncertainty.discs import Discs, discs_of
from lin_freq_ocp.uncertainty.disturbance import Disturbance
from lin_freq_ocp.uncertainty.loads import Gaussian, Records
from lin_freq_ocp.uncertainty.plants import Plants
from lin_freq_ocp.uncertainty.protocol import RobustProblem
from lin_freq_ocp.uncertainty.protocol import robust as tightened

FORMULA_KEYS = ("f", "region", "domain")


def _linear(
    A: FileValue,
    B: FileValue,
    offset: FileValue = None,
    sampling_time: FileValue = None,
    state_names: FileValue = None,
    control_names: FileValue = None,
    known_states: FileValue = None,
    continuous: bool = False,
    disturbance: FileValue = None,
    d: FileValue = None,
) -> LinearDynamics:
    for key, value in (("disturbance", disturbance), ("d", d)):
        if value is not None and not continuous:
            raise ProblemError(key, "values", "none without continuous = true", "Add it to the offset, one per time.")
    if not continuous:
        return LinearDynamics(A, B, offset, sampling_time, state_names, control_names, known_states=known_states)
    if known_states is not None:
        raise ProblemError("known_states", "names", "none of a continuous model", "Give A and B sampled.")
    if sampling_time is None:
        raise ProblemError("sampling_time", "nothing", "seconds per step", "A continuous model is sampled with it.")
    names = {"state_names": state_names, "control_names": control_names}
    return LinearDynamics.from_continuous(A, B, sampling_time, offset, disturbance=disturbance, d=d, **names)


def without_zeros(first: Array, second: Array) -> tuple[Array | None, Array | None]:
    """Return two matrices of the same rows, None for those of zeros; the second stays if both are zero."""
    left, right = (part if part.any() or part.ndim > 2 else None for part in (first, second))
    return left, second if left is None else right


def _mode_values(mode: AffineMode) -> FileTable:
    linear, region = mode.linear, mode.region
    table = {"name": mode.name or None, "A": linear.A, "B": linear.B, "offset": linear.offset}
    G, H = without_zeros(region.C, region.D)
    trivial = not (region.C.any() or region.D.any()) and region.C.ndim == region.D.ndim == 2
    if trivial and mode.everywhere and region.e.shape == (1,):
        return table
    return table | {"G": G, "H": H, "h": region.e}


def _from_formulas(
    f: FileValue, control_dim: FileValue, let: FileValue = None, domain: FileValue = (), **labels: FileValue
) -> PiecewiseSmoothDynamics:
    (mode,), n, m = _parse_modes({"dynamics": SmoothMode(f, domain=domain)}, control_dim, let)
    return PiecewiseSmoothDynamics.from_formulas(mode.f, n, m, domain=mode.domain, **labels)


def _from_modes(
    modes: list[SmoothMode], control_dim: FileValue, let: FileValue = None, **labels: FileValue
) -> PiecewiseSmoothDynamics:
    by_location = {f"dynamics.modes[{i}]": mode for i, mode in enumerate(modes)}
    return PiecewiseSmoothDynamics(*_parse_modes(by_location, control_dim, let), **labels)


def _parse_modes(
    modes: Mapping[str, SmoothMode], control_dim: FileValue, let: FileValue
) -> tuple[list[SmoothMode], int, int]:
    """Return modes, by their location, with their texts parsed, n, and m; their class refuses other values."""
    f = next(iter(modes.values())).f
    n, m = max(len(f), 1) if isinstance(f, list) else 1, positive_integer("control_dim", control_dim)
    known, parsed = read_definitions("dynamics.let", {} if let is None else let, (n, m)), list[SmoothMode]()
    for location, mode in modes.items():
        formulas: FileTable = {}
        for key in FORMULA_KEYS:
            given = getattr(mode, key)
            if isinstance(given, (str, list)):
                formulas[key] = [
                    formula_from_text(f"{location}.{key}[{i}]", text, (n, m), known) if isinstance(text, str) else text
                    for i, text in enumerate([given] if isinstance(given, str) else given)
                ]
        parsed.append(replace(mode, **formulas))
    return parsed, n, m


def _response(
    G_real: FileValue,
    G_imag: FileValue,
    offset_real: FileValue = None,
    offset_imag: FileValue = None,
    disturbance: FileValue = None,
    mode: FileValue = "periodic",
    **labels: FileValue,
) -> FrequencyResponse:
    G, offset = _complex("G", G_real, G_imag), None
    if offset_real is not None or offset_imag is not None:
        offset = _complex("offset", offset_real, offset_imag)
    return FrequencyResponse(G, offset=offset, disturbance=disturbance, mode=mode, **labels)


def _complex(field: str, real: FileValue, imaginary: FileValue) -> ComplexArray:
    """Return the complex array of two keys, both of which must be there with the same shape."""
    parts = [real_array(f"dynamics.{field}_{part}", one) for part, one in (("real", real), ("imag", imaginary))]
    if parts[0].shape != parts[1].shape:
        expected = f"that of {field}_real, {parts[0].shape}"
        raise ProblemError(f"dynamics.{field}_imag", f"shape {parts[1].shape}", expected)
    return parts[0] + 1j * parts[1]


def _response_values(dynamics: FrequencyResponse) -> FileTable:
    table: FileTable = {"G_real": dynamics.G.real, "G_imag": dynamics.G.imag}
    if dynamics.offset.any():
        table |= {"offset_real": dynamics.offset.real, "offset_imag": dynamics.offset.imag}
    keys = ("disturbance", "mode", "sampling_time", "state_names", "control_names")
    return table | {key: getattr(dynamics, key) for key in keys}


def _labels(sampling_time: object = None, state_names: object = None, control_names: object = None) -> None:
    """Declare the arguments that all dynamics share."""


def _smooth_values(dynamics: PiecewiseSmoothDynamics) -> FileTable:
    """Return the keys of dynamics by formulas, with ``let`` if formulas are long or share subexpressions."""
    formulas = {
        f"dynamics.modes[{i}].{key}[{j}]": formula
        for i, mode in enumerate(dynamics.modes)
        for key in FORMULA_KEYS
        for j, formula in enumerate(getattr(mode, key))
    }
    texts, definitions = _texts(formulas)
    left = iter(texts)
    modes = [
        replace(mode, **{key: [next(left) for _ in getattr(mode, key)] for key in FORMULA_KEYS})
        for mode in dynamics.modes
    ]
    names = {key: getattr(dynamics, key) for key in ("control_dim", "sampling_time", "state_names", "control_names")}
    return names | {"let": definitions or None, "modes": modes}


AFFINE_MODE = TableRecord(AffineMode, own=MODE, values=_mode_values, offset=nonzero(1))
SMOOTH_MODE = TableRecord(
    SmoothMode, values=lambda mode: {key: getattr(mode, key) or None for key in ("name", *FORMULA_KEYS)}
)

LINEAR = TableRecord(
    _linear,
    own="dynamics",
    classes=(LinearDynamics,),
    offset=nonzero(1),
    continuous=checked_value(lambda given: isinstance(given, bool), "true or false"),
)
PIECEWISE_AFFINE = TableRecord(PiecewiseAffineDynamics, modes=Tables(AFFINE_MODE, single=False))
SMOOTH_MODES = TableRecord(
    _from_modes,
    like=_labels,
    classes=(PiecewiseSmoothDynamics,),
    values=_smooth_values,
    modes=Tables(SMOOTH_MODE, single=False),
)
SMOOTH = TableRecord(_from_formulas, like=_labels)

RESPONSE = TableRecord(_response, "dynamics", _labels, (FrequencyResponse,), _response_values)
MEASURED = TableRecord(FrequencyResponse.from_table, own="dynamics")

PULSE_TRAIN = TableRecord(PulseTrain)

RECORDS: dict[type, TableRecord] = {
    FrequencyResponse: RESPONSE,
    PulseTrain: PULSE_TRAIN,
    LinearDynamics: LINEAR,
    PiecewiseAffineDynamics: PIECEWISE_AFFINE,
    PiecewiseSmoothDynamics: SMOOTH_MODES,
}


def _read_dynamics(location: str, given: FileValue) -> Dynamics:
    keys = given if isinstance(given, Mapping) else {}
    modes = keys.get("modes")
    smooth = isinstance(modes, list) and any(isinstance(mode, Mapping) and "f" in mode for mode in modes)
    with_modes = SMOOTH_MODES if smooth else PIECEWISE_AFFINE
    kinds = {"table": MEASURED, "G_real": RESPONSE, "f": SMOOTH, "orders": PULSE_TRAIN, "modes": with_modes}
    return next((record for key, record in kinds.items() if key in keys), LINEAR).read(location, given)


def _write_dynamics(location: str, value: Dynamics) -> FileTable:
    """Return the table of dynamics, of another class that of their standard form."""
    record = entry_for(RECORDS, value)
    return record.write(location, value if record.holds(value) else value.standard_form)


# Dynamics of every kind: a table with ``A`` and ``B``, with formulas ``f``, with ``modes`` of either form, or with
# ``orders`` of a pulse train.
DYNAMICS = Value(_read_dynamics, _write_dynamics)


def _finite_set_values(finite: FiniteSet) -> FileTable:
    """Return the keys of a finite set; a component without levels is a table with its bounds."""
    ends = [dict(zip(("lower", "upper"), component.ends, strict=True)) for component in finite.components]
    each = [one.values if len(one.values) else ends[i] for i, one in enumerate(finite.components)]
    levels = finite.levels if finite.single else each
    return {"levels": levels, "costs": finite.costs, "duty_cycles": finite.duty_cycles or None}


SCHEMA = 2  # version of the layout; earlier ones are read, as what was added since is optional

SETS = Kinds("set", default="box")
SETS.records |= {
    "box": TableRecord(
        Box, classes=(Box, Point, Everything), values=lambda box: {"lower": box.lower, "upper": box.upper}
    ),
    "polyhedron": TableRecord(Polyhedron),
    "ball": TableRecord(Ball),
    "ellipsoid": TableRecord(Ellipsoid),
    "second_order_cone": TableRecord(SecondOrderCone),
    "intersection": TableRecord(Intersection, sets=Tables(SETS, single=False)),
    "finite_set": TableRecord(FiniteSet, values=_finite_set_values),
    "linked_ends": TableRecord(LinkedEnds),
    "periodic": TableRecord(Periodic),
    "soft": TableRecord(Soft, renamed={"soft_set": "set"}, soft_set=SETS),
}
SET_TABLES = Tables(SETS)
SET_KEYS = {"kind", "lower", "upper"}  # one of them is in the table of a set


def _read_end(location: str, given: FileValue) -> FileValue:
    if isinstance(given, Mapping) and not SET_KEYS.isdisjoint(given):
        return SETS.read(location, given)
    if isinstance(given, Mapping):  # the state by the names of its components
        return given
    with at_location(location, "Point"):
        return Point(given)


def _write_end(location: str, value: Box) -> FileValue:
    if not value.members and value.fixed.all():
        return value.lower
    free = not value.members and np.isinf(value.lower).all() and np.isinf(value.upper).all()
    return None if free else SETS.write(location, value)


# One set for all times, or a list with one per time.
SET_OR_SETS = Value(
    lambda location, given: (SET_TABLES if isinstance(given, list) else SETS).read(location, given),
    lambda location, value: (SET_TABLES if isinstance(value, (list, tuple)) else SETS).write(location, value),
)
# The set of an end of the horizon: a point, which is an array in the file, a table, or nothing for a free end.
END_SET = Value(_read_end, _write_end)

BINS = checked_value(lambda given: isinstance(given, (list, np.ndarray)), "a list of whole numbers")


class _Band(TableRecord):
    """A kind of band: its edges from ``first`` on are these arguments, in rad/sample or, with _hz, in Hz."""

    def __init__(self, make: Callable[..., Band], *edges: str, first: int = 0, required: Sequence[str] = ()):
        super().__init__(make, values=self._keys, required=required, bins=BINS)
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
    "stop_band": _Band(stop_band, required=["bins"]),
}


REFER = {"percent": "of", "db": "reference", "limit_db": "reference"}  # of keywords: what their limits refer to


def _bound_values(bound: MagnitudeBound | EnergyBound) -> FileTable:
    """Return the keys of a bound: bins as a stop band, and a component only where the band does not have it."""
    quantity, listed = bound.quantity, bound.band.unit == "harmonics"
    return {
        "limit" if quantity.keyword == "energy" else quantity.keyword: bound.limit,
        REFER.get(quantity.keyword, "of"): quantity.reference if quantity.keyword in REFER else None,
        "phase": quantity.phase if quantity.of_fundamental else None,
        "harmonics": np.array(bound.band.edges, dtype=np.int64) if listed else None,
        "fundamental_hz": bound.fundamental_hz,
        "band": None if listed else bound.band,
        "component": bound.component if bound.band.component is None else None,
        "oversampling": bound.oversampling if bound.oversampling != 1 else None,
        "between": getattr(bound, "between", False) or None,
        "edges": bound.edges or None,
        "every_frequency": bound.every_frequency or None,
        "hold": getattr(bound, "hold", False) or None,
        "penalty": bound.penalty,
        "window": bound.window,
    }


NO_LOWER = checked_value(lambda given: False, "an upper limit", NO_LOWER_MASK)
SPECTRUM = Kinds("frequency constraint")
SPECTRUM.records |= BANDS.records
SPECTRUM.records |= {
    "magnitude_bound": TableRecord(
        MagnitudeBound, own="stop_band", values=_bound_values, bins=BINS, band=BANDS, at_least=NO_LOWER
    ),
    "energy_bound": TableRecord(EnergyBound, own="stop_band", values=_bound_values, bins=BINS, band=BANDS),
    "linear_constraint": TableRecord(LinearConstraint),
    "residual_vibration": TableRecord(ResidualVibration, relative=Value(write=lambda location, value: value or None)),
}
BOUNDS = Kinds("mask or energy bound")
BOUNDS.records |= {kind: SPECTRUM.records[kind] for kind in ("magnitude_bound", "energy_bound")}
SPECTRUM.records["spectrogram"] = TableRecord(Spectrogram, bound=BOUNDS)
OUTPUTS = TableRecord(OutputSpectrum, own="output_spectrum", required=["constraints"], constraints=Tables(SPECTRUM))


def _texts(formulas: Mapping[str, Formula]) -> tuple[list[str], dict[str, str]]:
    """Return formulas, by the fields that errors name, as texts, and the named formulas that long ones use."""
    for field, formula in formulas.items():
        for node in nodes_in_order([formula]):
            require_formula(node, field)
    return with_definitions(list(formulas.values()))


def _formula_cost_values(cost: SmoothCost) -> FileTable:
    """Return the keys of a cost by formulas, with ``let`` if they are long."""
    given = {key: one for key, one in zip(("stage", "terminal"), cost.formulas, strict=True) if one is not None}
    texts, definitions = _texts({f"cost.norms.{key}": one for key, one in given.items()})
    return dict(zip(given, texts, strict=True)) | {"let": definitions or None}


NORM_COSTS = Kinds("cost")
NORM_COSTS.records |= {
    kind: TableRecord(make, **dict.fromkeys(("x", "u", "terminal", "x_ref", "u_ref"), nonzero(2)))
    for kind, make in {"L1": L1Cost, "Linf": LInfCost}.items()
}
NORM_COSTS.records["formula"] = TableRecord(SmoothCost, values=_formula_cost_values)


def _cost(norms: FileValue = None, **terms: FileValue) -> Cost:
    quadratic = QuadraticCost(**terms)
    if norms is None:
        return quadratic
    return CostSum([quadratic, *(norms if isinstance(norms, list) else [norms])])


COST = TableRecord(
    _cost,
    like=QuadraticCost,
    values=lambda cost: {key: getattr(cost if key == "norms" else cost.quadratic, key) for key in COST.optional},
    norms=Tables(NORM_COSTS),
    **dict.fromkeys(("Q", "R", "S", "P"), nonzero(2)),
    **dict.fromkeys(("q", "r", "p", "x_ref", "u_ref"), nonzero(1)),
)


def _row_values(rows: StageRows) -> FileTable:
    C, D = without_zeros(rows.C, rows.D)
    return {"name": rows.name, "C": C, "D": D, "e": rows.e, "penalty": rows.penalty}


def _path_values(rows: PathConstraint) -> FileTable:
    """Return the keys of a path constraint, with ``let`` if its formulas are long."""
    texts, definitions = _texts({f"stage_rows.h[{i}]": formula for i, formula in enumerate(rows.formulas)})
    values = {"h": texts, "name": rows.name, "upper": rows.e if rows.e.any() else None, "price": rows.price}
    return values | {"convex": rows.convex or None, "let": definitions or None}


STAGE_ROWS = Kinds("family of rows", default="linear")
STAGE_ROWS.records |= {
    "linear": TableRecord(StageRows, own="stage_rows", required=["e"], values=_row_values),
    "formula": TableRecord(PathConstraint, own="stage_rows", values=_path_values),
}


def _keys(**given: FileValue) -> FileTable:
    """Return the keys of a table whose function takes the problem of the others, too."""
    return given


LOADS = Kinds("set of loads", default="box")
LOADS.records |= {kind: SETS.records[kind] for kind in ("box", "polyhedron", "ball", "ellipsoid")}
LOADS.records |= {"records": TableRecord(Records), "gaussian": TableRecord(Gaussian)}
LOAD_SET = Value(  # a table, or an array of measured loads
    lambda location, given: LOADS.read(location, given) if isinstance(given, Mapping) else given,
    lambda location, value: value if isinstance(value, (list, np.ndarray)) else LOADS.write(location, value),
)
MADE_OF = "rate_limit", "disturbance", "discs", "plants", "plant_shares", "robust"  # what changes the problem of others
NO_FEEDBACK = "none"  # TOML has no null
ANY: FileValue = None  # in place of the problem of the other tables
GAIN = Value(lambda location, given: None if isinstance(given, str) and given == NO_FEEDBACK else given)
DISTURBANCE = TableRecord(
    Disturbance,
    own="disturbance",
    values=lambda load: vars(load) | {"gain": NO_FEEDBACK if load.gain is None else load.gain},
    set=LOAD_SET,
    gain=GAIN,
    start=SETS,
)


def _problem(
    schema: int,
    rate_limit: FileTable | None = None,
    disturbance: Disturbance | None = None,
    discs: Callable[[OptimalControlProblem], Discs] | None = None,
    plants: Sequence[Dynamics] | None = None,
    plant_shares: FileValue = None,
    robust: FileTable | None = None,
    **fields: FileValue,
) -> OptimalControlProblem:
    problem = given = OptimalControlProblem(**fields)
    within = None if discs is None else discs(given)
    if rate_limit is not None:
        within = within and Discs(within.radii(given), within.cost)  # the last controls, which it adds, are known
        with at_location("rate_limit"):
            problem = rate_limited(problem, **rate_limit)
    if disturbance is None and robust is not None:
        raise ProblemError("robust", "no disturbance", "a table [disturbance] with the set of the loads")
    if plants is None and plant_shares is not None:
        raise ProblemError("plant_shares", brief(plant_shares), "tables [[plants]], whose weights they are")
    with rename_field(lambda field: field.replace("plants.shares", "plant_shares")):
        several = None if plants is None else Plants(plants, plant_shares)
    tables = ("disturbance", disturbance), ("discs", within), ("plants", several)
    stated = [(key, uncertainty) for key, uncertainty in tables if uncertainty is not None]
    if len(stated) > 1:
        raise ProblemError(stated[1][0], f"{stated[0][0]}, too", "one of [disturbance], [discs] and [[plants]]")
    with rename_field(lambda field: {"Records.loads": "disturbance.set.loads", "end": "robust.end"}.get(field, field)):
        return tightened(problem, stated[0][1], **(robust or {})) if stated else problem


def _problem_values(problem: OptimalControlProblem) -> FileTable:
    """Return the keys of a problem in the order of the file; a list of boxes becomes one box with bounds per time."""
    keys = ("name", "horizon", "initial_state", "terminal_state", *PROBLEM.required, *PROBLEM.optional)
    made: FileTable = {}
    if isinstance(problem, RobustProblem) and problem.as_made and problem.uncertainty.stated:
        made = {**problem.uncertainty.stated, "robust": problem if problem.end else None}
        problem = problem.given  # one with other limits is written with the limits that it has
    # a rate limit is written as its states and rows
    fields = {"schema": SCHEMA} | {key: getattr(problem, key) for key in keys if key not in (*MADE_OF, "schema")} | made
    for key, boxes in (("control_set", problem.control_tube), ("state_set", problem.state_boxes)):
        given = fields[key]
        if isinstance(given, (list, tuple)) and not any(member.members for member in given):
            fields[key] = boxes
    return fields


PROBLEM = TableRecord(
    _problem,
    like=OptimalControlProblem,
    values=_problem_values,
    schema=checked_value(lambda given: readable(given, SCHEMA), versions(SCHEMA), OTHER_VERSION),
    name=checked_value(lambda given: isinstance(given, str), "text in quotes"),
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
    rate_limit=TableRecord(_keys, like=partial(rate_limited, ANY)),
    disturbance=DISTURBANCE,
    discs=TableRecord(discs_of, own="discs", values=vars),
    plants=Tables(DYNAMICS, single=False),
    robust=TableRecord(_keys, like=partial(tightened, ANY, ANY)),
)


def problem_from_tables(tables: Mapping[str, FileValue]) -> OptimalControlProblem:
    """Return the problem of tables with arrays as nested lists or numpy arrays; ProblemError names the field there."""
    return PROBLEM.read("", tables)
