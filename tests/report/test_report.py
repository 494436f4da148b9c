"""Figures, tables and the page: they say what the measures and the certificate say, and nothing leaves the page."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from io import BytesIO, StringIO
from xml.etree import ElementTree

import matplotlib as mpl
import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from helpers.pages import STATES, double_integrator, parsed
from lin_freq_ocp.analysis.measures import padded_spectrum
from lin_freq_ocp.api.compare import Comparison, compare
from lin_freq_ocp.api.solve import solve
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.errors import ProblemError, SolveError
from lin_freq_ocp.library import pendulum
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import low_pass, notch, stop_band
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.report import findings, proof
from lin_freq_ocp.report.figures.figures import (
    comparison_data,
    comparison_figure,
    gap_figure,
    phase_pairs,
    price_figure,
    result_figure,
    states_figure,
)
from lin_freq_ocp.report.figures.plot_data import view
from lin_freq_ocp.report.figures.style import MOST_POINTS, STYLES, thinned
from lin_freq_ocp.report.page import draw, render, save_report, tiles
from lin_freq_ocp.report.tables import (
    NOT_MEANINGFUL,
    certificate_rows,
    certificate_table,
    comparison_rows,
    comparison_table,
)
from lin_freq_ocp.report.units import aligned, frequency_scale, quantity, rough, time_scale
from lin_freq_ocp.text.phrases import NOTHING, listed, number, runs_in_words, split_unit

CASES: dict[str, Callable[[], OptimalControlProblem]] = {
    "pendulum": pendulum,
    "not replayed": lambda: pendulum(horizon=100, sampling_time=0.1),
    "infeasible": lambda: pendulum(control_bound=4.5),
    "state band": lambda: double_integrator(
        sampling_time=0.01, state_spectrum=stop_band(bins=[5, 6], component=1), state_set=Box([None, -1], [None, 9])
    ),
    "two controls": lambda: double_integrator(
        controls=2,
        control_spectrum=low_pass(1.5, component=0),
        initial_state=(1.0, 0.5),
        terminal_state=Box(None, [0.5, 0.5]),
        name="<b>two</b> & $more$",
    ),
    "no band": lambda: double_integrator(),
}


@pytest.fixture(autouse=True, scope="module")
def _coarse_images():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lin_freq_ocp.report.page.PIXELS_PER_INCH", 60)
        yield


@cache
def case(name: str) -> Comparison:
    filters = None if name == "pendulum" else ["brickwall", "zero_phase"]
    return compare(CASES[name](), filters=filters)


@cache
def drawings(name: str):
    return draw(case(name))


@cache
def page(name: str) -> str:
    return render(case(name), drawings(name))


@cache
def text(name: str) -> str:
    return parsed(page(name)).text


def quietly(name: str) -> list[float]:
    """Return all numbers of the headline."""
    return [float(one) for one in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", str(findings.finding(case(name))))]


@pytest.mark.parametrize("name", CASES)
def test_page_is_one_file_that_loads_nothing(name: str):
    html = page(name)
    found = parsed(html)
    assert not found.open
    assert "://" not in html
    assert not {"script", "link", "iframe", "img", "object", "base"} & set(found.tags)
    assert len(set(found.identifiers)) == len(found.identifiers)
    assert "@import" not in found.styles
    targets = [one.removeprefix("#") for one in found.references if one.startswith("#")]
    assert len(targets) == len(found.references)
    targets += re.findall(r"url\(#([^)]*)\)", found.styles)
    assert len(re.findall(r"url\(", found.styles)) == len(re.findall(r"url\(#", found.styles))
    assert set(targets) <= set(found.identifiers)
    assert len(html.encode()) < 1.5e6


@pytest.mark.parametrize("name", CASES)
def test_page_names_everything(name: str):
    problem, shown = case(name).problem, text(name)
    for component in (*problem.state_names, *problem.control_names):
        assert component in shown
    assert str(findings.finding(case(name))).split(": ", 1)[1].split(". ")[0][1:] in shown
    certificate = case(name).constrained.certificate
    if certificate is not None:
        for condition in certificate.conditions:
            assert f"{condition.label} {condition.name}" in shown
    assert "lin-freq-ocp 0." in shown


def test_names_are_escaped_and_dollars_are_no_formulas():
    assert "<b>two</b>" not in page("two controls")
    assert "&lt;b&gt;two&lt;/b&gt; &amp; $more$" in page("two controls")
    assert "<p> [m]" not in page("two controls")


def test_page_and_figures_do_not_change_from_run_to_run():
    comparison = case("infeasible")
    first, second = drawings("infeasible"), draw(comparison)
    assert [one.svg for one in first] == [one.svg for one in second]
    assert [one.png for one in first] == [one.png for one in second]
    assert render(comparison, first) == render(comparison, second)
    assert mpl.rcParams["svg.hashsalt"] is None


def test_saved_folder_holds_page_and_figures(tmp_path, monkeypatch):
    monkeypatch.setattr("lin_freq_ocp.report.page.draw", lambda _: drawings("state band"))  # they are drawn only once
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


def test_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(ProblemError, match="taken: got File exists"):
        save_report(case("no band"), tmp_path / "taken")


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
    assert "everything holds" in text("pendulum").lower()


def test_stop_band_is_explained_with_its_peaks():
    comparison, shown = case("pendulum"), text("pendulum")
    assert "97 to 120 of force" in shown
    assert comparison.constrained_measures is not None
    for measures in (comparison.constrained_measures, comparison.classical_measures):
        assert number(measures.stopband_peak, 3) in findings.stop_band_meaning(comparison)[1]


def test_an_infeasible_problem_shows_its_conflict_and_no_certificate():
    comparison, shown = case("infeasible"), text("infeasible")
    assert comparison.constrained.status == "infeasible"
    assert "No trajectory satisfies all constraints" in shown
    for block in comparison.constrained.conflict or ():
        assert str(block) in shown
    assert "The proof rests on" in shown
    assert "C-iii" not in shown
    assert [one.name for one in drawings("infeasible")] == ["comparison", "states"]
    assert ("with the constraint", "infeasible", "proven") in tiles(comparison)
    assert "constrained" not in [trace.label for trace in comparison_data(comparison).traces]
    assert {row.cells[-1].text for group in comparison_rows(comparison).groups for row in group.rows} == {NOTHING}


def test_without_a_meaningful_replay_no_states_are_claimed():
    comparison = case("not replayed")
    assert not comparison.replay_is_meaningful
    table = comparison_rows(comparison)
    groups = {group.title: group for group in table.groups}
    filtered = slice(1, -1)
    for title in ("Beyond the state bounds by", "Misses the end state by"):
        assert {cell.text for row in groups[title].rows for cell in row.cells[filtered]} == {NOT_MEANINGFUL}
        assert NOT_MEANINGFUL not in {row.cells[-1].text for row in groups[title].rows}
    one_step = groups["Misses the next planned state, in one step, by"]
    for i, row in enumerate(one_step.rows):
        expected = [one.replay.one_step_residual[i] for one in comparison.filtered]
        assert [float(cell.text) for cell in row.cells[filtered]] == pytest.approx(expected, rel=1e-3)
    assert "cannot be replayed" in text("not replayed")
    figure = comparison_figure(comparison)
    assert all(any("not replayed" in one.get_text() for one in ax.texts) for ax in figure.axes[2:])
    orange = STYLES["filtered"].color
    assert [sum(line.get_color() == orange for line in ax.lines) > 0 for ax in figure.axes] == [
        True,
        True,
        False,
        False,
    ]


def test_without_a_stop_band_there_is_nothing_to_filter():
    comparison = case("no band")
    assert findings.finding(comparison).filtering == ""
    assert "nothing to filter" in text("no band")
    assert comparison_rows(comparison).columns == ("optimal",)
    assert "The filters" not in text("no band")
    assert "brickwall" not in text("no band")
    assert comparison.shown_filter is None
    assert [trace.label for trace in comparison_data(comparison).traces] == ["optimal"]


def test_state_stop_bands_have_their_spectra():
    comparison = case("state band")
    assert [one.name for one in drawings("state band")] == ["comparison", "state_spectra", "states", "gap", "price"]
    assert "5 to 6 of speed & co" in text("state band")
    assert "Stop band of the states" in text("state band")
    assert "Stop band of the controls" not in text("state band")
    (figure_axes,) = price_axes(comparison)
    assert figure_axes.get_title(loc="left") == "Price of each removed state bin"


def price_axes(comparison: Comparison):
    assert comparison.prices is not None
    return price_figure(comparison_data(comparison), comparison.prices).axes


def test_every_control_has_its_panels():
    figure = comparison_figure(case("two controls"))
    assert len(figure.axes) == 6
    assert figure.axes[2].get_ylabel() == "pull \\$b\\$"
    assert figure.axes[0].get_xlabel() == "step t"
    assert figure.axes[1].get_xlabel() == "frequency [rad/sample]"
    assert "no stop band here" in [one.get_text() for one in figure.axes[3].texts]


def test_panels_draw_the_data():
    comparison = case("pendulum")
    trajectory = comparison.constrained.trajectory
    assert trajectory is not None
    figure = comparison_figure(comparison)
    blue = STYLES["constrained"].color
    control, spectrum, portrait, _ = figure.axes
    (drawn,) = (line for line in control.lines if line.get_color() == blue)
    np.testing.assert_array_equal(drawn.get_ydata()[:-1], trajectory.u[:, 0])
    np.testing.assert_allclose(drawn.get_xdata(), 0.01 * np.arange(241))
    lines = {line.get_marker(): line for line in spectrum.lines if line.get_color() == blue}
    magnitude, floor = np.abs(np.fft.rfft(trajectory.u[:, 0])), lines["v"].get_ydata()[0]
    np.testing.assert_allclose(lines["o"].get_ydata(), magnitude[magnitude >= floor])
    np.testing.assert_allclose(lines["v"].get_xdata(), np.flatnonzero(magnitude < floor) / 2.4)
    assert set(range(97, 121)) <= set(np.round(2.4 * lines["v"].get_xdata()).astype(int))
    between = padded_spectrum(trajectory.u)[1][:, 0]
    inside = (lines["None"].get_xdata() > 97 / 2.4) & (lines["None"].get_xdata() < 50)
    assert comparison.constrained_measures is not None
    peak = lines["None"].get_ydata()[inside].max()
    assert peak == pytest.approx(comparison.constrained_measures.stopband_peak)
    assert lines["None"].get_ydata().max() == between.max()
    curve = next(line for line in portrait.lines if line.get_color() == blue)
    np.testing.assert_array_equal(curve.get_xydata(), trajectory.x[:, [0, 2]])


def test_a_trajectory_that_flies_off_does_not_squeeze_the_others():
    comparison = case("pendulum")
    trajectory = comparison.constrained.trajectory
    assert trajectory is not None
    _, _, position, angle = comparison_figure(comparison).axes
    low, high = angle.get_xlim()
    assert np.ptp(trajectory.x[:, 1]) > 0.8 * (high - low)
    assert any("leaves the picture; ends 16.7 rad and 74.7 rad/s away" in one.get_text() for one in angle.texts)
    assert any("ends 0.813 m" in one.get_text() for one in position.texts)


def test_view_keeps_trajectories_and_near_overlays():
    main, far, near = np.array([0.0, 1.0]), np.array([0.0, 9.0]), np.array([-0.4, 0.0])
    bounds = np.array([-np.inf, 1.5, 40.0])
    seen = view([main], [far], bounds)
    assert seen.outside
    assert seen.low < 0
    assert 1.5 < seen.high < 2
    seen = view([main], [near], bounds)
    assert not seen.outside
    assert seen.low < -0.4
    constant = view([np.array([3.0, 3.0])], [], np.array([]))
    assert constant.low < 3 < constant.high


def test_without_a_brick_wall_the_first_filter_is_shown():
    comparison = case("pendulum")
    alone = replace(comparison, filtered=comparison.filtered[3:4])
    trace = comparison_data(alone).traces[1]
    assert (trace.label, trace.detail) == ("filtered", "moving average")
    assert trace.trajectory is comparison.filtered[3].replay.trajectory
    nothing = replace(comparison, filtered=())
    assert findings.finding(nothing).filtering == ""
    assert [trace.label for trace in comparison_data(nothing).traces] == ["classical", "constrained"]


def test_result_figure_shows_one_solution():
    result = case("state band").constrained
    figure = result.plot()
    assert len(figure.axes) == 5
    assert result_figure(replace(result, status="limit")).legends[0].get_texts()[0].get_text() == "best point"
    with pytest.raises(SolveError, match="without a trajectory"):
        result_figure(case("infeasible").constrained)


@pytest.mark.parametrize(("n", "panels"), [(1, 3), (2, 5), (3, 7), (4, 8), (5, 9), (9, 6)])
def test_any_number_of_states_can_be_drawn(n: int, panels: int):
    problem = OptimalControlProblem(
        LinearDynamics(0.9 * np.eye(n) + 0.1 * np.eye(n, k=1), np.ones((n, 1))),
        horizon=6,
        cost=QuadraticCost(Q=1.0, R=1.0),
        state_set=[Box(-2 - 0.1 * t, 2) for t in range(7)],
        initial_state=np.ones(n),
    )
    result = solve(problem)
    figure = result_figure(result)
    assert len(figure.axes) == panels
    assert len(phase_pairs(n)) == {1: 0, 2: 1}.get(n, 2)
    assert len(states_figure(comparison_data(compare(problem))).axes) == n
    assert (
        "state: x_0",
        "bounds that depend on time: lower -2.6 to -2, upper 2; starts at 1; ends anywhere",
    ) in problem_facts(problem)


def test_positions_are_paired_with_their_speeds():
    assert phase_pairs(4) == [(0, 2), (1, 3)]
    assert phase_pairs(8) == [(0, 4), (1, 5)]
    assert phase_pairs(3) == [(0, 1), (1, 2)]
    assert phase_pairs(1) == []


def test_prices_and_gaps_are_the_multipliers_and_stage_gaps():
    comparison = case("pendulum")
    result = comparison.constrained
    assert result.multipliers is not None
    assert result.certificate is not None
    (ax,) = price_axes(comparison)
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), np.abs(result.multipliers.rho_u[97:, 0]))
    np.testing.assert_allclose(ax.lines[0].get_xdata(), np.arange(97, 121) / 2.4)
    figure = gap_figure(comparison_data(comparison), result.certificate)
    assert figure is not None
    gaps = result.certificate.stage_gaps
    assert gaps is not None
    points, lower_edge = figure.axes[0].lines[:2]
    np.testing.assert_array_equal(points.get_ydata(), gaps[gaps > 1e-6 * gaps.max()])
    assert len(lower_edge.get_ydata()) == len(gaps) - len(points.get_ydata())
    unbounded = replace(result.certificate, bound=None)
    assert gap_figure(comparison_data(comparison), unbounded) is None
    assert proof.parts_of_the_gap(unbounded) == ""


def test_comparison_rows_are_the_measures():
    comparison = case("pendulum")
    groups = {group.title: group.rows for group in comparison_rows(comparison).groups}
    constrained = comparison.constrained_measures
    assert constrained is not None
    measured = [comparison.classical_measures, *(one.replay.measures for one in comparison.filtered), constrained]
    assert comparison_rows(comparison).columns[:2] == ("classical", "brickwall")
    for column, measures in enumerate(measured):

        def largest(title: str, column: int = column) -> float:
            return max(float(row.cells[column].text) for row in groups[title])

        for title, value in {
            "": measures.cost,
            "Largest magnitude": measures.max_control,
            "Beyond the control bounds by": measures.control_violation,
            "Beyond the state bounds by": measures.state_violation,
            "Misses the end state by": measures.terminal_error,
        }.items():
            assert largest(title) == pytest.approx(value, rel=0.05 if value and value < 1e-3 else 1e-3)
        energy, peak = groups["Stop band of the controls"]
        assert float(energy.cells[column].text) == pytest.approx(measures.stopband_energy, rel=0.05)
        assert float(peak.cells[column].text) == pytest.approx(measures.stopband_peak, rel=1e-3)


def test_cells_fail_where_a_constraint_does():
    table = comparison_rows(case("pendulum"))
    constrained = [row.cells[-1] for group in table.groups for row in group.rows]
    assert False not in {cell.passed for cell in constrained}
    groups = {group.title: group.rows for group in table.groups}
    brick_wall = table.columns.index("brickwall")
    assert [row.cells[brick_wall].passed for row in groups["Beyond the state bounds by"]] == [False, False, True, False]
    assert [row.cells[brick_wall].passed for row in groups["Misses the end state by"]] == [False] * 4
    energy = groups["Stop band of the controls"][0]
    assert [cell.passed for cell in energy.cells] == [False, True, False, False, False, False, True]
    assert "✗" in text("pendulum")


@pytest.mark.parametrize("name", ["pendulum", "state band", "two controls"])
def test_certificate_rows_are_the_conditions(name: str):
    problem, certificate = case(name).problem, case(name).constrained.certificate
    assert certificate is not None
    rows = certificate_rows(problem, certificate)
    assert [(row.label, row.name, row.passed) for row in rows] == [
        (one.label, one.name, one.passed) for one in certificate.conditions
    ]
    for row, one in zip(rows, certificate.conditions, strict=True):
        for shown, value in ((row.residual, one.residual), (row.scale, one.scale), (row.relative, one.relative)):
            assert float(shown) == pytest.approx(value, rel=0.06)
        if one.residual == 0 or one.component is None:
            assert row.place == NOTHING
        else:
            names = problem.control_names if one.label in ("C-v", "C-vii", "S-u", "N-u") else problem.state_names
            assert row.place.endswith(split_unit(names[one.component])[0])
            assert str(one.time) in row.place
            assert ("bin" in row.place) == (one.label in ("C-vi", "C-vii"))


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
    failing = [row for row in certificate_rows(comparison.problem, certificate) if not row.passed]
    assert failing
    assert failing[0].verdict == "fails"
    sentences = proof.verdict(certificate)
    assert "violated" in sentences[0]
    assert all(row.label in sentences[0] for row in failing)
    spoiled = replace(
        comparison, constrained=replace(comparison.constrained, certificate=certificate, message="out of time")
    )
    assert "not every constraint holds (out of time)" in str(findings.finding(spoiled))
    assert "✗ fails" in parsed(render(spoiled, draw_nothing())).text
    assert "not judged" in proof.verdict(replace(certificate, pmp="not_applicable"))[0]
    assert "no global lower bound" in proof.verdict(replace(certificate, bound=None))[1]


def draw_nothing():
    """Stand in for drawings where only the words matter."""
    blank = drawings("no band")[0]
    return tuple(replace(blank, name=name) for name in ("comparison", "states"))


def test_a_solve_without_an_answer_has_a_page():
    comparison = case("pendulum")
    result = replace(comparison.constrained, status="limit", message="time is up", trajectory=None, certificate=None)
    stopped = replace(comparison, constrained=result)
    assert "no solution (limit: time is up)" in str(findings.finding(stopped))
    assert ("with the constraint", "limit", "") in tiles(stopped)
    shown = parsed(render(stopped, draw_nothing())).text
    assert "limit: time is up" in shown
    assert "The proof" not in shown
    assert "Why there is no solution" not in shown


def test_a_harmless_filter_is_not_blamed():
    problem = double_integrator(control_spectrum=stop_band(bins=[7]), terminal_state=None)
    comparison = compare(problem, filters=["brickwall"])
    assert findings.finding(comparison).filtering == "breaks no constraint"
    dear = case("state band")
    assert "leaves an energy of" in findings.finding(dear).filtering


def test_extra_cost_reads_well():
    def said(before: float, after: float) -> str:
        comparison = case("pendulum")
        certificate = comparison.constrained.certificate
        assert certificate is not None
        changed = replace(comparison.constrained, certificate=replace(certificate, cost=after))
        classical = replace(comparison.classical, certificate=replace(certificate, cost=before))
        return findings.finding(replace(comparison, constrained=changed, classical=classical)).solution

    assert "for 12.5 % more cost" in said(80.0, 90.0)
    assert "for 0.25 % more cost" in said(80.0, 80.2)
    assert "for a cost of 90 instead of 8" in said(8.0, 90.0)
    assert "for a cost of -1 instead of -3" in said(-3.0, -1.0)


@pytest.mark.parametrize("name", CASES)
def test_terminal_tables_show_units_and_rows(name: str):
    comparison = case(name)
    console = Console(file=StringIO(), width=220)
    console.print(comparison_table(comparison))
    shown = console.file.getvalue()
    for group in comparison_rows(comparison).groups:
        for row in group.rows:
            assert (f"{row.label} [{row.unit}]" if row.unit else row.label) in shown
            for cell in row.cells:
                assert cell.text in shown
    certificate = comparison.constrained.certificate
    if certificate is not None:
        console.print(certificate_table(comparison.problem, certificate))
        assert "maximum principle satisfied" in console.file.getvalue()
        assert all(f" {one.name} " in console.file.getvalue() for one in certificate.conditions)


def test_problem_is_described():
    facts = dict(problem_facts(pendulum()))
    assert facts["horizon"] == "240 steps of 0.01 s (2.4 s)"
    assert facts["control: force [N]"] == "within ±5"
    assert facts["state: position [m]"] == "within ±0.2; starts at -0.15; ends at 0.15"
    assert facts["minimise"] == "the sum of ½ u' R u"
    assert facts["where"] == "R = 2"
    facts = dict(problem_facts(case("state band").problem))
    assert facts[f"state: {STATES[0]}"] == "no bound; starts at 0; ends at 1"
    assert facts[f"state: {STATES[1]}"] == "from -1 to 9; starts at 0; ends at 0"
    reaching = replace(case("no band").problem, terminal_state=Box([None, 0], [2, None]))
    assert dict(problem_facts(reaching))[f"state: {STATES[0]}"] == "no bound; starts at 0; ends at most 2"
    assert dict(problem_facts(reaching))[f"state: {STATES[1]}"] == "no bound; starts at 0; ends at least 0"


def test_costs_are_described_term_by_term():
    problem = case("no band").problem
    everything = QuadraticCost(
        Q=np.diag([1.0, 2.0]), R=3.0, S=np.ones((2, 1)), q=[1, 1], r=[1], P=2.0, p=[0, 1], x_ref=[1, 0], u_ref=[0]
    )
    facts = problem_facts(replace(problem, cost=everything))
    (told,) = (value for term, value in facts if term == "minimise")
    data = " ".join(value for term, value in facts if term == "where")
    for term in (
        "(x - x_ref)' Q (x - x_ref)",
        "u' R u",
        "(x - x_ref)' S u",
        "q' x",
        "r' u",
        "P (x - x_ref) at the end",
    ):
        assert term in told
    for value in ("Q = diag(1, 2)", "R = 3", "S = [1; 1]", "P = 2 I", "p = (0, 1)", "x_ref = (1, 0)"):
        assert value in data
    assert dict(problem_facts(replace(problem, cost=QuadraticCost())))["minimise"].startswith("nothing")


def test_axes_have_readable_units():
    def scales(step: float | None) -> tuple[str, str]:
        problem = double_integrator(horizon=100, sampling_time=step)
        return time_scale(problem).unit, frequency_scale(problem).unit

    assert scales(None) == ("steps", "rad/sample")
    assert scales(1e-6) == ("\N{MICRO SIGN}s", "Hz")
    assert scales(1e-3) == ("ms", "Hz")
    assert scales(10.0) == ("s", "Hz")
    problem = double_integrator(horizon=100, sampling_time=1e-3, control_spectrum=notch(centre_hz=100, width_hz=50))
    scale = frequency_scale(problem)
    assert scale.factor * 2 * np.pi * 10 / 100 == pytest.approx(100)
    assert time_scale(problem).factor * 100 == pytest.approx(100)


@given(st.floats(-1e300, 1e300))
def test_numbers_are_close_to_what_they_show(value: float):
    for shown, accuracy in ((number(value), 5e-2), (aligned(value), 5e-2), (rough(value), 6e-2)):
        assert float(shown) == pytest.approx(value, rel=accuracy, abs=0)
    assert value == 0 or float(number(value)) != 0


def test_numbers_read_well():
    assert [number(one) for one in (None, 0, 2852.7053, 12345.6, 9.0e-27, 8.1e46, 0.25)] == [
        NOTHING,
        *("0", "2852.7", "12346", "9.0e-27", "8.1e46", "0.25"),
    ]
    assert [aligned(one) for one in (None, 0, 5.0, 2852.7, 9.0e-27)] == [NOTHING, "0", "5.000", "2852.7", "9.0e-27"]
    assert split_unit("angular speed [rad/s]") == ("angular speed", "rad/s")
    assert split_unit("x_0") == ("x_0", "")
    assert quantity(0.85752, "force [N]") == "0.858 N"
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert runs_in_words([(3, 3), (7, 9)]) == "3 and 7 to 9"


def test_long_signals_keep_their_extremes():
    t = np.arange(50_000.0)
    y = np.sin(t / 7) + (t == 31_234) * 5
    x, thin = thinned(t, y)
    assert len(thin) <= MOST_POINTS + 2
    assert thin.max() == y.max()
    assert x[thin.argmax()] == 31_234
    assert (x[0], x[-1]) == (0, 49_999)
    assert np.all(np.diff(x) > 0)
    same = thinned(t[:10], y[:10])
    assert same[1] is not None
    np.testing.assert_array_equal(same[0], t[:10])


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


def test_plotting_libraries_are_imported_late():
    code = "import sys, lin_freq_ocp; print({'matplotlib', 'jinja2', 'lin_freq_ocp.report'} & set(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"
