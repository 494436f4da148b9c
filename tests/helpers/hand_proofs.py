"""Proofs that are written by hand, as lists of objects with plain numbers, and how to run the checker on them."""

from __future__ import annotations

import importlib.util
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from io import StringIO
from pathlib import Path
from unittest.mock import patch

import pytest

ROOT = Path(__file__).parents[2]
DOUBLE_INTEGRATOR = ROOT / "tests" / "proof" / "double_integrator.proof"
WHOLE = (
    "version bits horizon from stop samples bins node parent t modes term first window mode signal multiplier".split()
)


@cache
def checker():
    """Return the checker as a module: its one file, as a stranger runs it. Its numbers are those of python-flint."""
    pytest.importorskip("flint", reason="needs python-flint, of the extra proof")
    spec = importlib.util.spec_from_file_location("lfo_check_alone", ROOT / "lin_freq_ocp" / "proof" / "lfo_check.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Verdict:
    """The exit status and what was printed."""

    status: int
    printed: str

    @property
    def last(self) -> str:
        """The last line."""
        return self.printed.strip().splitlines()[-1]

    @property
    def interval(self) -> tuple[str, str] | None:
        """The ends of what is proven, as texts; None if that is no interval."""
        words = self.last.split()
        return (words[1], words[2]) if self.status == 0 and words[0] == "VERIFIED" else None


def encoded(value, key=""):
    """Return a value with its real numbers in hexadecimal."""
    if isinstance(value, dict):
        return {name: encoded(inner, name) for name, inner in value.items()}
    if key == "row":
        return [[t, component, encoded(factor)] for t, component, factor in value]
    if isinstance(value, list) and key not in ("bins", "frequency"):
        return [encoded(inner, key) for inner in value]
    if (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and key not in WHOLE
        and (key, value) not in COSTS
    ):
        return float(value).hex()
    return value


COSTS = ("cost", 0), ("cost", 1)


def text(lines) -> str:
    """Return objects (or texts, as they are) as the text of a proof."""
    return "".join(line if isinstance(line, str) else json.dumps(encoded(line)) + "\n" for line in lines)


def json_line(line: dict) -> str:
    """Return an object whose real numbers are texts already as a line."""
    return json.dumps(line) + "\n"


def double_integrator() -> list[dict]:
    """Return the proof of docs/proof.md."""
    return [json.loads(line) for line in DOUBLE_INTEGRATOR.read_text().splitlines()]


def scalar_problem(horizon, modes, bounds_x, goal, bound_u) -> list[dict]:
    """Return a problem of one state and control: 1/2 u^2 at every stage, 1/2 (x_T - goal)^2."""
    names = [f"mode {index}" for index in range(len(modes))]
    stages = [{"bounds": "stage", "lower": [low, -bound_u], "upper": [high, bound_u]} for low, high in bounds_x[:-1]]
    low, high = bounds_x[-1]
    return [
        {"format": "lfo-proof", "version": 1, "bits": 128},
        {
            **{"section": "problem", "name": "scalar", "horizon": horizon},
            **{"states": ["x"], "controls": ["u"], "modes": names},
        },
        *({"mode": index} | mode for index, mode in enumerate(modes)),
        {"cost": "stage", "hessian": [[0, 0], [0, 1]], "center": [0, 0], "linear": [0, 0]},
        {"cost": "end", "hessian": [[1]], "center": [goal], "linear": [0]},
        *stages,
        {"bounds": "end", "lower": [low], "upper": [high]},
    ]


def two_modes() -> list[dict]:
    """Return a tree: x+ = x + u for x <= 0, x+ = 2 x + u for x >= 0, T = 1, x_0 in [-1, 1], goal 3: J* = 1/4.

    Mode 0 has its optimum 9/4 at x_0 = 0, u = 3/2; mode 1 at x_0 = 1, u = 1/2.
    """
    modes = [
        {"A": [[1]], "B": [[1]], "d": [0], "G": [[1]], "H": [[0]], "h": [0]},
        {"A": [[2]], "B": [[1]], "d": [0], "G": [[-1]], "H": [[0]], "h": [0]},
    ]
    return [
        *scalar_problem(1, modes, [(-1, 1), ("-inf", "inf")], 3, 4),
        {"section": "claim", "lower": 0.25 - 2.0**-30, "upper": 0.25},
        {"section": "point", "x": [1], "levels": []},
        {"t": 0, "u": [0.5], "mode": 1},
        {"section": "nodes", "reach": True},
        {"node": 0, "parent": None, "t": 0, "modes": [0, 1]},
        {"node": 1, "parent": 0, "t": 0, "modes": [0]},
        {"node": 2, "parent": 0, "t": 0, "modes": [1]},
        {"section": "dual", "node": 1, "cost": 1},
        {"t": 1, "z": [1.5]},
        {"t": 0, "z": [0, 1.5]},
        {"section": "dual", "node": 2, "cost": 1},
        {"t": 1, "z": [2.5]},
        {"t": 0, "z": {"1": [1, 0.5]}},
        {"section": "end"},
    ]


def infeasible() -> list[dict]:
    """Return a proof that x+ = x + u, |u| <= 1 does not lead from 0 to 3 in two steps: <eta, 3> - 2 |eta| > 0."""
    modes = [{"A": [[1]], "B": [[1]], "d": [0], "G": [], "H": [], "h": []}]
    return [
        *scalar_problem(2, modes, [(0, 0), ("-inf", "inf"), (3, 3)], 0, 1),
        {"section": "claim", "lower": "inf", "upper": "inf"},
        {"section": "nodes", "reach": False},
        {"node": 0, "parent": None, "t": 0, "modes": [0]},
        {"section": "dual", "node": 0, "cost": 0},
        {"t": 2, "z": [3], "mu": [-1]},
        {"t": 1, "z": [1, 1]},
        {"t": 0, "z": [0, 1]},
        {"section": "end"},
    ]


def check(text: str | bytes, folder: Path) -> Verdict:
    """Run the checker on a text."""
    path = folder / "some.proof"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return check_file(path)


def check_file(path: Path) -> Verdict:
    """Run the checker on a file."""
    printed = StringIO()
    with redirect_stdout(printed), redirect_stderr(printed), patch.object(sys, "argv", ["lfo_check.py", str(path)]):
        status = checker().main()
    return Verdict(status, printed.getvalue())
