"""One self-contained HTML page: the finding, the figures, the tables, the proof and the problem."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from matplotlib.figure import Figure

from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.certificate.hybrid.clarke import facts_where_modes_meet
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.filters import can_be_filtered, filter_limits, has_frequency_constraint
from lin_freq_ocp.pages.figures import figures
from lin_freq_ocp.pages.figures.continua import held_figure, vibrations_figure
from lin_freq_ocp.pages.figures.modes import adjoint_figure, smallest_adjoint, strip_rows, strips_figure
from lin_freq_ocp.pages.figures.plot_data import PlotData
from lin_freq_ocp.pages.figures.vibration import moves_figure
from lin_freq_ocp.pages.report import proof
from lin_freq_ocp.pages.report.drawing import Drawing, drawing_of, rendered, save_page
from lin_freq_ocp.pages.report.findings import FILTERING, finding, stop_band_meaning
from lin_freq_ocp.pages.report.moves import moves_caption, moves_rows, moves_title
from lin_freq_ocp.pages.report.tables import NOT_MEANINGFUL, certificate_rows, comparison_rows
from lin_freq_ocp.pages.report.units import rough
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.solving.outcome import Outcome


def save_report(comparison: ComparisonOutcome, folder: str | Path) -> Path:
    """Write index.html and its figures, each as .svg and .png, into a folder; return the page's path."""
    drawings = draw(comparison)
    return save_page(Path(folder), render(comparison, drawings), drawings)


def draw(comparison: ComparisonOutcome) -> tuple[Drawing, ...]:
    """Return all figures that the comparison has something to show in."""
    return tuple(drawing_of(*parts) for parts in _figures(comparison))


def render(comparison: ComparisonOutcome, drawings: tuple[Drawing, ...]) -> str:
    """Return the page."""
    problem, certificate = comparison.problem, comparison.constrained.certificate
    constrained, result = has_frequency_constraint(problem), comparison.constrained
    return rendered(
        "page.html.jinja",
        title=problem.name or "Optimal control problem",
        finding=finding(comparison),
        tiles=tiles(comparison),
        drawings={drawing.name: drawing for drawing in drawings},
        table=comparison_rows(comparison),
        moves=None if comparison.moves is None else moves_rows(comparison.moves),
        filtering=FILTERING,
        not_meaningful=NOT_MEANINGFUL,
        meaning=stop_band_meaning(comparison),
        verdict=[] if certificate is None else proof.verdict(certificate, problem),
        search=proof.search_sentences(result),
        conditions=() if certificate is None else certificate_rows(problem, certificate),
        problem=problem,
        result=result,
        comparison=comparison,
        amplification=rough(comparison.classical_measures.amplification),
        facts=problem_facts(problem, problem.gap),
        filter_limits=filter_limits(problem),
        constrained=constrained,
        filters=comparison.filtered if can_be_filtered(problem) else (),
        solves=[
            *([_how("without the frequency constraint", comparison.classical)] if constrained else []),
            _how("with the constraint" if constrained else "the problem", result),
        ],
        sampling_time=None if problem.sampling_time is None else number(problem.sampling_time),
        version=version("lin-freq-ocp"),
    )


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


def _figures(comparison: ComparisonOutcome) -> Iterator[tuple[str, str, str, Figure]]:
    """Yield name, title, caption and figure."""
    data, result = figures.comparison_data(comparison), comparison.constrained
    shown = comparison.shown_filter
    caption = (
        "Spectra: points are the bins of the DFT, hollow triangles at the lower edge those too small for the axis; "
        "lines are the zero-padded spectrum, which looks between the bins (for many bins, its largest value between "
        "neighbours)."
    )
    filtered = "" if shown is None else f" Filtered: {shown.description}."
    yield "comparison", "Controls, their spectra, and the states", caption + filtered, figures.four_panels(data)
    stopped = [state for state in data.states if state.stop.any()]
    if stopped:
        yield "state_spectra", "Spectra of the states with a stop band", "", figures.spectra_figure(data, stopped)
    if data.outputs:
        yield "output_spectra", "Spectra of the outputs with a band", "", figures.spectra_figure(data, data.outputs)
    if comparison.moves is not None:
        title, caption = moves_title(comparison.moves), moves_caption(comparison.moves)
        yield "vibration", title, caption, moves_figure(comparison.moves)
    yield from _of_continua(data, comparison.moves is None)
    if data.modes:
        rows = strip_rows(comparison)
        yield "modes", "Modes", proof.modes_caption(rows, data.main.label), strips_figure(data, rows)
    yield "states", "Every state in time", "", figures.states_figure(data)
    certificate, multipliers = result.certificate, result.multipliers
    if certificate is None or multipliers is None:
        return
    borders = facts_where_modes_meet(certificate)
    if borders is not None and data.main.trajectory is result.trajectory:
        solution = PlotData(data.problem, (data.main,))
        figure = adjoint_figure(solution, multipliers.eta, comparison.kinks, smallest_adjoint(certificate))
        yield "adjoint", "Adjoint, and its choice at kinks", proof.adjoint_caption(borders), figure
    gap = figures.gap_figure(data, certificate)
    if gap is not None:
        yield "gap", "Gap per stage", proof.parts_of_the_gap(certificate), gap
    if comparison.prices is not None:
        text = (
            "What the optimal cost would lose, per unit, if a removed bin were allowed to be a little above zero, "
            "or the limit of a bin a little higher (its mirror image with it): the magnitude of its multiplier."
        )
        yield "price", "Price of each bin", text, figures.price_figure(data, comparison.prices)


def _of_continua(data: PlotData, with_boxes: bool) -> Iterator[tuple[str, str, str, Figure]]:
    held, vibrations = held_figure(data), vibrations_figure(data) if with_boxes else None
    if held is not None:
        caption = (
            "What the plant sees of a signal that is held between its samples: |sinc(f h) V(2 pi f h)|, images above "
            "the Nyquist frequency included (for many bins, its largest value between neighbours)."
        )
        yield "held_spectra", "Spectra of held signals below their limits", caption, held
    if vibrations is not None:
        caption = "The amplitude that is left in a mode of this natural frequency, the largest over the damping ratios."
        yield "vibration", "Residual vibration over the natural frequency, with its limit", caption, vibrations


def _how(what: str, result: Outcome) -> tuple[str, str, str, str, str]:
    times = ", ".join(f"{stage} {number(seconds, 3)} s" for stage, seconds in result.seconds.items())
    status = f"{result.status.replace('_', ' ')}{': ' if result.message else ''}{result.message}"
    return what, status, result.method, result.backend or "none needed", times
