"""Self-contained HTML pages of a comparison and of a control loop.

The page of a comparison contains the finding, the figures, the tables, the proof and the problem; the page of a loop
contains its signals and the table of its steps. Figures are embedded, and also written as separate files.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from lin_freq_ocp import library
from lin_freq_ocp.base.atomic import report_write_errors, write_each
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import number, plural
from lin_freq_ocp.batch.sweep import SweepOutcome
from lin_freq_ocp.certificate.hybrid.clarke import facts_where_modes_meet
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.filters import can_be_filtered, filter_limits, has_frequency_constraint
from lin_freq_ocp.loop.record import NOT_JUDGED, LoopRecord
from lin_freq_ocp.loop.step_problem import limits_of_plans
from lin_freq_ocp.pages.figures import figures
from lin_freq_ocp.pages.figures.continua import held_panels, moves_figure, panels_figure, vibration_panels
from lin_freq_ocp.pages.figures.look import THEMED, THEMED_TINTS
from lin_freq_ocp.pages.figures.loop import loop_figure
from lin_freq_ocp.pages.figures.modes import adjoint_figure, smallest_adjoint, strip_rows, strips_figure
from lin_freq_ocp.pages.figures.plot_data import PlotData
from lin_freq_ocp.pages.figures.sweep import sweep_figure
from lin_freq_ocp.pages.report import proof, tables
from lin_freq_ocp.pages.report.findings import FILTERING, finding_of, stop_band_meaning
from lin_freq_ocp.pages.templates import render_template
from lin_freq_ocp.pages.units import frequency_scale, rough
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.problem.spectrum.base import WindowSpectra
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.uncertainty.protocol import RobustProblem

PIXELS_PER_INCH = 150

Facts = Sequence[tuple[str, str]]
Rows = Sequence[Sequence[object]]
WINDOW_COLUMNS = ("signal", "band", "level", "worst window", "at", "which begins at", "windows above", "bins above")

MOST_NAMED_BINS = 8  # of a level that was exceeded, that a table names

CAPTION = (
    "Spectrograms show the magnitude of the DFT of short windows over the time of their middle. Crosses mark steps "
    "whose problem had no solution, or no plan in time. Broken lines are references. Amplitudes of applied windows are "
    "those of sinusoids."
)


def save_report(comparison: ComparisonOutcome, folder: str | Path) -> Path:
    """Write index.html and its figures, each as .svg and .png, into a folder; return the page's path."""
    drawings = tuple(draw_figures(comparison))
    return save_page(Path(folder), render_page(comparison, drawings), drawings)


def draw_figures(comparison: ComparisonOutcome) -> Iterator[Drawing]:
    """Yield all figures that apply to the comparison."""
    data, result = figures.comparison_data(comparison), comparison.constrained
    shown = comparison.shown_filter
    caption = (
        "Spectra: points are the bins of the DFT; hollow triangles at the lower edge are bins too small for the axis. "
        "Lines are the zero-padded spectrum between the bins (for many bins, its largest value between neighbours)."
    )
    caption += "" if shown is None else f" Filtered: {shown.description}."
    yield drawing_of("comparison", "Controls, their spectra, and the states", caption, figures.four_panels(data))
    stopped = [state for state in data.states if state.stop.any()]
    for kind, title, signals in (("state", "states with a stop band", stopped), ("output", "outputs", data.outputs)):
        if signals:
            figure = figures.spectra_figure(data, signals)
            yield drawing_of(f"{kind}_spectra", f"Spectra of the {title}", "", figure)
    if comparison.moves is not None:
        title, caption = tables.moves_title(comparison.moves), tables.moves_caption(comparison.moves)
        yield drawing_of("vibration", title, caption, moves_figure(comparison.moves))
    held = panels_figure(held_panels(data))
    vibrations = panels_figure(vibration_panels(data)) if comparison.moves is None else None
    if held is not None:
        caption = (
            "The spectrum of a signal after its zero-order hold, as the plant receives it: |sinc(f h) V(2 pi f h)|, "
            "images above the Nyquist frequency included (for many bins, its largest value between neighbours)."
        )
        yield drawing_of("held_spectra", "Spectra after the zero-order hold, with their limits", caption, held)
    if vibrations is not None:
        caption = "Residual amplitude of a mode with this natural frequency, the largest over the damping ratios."
        yield drawing_of(
            "vibration", "Residual vibration over the natural frequency, with its limit", caption, vibrations
        )
    if data.modes:
        rows = strip_rows(comparison)
        yield drawing_of("modes", "Modes", proof.modes_caption(rows, data.main.label), strips_figure(data, rows))
    yield drawing_of("states", "Every state in time", "", figures.states_figure(data))
    certificate, multipliers = result.certificate, result.multipliers
    if comparison.problem.uncertainty is not None and result.trajectory is not None:
        caption = "Bands are margins. The worst case is that of the limit that it brings closest to its limit."
        yield drawing_of("worst_case", "The plan and its worst case", caption, figures.result_figure(result))
    if certificate is None or multipliers is None:
        return
    borders = facts_where_modes_meet(certificate)
    if borders is not None and data.main.trajectory is result.trajectory:
        solution = PlotData(data.problem, (data.main,))
        figure = adjoint_figure(solution, multipliers.eta, comparison.kinks, smallest_adjoint(certificate))
        yield drawing_of("adjoint", "Adjoint, and its choice at kinks", proof.adjoint_caption(borders), figure)
    gap = figures.gap_figure(data, certificate)
    if gap is not None:
        yield drawing_of("gap", "Gap per stage", proof.parts_of_the_gap(certificate), gap)
    if comparison.prices is not None:
        text = (
            "Decrease of the optimal cost per unit, if a removed bin (with its mirror image) may be slightly above "
            "zero, or its limit is slightly higher: the magnitude of the bin's multiplier."
        )
        yield drawing_of("price", "Price of each bin", text, figures.price_figure(data, comparison.prices))


