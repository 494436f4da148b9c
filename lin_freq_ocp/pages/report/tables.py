"""Tables as rows of text, for the page and the terminal: comparisons, certificates, sweeps and moves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table
from rich.text import Text

from lin_freq_ocp.base.phrases import NOTHING, join_words, number, plural, short_name, split_unit
from lin_freq_ocp.batch.sweep import SweepOutcome
from lin_freq_ocp.certificate.conditions import Condition
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.moves import OURS, Moves
from lin_freq_ocp.comparison.trajectories import MeasuredTrajectory, Violation, controls_of
from lin_freq_ocp.pages.report.proof import bound_kind
from lin_freq_ocp.pages.units import align
from lin_freq_ocp.problem.measures import Measures
from lin_freq_ocp.problem.ocp import OptimalControlProblem

NOT_MEANINGFUL = "not meaningful"  # instead of numbers of a replay that is not meaningful
KEY = "\N{BALLOT X} marks values that violate a constraint of the problem"

# Conditions whose component is a control, a joint row or a mode; that of the others is a state.
OF_CONTROL, OF_ROWS, OF_MODES = ("C-v", "C-vii", "S-u", "N-u"), ("S-z", "N-z"), ("S-f", "N-f")
IN_FREQUENCY = ("C-vi", "C-vii", "N-xhat", "N-uhat", "S-yhat", "N-yhat")  # conditions whose worst violation is at a bin

CONDITION_DIGITS = {"residual": 3, "scale": 4, "relative": 3, "tolerance": 3}  # digits of each number of a condition
COST_DIGITS = 5  # costs differ less than the other numbers
SWEEP_DIGITS = 6  # costs of neighbouring points differ little

Columns = Sequence[MeasuredTrajectory | None]  # None: there is no trajectory


@dataclass(frozen=True)
class TableCell:
    """A text, and whether the constraint on its value holds; None without a constraint."""

    text: str
    passed: bool | None = None


@dataclass(frozen=True)
class Row:
    """One quantity: its label and unit, and a cell per trajectory."""

    label: str
    unit: str
    cells: tuple[TableCell, ...]


@dataclass(frozen=True)
class Group:
    """Rows under a common title, which may be empty."""

    title: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class ComparisonRows:
    """A comparison: one column per trajectory, one row per quantity."""

    columns: tuple[str, ...]
    groups: tuple[Group, ...]


def comparison_rows(comparison: ComparisonOutcome) -> ComparisonRows:
    """Return the measurements of every trajectory that apply to the problem."""
    problem, measured = comparison.problem, comparison.trajectories
    columns, labels = list[MeasuredTrajectory | None](measured), [trajectory.label for trajectory in measured]
    if comparison.constrained_solution is None:
        columns.append(None)
        labels.append(comparison.constrained_label)
    controls, hard = controls_of(problem), [term for term in problem.terms if term.hard]
    only_rows = all(term.kind.is_rows for term in hard if term.statement is None)
    of_terms = "Violates the joint rows by" if only_rows else "Violates other constraints by"
    groups = [
        _group("", ["cost"], columns, lambda line, _: _measured_cell(line, line.measures.cost, digits=COST_DIGITS)),
        _group(
            "Largest magnitude",
            problem.control_names,
            columns,
            lambda line, j: TableCell(align(line.largest(controls[j]))),
        ),
        _violation_group("Violates the control bounds by", problem.control_names, columns, lambda line: line.controls),
        _violation_group("Violates the state bounds by", problem.state_names, columns, lambda line: line.states),
        _violation_group(of_terms, [term.name for term in hard], columns, lambda line: line.terms),
        _reading_group(columns),
        _violation_group("Misses the end state by", problem.state_names, columns, lambda line: line.end),
        _stop_band_group(problem, columns, of_states=False),
        _stop_band_group(problem, columns, of_states=True),
    ]
    if not all(trajectory.meaningful for trajectory in measured):
        title = "Misses the next planned state, in one step, by"
        groups.append(
            _group(title, problem.state_names, columns, lambda line, i: TableCell(align(line.one_step_residual[i])))
        )
    return ComparisonRows(tuple(labels), tuple(group for group in groups if group.rows))


def _group(
    title: str,
    names: Sequence[str],
    columns: Columns,
    cell: Callable[[MeasuredTrajectory, int], TableCell],
    shown: Iterable[int] | None = None,
) -> Group:
    """Return a row per name, or for some of them, with ``cell`` of each trajectory and the name's index."""
    return Group(
        title,
        tuple(
            Row(*split_unit(names[i]), tuple(TableCell(NOTHING) if line is None else cell(line, i) for line in columns))
            for i in (range(len(names)) if shown is None else shown)
        ),
    )


