"""The page says what the measures and the certificate say."""

from __future__ import annotations

import re
from dataclasses import replace
from io import BytesIO
from xml.etree import ElementTree

import matplotlib as mpl
import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from helpers.compared_pages import CASES, blanks, case, drawings, page, price_axes, text
from helpers.pages import double_integrator, parsed
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp import MagnitudeBound, Trajectory, compare, library, low_pass, stop_band
from lin_freq_ocp.base import NOTHING, number
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.pages import (
    NOT_MEANINGFUL,
    STYLES,
    comparison_data,
    comparison_figure,
    comparison_rows,
    draw_figures,
    drawing_of,
    finding_of,
    render_page,
    save_report,
    stop_band_meaning,
    tiles,
    verdict,
)
from lin_freq_ocp.results import Certificate, Comparison


def quietly(name: str) -> list[float]:
    """Return all numbers of the headline."""
    return [float(one) for one in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", str(finding_of(case(name))))]


@expensive
@pytest.mark.parametrize("name", CASES)
def test_page_names_its_finding_and_all_conditions(name: str):
    shown = text(name)
    assert str(finding_of(case(name))).split(": ", 1)[1].split(". ")[0][1:] in shown
    certificate = case(name).constrained.certificate
    if certificate is not None:
        for condition in certificate.conditions:
            assert f"{condition.label} {condition.name}" in shown
    assert "lin-freq-ocp 0." in shown


@expensive
def test_page_and_figures_do_not_change_from_run_to_run(images):
    comparison = case("infeasible")
    first, second = drawings("infeasible"), tuple(draw_figures(comparison))
    assert [one.svg for one in first] == [one.svg for one in second]
    assert first[0].png() == second[0].png()
    assert render_page(comparison, first) == render_page(comparison, second)
    assert mpl.rcParams["svg.hashsalt"] is None


def test_the_image_of_a_figure_is_drawn_only_when_it_is_asked_for(images, monkeypatch):
    drawn, honest = [], FigureCanvasAgg.print_png
    monkeypatch.setattr(FigureCanvasAgg, "print_png", lambda *given: drawn.append(given) or honest(*given))
    figure = Figure()
    figure.subplots()
    drawing = drawing_of("one", "One", "", figure)
    assert not drawn
    assert drawing.png().startswith(b"\x89PNG")
    assert len(drawn) == 1


@expensive
def test_saved_folder_holds_page_and_figures(images, tmp_path, monkeypatch):
    substitute(monkeypatch, "pages.draw_figures", lambda _: drawings("state band"))  # they are drawn only once
    path = case("state band").save(tmp_path / "new" / "folder")
    assert path == tmp_path / "new" / "folder" / "index.html"
    assert path.read_text(encoding="utf-8") == page("state band")
    names = {"comparison", "state_spectra", "states", "gap", "price"}
    assert {one.stem for one in path.parent.glob("*.png")} == {one.stem for one in path.parent.glob("*.svg")} == names
    for name in names:
        image = matplotlib.image.imread(BytesIO((path.parent / f"{name}.png").read_bytes()))
        assert min(image.shape[:2]) > 150
        assert image[..., :3].std() > 0.02
        root = ElementTree.parse(path.parent / f"{name}.svg").getroot()
        assert root.tag.endswith("svg")
        assert "Date" not in (path.parent / f"{name}.svg").read_text(encoding="utf-8")


def test_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    substitute(monkeypatch, "pages.draw_figures", lambda _: blanks())
    (tmp_path / "taken").write_text("")
    with pytest.raises(ProblemError, match="taken: got File exists"):
        save_report(case("no band"), tmp_path / "taken")


@expensive
def test_headline_has_the_measured_numbers():
    comparison = case("pendulum")
    numbers = quietly("pendulum")
    measures, best = comparison.filtered[0].replay.measures, comparison.constrained
    assert measures.terminal_errors is not None
    assert best.cost is not None
    assert comparison.classical.cost is not None
    expected = [
        measures.control_violation,
        measures.max_control,
        *np.flatnonzero(np.abs(comparison.filtered[0].replay.trajectory.u[:, 0]) > 5.8),
        1,  # other state beyond its bounds
        *measures.terminal_errors[:2],
        2,  # other states that miss the end
        100 * (best.cost / comparison.classical.cost - 1),
        best.gap,
    ]
    assert numbers == pytest.approx(expected, rel=2e-2)
    assert numbers[:2] == pytest.approx([0.857523687, 5.857523687], rel=2e-3)
    assert numbers[5:7] == pytest.approx([0.8134, 16.722], rel=2e-3)
    assert numbers[8] == pytest.approx(12.1, abs=0.06)
    assert "all constraints hold" in text("pendulum").lower()


@expensive
def test_stop_band_is_explained_with_its_peaks():
    comparison, shown = case("pendulum"), text("pendulum")
    assert "97 to 120 of force" in shown
    assert comparison.constrained_measures is not None
    for measures in (comparison.constrained_measures, comparison.classical_measures):
        assert number(measures.stopband_peak, 3) in stop_band_meaning(comparison)[1]


@expensive
def test_an_infeasible_problem_shows_its_conflict_and_no_certificate():
    comparison, shown = case("infeasible"), text("infeasible")
    assert comparison.constrained.status == "infeasible"
    assert "No trajectory satisfies all constraints" in shown
    for block in comparison.constrained.conflict or ():
        assert str(block) in shown
    assert "The proof uses these constraints" in shown
    assert "C-iii" not in shown
    assert [one.name for one in drawings("infeasible")] == ["comparison", "states"]
    assert ("with the constraint", "infeasible", "proven") in tiles(comparison)
    assert "constrained" not in [trace.label for trace in comparison_data(comparison).traces]
    assert {row.cells[-1].text for group in comparison_rows(comparison).groups for row in group.rows} == {NOTHING}


@expensive
def test_without_a_meaningful_replay_no_states_are_claimed():
    comparison = case("not simulated")
    assert not comparison.replay_is_meaningful
    table = comparison_rows(comparison)
    groups = {group.title: group for group in table.groups}
    filtered = slice(1, -1)
    for title in ("Violates the state bounds by", "Misses the end state by"):
        assert {cell.text for row in groups[title].rows for cell in row.cells[filtered]} == {NOT_MEANINGFUL}
        assert NOT_MEANINGFUL not in {row.cells[-1].text for row in groups[title].rows}
    one_step = groups["Misses the next planned state, in one step, by"]
    for i, row in enumerate(one_step.rows):
        expected = [one.replay.one_step_residual[i] for one in comparison.filtered]
        assert [float(cell.text) for cell in row.cells[filtered]] == pytest.approx(expected, rel=1e-3)
    assert "cannot be simulated" in text("not simulated")
    figure = comparison_figure(comparison)
    assert all(any("not simulated" in one.get_text() for one in ax.texts) for ax in figure.axes[2:])
    orange = STYLES["filtered"].color
    assert [sum(line.get_color() == orange for line in ax.lines) > 0 for ax in figure.axes] == [
        True,
        True,
        False,
        False,
    ]


@expensive
def test_without_a_stop_band_there_is_nothing_to_filter():
    comparison = case("no band")
    assert finding_of(comparison).filtering == ""
    assert "nothing to filter" in text("no band")
    assert comparison_rows(comparison).columns == ("optimal",)
    assert "The filters" not in text("no band")
    assert "brickwall" not in text("no band")
    assert comparison.shown_filter is None
    assert [trace.label for trace in comparison_data(comparison).traces] == ["optimal"]


@expensive
def test_state_stop_bands_have_their_spectra():
    comparison = case("state band")
    assert [one.name for one in drawings("state band")] == ["comparison", "state_spectra", "states", "gap", "price"]
    assert "5 to 6 of speed & co" in text("state band")
    assert "Stop band of the states" in text("state band")
    assert "Stop band of the controls" not in text("state band")
    (figure_axes,) = price_axes(comparison)
    assert figure_axes.get_title(loc="left") == "Price of each removed state bin"


def test_bins_under_a_mask_are_no_stop_band():
    problem = library.double_integrator(cutoff_hz=None)
    mask = MagnitudeBound(1000.0, band=low_pass(1.0))
    comparison = compare(replace(problem, control_spectrum=mask), filters=["brickwall"])
    titles = [group.title for group in comparison_rows(comparison).groups]
    assert "Bounded bins of the controls" in titles
    assert "Stop band of the controls" not in titles


def test_cells_fail_where_a_constraint_does():
    table = comparison_rows(case("pendulum"))
    constrained = [row.cells[-1] for group in table.groups for row in group.rows]
    assert False not in {cell.passed for cell in constrained}
    groups = {group.title: group.rows for group in table.groups}
    brick_wall = table.columns.index("brickwall")
    assert [row.cells[brick_wall].passed for row in groups["Violates the state bounds by"]] == [
        False,
        False,
        True,
        False,
    ]
    assert [row.cells[brick_wall].passed for row in groups["Misses the end state by"]] == [False] * 4
    energy = groups["Stop band of the controls"][0]
    assert [cell.passed for cell in energy.cells] == [False, True, False, False, False, False, True]
    assert "✗" in text("pendulum")


def violated(comparison: Comparison) -> Certificate:
    """Judge a control that is a little too large."""
    result = comparison.constrained
    assert result.trajectory is not None
    assert result.multipliers is not None
    moved = Trajectory(result.trajectory.x, 1.01 * result.trajectory.u)
    return judge(comparison.problem, moved, result.multipliers)


def test_failing_conditions_are_named():
    comparison = case("pendulum")
    certificate = violated(comparison)
    failing = certificate.failed
    assert failing
    sentences = verdict(certificate)
    assert "violated" in sentences[0]
    assert all(row.label in sentences[0] for row in failing)
    spoiled = replace(
        comparison, constrained=replace(comparison.constrained, certificate=certificate, message="out of time")
    )
    assert "not every constraint holds (out of time)" in str(finding_of(spoiled))
    assert "✗ fails" in parsed(render_page(spoiled, blanks())).text
    assert "was not checked" in verdict(replace(certificate, applicable=False))[0]
    assert "no global lower bound" in verdict(replace(certificate, bound=None))[1]


def test_a_solve_without_an_answer_has_a_page():
    comparison = case("pendulum")
    result = replace(comparison.constrained, status="limit", message="time is up", trajectory=None, certificate=None)
    stopped = replace(comparison, constrained=result)
    assert "no point found (time is up)" in str(finding_of(stopped))
    assert ("with the constraint", "limit", "") in tiles(stopped)
    shown = parsed(render_page(stopped, blanks())).text
    assert "limit: time is up" in shown
    assert "The proof" not in shown
    assert "Why there is no solution" not in shown


def test_a_harmless_filter_is_not_blamed():
    problem = double_integrator(control_spectrum=stop_band(bins=[7]), terminal_state=None)
    comparison = compare(problem, filters=["brickwall"])
    assert finding_of(comparison).filtering == "breaks no constraint"
    dear = case("state band")
    assert "leaves an energy of" in finding_of(dear).filtering


def test_extra_cost_reads_well():
    def said(before: float, after: float) -> str:
        comparison = case("pendulum")
        certificate = comparison.constrained.certificate
        assert certificate is not None
        changed = replace(comparison.constrained, certificate=replace(certificate, cost=after))
        classical = replace(comparison.classical, certificate=replace(certificate, cost=before))
        return finding_of(replace(comparison, constrained=changed, classical=classical)).solution

    assert "for 12.5 % more cost" in said(80.0, 90.0)
    assert "for 0.25 % more cost" in said(80.0, 80.2)
    assert "for 0.25 % less cost" in said(80.0, 79.8)
    assert "all constraints hold, at the same cost, " in said(80.0, 80.0 - 1e-9)
    assert "for a cost of 90 instead of 8" in said(8.0, 90.0)
    assert "for a cost of -1 instead of -3" in said(-3.0, -1.0)


def test_entries_say_what_holds():
    by_label = {entry.label: entry for entry in case("pendulum").trajectories}
    assert by_label["constrained"].empties_band(of_states=False) is True
    assert by_label["constrained"].empties_band(of_states=True) is None
    assert by_label["classical"].empties_band(of_states=False) is False
    end = by_label["brickwall"].end
    measures = by_label["brickwall"].measures
    assert end is not None
    assert measures is not None
    np.testing.assert_array_equal(end.values, measures.terminal_errors)