def render_page(comparison: ComparisonOutcome, drawings: Iterable[Drawing]) -> str:
    """Return the page."""
    problem, certificate = comparison.problem, comparison.constrained.certificate
    constrained, result = has_frequency_constraint(problem), comparison.constrained
    filters = comparison.filtered if can_be_filtered(problem) else ()
    return render_template(
        "page.html.jinja",
        title=problem.name or "Optimal control problem",
        finding=finding_of(comparison),
        tiles=tiles(comparison),
        drawings={drawing.name: drawing for drawing in drawings},
        table=tables.comparison_rows(comparison),
        moves=None if comparison.moves is None else tables.moves_rows(comparison.moves),
        filtering=FILTERING,
        not_meaningful=tables.NOT_MEANINGFUL,
        meaning=stop_band_meaning(comparison),
        worst=worst_case_table(comparison),
        verdict=[] if certificate is None else proof.verdict(certificate, problem),
        search=proof.search_sentences(result),
        conditions=() if certificate is None else certificate.conditions,
        condition_digits=tables.CONDITION_DIGITS.items(),
        number=number,
        worst_location=tables.worst_location,
        problem=problem,
        result=result,
        comparison=comparison,
        amplification=rough(comparison.classical_measures.amplification),
        facts=problem_facts(problem, problem.gap),
        filter_limits=filter_limits(problem),
        constrained=constrained,
        filters=filters,
        of_filters=[(one.replay.label, one.description) for one in filters],
        solves=[
            *([_solve_row("without the frequency constraint", comparison.classical)] if constrained else []),
            _solve_row("with the constraint" if constrained else "the problem", result),
        ],
        sampling_time=None if problem.sampling_time is None else number(problem.sampling_time),
    )


def worst_case_table(comparison: ComparisonOutcome) -> PageTable | None:
    """Return what the worst load or plant does to the plan, by the given limits; None if the problem is certain."""
    problem, plan = comparison.problem, comparison.constrained.trajectory
    if not isinstance(problem, RobustProblem) or plan is None:
        return None
    worst = problem.uncertainty.worst(problem.given, plan, None)
    rows = [
        [*one.cells, one.remark(soft)] for soft, ones in ((False, worst.limits), (True, worst.soft)) for one in ones
    ]
    rows += [[*one.cells, "for the plan only"] for one in worst.leakage]
    note = f"{worst.words[:1].upper()}{worst.words[1:]}. {worst.verdict}"
    columns = ("limit", "at", "plan", "margin", "limit", "attained", "")
    return PageTable("The worst case", columns, rows, {0, 1, 6}, note)


def _solve_row(problem: str, result: Outcome) -> tuple[str, str, str, str, str]:
    times = ", ".join(f"{stage} {number(seconds, 3)} s" for stage, seconds in result.seconds.items())
    status = f"{result.status.replace('_', ' ')}{': ' if result.message else ''}{result.message}"
    return problem, status, result.method, result.backend or "none needed", times


def tiles(comparison: ComparisonOutcome) -> list[tuple[str, str, str]]:
    """Return the figures of the headline: label, number, and a remark on it."""
    result, certificate = comparison.constrained, comparison.constrained.certificate
    shown = list[tuple[str, str, str]]()
    if has_frequency_constraint(comparison.problem):
        shown.append(("cost without frequency constraint", number(comparison.classical.cost), ""))
    if certificate is None:
        return [*shown, ("with the constraint", result.status.replace("_", " "), "proven" if result.dual else "")]
    cost, remark = ("optimal cost", "") if proof.proven_optimal(result) else ("cost found", "not proven global")
    if certificate.borders is not None and certificate.bound is None:
        cost, remark = "cost found", "no global bound"
    if not certificate.feasible:
        remark = "breaks constraints"
    shown.append(("cost with the constraint" if shown else cost, number(result.cost), remark))
    kind = "" if certificate.normal is None else "normal" if certificate.normal else "abnormal"
    shown.append(("maximum principle", certificate.pmp.replace("_", " "), kind))
    if certificate.gap is not None and certificate.bound is not None:
        bound = f"{proof.bound_kind(certificate)} bound"
        shown.append((f"gap to the {bound}", number(certificate.gap, 2), certificate.bound.kind))
    return shown


