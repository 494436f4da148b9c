"""A dumped run beside its repetition here: what is the same, and what is not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lin_freq_ocp.result import Result

from lin_freq_ocp.interchange.results.summary import finite, result_summary
from lin_freq_ocp.interchange.runs.environment import environment
from lin_freq_ocp.interchange.runs.run_file import SavedRun, described

SAME_COST = 1e-6
"""Costs that differ by less, relative to the larger of 1 and the cost, are the same answer."""

COMPARED = ("status", "cost", "theorem", "method", "backend", "error")


@dataclass(frozen=True, eq=False)
class Rerun:
    """What a run ended with then, and now.

    Attributes
    ----------
    result : Result or None
        Of now; None if it ended with an error that has none.
    error : Exception or None
        That error.
    then, now : dict
        "status", "cost", "gap", "theorem", "method", "backend", "seconds" (in all) and "error"; what is not there is
        None.
    then_on, now_on : dict
        The environments.
    """

    result: Result | None
    error: Exception | None
    then: dict[str, Any]
    now: dict[str, Any]
    then_on: dict[str, Any]
    now_on: dict[str, Any]

    @property
    def differences(self) -> tuple[str, ...]:
        """Return what differs, of status, cost, theorem, method, backend and error."""
        return tuple(key for key in COMPARED if not _same(self.then[key], self.now[key]))

    @property
    def versions(self) -> dict[str, tuple[str, str]]:
        """Return what then and now ran on, where that differs."""
        flat = [_flat(one) for one in (self.then_on, self.now_on)]
        pairs = {name: (flat[0].get(name, "none"), flat[1].get(name, "none")) for name in {**flat[0], **flat[1]}}
        return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}

    def __str__(self) -> str:
        rows = [("", "then", "now")]
        rows += [(key, _shown(self.then[key]), _shown(self.now[key])) for key in self.then]
        rows += [(name, *pair) for name, pair in self.versions.items()]
        widths = [max(len(row[i]) for row in rows) for i in (0, 1)]
        lines = [f"{what:{widths[0]}}  {then:{widths[1]}}  {now}".rstrip() for what, then, now in rows]
        return "\n".join([*lines, f"differs: {', '.join(self.differences)}" if self.differences else "the same"])


def rerun(run: SavedRun) -> Rerun:
    """Repeat a run, and set what it ends with beside what it ended with then; errors of any kind are such an end."""
    result, error = None, None
    try:
        result = run.solve()
    except Exception as caught:
        error = caught
    now = None if result is None else result_summary(result)
    now_error = None if error is None else described(error)
    here = environment(run.options.get("backend"))
    return Rerun(result, error, _outcome(run.summary, run.error), _outcome(now, now_error), run.environment, here)


def rerun_summary(comparison: Rerun) -> dict[str, Any]:
    """Return the JSON object of ``lin-freq-ocp rerun --json``."""
    versions = {name: list(pair) for name, pair in comparison.versions.items()}
    summary = {"schema": 1, "then": comparison.then, "now": comparison.now}
    return finite(summary | {"differences": list(comparison.differences), "environment": versions})


def _outcome(summary: Mapping[str, Any] | None, error: Mapping[str, Any] | None) -> dict[str, Any]:
    given = summary or {}
    seconds = [value for value in _table(given.get("seconds")).values() if isinstance(value, (int, float))]
    return {
        "status": given.get("status"),
        "cost": given.get("cost"),
        "gap": given.get("gap"),
        "theorem": _table(given.get("certificate")).get("pmp"),
        "method": given.get("method"),
        "backend": given.get("backend"),
        "seconds": sum(seconds) if seconds else None,
        "error": None if error is None else f"{error.get('type')}: {error.get('message')}",
    }


def _same(then: Any, now: Any) -> bool:
    if isinstance(then, (int, float)) and isinstance(now, (int, float)):
        return abs(then - now) <= SAME_COST * max(1.0, abs(then))
    return then == now


def _flat(given: Mapping[str, Any]) -> dict[str, str]:
    return {key: str(value) for key, value in {**given, **_table(given.get("packages"))}.items() if key != "packages"}


def _table(given: Any) -> dict[str, Any]:
    """Return a table from a file, empty if something else stands there."""
    return given if isinstance(given, dict) else {}


def _shown(value: Any) -> str:
    return "none" if value is None else f"{value:.12g}" if isinstance(value, float) else str(value)
