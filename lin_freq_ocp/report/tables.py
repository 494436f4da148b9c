"""Tables as rows of text, for the page and for the terminal alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from lin_freq_ocp.analysis.measures import Measures
from lin_freq_ocp.certificate.conditions import Condition
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.signals import controls_of
from lin_freq_ocp.comparison.sweep.sweep import SweepOutcome
from lin_freq_ocp.comparison.trajectories import MeasuredTrajectory, Violation, mode_names
from lin_freq_ocp.phrases import NOTHING, number, plural, short_name, split_unit
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.report.numbers import aligned

NOT_MEANINGFUL = "not meaningful"
"""Stands for numbers that need a replay, where a replay would only show amplified rounding errors."""

OF_CONTROL = ("C-v", "C-vii", "S-u", "N-u")
"""Conditions whose component is a control; that of the others is a state, or a row."""

OF_ROWS = ("S-z", "N-z")
"""Conditions whose component is a joint row."""

OF_MODES = ("S-f", "N-f")
"""Conditions whose component is a mode."""

IN_FREQUENCY = ("C-vi", "C-vii", "N-xhat", "N-uhat", "S-yhat", "N-yhat")
"""Conditions whose worst violation is at a bin."""


COST_DIGITS = 5
"""Costs differ less than the other figures do."""

SWEEP_DIGITS = 6
"""Neighbours in a grid differ less than a filter and a solution do."""


@dataclass(frozen=True)
class Cell:
    """A text, and whether what it says is as it should be; None where that is no question."""

    text: str
    passed: bool | None = None


@dataclass(frozen=True)
class Row:
    """One row: what it shows, in which unit, and a cell per column."""

    label: str
    unit: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Group:
    """Rows under a common title, which may be empty."""

    title: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class ComparisonRows:
    """A comparison: one column per trajectory, one row per figure."""

    columns: tuple[str, ...]
    groups: tuple[Group, ...]


@dataclass(frozen=True)
class ConditionRow:
    """One condition of a certificate, in words."""

    label: str
    name: str
    residual: str
    scale: str
    relative: str
    tolerance: str
    passed: bool
    place: str

    @property
    def verdict(self) -> str:
        """Return "holds" or "fails"."""
        return "holds" if self.passed else "fails"


def comparison_rows(comparison: ComparisonOutcome) -> ComparisonRows:
    """Return what was measured of every trajectory, where it applies to the problem."""
    problem, columns = comparison.problem, comparison.trajectories
    hard = [term for term in problem.terms if term.hard]
    only_rows = all(term.kind == "stage rows" for term in hard)
    of_terms = "Beyond the joint rows by" if only_rows else "Beyond other constraints by"
    groups = [
        Group(
            "", (Row("cost", "", tuple(_measured(entry, attrgetter("cost"), digits=COST_DIGITS) for entry in columns)),)
        ),
        _largest_controls(problem, columns),
        _violations("Beyond the control bounds by", problem.control_names, columns, attrgetter("controls")),
        _violations("Beyond the state bounds by", problem.state_names, columns, attrgetter("states")),
        _violations(of_terms, [term.name for term in hard], columns, attrgetter("terms")),
        _violations("Misses the end state by", problem.state_names, columns, attrgetter("end")),
        _stop_band("Stop band of the controls", columns, of_states=False),
        _stop_band("Stop band of the states", columns, of_states=True),
    ]
    if not all(entry.replayed for entry in columns):
        groups.append(_one_step(problem, columns))
    return ComparisonRows(tuple(entry.label for entry in columns), tuple(group for group in groups if group.rows))


def certificate_rows(problem: OptimalControlProblem, certificate: Certificate) -> tuple[ConditionRow, ...]:
    """Return every condition of a certificate, in the paper's order."""
    return tuple(
        ConditionRow(
            label=condition.label,
            name=condition.name,
            residual=number(condition.residual, 3),
            scale=number(condition.scale, 4),
            relative=number(condition.relative, 3),
            tolerance=number(condition.tolerance, 3),
            passed=condition.passed,
            place=_place(problem, condition),
        )
        for condition in certificate.conditions
    )


def comparison_table(comparison: ComparisonOutcome) -> Table:
    """Return the comparison as a table for a terminal."""
    rows = comparison_rows(comparison)
    table = Table(title=Text(comparison.problem.name or "Comparison"), caption=Text(KEY))
    table.add_column("")
    for column in rows.columns:
        table.add_column(Text(column), justify="right", style="bold" if column == rows.columns[-1] else "")
    for group in rows.groups:
        table.add_section()
        if group.title:
            table.add_row(Text(group.title, style="italic"))
        for row in group.rows:
            label = f"{row.label} [{row.unit}]" if row.unit else row.label
            table.add_row(Text(("  " if group.title else "") + label), *(_styled(cell) for cell in row.cells))
    return table


def certificate_table(problem: OptimalControlProblem, certificate: Certificate) -> Table:
    """Return the conditions of a certificate as a table for a terminal."""
    verdict = f"maximum principle {certificate.pmp.replace('_', ' ')}"
    if certificate.gap is not None:
        kind = "global" if certificate.bound is not None and certificate.bound.kind == "rigorous" else "numerical"
        verdict += f", gap to the {kind} bound {number(certificate.gap, 2)}"
    table = Table(title=Text(verdict))
    for heading in ("", "condition", "residual", "scale", "relative", "tolerance", "", "worst at"):
        justify = "right" if heading in ("residual", "scale", "relative", "tolerance") else "left"
        table.add_column(heading, justify=justify)
    for row in certificate_rows(problem, certificate):
        style = "green" if row.passed else "bold red"
        cells = (row.label, row.name, row.residual, row.scale, row.relative, row.tolerance)
        table.add_row(*(Text(cell) for cell in cells), Text(row.verdict, style=style), Text(row.place))
    return table