def save_loop_report(loop: LoopRecord, folder: Path) -> Path:
    """Write index.html and its figure, as .svg and .png, into a folder; return the page's path."""
    drawing = drawing_of("loop", "States, controls, their spectra over time, and the steps", CAPTION, loop_figure(loop))
    steps = plural(len(loop.steps), "step")
    sentence = f"{int(loop.satisfied.sum())} of {steps} have plans that satisfy the maximum principle"
    known = loop.gaps[np.isfinite(loop.gaps)]
    sentence += f", with gaps of at most {number(float(known.max()), 2)}." if len(known) else "."
    sentence += f" The loop stopped before its end: {loop.stopped}" if loop.stopped else ""
    headline = [("steps", str(len(loop.steps)), "")]
    if loop.steps:
        solve, certify = 1e3 * loop.solve_seconds, 1e3 * loop.certify_seconds
        most = f"at most {number(float(solve.max()), 3)} ms"
        headline += [
            ("time of a step", f"{number(float(np.median(solve)), 3)} ms", most),
            ("its certificate", f"{number(float(np.median(certify)), 3)} ms", "in addition"),
            ("steps softened", str(sum(bool(step.excess) for step in loop.steps)), ""),
        ]
        if raised := sum(step.raised for step in loop.steps):
            headline.append(("steps whose level was raised", str(raised), "by what the past exceeds"))
        if loop.changes.any():
            median = number(float(np.median(loop.changes)), 3)
            headline.append(("changes of the working set", median, f"at most {loop.changes.max()}"))
    statuses = [NOT_JUDGED if status is None else status.replace("_", " ") for status in loop.statuses]
    counts = Counter((status, str(step.source), step.method) for status, step in zip(statuses, loop.steps, strict=True))
    # The largest violation of each softened constraint, and the number of steps with one
    violations = list[tuple[str, str, int]]()
    for name in dict.fromkeys(name for step in loop.steps for name in step.excess):
        amounts = [step.excess.get(name, 0.0) for step in loop.steps]
        violations.append((name, number(max(amounts), 3), sum(amount > 0 for amount in amounts)))
    windows = [_window_row(loop, spectra) for spectra in loop.spectra()]
    note = "Each window of applied controls or measured states against the level of its Spectrogram."
    return _save_tables(
        folder,
        [drawing],
        kind="control loop",
        title=loop.problem.name or "Control loop",
        kicker="Receding-horizon control with constraints in time and in frequency",
        finding=sentence,
        caution=limits_of_plans(loop.problem),
        tiles=headline,
        tables=[
            PageTable("Windows of the applied signals", WINDOW_COLUMNS, windows, {0, 1, 7}, note),
            PageTable(
                "Outcomes of the steps",
                ("problem", "control from", "method", "steps"),
                [(*key, count) for key, count in counts.most_common()],
                {0, 1, 2},
            ),
            PageTable("Relaxed constraints", ("constraint", "largest violation of a plan", "steps"), violations, {0}),
        ],
        facts={"The problem of each step": problem_facts(loop.problem, loop.problem.gap)},
    )


def save_sweep_report(sweep: SweepOutcome, sentence: str, folder: Path) -> Path:
    """Write index.html and its figure, as .svg and .png, into a folder; return the page's path."""
    drawings, caution = list[Drawing](), ""
    try:
        title = "Cost over a parameter; marks are points without a solution"
        drawings.append(drawing_of("sweep", title, "", sweep_figure(sweep)))
    except ProblemError as error:
        caution = f"No figure: {error}"
    table, words = tables.sweep_table(sweep), {len(sweep.names) + i for i in (0, 3, 5)}
    rows = list(
        zip(*([getattr(cell, "plain", cell) for cell in column.cells] for column in table.columns), strict=True)
    )
    statuses = Counter(row["status"] for row in sweep.rows).most_common()
    return _save_tables(
        folder,
        drawings,
        kind="sweep",
        title=sweep.problem,
        finding=sentence,
        caution=caution,
        tiles=[(status, str(count), "") for status, count in statuses],
        tables=[PageTable("Every point", tuple(str(column.header) for column in table.columns), rows, words)],
        facts={"The grid": [(name, ", ".join(map(str, values))) for name, values in sweep.grid.items()]},
    )


