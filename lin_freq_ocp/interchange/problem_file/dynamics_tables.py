"""Dynamics as tables: A and B of a linear model, one table for each mode of a piecewise one, or formulas."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lin_freq_ocp.arrays import brief, positive_integer
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.formulas.definitions import defined, with_definitions
from lin_freq_ocp.formulas.nodes import Formula, in_order
from lin_freq_ocp.formulas.text import formula_from_text, require_formula
from lin_freq_ocp.interchange.keys import require_keys
from lin_freq_ocp.interchange.places import placed
from lin_freq_ocp.problem.dynamics.affine_mode import MODE, AffineMode
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode

NAME_KEYS = ("state_names", "control_names")

DYNAMICS_KEYS = ("offset", "continuous", "sampling_time", *NAME_KEYS)
"""Of linear dynamics, beside A and B."""

PIECEWISE_KEYS = ("sampling_time", *NAME_KEYS)
"""Of piecewise-affine dynamics, beside modes."""

MODE_KEYS = ("offset", "G", "H", "h", "name")
"""Of a mode, beside A and B."""


SMOOTH_MODE_KEYS = ("region", "domain", "name")
"""Of a mode of piecewise-smooth dynamics, beside f."""

Dynamics = LinearDynamics | PiecewiseAffineDynamics | PiecewiseSmoothDynamics


def dynamics_from_table(table: Any) -> Dynamics:
    """Return the dynamics of a table: piecewise ones if it has modes, of formulas if it has f or its modes have."""
    piecewise, formulas = (isinstance(table, Mapping) and key in table for key in ("modes", "f"))
    if formulas or (piecewise and _has_formulas(table["modes"])):
        return _smooth(table)
    required, optional = (("modes",), PIECEWISE_KEYS) if piecewise else (("A", "B"), DYNAMICS_KEYS)
    require_keys("dynamics", table, required, optional)
    _require_names(table)
    return _piecewise(table) if piecewise else _linear(table)


def _require_names(table: Mapping[str, Any]) -> None:
    for key in NAME_KEYS:
        if key in table and not isinstance(table[key], list):
            raise ProblemError(f"dynamics.{key}", brief(table[key]), "a list of names")


def _has_formulas(modes: Any) -> bool:
    return isinstance(modes, list) and any(isinstance(mode, Mapping) and "f" in mode for mode in modes)


def _smooth(table: Mapping[str, Any]) -> PiecewiseSmoothDynamics:
    """Return piecewise-smooth dynamics, whose number of states is that of the formulas."""
    whole = "f" in table
    required = ("f", "control_dim") if whole else ("modes", "control_dim")
    require_keys("dynamics", table, required, (*PIECEWISE_KEYS, "let", *(("domain",) if whole else ())))
    _require_names(table)
    named = {key: table[key] for key in PIECEWISE_KEYS if key in table}
    with placed("dynamics"):
        if whole:
            n, m = _count(table["f"]), positive_integer("control_dim", table["control_dim"])
            given = _with_formulas("dynamics", table, _known(table, (n, m)), (n, m))
            return PiecewiseSmoothDynamics.from_formulas(given["f"], n, m, domain=given.get("domain", ()), **named)
        for i, one in enumerate(table["modes"]):
            require_keys(f"dynamics.modes[{i}]", one, ("f",), SMOOTH_MODE_KEYS)
        n, m = _count(table["modes"][0]["f"]), positive_integer("control_dim", table["control_dim"])
        known = _known(table, (n, m))
        read = [_with_formulas(f"dynamics.modes[{i}]", one, known, (n, m)) for i, one in enumerate(table["modes"])]
        return PiecewiseSmoothDynamics([SmoothMode(**one) for one in read], n, m, **named)


def _known(table: Mapping[str, Any], dimensions: tuple[int, int]) -> dict[str, Formula]:
    return defined("dynamics.let", table.get("let", {}), dimensions)


def _with_formulas(
    place: str, table: Mapping[str, Any], known: Mapping[str, Formula], dimensions: tuple[int, int]
) -> dict[str, Any]:
    """Return the table with formulas for texts; whatever else stands there, the dynamics refuse."""
    read = dict(table)
    for key in {"f", "region", "domain"} & set(table):
        given = [table[key]] if isinstance(table[key], str) else table[key]
        if isinstance(given, list):
            read[key] = [
                formula_from_text(f"{place}.{key}[{i}]", one, dimensions, known) if isinstance(one, str) else one
                for i, one in enumerate(given)
            ]
    return read


def _count(formulas: Any) -> int:
    return max(len(formulas), 1) if isinstance(formulas, list) else 1


def _smooth_tables(dynamics: PiecewiseSmoothDynamics) -> dict[str, Any]:
    """Return ``modes``, and ``let`` where formulas are long or share what is."""
    places: list[tuple[dict[str, Any], str]] = []
    formulas: list[Formula] = []
    modes: list[dict[str, Any]] = []
    for i, mode in enumerate(dynamics.modes):
        modes.append({"name": mode.name} if mode.name else {})
        for key in ("f", "region", "domain"):
            for j, one in enumerate(getattr(mode, key)):
                for node in in_order([one]):
                    require_formula(node, f"dynamics.modes[{i}].{key}[{j}]")
                places.append((modes[-1], key))
                formulas.append(one)
    texts, definitions = with_definitions(formulas)
    for (table, key), text in zip(places, texts, strict=True):
        table.setdefault(key, []).append(text)
    return ({"let": definitions} if definitions else {}) | {"modes": modes}


def table_from_dynamics(dynamics: Dynamics) -> dict[str, Any]:
    """Return the table from which ``dynamics_from_table`` makes the same dynamics."""
    named: dict[str, Any] = {} if dynamics.sampling_time is None else {"sampling_time": dynamics.sampling_time}
    named |= {"state_names": list(dynamics.state_names), "control_names": list(dynamics.control_names)}
    if isinstance(dynamics, LinearDynamics):
        return _table_of_map(dynamics) | named
    if isinstance(dynamics, PiecewiseSmoothDynamics):
        return {"control_dim": dynamics.control_dim} | named | _smooth_tables(dynamics)
    return named | {"modes": [_table_of_mode(mode) for mode in dynamics.modes]}


def _linear(table: Mapping[str, Any]) -> LinearDynamics:
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


def _piecewise(table: Mapping[str, Any]) -> PiecewiseAffineDynamics:
    given = table["modes"]
    if not isinstance(given, list) or not given:
        raise ProblemError("dynamics.modes", brief(given), "tables that begin with [[dynamics.modes]]")
    modes = [_mode(f"dynamics.modes[{i}]", one) for i, one in enumerate(given)]
    with placed("dynamics"):
        return PiecewiseAffineDynamics(modes, **{key: value for key, value in table.items() if key != "modes"})


def _mode(place: str, table: Any) -> AffineMode:
    require_keys(place, table, ("A", "B"), MODE_KEYS)
    with placed(place, MODE):
        return AffineMode(**table)


def _table_of_map(dynamics: LinearDynamics) -> dict[str, Any]:
    table: dict[str, Any] = {"A": dynamics.A, "B": dynamics.B}
    if dynamics.offset.any() or dynamics.offset.ndim > 1:
        table["offset"] = dynamics.offset
    return table


def _table_of_mode(mode: AffineMode) -> dict[str, Any]:
    """Leave out a matrix of zeros: without it, the same one is made again; but one of the two stays beside h."""
    region = mode.region
    table = ({"name": mode.name} if mode.name else {}) | _table_of_map(mode.linear)
    without_G, without_H = (not part.any() and part.ndim == 2 for part in (region.C, region.D))
    if without_G and without_H and mode.everywhere and region.e.shape == (1,):
        return table
    if not without_G:
        table["G"] = region.C
    if not without_H or without_G:
        table["H"] = region.D
    return table | {"h": region.e}