def _measured_cell(
    trajectory: MeasuredTrajectory, value: float | None, passed: bool | None = None, digits: int = 4
) -> TableCell:
    return TableCell(NOT_MEANINGFUL if value is None and not trajectory.meaningful else align(value, digits), passed)


def _violation_group(
    title: str, names: Sequence[str], columns: Columns, violation: Callable[[MeasuredTrajectory], Violation | None]
) -> Group:
    """Return one row per component that has a bound."""

    def cell(trajectory: MeasuredTrajectory, i: int) -> TableCell:
        measured = violation(trajectory)
        if measured is None:
            return TableCell(NOT_MEANINGFUL)
        return TableCell(align(float(measured.values[i])), bool(measured.passed[i]))

    violations = [violation(trajectory) for trajectory in columns if trajectory is not None]
    bounded = np.any([measured.bounded for measured in violations if measured is not None], axis=0)
    return _group(title, names, columns, cell, map(int, np.flatnonzero(bounded)))


def _reading_group(columns: Columns) -> Group:
    """Return a row for each limited harmonic, bin or band: its limit, or one beside each value if they differ."""
    read = [{} if line is None else line.limited_spectra for line in columns]
    rows = list[Row]()
    for label, (reading, _) in max(read, key=len, default={}).items():
        cells = [TableCell(NOTHING if line is None else NOT_MEANINGFUL) for line in columns]
        same = len({found[label][0].limit for found in read if label in found}) == 1
        for k, found in enumerate(read):
            if label in found:
                of, passed = found[label]
                cells[k] = TableCell(align(of.value) + ("" if same else f" of {align(of.limit)}"), passed)
        unit = f"{reading.unit}, limit {align(reading.limit)}".lstrip(", ") if same else reading.unit
        rows.append(Row(label, unit, tuple(cells)))
    return Group("Limited spectra", tuple(rows))


def _stop_band_group(problem: OptimalControlProblem, columns: Columns, of_states: bool) -> Group:
    def cell(trajectory: MeasuredTrajectory, i: int) -> TableCell:
        value = stop_band_figures(trajectory.measures, of_states)[i]
        return _measured_cell(trajectory, value, None if i else trajectory.empties_band(of_states))

    rows = ["energy at its bins", "peak between its bins"]
    band, stop = (problem.state_band, problem.state_stop) if of_states else (problem.control_band, problem.control_stop)
    title = f"{'Stop band' if stop.any() else 'Bounded bins'} of the {'states' if of_states else 'controls'}"
    return _group(title, rows if band.any() else [], columns, cell)


def stop_band_figures(measures: Measures, of_states: bool) -> tuple[float | None, float | None]:
    """Return the energy at the bins of the stop band of the states, or of the controls, and the peak between them."""
    of_controls = measures.stopband_energy, measures.stopband_peak
    return (measures.state_stopband_energy, measures.state_stopband_peak) if of_states else of_controls


def worst_location(problem: OptimalControlProblem, condition: Condition) -> str:
    """Return the time or bin at which a condition is worst; an empty cell if it holds exactly."""
    if condition.time is None or condition.residual == 0:
        return NOTHING
    if condition.label in OF_ROWS:
        return f"t = {condition.time}, row {condition.component}"
    if condition.label in OF_MODES and condition.component is not None:
        return f"t = {condition.time}, {problem.mode_names[condition.component]}"
    names = problem.control_names if condition.label in OF_CONTROL else problem.state_names
    axis = "bin" if condition.label in IN_FREQUENCY else "t ="
    if condition.component is None:
        return f"{axis} {condition.time}"
    return f"{axis} {condition.time}, {short_name(names[condition.component])}"


def comparison_table(comparison: ComparisonOutcome) -> Table:
    """Return the comparison as a table for a terminal."""
    return terminal_table(comparison.problem.name or "Comparison", comparison_rows(comparison))


def terminal_table(title: str, rows: ComparisonRows) -> Table:
    """Return one column per trajectory as a table for a terminal."""
    table = Table(title=Text(title), caption=Text(KEY))
    table.add_column("")
    for column in rows.columns:
        table.add_column(Text(column), justify="right", style="bold" if column == rows.columns[-1] else "")
    for group in rows.groups:
        table.add_section()
        if group.title:
            table.add_row(Text(group.title, style="italic"))
        for row in group.rows:
            label, texts = f"{row.label} [{row.unit}]" if row.unit else row.label, list[Text]()
            for cell in row.cells:
                style = "dim" if cell.text in (NOTHING, NOT_MEANINGFUL) else ""
                broken = cell.passed is False
                texts.append(Text(f"{cell.text} \N{BALLOT X}", "bold red") if broken else Text(cell.text, style))
            table.add_row(Text(("  " if group.title else "") + label), *texts)
    return table


