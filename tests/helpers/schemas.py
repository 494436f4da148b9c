"""The JSON Schemas in docs/, and what they find wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

from lin_freq_ocp.files.summary import to_json

DOCS = Path(__file__).parents[2] / "docs"
PROBLEM = json.loads((DOCS / "problem.schema.json").read_text(encoding="utf-8"))
RESULT = json.loads((DOCS / "result.schema.json").read_text(encoding="utf-8"))
SWEEP = json.loads((DOCS / "sweep.schema.json").read_text(encoding="utf-8"))
SHOW = json.loads((DOCS / "show.schema.json").read_text(encoding="utf-8"))
MINIMUM_TIME = json.loads((DOCS / "minimum_time.schema.json").read_text(encoding="utf-8"))


def faults(schema: dict[str, Any], instance: Any) -> list[str]:
    return [f"{error.json_path}: {error.message}" for error in Draft202012Validator(schema).iter_errors(instance)]


def printed(summary: Any) -> Any:
    return json.loads(to_json(summary))
