"""Frequency bands as tables: ``kind`` is the function that makes the band, the other keys are its arguments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.interchange.keys import require_keys
from lin_freq_ocp.interchange.places import placed
from lin_freq_ocp.problem.spectrum.bands import Band, band_pass, high_pass, low_pass, notch, stop_band

MAKERS: dict[str, Callable[..., Band]] = {
    "low_pass": low_pass,
    "high_pass": high_pass,
    "band_pass": band_pass,
    "notch": notch,
    "stop_band": stop_band,
}
"""The functions that make bands, by the kind of band they make."""

EDGES = {
    "low_pass": ("cutoff",),
    "high_pass": ("cutoff",),
    "band_pass": ("lower", "upper"),
    "notch": ("centre", "width"),
    "stop_band": (),
}
"""Their arguments that are frequencies; each has a second name, with _hz."""


def band_from_table(place: str, table: Any) -> Band:
    """Return the band of a table; ``place`` is where the table stands in the file."""
    require_keys(place, table, required=("kind",), optional=table)  # which others it may have depends on the kind
    kind = table["kind"]
    if not isinstance(kind, str) or kind not in MAKERS:
        raise ProblemError(f"{place}.kind", brief(kind), f"one of {', '.join(MAKERS)}", suggestion(kind, MAKERS))
    frequencies = [name + unit for name in EDGES[kind] for unit in ("", "_hz")]
    bins = ("bins",) if kind == "stop_band" else ()
    require_keys(place, table, required=("kind", *bins), optional=(*frequencies, "component"))
    if bins and not isinstance(table["bins"], (list, np.ndarray)):
        raise ProblemError(f"{place}.bins", brief(table["bins"]), "a list of whole numbers")
    with placed(place, kind):
        return MAKERS[kind](**{key: value for key, value in table.items() if key != "kind"})


def table_from_band(band: Band) -> dict[str, Any]:
    """Return the table from which ``band_from_table`` makes the same band."""
    table: dict[str, Any] = {"kind": band.kind, **_arguments(band)}
    if band.component is not None:
        table["component"] = band.component if isinstance(band.component, str) else int(band.component)
    return table


def _arguments(band: Band) -> dict[str, Any]:
    if band.kind == "stop_band":
        return {"bins": np.array(band.edges, dtype=np.int64)}
    edges = {"low_pass": band.edges[1:], "high_pass": band.edges[:1]}.get(band.kind, band.edges)
    unit = "_hz" if band.unit == "Hz" else ""
    return {name + unit: float(edge) for name, edge in zip(EDGES[band.kind], edges, strict=True)}
