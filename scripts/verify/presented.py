"""What users see of the same problems before and after a change of the code: it stays, to the last digit.

Part of scripts/verify.py. ``--save FILE`` writes the JSON of solves, what commands print, and the steps of loops into a
JSON file; ``--against FILE`` compares with those of another state of the code. Times are left out. Without either, two
runs are compared, which must not differ.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterator
from difflib import unified_diff
from pathlib import Path

from rich.console import Console
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from helpers.checks.pairs import FEATURES, problem_of, quick_method
from helpers.command_line import run
from lin_freq_ocp.files.summary import result_summary
from lin_freq_ocp.library import PROBLEMS

LONG = "ball_and_paddle", "norm_dynamics", "buck_converter", "pendulum_swing_up"  # seconds to minutes each
FACTORS = 1.0, 0.9, 0.8  # of the initial state, at the steps of a loop
MOST_LINES = 12  # of a difference that is printed
TIMES = re.compile(r"[\d.]+ m?s\b")

Texts = dict[str, str]


def solves() -> Iterator[tuple[str, str]]:
    """Yield what ``solve`` says of a small problem with each feature, and how the problem describes itself."""
    for feature in FEATURES:
        problem = problem_of(feature)
        yield f"describe: {feature}", f"{problem}\n{problem._repr_html_()}"
        try:
            result = lfo.solve(problem, quick_method(problem), throw=False)
            summary = result_summary(result) | {"seconds": None}
            yield f"solve: {feature}", f"{json.dumps(summary, indent=1, default=str)}\n{result}"
        except lfo.errors.LinFreqOCPError as error:
            yield f"solve: {feature}", f"{type(error).__name__}: {error}"


def commands() -> Iterator[tuple[str, str]]:
    """Yield what commands print of the problems of the library."""
    for name in PROBLEMS:
        for command in ("show", "solve")[: 1 if name in LONG else 2]:
            status, out, err = run(command, name)
            yield f"command: {command} {name}", f"status {status}\n{out}\n{err}"


def loops() -> Iterator[tuple[str, str]]:
    """Yield the steps of a loop of each feature that has one."""
    for feature in FEATURES:
        try:
            with warnings.catch_warnings(action="ignore", category=lfo.errors.ClosedLoopWarning):
                controller = lfo.RecedingHorizon(problem_of(feature))
            for factor in FACTORS:
                controller.step([1.5 * factor, 0.0])
            controls = controller.log.controls.tolist()
            yield f"loop: {feature}", f"{[str(status) for status in controller.log.statuses]}\n{controls}"
        except lfo.errors.LinFreqOCPError as error:
            yield f"loop: {feature}", f"{type(error).__name__}: {error}"


def texts() -> Texts:
    """Return all texts by what they are of, without times."""
    with threadpool_limits(1):
        found = [*solves(), *commands(), *loops()]
    return {key: TIMES.sub("", text) for key, text in found}


def compare(console: Console, before: Texts, after: Texts) -> bool:
    """Print the differences; return whether there is none."""
    differing = [key for key in sorted(before.keys() | after.keys()) if before.get(key) != after.get(key)]
    for key in differing:
        lines = [side.get(key, "absent").splitlines() for side in (before, after)]
        shown = [line for line in unified_diff(*lines, lineterm="", n=0) if not line.startswith(("---", "+++", "@@"))]
        console.print(key, *shown[:MOST_LINES], sep="\n", markup=False, soft_wrap=True)
    console.print(f"{len(after)} texts, {len(differing)} that differ")
    return not differing


def verify(console: Console, save: Path | None = None, against: Path | None = None) -> bool:
    """Collect all texts; write them into a file, or compare them with those of a file or of a second run."""
    found = texts()
    if save is not None:
        save.write_text(json.dumps(found, indent=1), encoding="utf-8")
        if against is None:
            return True
    before = texts() if against is None else json.loads(against.read_text(encoding="utf-8"))
    return compare(console, before, found)
