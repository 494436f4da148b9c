"""Pages and figures of problems with modes: tints and strips, the adjoint with its kinks, and what the words say."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle

import lin_freq_ocp as lfo
from helpers.compared_pages import blanks
from helpers.kinks import peak, rotation, valley
from helpers.pages import double_integrator, parsed
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp import OptimalControlProblem, Trajectory, compare, library, solve
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.certificate.hybrid import kinks
from lin_freq_ocp.comparison import NO_MODE, mode_sequence
from lin_freq_ocp.pages import (
    THEMED,
    THEMED_TINTS,
    TINTS,
    Span,
    adjoint_caption,
    adjoint_figure,
    certificate_table,
    comparison_data,
    comparison_rows,
    draw_figures,
    finding_of,
    modes_caption,
    render_page,
    result_data,
    result_figure,
    search_sentences,
    shade_modes,
    spans,
    states_figure,
    strip_rows,
    strips_figure,
    switching_sentences,
    tiles,
    worst_location,
)
from lin_freq_ocp.problem import problem_facts
from lin_freq_ocp.results import Comparison, Multipliers, Result
from lin_freq_ocp.transform.hybrid import piecewise_affine


def vanishing_norm() -> OptimalControlProblem:
    """a = |(a, b)| + v, b = w: the cost a_2 + (v_0^2 + w_0^2 + v_1^2 + w_1^2)/4 holds x_1 at the kink (0, 0).

    From x_0 = (1, 0): v_0 = -1, w_0 = 0, and eta_1 = (-1, 0), eta_0 = (-1/2, 0) = -xi, so xi = (1/2, 0).
    """
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [lfo.norm([x[0], x[1]]) + u[0], u[1]], 2, 2)
    cost = lfo.QuadraticCost(R=0.5 * np.eye(2), p=[1.0, 0.0])
    return OptimalControlProblem(dynamics, 2, cost, control_set=lfo.Box(-2, 2), initial_state=(1.0, 0.0))


def by_hand() -> Result:
    """Return the solution of that problem as its docstring has it."""
    problem = vanishing_norm()
    trajectory = Trajectory(np.array([[1.0, 0], [0, 0], [-2, 0]]), np.array([[-1.0, 0], [-2, 0]]))
    multipliers = Multipliers(
        eta_C=1.0,
        eta=np.array([[-0.5, 0], [-1, 0]]),
        rho_x=np.zeros((2, 2), complex),
        rho_u=np.zeros((2, 2), complex),
        mu=np.array([[-0.5, 0], [0, 0], [0, 0]]),
        nu=np.zeros((2, 2)),
    )
    certificate = judge(problem, trajectory, multipliers)
    assert certificate.pmp == "satisfied"
    return Result(problem, "optimal", "by hand", None, {}, trajectory, multipliers, certificate)


@pytest.fixture(scope="module", autouse=True)
def without_bounds():
    """Smooth pieces get no global bound here: pages without one are looked at, and it takes its time."""
    with pytest.MonkeyPatch.context() as patch:
        substitute(patch, "solving.hybrid.GLOBAL_SECONDS", 0.0)
        yield


CASES = {
    "wall": lambda: library.pendulum_with_wall(horizon=20, control_spectrum="freq"),
    "tree": library.buck_affine,
    "absolute": library.absolute_value,
    "kink": lambda: library.buck_converter(4, terminal_state=None, terminal_price=-40.0),
    "norm": by_hand,
    "linear": double_integrator,
}


@cache
def case(name: str) -> Comparison:
    if name == "wall":
        return compare(CASES[name](), filters=["brickwall", "zero_phase"])
    result = by_hand() if name == "norm" else solve(CASES[name]())
    return Comparison(result.problem, result, result, ())


@cache
def drawings(name: str):
    return {drawing.name: drawing for drawing in draw_figures(case(name))}


@cache
def page(name: str) -> str:
    return render_page(case(name), tuple(drawings(name).values()))


@cache
def text(name: str) -> str:
    return parsed(re.sub(r"<svg.*?</svg>", "", page(name), flags=re.DOTALL)).text


def tints(ax) -> list[tuple[float, float, str]]:
    """Return start, end and colour of what stands behind everything else in a panel."""
    behind = [one for one in ax.patches if isinstance(one, Rectangle) and to_hex(one.get_facecolor()) in TINTS]
    return [(one.get_x(), one.get_x() + one.get_width(), to_hex(one.get_facecolor())) for one in behind]


@expensive
@given(st.lists(st.integers(NO_MODE, 3), min_size=1, max_size=30))
def test_spans_cover_the_horizon_once_and_in_order(modes):
    found = spans(np.array(modes))
    assert [found[0].start, found[-1].end] == [0, len(modes)]
    assert all(one.end == other.start and one.mode != other.mode for one, other in pairwise(found))
    assert [one.mode for one in found for _ in range(one.start, one.end)] == modes


@pytest.mark.parametrize("name", seeds(["wall", "tree", "kink"]))
def test_tints_are_the_modes_of_the_result_at_its_times(name):
    result, data = case(name).constrained, comparison_data(case(name))
    assert data.modes == spans(result.sequence)
    figure, step = result_figure(result), data.time.factor
    assert len({span.mode for span in data.modes}) == 2
    for ax in (figure.axes[0], *states_figure(data).axes):
        drawn = tints(ax)
        assert drawn[0][0] == 0
        assert drawn[-1][1] == pytest.approx(step * result.problem.horizon)
        assert [end for _, end, _ in drawn[:-1]] == pytest.approx([start for start, _, _ in drawn[1:]])
        for t, mode in enumerate(result.sequence):
            assert [color for start, end, color in drawn if start <= step * (t + 0.5) < end] == [TINTS[mode]]
    assert not tints(figure.axes[1])  # the spectrum has no time
    names = [one.get_text() for legend in figure.legends for one in legend.get_texts()]
    assert set(result.problem.mode_names) <= {one.split("   ")[0] for one in names}


def test_every_trajectory_has_its_strip():
    comparison = case("wall")
    rows = strip_rows(comparison)
    assert [label for label, _ in rows] == ["classical", "brickwall", "zero phase", "constrained"]
    assert list(rows[0][1]) == list(comparison.classical.sequence)
    assert list(rows[-1][1]) == list(comparison.constrained.sequence)
    for (_, modes), one in zip(rows[1:-1], comparison.filtered, strict=True):
        x, u = one.replay.trajectory.x, one.replay.trajectory.u
        assert list(modes) == list(piecewise_affine(comparison.problem).sequence_of(x, u))
    figure = strips_figure(comparison_data(comparison), rows)
    assert len(figure.axes[0].patches) == sum(len(spans(modes)) for _, modes in rows)
    shown = [one.get_text() for one in figure.axes[0].texts]
    assert {"free", "contact"} <= set(shown)
    assert "constrained trajectory" in modes_caption(rows, "constrained")


def test_outside_all_regions_there_is_no_mode():
    problem = CASES["tree"]()
    result = case("tree").constrained
    x = result.trajectory.x.copy()
    x[2] = -50.0
    far = Trajectory(x, result.trajectory.u)
    regions = [mode.region for mode in piecewise_affine(problem).modes]
    holds = [(region.violation(far.x, far.u)[2] <= 0).all() for region in regions]
    assert (mode_sequence(problem, far)[2] == NO_MODE) == (not any(holds))
    closed = closed_off()
    outside = Trajectory(np.array([[0.0], [3.0], [0.5], [0.0]]), np.zeros((3, 1)))
    assert list(mode_sequence(closed, outside)) == [0, NO_MODE, 1]
    rows = [("filtered", mode_sequence(closed, outside)), ("unknown", None)]
    figure = strips_figure(result_data(case("linear").constrained), [])
    assert not figure.axes[0].patches
    data = replace(result_data(solve(closed)), problem=closed)
    figure = strips_figure(data, rows)
    assert [one.get_text() for one in figure.axes[0].texts] == ["falling", "outside", "rising", "not simulated"]
    assert "Dashed: outside" in modes_caption(rows, "filtered")
    ax = figure.axes[0]
    hidden = replace(
        data,
        traces=(replace(data.main, measured=replace(data.main.measured, sequence=mode_sequence(closed, outside))),),
    )
    before = len(ax.patches)
    shade_modes(ax, hidden)
    assert len(ax.patches) == before + 2


def closed_off(first: str = "falling", second: str = "rising") -> OptimalControlProblem:
    """Two modes on [-1, 0] and [0, 1], and nothing beyond."""
    modes = [
        lfo.AffineMode([[0.5]], [[1.0]], G=[[1.0], [-1.0]], h=[0.0, 1.0], name=first),
        lfo.AffineMode([[0.9]], [[1.0]], G=[[-1.0], [1.0]], h=[0.0, 1.0], name=second),
    ]
    return OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        3,
        lfo.QuadraticCost(Q=1.0, R=1.0),
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box(-1, 1),
        initial_state=[0.5],
    )


@expensive
@pytest.mark.parametrize("name", ["kink", "norm", "absolute"])
def test_what_the_adjoint_equation_requires_lies_within_the_bar(name):
    result = case(name).constrained
    borders = result.certificate.borders
    found = kinks(result.problem, result.trajectory, result.multipliers, borders)
    assert {one.time for one in found} == {*borders.times, *(one.time for one in borders.norms)} != set()
    eta = result.multipliers.eta
    for one in found:
        slack = 1e-6 * (1 + np.abs(eta).max())
        assert (one.lower <= one.required + slack).all()
        assert (one.required <= one.upper + slack).all()
        assert (one.upper - one.lower).max() > 0.1
    figure = adjoint_figure(result_data(result), eta, found, 0.0)
    for i, ax in enumerate(figure.axes):
        bars = [one for one in ax.patches if to_hex(one.get_facecolor()) not in TINTS]
        drawn = np.array([(one.get_y(), one.get_y() + one.get_height()) for one in bars])
        assert drawn == pytest.approx(np.array([(one.lower[i], one.upper[i]) for one in found]))
        low, high = ax.get_ylim()
        assert all(low < value < high for one in found for value in one.of(i))
        assert any(list(line.get_ydata()) == list(eta[:, i]) for line in ax.lines)


def test_the_interval_of_two_modes_is_that_of_their_slopes():
    problem = peak()
    result = solve(problem)
    (one,) = kinks(problem, result.trajectory, result.multipliers, result.certificate.borders)
    slopes = [mode.linear.A.T @ result.multipliers.eta[one.time] for mode in piecewise_affine(problem).modes]
    assert one.lower == pytest.approx(np.min(slopes, axis=0))
    assert one.upper == pytest.approx(np.max(slopes, axis=0))
    weights = result.certificate.borders.weights[0]
    assert weights @ np.array(slopes) == pytest.approx(one.required, abs=1e-6)


def test_the_interval_of_a_norm_is_that_of_all_its_selections():
    result = case("norm").constrained
    (one,) = kinks(result.problem, result.trajectory, result.multipliers, result.certificate.borders)
    assert result.multipliers.eta[1] == pytest.approx([-1, 0], abs=1e-6)
    assert (one.time, list(one.lower), list(one.upper)) == (1, pytest.approx([-1, -1]), pytest.approx([1, 1]))
    assert one.required == pytest.approx([-0.5, 0], abs=1e-6)
    (norm,) = result.certificate.borders.norms
    assert norm.selection == pytest.approx((0.5, 0), abs=1e-6)
    assert "= (0.5, " in adjoint_caption(result.certificate.borders)
    assert "norm(x_0, x_1) is zero at t = 1. There" in switching_sentences(result.certificate.borders)[0]


def test_a_wrong_adjoint_lies_outside_the_bar():
    result = case("kink").constrained
    eta = result.multipliers.eta.copy()
    eta[2] += 500.0
    spoiled = replace(result.multipliers, eta=eta, weights=None)
    certificate = judge(result.problem, result.trajectory, spoiled)
    (one,) = kinks(result.problem, result.trajectory, spoiled, certificate.borders)
    assert one.required > one.upper
    assert any("fails with these multipliers" in sentence for sentence in switching_sentences(certificate.borders))


@expensive
def test_pages_of_linear_problems_have_none_of_it():
    assert set(drawings("linear")) == {"comparison", "states", "gap"}
    assert not re.search(r"mode|adjoint_|S-f|N-f|--mode", text("linear") + page("linear"))
    assert case("linear").constrained.certificate.borders is None
    assert search_sentences(case("linear").constrained) == []
    data = comparison_data(case("linear"))
    assert data.modes == ()
    assert not any(tints(ax) for ax in states_figure(data).axes)
    assert [name for name, _ in problem_facts(case("linear").problem)][:5] == [
        "horizon",
        "minimise",
        "where",
        "dynamics",
        "control: force $a$ [N]",
    ]


@expensive
def test_pages_with_modes_have_strips_and_adjoint():
    for name in ("wall", "kink"):
        assert {"modes", "adjoint"} <= set(drawings(name))
        assert "adjoint" in page(name)
        assert all(tint not in re.sub(r"<style>.*?</style>", "", page(name), flags=re.DOTALL) for tint in TINTS)
        assert set(re.findall(r"var\(--(mode-\d)\)", page(name))) <= set(re.findall(r"--(mode-\d):", page(name)))
    assert result_data(case("norm").constrained).modes == ()  # one mode
    assert [one.svg for one in draw_figures(case("kink"))] == [one.svg for one in drawings("kink").values()]
    assert "N-f: the weights are nonnegative" in text("wall")


@expensive
def test_words_of_borders_and_trees():
    tree = case("tree").constrained
    sentence = search_sentences(tree)[0]
    assert f"{len(tree.tree.nodes)} nodes; {tree.tree_bound.leaves} are leaves" in sentence
    assert float(re.search(r"bounds is (\S+)\.$", sentence)[1]) == pytest.approx(tree.tree_bound.value, rel=1e-8)
    assert search_sentences(case("wall").constrained)[0] in text("wall")
    assert "No two modes meet along this trajectory" in text("wall")
    borders = case("kink").constrained.certificate.borders
    found = re.search(r"(\S+) “on” and (\S+) “off”\.", text("kink"))
    assert [float(one) for one in found.groups()] == pytest.approx(list(borders.weights[0]), rel=1e-2)
    assert "flip-stationary: to first order, a switch to another mode" in text("kink")
    assert "no global bound" in text("kink")
    assert ("cost found", "-17.599", "no global bound") in tiles(case("kink"))
    assert "is not here" in " ".join(switching_sentences(case("absolute").constrained.certificate.borders))
    assert "search over their sequences" not in text("kink")
    uncovered = replace(tree, evidence=replace(tree.evidence, bound=replace(tree.tree_bound, covers=False)))
    assert "so there is no bound" in search_sentences(uncovered)[0]
    without = replace(tree, evidence=replace(tree.evidence, bound=replace(tree.tree_bound, value=np.inf)))
    assert "no leaf can contain a trajectory" in search_sentences(without)[0]


def test_words_of_flips_and_jumps():
    rising = " ".join(switching_sentences(lfo.certify(valley(), [[-1.0], [4.0]]).borders))
    assert "the Hamiltonian rises towards “rising” at t = 1" in rising
    assert "verified" in rising
    assert "other multipliers" not in rising
    jump = switching_sentences(lfo.certify(rotation(), np.zeros((5, 1))).borders)
    assert jump[0].startswith("The map jumps at the switching boundary between “")
    untried = case("norm").constrained.certificate.borders
    kink = untried.norms[0]._replace(rate=2.0)
    text_of_kink = " ".join(switching_sentences(replace(untried, norms=(kink,), flip_stationary=False)))
    assert "away from norm(x_0, x_1) = 0 at t = 1 (rate 2)" in text_of_kink
    assert "does not prove that the cost can fall" in text_of_kink


def test_tables_name_modes_of_smooth_pieces():
    result = case("kink").constrained
    wrong = Trajectory(result.trajectory.x, result.trajectory.u + 0.3)
    certificate = judge(result.problem, wrong, replace(result.multipliers, weights=None))
    (regions,) = (one for one in certificate.conditions if one.label == "S-f")
    assert worst_location(result.problem, replace(regions, residual=0.5, time=3, component=1)) == "t = 3, off"
    assert certificate_table(result.problem, certificate).row_count == len(certificate.conditions)
    (cost,) = comparison_rows(case("kink")).groups[0].rows
    assert float(cost.cells[0].text) == pytest.approx(result.cost, rel=1e-3)
    facts = dict(problem_facts(result.problem))
    assert facts["modes"].startswith("2: “on” and “off”; a smooth map")
    assert dict(problem_facts(case("norm").problem))["kinks"] == "norm(x_0, x_1), not differentiable at zero"


@expensive
def test_a_page_without_a_solution_shows_the_classical_modes_and_the_tree():
    comparison = case("wall")
    before = comparison.constrained
    tree = replace(before.evidence, bound=replace(before.tree_bound, value=np.inf))
    gone = {"trajectory": None, "multipliers": None, "certificate": None, "sequence": None}
    result = replace(before, status="infeasible", evidence=tree, **gone)
    shown = replace(comparison, constrained=result)
    made = tuple(drawings("wall")[name] for name in ("comparison", "modes", "states"))
    data = comparison_data(shown)
    assert data.modes == spans(comparison.classical.sequence)
    assert [label for label, _ in strip_rows(shown)] == ["classical", "brickwall", "zero phase"]
    assert "those of the classical trajectory" in modes_caption(strip_rows(shown), data.main.label)
    html = parsed(re.sub(r"<svg.*?</svg>", "", render_page(shown, made), flags=re.DOTALL)).text
    assert "no leaf can contain a trajectory" in html
    assert "The proof rests on" not in html
    assert result.conflict is None


def test_tints_differ_from_each_other_and_from_all_other_colours():
    assert not set(THEMED) & set(THEMED_TINTS)
    lightness = [linear(tint) @ [0.2126, 0.7152, 0.0722] for tint in TINTS]
    assert abs(lightness[0] - lightness[1]) > 0.1  # two modes are told apart without any colour
    assert min(lightness) > 0.4
    # Machado, Oliveira, Fernandes (2009), deuteranopia
    seen = np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]])
    for i, one in enumerate(TINTS):
        for other in TINTS[:i]:
            assert np.abs(seen @ (linear(one) - linear(other))).max() > 0.05


def linear(color: str) -> np.ndarray:
    part = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


@expensive
def test_long_and_odd_mode_names_are_drawn_as_they_are():
    result = solve(closed_off("_$a$", "b" * 60))
    figure = result_figure(replace(result, sequence=np.array([0, 1, 0])))
    labels = [one.get_text() for one in figure.legends[-1].get_texts()]
    assert labels[0] == r"_\$a\$"
    assert labels[1].startswith("b" * 31 + "…")
    figure.draw_without_rendering()


def test_span_is_plain_data():
    assert spans(np.array([2])) == (Span(0, 1, 2),)


def test_a_replay_that_leaves_all_regions_is_said_to():
    problem = replace(
        closed_off(),
        horizon=8,
        cost=lfo.QuadraticCost(R=0.01, q=[-3.0]),
        control_spectrum=lfo.stop_band(bins=[1, 2, 3, 4]),
        initial_state=[0.0],
    )
    comparison = compare(problem, filters=["brickwall", "clipped"])
    first = comparison.filtered[0].replay
    assert (first.meaningful, first.measures.cost, first.measures.state_violation) == (False, None, None)
    assert first.stopped.startswith("No mode of the dynamics holds at t = ")
    with pytest.raises(lfo.errors.NumericalError, match="No mode"):
        lfo.simulate(problem, first.trajectory.u)
    rows = dict(strip_rows(comparison))
    assert rows["brickwall"] is None
    assert list(rows["constrained"]) == list(comparison.constrained.sequence)
    assert "its states leave the regions of all modes, so that" in str(finding_of(comparison))
    notes = [note.text for note in comparison_data(comparison).notes(comparison_data(comparison).states[:1])]
    assert not first.between_levels
    assert notes == ["filtered: not simulated; its states leave the regions of all modes"]
    html = render_page(comparison, tuple(drawings("wall").values()))
    assert "regions of all modes\n  (brickwall" in html


def thruster(duty_cycles: bool = False) -> OptimalControlProblem:
    """Move by a thruster that is off, or on in either direction."""
    return OptimalControlProblem(
        lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.125], [0.5]], control_names=["thrust [N]"]),
        8,
        lfo.QuadraticCost(R=0.1),
        control_set=lfo.FiniteSet([-1, 0, 1], costs=[0.3, 0, 0.3], duty_cycles=duty_cycles),
        initial_state=[1.0, 0.0],
        terminal_state=[0.0, 0.0],
        control_spectrum=lfo.MagnitudeBound(3.0, band=lfo.low_pass(2.0)),
    )


@expensive
def test_a_filter_takes_controls_between_levels_and_the_page_says_so():
    comparison = compare(thruster(), filters=["brickwall"])
    (filtered,) = comparison.filtered
    assert filtered.replay.between_levels
    assert not comparison.classical_solution.between_levels
    words = finding_of(comparison).filtering
    assert words == "its controls lie between the levels, so that they cannot be simulated to the end"
    data = comparison_data(comparison)
    assert [note.text for note in data.notes(data.states[:1])] == [
        "filtered: not simulated; its controls lie between the levels"
    ]
    html = render_page(comparison, blanks())
    assert "the controls lie between the levels\n  (brickwall)" in html
    assert "At t = 0, 1, 2, 3, 4, 5, 6 and 7 the trajectory lies at the edge of a gap" in html


@expensive
def test_costs_of_levels_are_no_bounds_and_levels_are_said_once():
    for problem in (thruster(), thruster(duty_cycles=True)):
        (signal,) = result_data(solve(problem)).controls
        assert signal.row_bounds == []
    terms = [term for term, _ in problem_facts(thruster(), thruster().gap)]
    assert thruster().gap is not None
    assert "levels" in terms
    assert not {"gap", "control set"} & set(terms)
    assert "control set" in [term for term, _ in problem_facts(thruster(duty_cycles=True))]
