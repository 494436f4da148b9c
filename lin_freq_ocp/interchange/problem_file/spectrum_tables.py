"""Frequency constraints as tables: bands, magnitude and energy bounds, linear constraints, and those of outputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.interchange.keys import require_keys
from lin_freq_ocp.interchange.places import placed
from lin_freq_ocp.interchange.problem_file.band_tables import MAKERS, band_from_table, table_from_band
from lin_freq_ocp.problem.spectrum.bands import Band
from lin_freq_ocp.problem.spectrum.bounds import NO_LOWER_MASK, EnergyBound, LinearConstraint, MagnitudeBound
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum

WHERE = ("bins", "band", "component", "penalty", "window", "oversampling")
"""Arguments that magnitude and energy bounds share."""

BOUNDS: dict[str, tuple[Any, tuple[str, ...], tuple[str, ...]]] = {
    "magnitude_bound": (MagnitudeBound, (), ("limit", "limit_db", "reference", *WHERE, "between")),
    "energy_bound": (EnergyBound, ("limit",), WHERE),
    "linear_constraint": (LinearConstraint, ("coefficients",), ("constant", "penalty")),
}
"""What else than bands may stand in a spectrum: class, required and optional arguments."""

OUTPUT_KEYS = ("C", "D", "output_names")
"""Of an output spectrum, beside its constraints."""


def spectrum_from_table(place: str, table: Any) -> Any:
    """Return the frequency constraint of a table; ``place`` is where the table stands in the file."""
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if not isinstance(kind, str) or kind not in BOUNDS:
        if isinstance(kind, str) and kind not in MAKERS:
            known = (*MAKERS, *BOUNDS)
            raise ProblemError(f"{place}.kind", repr(kind), f"one of {', '.join(known)}", suggestion(kind, known))
        return band_from_table(place, table)
    if kind == "magnitude_bound" and "at_least" in table:
        raise ProblemError(f"{place}.at_least", brief(table["at_least"]), "an upper limit", NO_LOWER_MASK)
    maker, required, optional = BOUNDS[kind]
    require_keys(place, table, ("kind", *required), optional)
    arguments = {key: value for key, value in table.items() if key != "kind"}
    if "band" in arguments:
        arguments["band"] = band_from_table(f"{place}.band", arguments["band"])
    if "bins" in arguments and not isinstance(arguments["bins"], (list, np.ndarray)):
        raise ProblemError(f"{place}.bins", brief(arguments["bins"]), "a list of whole numbers")
    with placed(place, maker.__name__, "stop_band"):
        return maker(**arguments)


def table_from_spectrum(one: Any) -> dict[str, Any]:
    """Return the table from which ``spectrum_from_table`` makes the same constraint."""
    if isinstance(one, Band):
        return table_from_band(one)
    if isinstance(one, LinearConstraint):
        table = {"kind": "linear_constraint", "coefficients": one.coefficients, "constant": one.constant}
        return table | _given(one, "penalty")
    kind = "magnitude_bound" if isinstance(one, MagnitudeBound) else "energy_bound"
    table: dict[str, Any] = {"kind": kind, "limit": one.limit, "band": table_from_band(one.band)}
    if one.component is not None and one.band.component is None:
        table["component"] = one.component if isinstance(one.component, str) else int(one.component)
    if one.oversampling != 1:
        table["oversampling"] = one.oversampling
    if isinstance(one, MagnitudeBound) and one.between:
        table["between"] = True
    return table | _given(one, "penalty", "window")


def outputs_from_table(place: str, table: Any) -> OutputSpectrum:
    """Return the constraints on outputs of a table."""
    require_keys(place, table, required=("constraints",), optional=OUTPUT_KEYS)
    given = table["constraints"]
    listed = given if isinstance(given, list) else [given]
    constraints = [spectrum_from_table(f"{place}.constraints[{i}]", one) for i, one in enumerate(listed)]
    with placed(place, "output_spectrum"):
        return OutputSpectrum(table.get("C"), table.get("D"), constraints, table.get("output_names"))


def table_from_outputs(outputs: OutputSpectrum) -> dict[str, Any]:
    """Return the table from which ``outputs_from_table`` makes the same constraints."""
    constraints = [table_from_spectrum(one) for one in outputs.constraints]
    names = list(outputs.output_names)
    return _given(outputs, "C", "D") | {"output_names": names, "constraints": constraints}


def _given(one: Any, *keys: str) -> dict[str, Any]:
    """Return the attributes that are not None."""
    return {key: value for key in keys if (value := getattr(one, key)) is not None}
