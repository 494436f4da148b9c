"""Solutions as .npz files: trajectory, multipliers and summary."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.atomic import write_bytes
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.interchange.files import npz_bytes, opened_npz, parsed_json
from lin_freq_ocp.interchange.locations import naming
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

SCHEMA = 1
"""Version of the layout of the .npz."""

DIMENSIONS_OF_MULTIPLIERS = {"eta_C": 0, "eta": 2, "mu": 2, "nu": 2, "rho_u": 2, "rho_x": 2}
"""The fields of Multipliers that are one array, with the dimensions of each."""

WEIGHTS = "weights"
"""The field of Multipliers that only piecewise-affine dynamics have; its array has two dimensions."""

STAGE = "stage/"
"""What stands before the name of a family of joint rows: its multipliers are a field of their own."""


@dataclass(frozen=True, eq=False)
class SavedSolution:
    """What a solution file holds.

    Attributes
    ----------
    trajectory : Trajectory
        States and controls.
    multipliers : Multipliers or None
        None if the file has none.
    summary : dict
        Status, cost, method and so on, as they were saved; empty if the file has none.
    """

    trajectory: Trajectory
    multipliers: Multipliers | None
    summary: dict[str, Any]


def save_solution(
    path: str | PathLike[str], trajectory: Trajectory, multipliers: Multipliers | None, summary: Mapping[str, Any]
) -> None:
    """Write a solution to an .npz: the fields of Trajectory and Multipliers under their names, summary and schema.

    The multipliers of joint rows are arrays of their own, "stage/" and the name of the rows.
    """
    write_bytes(path, solution_bytes(trajectory, multipliers, summary))


def solution_bytes(trajectory: Trajectory, multipliers: Multipliers | None, summary: Mapping[str, Any]) -> bytes:
    """Return what ``save_solution`` writes."""
    fields: dict[str, Any] = {"x": trajectory.x, "u": trajectory.u}
    if multipliers is not None:
        fields |= {name: getattr(multipliers, name) for name in DIMENSIONS_OF_MULTIPLIERS}
        fields |= {STAGE + name: weights for name, weights in multipliers.stage.items()}
        fields |= {} if multipliers.weights is None else {WEIGHTS: multipliers.weights}
    fields |= {"schema": SCHEMA, "summary": json.dumps(dict(summary))}
    return npz_bytes({name: np.asarray(value) for name, value in fields.items()})


def load_solution(path: str | PathLike[str]) -> SavedSolution:
    """Read a solution from an .npz that has at least x (T+1, n) and u (T, m).

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    SavedSolution

    Raises
    ------
    ProblemError
        If it is no such file, lacks x or u or some of the multipliers, or shapes do not match.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).save("run.npz")
    >>> lfo.load("run.npz").trajectory.x.shape[1]
    2
    """
    path = Path(path)
    with opened_npz(str(path), path) as archive:
        arrays: dict[str, NDArray[Any]] = {name: archive[name] for name in archive.files}
    with naming(path):
        _require_schema(arrays.get("schema"))
        trajectory = Trajectory(*(_numbers(arrays, name, 2) for name in ("x", "u")))
        multipliers = _multipliers(arrays)
        if multipliers is not None:
            _require_same_size(trajectory, multipliers)
        return SavedSolution(trajectory, multipliers, _summary(arrays.get("summary")))


def _require_schema(schema: NDArray[Any] | None) -> None:
    if schema is not None and (schema.shape != () or schema != SCHEMA):
        raise ProblemError("schema", brief(schema), f"{SCHEMA}", "Another version of this package may have written it.")


def _numbers(arrays: Mapping[str, NDArray[Any]], name: str, dimensions: int) -> NDArray[Any]:
    if name not in arrays:
        raise ProblemError(name, f"nothing (there is {', '.join(arrays) or 'no array'})", "an array of this name")
    array = arrays[name]
    if array.dtype.kind not in "biufc" or array.ndim != dimensions:
        raise ProblemError(name, f"{array.dtype} of shape {array.shape}", f"numbers in {dimensions} dimensions")
    return array


def _multipliers(arrays: Mapping[str, NDArray[Any]]) -> Multipliers | None:
    if not any(name in arrays for name in DIMENSIONS_OF_MULTIPLIERS):
        return None
    fields = {name: _numbers(arrays, name, count) for name, count in DIMENSIONS_OF_MULTIPLIERS.items()}
    stage = {name.removeprefix(STAGE): _numbers(arrays, name, 2) for name in arrays if name.startswith(STAGE)}
    weights = _numbers(arrays, WEIGHTS, 2) if WEIGHTS in arrays else None
    return Multipliers(float(fields.pop("eta_C")), **fields, stage=stage, weights=weights)


def _require_same_size(trajectory: Trajectory, multipliers: Multipliers) -> None:
    got, expected = (multipliers.eta.shape, multipliers.nu.shape), (trajectory.x[1:].shape, trajectory.u.shape)
    if got != expected:
        raise ProblemError(
            "multipliers",
            f"eta {got[0]}, nu {got[1]}",
            f"eta {expected[0]}, nu {expected[1]}, as the trajectory has it",
        )


def _summary(text: NDArray[Any] | None) -> dict[str, Any]:
    if text is None:
        return {}
    summary = parsed_json("summary", str(text))
    if not isinstance(summary, dict):
        raise ProblemError("summary", brief(summary), "a JSON object")
    return summary