def sweep_table(sweep: SweepOutcome) -> Table:
    """Return the points of a sweep as a table for a terminal."""
    table = Table(title=Text(f"{sweep.problem}: {len(sweep.rows)} of {plural(sweep.size, 'point')}"))
    for name in sweep.names:
        table.add_column(Text(name), justify="right")
    for heading in ("status", "cost", "gap", "method", "seconds", "message"):
        table.add_column(heading, justify="right" if heading in ("cost", "gap", "seconds") else "left")
    for row in sweep.rows:
        style = "" if row["status"] == "optimal" and row["proven"] else "yellow" if row["proven"] else "bold red"
        status = row["status"].replace("_", " ") + ("" if row["proven"] else ", not proven")
        numbers = (aligned(row["cost"], SWEEP_DIGITS), number(row["gap"], 2))
        table.add_row(
            *(Text(_shown(value)) for value in row["parameters"].values()),
            Text(status, style=style),
            *map(Text, numbers),
            Text(row["method"] or NOTHING),
            Text(number(row["seconds"], 3)),
            Text(row["message"] or ""),
        )
    return table


def _shown(value: Any) -> str:
    return NOTHING if value is None else number(value, SWEEP_DIGITS) if isinstance(value, float) else str(value)


KEY = "\N{BALLOT X} marks what a constraint of the problem does not allow"


def _styled(cell: Cell) -> Text:
    if cell.passed is False:
        return Text(f"{cell.text} \N{BALLOT X}", style="bold red")
    return Text(cell.text, style="dim" if cell.text in (NOTHING, NOT_MEANINGFUL) else "")


def _measured(
    entry: MeasuredTrajectory, value: Callable[[Measures], float | None], passed: bool | None = None, digits: int = 4
) -> Cell:
    if entry.measures is None:
        return Cell(NOTHING)
    found = value(entry.measures)
    return Cell(NOT_MEANINGFUL if found is None and not entry.replayed else aligned(found, digits), passed)


def _largest_controls(problem: OptimalControlProblem, columns: Sequence[MeasuredTrajectory]) -> Group:
    rows = [
        Row(*split_unit(one.name), tuple(Cell(aligned(entry.largest(one))) for entry in columns))
        for one in controls_of(problem)
    ]
    return Group("Largest magnitude", tuple(rows))


def _violations(
    title: str,
    names: Sequence[str],
    columns: Sequence[MeasuredTrajectory],
    violation: Callable[[MeasuredTrajectory], Violation | None],
) -> Group:
    """Return one row per component that has a bound."""
    found = [violation(entry) for entry in columns]
    bounded = np.any([one.bounded for one in found if one is not None], axis=0)
    rows = list[Row]()
    for i in map(int, np.flatnonzero(bounded)):
        cells = tuple(_violation(entry, one, i) for entry, one in zip(columns, found, strict=True))
        rows.append(Row(*split_unit(names[i]), cells))
    return Group(title, tuple(rows))


def _violation(entry: MeasuredTrajectory, violation: Violation | None, i: int) -> Cell:
    if violation is None:
        return Cell(NOT_MEANINGFUL if entry.trajectory is not None else NOTHING)
    return Cell(aligned(float(violation.values[i])), bool(violation.passed[i]))


def _stop_band(title: str, columns: Sequence[MeasuredTrajectory], of_states: bool) -> Group:
    stopped = columns[0].problem.state_band if of_states else columns[0].problem.control_band
    if not stopped.any():
        return Group(title, ())
    prefix = "state_" if of_states else ""
    energy = attrgetter(prefix + "stopband_energy")
    peak = attrgetter(prefix + "stopband_peak")
    energies = tuple(_measured(one, energy, one.empties_band(of_states)) for one in columns)
    peaks = tuple(_measured(one, peak) for one in columns)
    return Group(title, (Row("energy at its bins", "", energies), Row("peak between its bins", "", peaks)))


def _one_step(problem: OptimalControlProblem, columns: Sequence[MeasuredTrajectory]) -> Group:
    """Return how far each step misses the next planned state, which needs no replay."""
    rows = [
        Row(
            *split_unit(name),
            tuple(Cell(aligned(None if one.one_step is None else one.one_step[i])) for one in columns),
        )
        for i, name in enumerate(problem.state_names)
    ]
    return Group("Misses the next planned state, in one step, by", tuple(rows))


def _place(problem: OptimalControlProblem, condition: Condition) -> str:
    """Return where a condition is worst; nothing where it holds exactly."""
    if condition.time is None or condition.residual == 0:
        return NOTHING
    if condition.label in OF_ROWS:
        return f"t = {condition.time}, row {condition.component}"
    if condition.label in OF_MODES and condition.component is not None:
        return f"t = {condition.time}, {mode_names(problem)[condition.component]}"
    names = problem.control_names if condition.label in OF_CONTROL else problem.state_names
    axis = "bin" if condition.label in IN_FREQUENCY else "t ="
    if condition.component is None:
        return f"{axis} {condition.time}"
    return f"{axis} {condition.time}, {short_name(names[condition.component])}"
