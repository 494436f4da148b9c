"""Saved runs, and the comparison of a saved run with its repetition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from typing import final

from lin_freq_ocp.api.result import Result, present_as
from lin_freq_ocp.api.solve import solve
from lin_freq_ocp.files.reading import FileTable
from lin_freq_ocp.files.run_file import RunRecord, describe_error, environment, read_run
from lin_freq_ocp.files.summary import finite, result_summary

SAME_COST = 1e-6  # difference of equal costs, relative to the larger of 1 and the cost
COMPARED = ("status", "cost", "theorem", "method", "backend", "error")


@final
class SavedRun(RunRecord):
    """A saved run, with the fields of ``RunRecord``.

    Methods
    -------
    solve()
        Solve the problem again with the same options.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).dump("run.zip")
    >>> lfo.load_run("run.zip").options["method"]
    'auto'
    """

    def solve(self, throw: bool = False) -> Result:
        """Solve the problem again with the same options; ``throw`` as for ``lfo.solve``."""
        return solve(self.problem, **self.options, throw=throw)


def load_run(path: str | PathLike[str]) -> SavedRun:
    """Read a run that ``result.dump`` or ``lin-freq-ocp solve --dump`` wrote; no code in the file is executed.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    SavedRun

    Raises
    ------
    ProblemError
        If the file is not a saved run; the message names the file, the entry of the archive and the location in it.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).dump("run.zip")
    >>> lfo.load_run("run.zip").solve().status
    'optimal'
    """
    return present_as(SavedRun, read_run(path))


@dataclass(frozen=True, eq=False)
class Rerun:
    """A saved run and its repetition, each with its environment.

    ``then`` and ``now`` have "status", "cost", "gap", "theorem", "method", "backend", "seconds" (the sum) and "error".
    """

    result: Result | None  # of the repetition; None if that ended with the error
    error: Exception | None
    then: FileTable
    now: FileTable
    then_on: FileTable
    now_on: FileTable

    @property
    def differences(self) -> tuple[str, ...]:
        """Return which of status, cost, theorem, method, backend and error differ.

        The cost reached at a limit depends on the machine; if both runs stopped at one, their costs are not compared.
        """
        stopped = self.then["status"] == self.now["status"] == "limit"
        then, now = self.then["cost"], self.now["cost"]
        numbers = isinstance(then, (int, float)) and isinstance(now, (int, float))
        same_cost = stopped or (numbers and abs(then - now) <= SAME_COST * max(1.0, abs(then)))
        differing = [key for key in COMPARED if self.then[key] != self.now[key]]
        return tuple(key for key in differing if not (key == "cost" and same_cost))

    @property
    def versions(self) -> dict[str, tuple[str, str]]:
        """Return the entries of the environments, then and now, that differ."""
        then, now = _flat(self.then_on), _flat(self.now_on)
        pairs = {name: (then.get(name, "none"), now.get(name, "none")) for name in then | now}
        return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}

    def __str__(self) -> str:
        rows = [("", "then", "now")]
        rows += [(key, _value_text(self.then[key]), _value_text(self.now[key])) for key in self.then]
        rows += [(name, *pair) for name, pair in self.versions.items()]
        widths = [max(len(row[i]) for row in rows) for i in (0, 1)]
        lines = [f"{name:{widths[0]}}  {then:{widths[1]}}  {now}".rstrip() for name, then, now in rows]
        return "\n".join([*lines, f"differs: {', '.join(self.differences)}" if self.differences else "the same"])


def rerun(run: SavedRun) -> Rerun:
    """Repeat a saved run, and compare its result or error with the saved one."""
    result, error = None, None
    try:
        result = run.solve()
    except Exception as caught:
        error = caught
    summary = None if result is None else result_summary(result)
    now = outcome_fields(summary, None if error is None else describe_error(error))
    here = environment(run.options.get("backend"))
    return Rerun(result, error, outcome_fields(run.summary, run.error), now, run.environment, here)


def rerun_summary(comparison: Rerun) -> FileTable:
    """Return the JSON object of ``lin-freq-ocp rerun --json``."""
    versions = {name: list(pair) for name, pair in comparison.versions.items()}
    summary = {"schema": 1, "then": comparison.then, "now": comparison.now}
    return finite(summary | {"differences": list(comparison.differences), "environment": versions})


def outcome_fields(summary: Mapping[str, object] | None, error: Mapping[str, object] | None) -> FileTable:
    """Return the fields by which two runs are compared; the summary or error may come from anybody's file."""
    fields = summary or {}
    seconds = [value for value in _table(fields.get("seconds")).values() if isinstance(value, (int, float))]
    return {
        "status": fields.get("status"),
        "cost": fields.get("cost"),
        "gap": fields.get("gap"),
        "theorem": _table(fields.get("certificate")).get("pmp"),
        "method": fields.get("method"),
        "backend": fields.get("backend"),
        "seconds": sum(seconds) if seconds else None,
        "error": None if error is None else f"{error.get('type')}: {error.get('message')}",
    }


def _flat(table: FileTable) -> dict[str, str]:
    return {key: str(value) for key, value in (table | _table(table.get("packages"))).items() if key != "packages"}


def _table(value: object) -> FileTable:
    """Return a table of a file, empty if the value is not a table."""
    return value if isinstance(value, dict) else {}


def _value_text(value: object) -> str:
    return "none" if value is None else f"{value:.12g}" if isinstance(value, float) else str(value)