def certificate_table(problem: OptimalControlProblem, certificate: Certificate) -> Table:
    """Return the conditions of a certificate as a table for a terminal."""
    verdict = f"maximum principle {certificate.pmp.replace('_', ' ')}"
    if certificate.gap is not None:
        verdict += f", gap to the {bound_kind(certificate)} bound {number(certificate.gap, 2)}"
    table = Table(title=Text(verdict))
    for heading in ("", "condition", *CONDITION_DIGITS, "", "worst at"):
        table.add_column(heading, justify="right" if heading in CONDITION_DIGITS else "left")
    for condition in certificate.conditions:
        holds = Text("holds", style="green") if condition.passed else Text("fails", style="bold red")
        numbers = [number(getattr(condition, name), digits) for name, digits in CONDITION_DIGITS.items()]
        texts = [Text(cell) for cell in (condition.label, condition.name, *numbers)]
        table.add_row(*texts, holds, Text(worst_location(problem, condition)))
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
        values = [NOTHING if value is None else value for value in row["parameters"].values()]
        table.add_row(
            *(Text(number(value, SWEEP_DIGITS) if isinstance(value, float) else str(value)) for value in values),
            Text(status, style=style),
            Text(align(row["cost"], SWEEP_DIGITS)),
            Text(number(row["gap"], 2)),
            Text(row["method"] or NOTHING),
            Text(number(row["seconds"], 3)),
            Text(row["message"] or ""),
        )
    return table


def moves_rows(moves: Moves) -> ComparisonRows:
    """Return one column per move: its length and its residual vibration."""
    columns, ours = list[tuple[TableCell, ...]](), moves.ours
    for move in moves.all:
        at_least = "" if move.measured is not None else "> "
        known = move.measured is not None and ours.measured is not None
        longer = number(100 * (move.samples / ours.samples - 1), 3) if known else NOTHING
        vibration = TableCell(NOTHING) if move.ratio is None else TableCell(align(move.ratio), move.keeps_everything)
        lengths = TableCell(f"{at_least}{move.samples}"), TableCell(f"{at_least}{align(move.seconds)}")
        columns.append((*lengths, TableCell(longer), vibration))
    labels = (
        *(("samples", ""), ("move time", "s")),
        *(("longer than the optimal move by", "%"), ("largest vibration, of its limit", "")),
    )
    rows = tuple(Row(*label, cells) for label, cells in zip(labels, zip(*columns, strict=True), strict=True))
    return ComparisonRows(tuple(move.name for move in moves.all), (Group("", rows),))


def moves_sentence(moves: Moves) -> str:
    """Compare the lengths of the shapers' moves with that of the problem in words."""
    known = [f"{move.name} {move.samples}" for move in moves.shaped if move.measured is not None]
    unknown = [f"{move.name} more than {move.samples}" for move in moves.shaped if move.measured is None]
    ours = moves.ours
    if ours.measured is None:
        optimum = f"{ours.samples} samples are not known to be enough for any control"
    else:
        optimum = f"{ours.samples} samples are enough" + (
            f", and {ours.samples - 1} are proven not to be" if moves.proof and ours.samples > 1 else ""
        )
    lengths = join_words(known + unknown)
    return f"with the profiles tried, input shapers of the same robustness need {lengths} samples; {optimum}"


def moves_caption(moves: Moves) -> str:
    """Describe the figure of the vibration, and the impulses."""
    impulses = "; ".join(f"{move.name}: {move.description}" for move in moves.shaped)
    return (
        "Residual amplitude of a mode with this natural frequency after each move, the largest over the damping ratios "
        "of the box; within the shaded frequencies it must not exceed the limit. Every move except the unshaped one is "
        f"the shortest of its kind found to satisfy all constraints; '{OURS}' is that of the problem. Impulses: "
        f"{impulses}."
    )


def moves_title(moves: Moves) -> str:
    """Return the title of the figure, which is also its description for screen readers."""
    within = [move.name for move in moves.all if move.keeps_everything]
    return (
        f"Residual vibration over the natural frequency: {join_words(within)} stay below the limit over the whole box"
    )
