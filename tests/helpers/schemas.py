"""The JSON Schemas of the package, and what they find wrong."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from jsonschema import Draft202012Validator

from lin_freq_ocp.cli import SCHEMAS
from lin_freq_ocp.files import to_json

FOLDER = files("lin_freq_ocp.files") / "schemas"
PROBLEM, RESULT, SHOW, SWEEP, MINIMUM_TIME = (
    json.loads((FOLDER / f"{name}.schema.json").read_text(encoding="utf-8")) for name in SCHEMAS
)


def faults(schema: dict[str, Any], instance: Any) -> list[str]:
    return [f"{error.json_path}: {error.message}" for error in Draft202012Validator(schema).iter_errors(instance)]


def is_valid(schema: dict[str, Any], instance: Any) -> bool:
    """Return whether there is no fault; the first one ends the search."""
    return Draft202012Validator(schema).is_valid(instance)


def printed(summary: Any) -> Any:
    return json.loads(to_json(summary))
