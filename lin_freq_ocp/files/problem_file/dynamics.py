"""Dynamics as tables: A and B of a linear model, one table for each mode of a piecewise model, or formulas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lin_freq_ocp.base.arrays import Array, ComplexArray, positive_integer, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.files.locations import FileTable, FileValue
from lin_freq_ocp.files.problem_file.codec import Record, Tables, Value, checked, nonzero
from lin_freq_ocp.formulas.nodes import Formula, in_order
from lin_freq_ocp.formulas.text import defined, formula_from_text, require_formula, with_definitions
from lin_freq_ocp.problem.dynamics.base import Dynamics, entry_for
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.affine_mode import MODE, AffineMode
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode
from lin_freq_ocp.problem.hybrid.pulse_train import PulseTrain

FORMULA_KEYS = ("f", "region", "domain")


def _linear(continuous: bool = False, **arguments: FileValue) -> LinearDynamics:
    if not continuous:
        return LinearDynamics(**arguments)
    if "sampling_time" not in arguments:
        raise ProblemError("sampling_time", "nothing", "seconds per step", "A continuous model is sampled with it.")
    return LinearDynamics.from_continuous(**arguments)


def without_zeros(first: Array, second: Array) -> tuple[Array | None, Array | None]:
    """Return two matrices of the same rows, None for those of zeros; the second stays if both are zero."""
    left, right = (part if part.any() or part.ndim > 2 else None for part in (first, second))
    return left, second if left is None else right


def _mode(mode: AffineMode) -> FileTable:
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
    n, m = _dimensions(f, control_dim)
    mode = _parsed("dynamics", SmoothMode(f, domain=domain), _known(let, n, m), n, m)
    return PiecewiseSmoothDynamics.from_formulas(mode.f, n, m, domain=mode.domain, **labels)


def _from_modes(
    modes: list[SmoothMode], control_dim: FileValue, let: FileValue = None, **labels: FileValue
) -> PiecewiseSmoothDynamics:
    n, m = _dimensions(modes[0].f, control_dim)
    known = _known(let, n, m)
    parsed = [_parsed(f"dynamics.modes[{i}]", mode, known, n, m) for i, mode in enumerate(modes)]
    return PiecewiseSmoothDynamics(parsed, n, m, **labels)


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
        raise ProblemError(
            f"dynamics.{field}_imag", f"shape {parts[1].shape}", f"that of {field}_real, {parts[0].shape}"
        )
    return parts[0] + 1j * parts[1]


def _response_values(dynamics: FrequencyResponse) -> FileTable:
    known = dynamics.offset if dynamics.offset.any() else None
    return {
        "G_real": dynamics.G.real,
        "G_imag": dynamics.G.imag,
        "offset_real": None if known is None else known.real,
        "offset_imag": None if known is None else known.imag,
        "disturbance": dynamics.disturbance,
        "mode": dynamics.mode,
        "sampling_time": dynamics.sampling_time,
        "state_names": dynamics.state_names,
        "control_names": dynamics.control_names,
    }


def _labels(sampling_time: object = None, state_names: object = None, control_names: object = None) -> None:
    """Declare the arguments that all dynamics share."""


def _dimensions(f: object, control_dim: FileValue) -> tuple[int, int]:
    """Return n, the number of formulas, and m."""
    return max(len(f), 1) if isinstance(f, list) else 1, positive_integer("control_dim", control_dim)


def _known(let: FileValue, n: int, m: int) -> dict[str, Formula]:
    return defined("dynamics.let", {} if let is None else let, (n, m))


def _parsed(location: str, mode: SmoothMode, known: Mapping[str, Formula], n: int, m: int) -> SmoothMode:
    """Return the mode with its texts parsed; its class refuses other values."""
    parsed: FileTable = {}
    for key in FORMULA_KEYS:
        given = getattr(mode, key)
        if isinstance(given, (str, list)):
            parsed[key] = [
                formula_from_text(f"{location}.{key}[{i}]", text, (n, m), known) if isinstance(text, str) else text
                for i, text in enumerate([given] if isinstance(given, str) else given)
            ]
    return replace(mode, **parsed)


def _smooth(dynamics: PiecewiseSmoothDynamics) -> FileTable:
    """Return the keys of dynamics by formulas, with ``let`` if formulas are long or share subexpressions."""
    formulas: list[Formula] = []
    for i, mode in enumerate(dynamics.modes):
        for key in FORMULA_KEYS:
            for j, formula in enumerate(getattr(mode, key)):
                for node in in_order([formula]):
                    require_formula(node, f"dynamics.modes[{i}].{key}[{j}]")
                formulas.append(formula)
    texts, definitions = with_definitions(formulas)
    left = iter(texts)
    modes = [
        replace(mode, **{key: [next(left) for _ in getattr(mode, key)] for key in FORMULA_KEYS})
        for mode in dynamics.modes
    ]
    names = {key: getattr(dynamics, key) for key in ("control_dim", "sampling_time", "state_names", "control_names")}
    return names | {"let": definitions or None, "modes": modes}


def _smooth_mode(mode: SmoothMode) -> FileTable:
    return {key: getattr(mode, key) or None for key in ("name", *FORMULA_KEYS)}


AFFINE_MODE = Record(AffineMode, own=MODE, values=_mode, offset=nonzero(1))
SMOOTH_MODE = Record(SmoothMode, values=_smooth_mode)

LINEAR = Record(
    _linear,
    like=LinearDynamics,
    offset=nonzero(1),
    continuous=checked(lambda given: isinstance(given, bool), "true or false"),
)
PIECEWISE_AFFINE = Record(PiecewiseAffineDynamics, modes=Tables(AFFINE_MODE, single=False))
SMOOTH_MODES = Record(
    _from_modes,
    like=_labels,
    classes=(PiecewiseSmoothDynamics,),
    values=_smooth,
    modes=Tables(SMOOTH_MODE, single=False),
)
SMOOTH = Record(_from_formulas, like=_labels)

RESPONSE = Record(_response, like=_labels, classes=(FrequencyResponse,), values=_response_values)
MEASURED = Record(FrequencyResponse.from_table, own="dynamics")

PULSE_TRAIN = Record(PulseTrain)

RECORDS: dict[type, Record] = {
    FrequencyResponse: RESPONSE,
    PulseTrain: PULSE_TRAIN,
    LinearDynamics: LINEAR,
    PiecewiseAffineDynamics: PIECEWISE_AFFINE,
    PiecewiseSmoothDynamics: SMOOTH_MODES,
}


def _read(location: str, given: FileValue) -> Dynamics:
    keys = given if isinstance(given, Mapping) else {}
    modes = keys.get("modes")
    if "table" in keys:
        return MEASURED.read(location, given)
    if "G_real" in keys:
        return RESPONSE.read(location, given)
    if "f" in keys:
        return SMOOTH.read(location, given)
    if "orders" in keys:
        return PULSE_TRAIN.read(location, given)
    if isinstance(modes, list) and any(isinstance(mode, Mapping) and "f" in mode for mode in modes):
        return SMOOTH_MODES.read(location, given)
    return (PIECEWISE_AFFINE if "modes" in keys else LINEAR).read(location, given)


def _write(location: str, value: Dynamics) -> FileTable:
    """Return the table of dynamics, of another class that of their standard form."""
    record = entry_for(RECORDS, value)
    return record.write(location, value if record.holds(value) else value.standard_form)


# Dynamics of every kind: a table with ``A`` and ``B``, with formulas ``f``, with ``modes`` of either form, or with
# ``orders`` of a pulse train.
DYNAMICS = Value(_read, _write)