def save_problem_page(title: str, about: str, parameters: Facts, facts: Facts, folder: Path) -> Path:
    """Write index.html with a problem, its sketch if the library has it, and its parameters into a folder."""
    lists = {"The problem": facts, "Parameters with their defaults, changed by --set": parameters}
    sketch = Markup(library.sketch_of(title))
    return _save_tables(folder, [], kind="problem", title=title, finding=about, facts=lists, sketch=sketch)


class PageTable(NamedTuple):
    """A table of a page; ``words`` are the numbers of the columns that are no figures."""

    title: str
    columns: tuple[str, ...]
    rows: Rows
    words: Set[int]
    note: str = ""


def _save_tables(folder: Path, drawings: Sequence[Drawing], **values: object) -> Path:
    """Write a page of figures, tables, and then facts under their headings."""
    return save_page(folder, render_template("tables.html.jinja", drawings=drawings, **values), drawings)


def _window_row(loop: LoopRecord, spectra: WindowSpectra) -> list[str]:
    """Return the cells of a limited signal: its worst window, and where its level was exceeded."""
    scale, (window, point) = frequency_scale(loop.problem), spectra.worst
    frequencies, step = scale.factor * spectra.frequencies, loop.problem.sampling_time
    begin = int(spectra.begins[window])
    bands = [f"{number(frequencies[first], 3)} to {number(frequencies[last], 3)}" for first, last in spectra.bands]
    limits = np.unique(spectra.limits) * (1.0 if spectra.joint else spectra.amplitude)
    level = f"{number(float(limits[0]), 3)}" + (f" to {number(float(limits[-1]), 3)}" if len(limits) > 1 else "")
    broken = [] if spectra.joint else [number(at, 3) for at in frequencies[spectra.bins][spectra.exceeded.any(axis=0)]]
    others = (
        f" {scale.unit} and {len(broken) - MOST_NAMED_BINS} more" if len(broken) > MOST_NAMED_BINS else f" {scale.unit}"
    )
    return [
        spectra.name,
        f"{' and '.join(bands)} {scale.unit}",
        f"{level} (root of the energy)" if spectra.joint else level,
        f"{number(100 * float(spectra.ratios.max()), 4)} %",
        f"{number(frequencies[point], 3)} {scale.unit}",
        f"sample {begin}" if step is None else f"{number(step * begin, 3)} s",
        f"{int(spectra.exceeded.any(axis=1).sum())} of {len(spectra.begins)}",
        ", ".join(broken[:MOST_NAMED_BINS]) + others if broken else "none",
    ]


@dataclass(frozen=True)
class Drawing:
    """A figure, ready for the page and for files of its own: ``name``.svg and ``name``.png."""

    name: str
    title: str
    caption: str
    svg: str
    figure: Figure

    def png(self) -> bytes:
        """Return the figure as an image."""
        self.figure.set_dpi(PIXELS_PER_INCH)
        FigureCanvasAgg(self.figure).print_png(png := BytesIO())
        return png.getvalue()

    @property
    def inline(self) -> Markup:
        """Return the figure as an element of a page: without header, with unique ids and the page's colours."""
        body = re.sub(r"<metadata>.*?</metadata>", "", self.svg[self.svg.index("<svg") :], flags=re.DOTALL)
        view_box = re.search(r'viewBox="[^"]*"', body)
        content = body[body.index(">") + 1 :].replace("xlink:href", "href")
        content = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{self.name}-", content)
        for color, variable in (THEMED | THEMED_TINTS).items():
            content = content.replace(color, f"var(--{variable})")
        view = Markup(view_box[0] if view_box else "")
        return Markup('<svg role="img" aria-label="{}" {}>').format(self.title, view) + Markup(content)


def drawing_of(name: str, title: str, caption: str, figure: Figure) -> Drawing:
    """Return a figure as SVG text; its image is drawn when it is asked for."""
    # Names of shapes are the same in every run, and text looks the same on every machine.
    with mpl.rc_context({"svg.hashsalt": "lin-freq-ocp", "svg.fonttype": "path"}):
        FigureCanvasSVG(figure).print_svg(svg := BytesIO(), metadata={"Date": None})
    figure.set_layout_engine("none")  # keeps the layout that was found
    return Drawing(name, title, caption, svg.getvalue().decode(), figure)


def save_page(folder: Path, page: str, drawings: Sequence[Drawing]) -> Path:
    """Write index.html and its figures, each as .svg and .png, into a folder; return the page's path."""
    with report_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    contents = {folder / f"{drawing.name}.svg": drawing.svg.encode() for drawing in drawings}
    contents |= {folder / f"{drawing.name}.png": drawing.png() for drawing in drawings}
    path = folder / "index.html"
    write_each(contents | {path: page.encode()})
    return path
