"""Regions that overlap are refused; gaps are found at a place that is one, in any units, and none elsewhere."""

from __future__ import annotations

import ast
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

import lin_freq_ocp as lfo
from helpers.kinked_maps import problem_of, random_kinks
from helpers.replacing import substitute
from helpers.seeds import examples, seeds
from lin_freq_ocp.base import SAME_FACET, THICKNESS, Cell, irredundant, uncovered_point

SEEDS = st.integers(0, 2**32 - 1)
FACTOR = 10.0 ** np.arange(-9, 10, 6)


def place_of(text: str | None) -> np.ndarray:
    """Return the point (x, u) that a message or ``problem.gap`` names."""
    assert text is not None
    return np.array(ast.literal_eval(text[text.index("= [") + 2 : text.index("]") + 1]))


def number_of_regions(modes, v, n, t=0, beyond=0.0):
    """Return how many regions hold v, all rows with this much to spare, relative to the terms."""
    count = 0
    for mode in modes:
        C, D, e = mode.region.C, mode.region.D, mode.region.e
        C, D, e = (part[t] if part.ndim > ndim else part for part, ndim in ((C, 2), (D, 2), (e, 1)))
        slack = e - C @ v[:n] - D @ v[n:]
        terms = np.where(np.isfinite(e), np.abs(e), 0) + np.abs(C) @ np.abs(v[:n]) + np.abs(D) @ np.abs(v[n:])
        count += bool((slack >= beyond * terms).all())
    return count


def with_region(mode, **change):
    region = {"G": mode.region.C, "H": mode.region.D, "h": mode.region.e} | change
    return lfo.AffineMode(mode.linear.A, mode.linear.B, mode.linear.offset, **region, name=mode.name)


# --- gaps and overlaps ------------------------------------------------------------------------------------------------


@settings(derandomize=True, max_examples=examples(15), deadline=None)
@given(seed=SEEDS, n=st.integers(1, 3), kinks=st.integers(1, 2), boxed=st.booleans(), kind=st.sampled_from("gsw"))
def test_what_is_wrong_with_regions_is_found_where_it_is(seed, n, kinks, boxed, kind):
    """One mode left out (g), one facet moved inwards (s) or outwards (w), by 2 % of its size."""
    rng = np.random.default_rng(seed)
    kinked = random_kinks(rng, n, 1, kinks, sizes=10.0 ** rng.integers(-9, 9, n + 1))
    sets = kinked.boxes() if boxed else {}
    good = kinked.dynamics()
    problem = problem_of(good, **sets)
    if not problem.borders:
        return
    border = problem.borders[rng.integers(len(problem.borders))]
    modes, i = list(good.modes), border.first
    row = int(np.argmax([np.allclose(-kinked.g[k] * np.linalg.norm(kinked.h[k]), border.g) for k in range(kinks)]))
    if kind == "g":
        del modes[i]
    else:
        limits = modes[i].region.e.copy()
        limits[row] += (0.02 if kind == "w" else -0.02) * (1 + abs(limits[row]))
        modes[i] = with_region(modes[i], h=limits)
    changed = lfo.PiecewiseAffineDynamics(modes)
    if kind == "w":
        with pytest.raises(lfo.errors.ProblemError, match="overlaps that of") as caught:
            replace(problem, dynamics=changed)
        v = place_of(caught.value.got)
        assert caught.value.field.startswith("dynamics.modes[")
        assert number_of_regions(modes, v, n, beyond=-1e-3) >= 2
    else:
        assert problem.gap is None
        v = place_of(replace(problem, dynamics=changed).gap)
        assert number_of_regions(modes, v, n, beyond=1e-3) == 0
    if boxed:
        assert (np.abs(v) <= 3.01 * kinked.sizes).all()


def halves(edge=0.0, other=None, **given):
    """Return modes x <= edge and x >= other of one state and one control."""
    other = edge if other is None else other
    modes = [
        lfo.AffineMode([[0.5]], [[1.0]], G=[[1.0]], h=[edge], name="below"),
        lfo.AffineMode([[0.25]], [[1.0]], G=[[-1.0]], h=[-other], name="above"),
    ]
    return problem_of(lfo.PiecewiseAffineDynamics(modes), **given)


@pytest.mark.parametrize("unit", FACTOR)
@pytest.mark.parametrize("sets", ["bounds", "upper bound", "nothing", "far bounds", "narrow bounds far away"])
def test_the_same_gap_is_found_in_all_units(unit, sets):
    """The edge is at one unit; a gap of a thousandth of it counts, one of a billionth does not."""
    given = {
        "bounds": {"state_set": lfo.Box(-3 * unit, 3 * unit)},
        "upper bound": {"state_set": lfo.Box(None, 3 * unit)},
        "nothing": {},
        "far bounds": {"state_set": lfo.Box(-1e5 * unit, 1e5 * unit)},
        "narrow bounds far away": {"state_set": lfo.Box(0.99 * unit, 1.01 * unit)},
    }[sets]
    assert len(halves(unit, **given).borders) == 1
    assert len(halves(unit, unit * (1 + 1e-9), **given).borders) == 1
    assert unit * 0.999 < place_of(halves(unit, unit * 1.001, **given).gap)[0] < unit * 1.002
    with pytest.raises(lfo.errors.ProblemError, match="overlaps that of 'below'"):
        halves(unit, unit * 0.999, **given)


def test_a_gap_within_the_tolerance_still_has_a_border():
    """Between what counts as a gap, and what rounding makes, modes meet: or a border would be lost."""
    for gap in (0.0, 1e-12, 0.5 * THICKNESS, 1.9 * THICKNESS):
        (border,) = halves(0.0, gap, state_set=lfo.Box(-1, 1), control_set=lfo.Box(-1, 1)).borders
        assert border.limit == pytest.approx(0.0, abs=2 * THICKNESS)
    assert halves(0.0, 2 * SAME_FACET, state_set=lfo.Box(-1, 1), control_set=lfo.Box(-1, 1)).gap is not None


@pytest.mark.parametrize("fixed", [0.5, 0.0, 1e9])
def test_components_that_bounds_fix_hide_nothing(fixed):
    """Regions in x and u, with u fixed: the gap is at x = 0, whatever u is."""
    given = {"state_set": lfo.Box(-1, 1), "control_set": lfo.Box(fixed, fixed)}
    assert len(halves(0.0, **given).borders) == 1
    place = place_of(halves(0.0, 0.1, **given).gap)
    assert 0 < place[0] < 0.1
    assert place[1] == fixed
    with pytest.raises(lfo.errors.ProblemError, match="overlaps"):
        halves(0.1, 0.0, **given)
    assert halves(
        -2.0, 2.0, state_set=lfo.Box(0.5, 0.5), control_set=lfo.Box(fixed, fixed)
    )  # a single point.gap is not None


def test_on_a_border_all_the_time_both_modes_hold_and_it_is_one():
    (border,) = halves(0.5, state_set=lfo.Box(0.5, 0.5), control_set=lfo.Box(-1, 1)).borders
    assert (border.first, border.second, border.limit) == (0, 1, 0.5)


def test_bounds_far_from_zero_lose_no_digits():
    given = {"state_set": lfo.Box(1e6, 1e6 + 1), "control_set": lfo.Box(-1, 1)}
    (border,) = halves(1e6 + 0.5, **given).borders
    assert border.limit == 1e6 + 0.5
    assert halves(1e6 + 0.5, 1e6 + 0.5001, **given).gap is not None


def test_a_slanting_gap_in_components_of_unlike_size():
    """Beside x_0 up to 1, x_1 is of the order of 1e-5 where the rows cross it, and its bounds are wide."""
    rows = lfo.AffineMode(np.eye(2), [[1.0], [0.0]], G=[[1.0, -1e5]], h=[0.0], name="above")
    for slope, fits in ((1e5, True), (1.1e5, False), (0.9e5, False)):
        below = lfo.AffineMode(np.eye(2), [[1.0], [0.0]], G=[[-1.0, slope]], h=[0.0])
        for state_set in (lfo.Box(-1, 1), lfo.Box([-1, None], [1, None]), None):
            if fits:
                problem = problem_of(lfo.PiecewiseAffineDynamics([rows, below]), state_set=state_set)
                assert len(problem.borders) == 1
                assert problem.gap is None
                continue
            with pytest.raises(lfo.errors.ProblemError, match="overlaps"):
                problem_of(lfo.PiecewiseAffineDynamics([rows, below]), state_set=state_set)


def test_a_row_of_rounding_errors_says_no_size():
    """x_1 has no bounds, and a coefficient 1e-17 beside 1: its unit comes from the row that is about it."""
    modes = [
        lfo.AffineMode(np.eye(2), [[1.0], [1.0]], G=[[1.0, 1e-17], [0.0, 1.0]], h=[0.0, 1.0]),
        lfo.AffineMode(np.eye(2), [[1.0], [1.0]], G=[[-1.0, -1e-17], [0.0, 1.0]], h=[0.0, 1.0], name="right"),
        lfo.AffineMode(np.eye(2), [[1.0], [1.0]], G=[[0.0, -1.0]], h=[-1.0], name="up"),
    ]
    assert len(problem_of(lfo.PiecewiseAffineDynamics(modes)).borders) == 3
    modes[2] = with_region(modes[2], h=[-1.5])
    assert problem_of(lfo.PiecewiseAffineDynamics(modes)).gap is not None


# --- the sets -------------------------------------------------------------------------------------------------------

WEDGE = [
    lfo.AffineMode(np.eye(2), [[1.0], [1.0]], G=[[1.0, 0.0], [1.0, 1.0]], h=[0.0, 1.0], name="left"),
    lfo.AffineMode(np.eye(2), [[1.0], [1.0]], G=[[-1.0, 0.0], [1.0, 1.0]], h=[0.0, 1.0], name="right"),
]
"""They cover x_0 + x_1 <= 1, and nothing else."""


@pytest.mark.parametrize(
    "given",
    [
        {"state_set": lfo.sets.Polyhedron([[1.0, 1.0]], [1.0])},
        {"state_set": lfo.sets.Polyhedron([[1.0, 1.0]], [1.0]) & lfo.Box(-3, 3), "initial_state": [0.0, 0.0]},
        {"stage_rows": lfo.StageRows([[1.0, 1.0]], None, [1.0])},
        {"stage_rows": lfo.StageRows([[1.0, 1.0]], None, [1.0]), "initial_state": [9.0, 9.0]},
        {"state_set": [lfo.sets.Polyhedron([[1.0, 1.0]], [1.0 - 0.1 * t]) for t in range(6)]},
        {"state_set": [lfo.sets.Polyhedron([[1.0 + t, 1.0 + t]], [1.0]) & lfo.Box(0, 9) for t in range(6)]},
        {"state_set": [*[lfo.Box(-3, 0.5)] * 5, lfo.Box(-9, 9)]},
    ],
)
def test_what_lies_outside_the_sets_is_no_gap(given):
    """Polyhedra and joint rows are sets, too; the state after the last control is in no region."""
    problem = problem_of(lfo.PiecewiseAffineDynamics(WEDGE), 5, **given)
    assert problem.gap is None
    assert [(border.first, border.second) for border in problem.borders] == [(0, 1)]


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"state_set": lfo.Box(-3, 3)},
        {"state_set": lfo.sets.Polyhedron([[1.0, 1.0]], [1.1])},
        {"stage_rows": lfo.StageRows([[1.0, 1.0]], None, [1.0], penalty=5.0)},
        {"state_set": lfo.sets.Soft(lfo.sets.Polyhedron([[1.0, 1.0]], [1.0]), 5.0)},
        {"terminal_state": lfo.sets.Polyhedron([[1.0, 1.0]], [1.0])},
        {"initial_state": lfo.sets.Polyhedron([[1.0, 1.0]], [1.0])},
        {"state_set": lfo.sets.Ball(0.1)},  # of balls and cones the check knows nothing
    ],
)
def test_gaps_are_looked_for_wherever_sets_may_be_left(given):
    assert problem_of(lfo.PiecewiseAffineDynamics(WEDGE), 5, **given).gap is not None


def test_the_time_of_a_gap_is_told():
    sets = [lfo.sets.Polyhedron([[1.0, 1.0]], [1.0 if t != 3 else 1.2]) & lfo.Box(-3, 3) for t in range(6)]
    gap = problem_of(lfo.PiecewiseAffineDynamics(WEDGE), 5, state_set=sets).gap
    assert 1.0 < place_of(gap)[:2].sum() < 1.2
    assert str(gap).endswith(" at t = 3")
    edges = np.array([[0.0], [0.1], [0.2], [0.3]])
    moving = [
        lfo.AffineMode([[0.5]], [[1.0]], G=[[1.0]], h=edges),
        lfo.AffineMode([[0.5]], [[1.0]], G=[[-1.0]], h=-edges - [[0.0], [0.0], [0.05], [0.0]], name="right"),
    ]
    assert str(problem_of(lfo.PiecewiseAffineDynamics(moving), 4).gap).endswith(" at t = 2")
    moving[1] = with_region(moving[1], h=-edges)
    borders = problem_of(lfo.PiecewiseAffineDynamics(moving), 4).borders
    assert [(border.time, border.limit) for border in borders] == [(t, pytest.approx(0.1 * t)) for t in range(4)]


def test_rows_that_are_equations_leave_the_bounds():
    """In x_0 + x_1 = 1 fits no ball: gaps are looked for within the bounds."""
    equation = lfo.StageRows([[1.0, 1.0], [-1.0, -1.0]], None, [1.0, -1.0])
    assert (
        problem_of(lfo.PiecewiseAffineDynamics(WEDGE), 5, state_set=lfo.Box(-3, 3), stage_rows=equation).gap is not None
    )


def test_regions_that_were_checked_are_not_checked_again(monkeypatch):
    problem = problem_of(lfo.PiecewiseAffineDynamics(WEDGE), 5, state_set=lfo.Box(-3, 0.5))
    assert problem.gap is None
    substitute(monkeypatch, "base.uncovered_point", None)
    assert replace(problem, horizon=7).gap is None
    with pytest.raises(TypeError):
        _ = replace(problem, state_set=lfo.Box(-3, 0.4)).gap


# --- the machinery --------------------------------------------------------------------------------------------------


@settings(derandomize=True, max_examples=examples(20), deadline=None)
@given(seed=SEEDS, d=st.integers(1, 6), rows=st.integers(1, 25))
def test_the_largest_ball_is_that_of_a_linear_program(seed, d, rows):
    """With thresholds just below and just above the radius that another solver finds."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(rows, d))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    limits = rng.normal(size=rows) * 10.0 ** rng.integers(-4, 2) + rng.choice([0.0, 0.1])
    matrix = np.column_stack([normals, np.ones(rows)])
    bounds = [(None, None)] * d + [(None, 1.0)]
    radius = -linprog(-np.eye(d + 1)[-1], matrix, limits, bounds=bounds).fun
    cell, margin = Cell(normals, limits), 1e-6 * max(1.0, abs(radius))
    point = cell.inner_point(radius - margin)
    assert point is not None
    assert (limits - normals @ point).min() > radius - margin
    assert cell.inner_point(radius + margin) is None


def test_the_centre_of_a_rectangle_and_where_projections_do_not_help(monkeypatch):
    square = Cell(np.vstack([np.eye(2), -np.eye(2)]), np.array([1.0, 1.0, 1.0, 0.5]))
    point = square.inner_point(0.7)
    assert point is not None
    assert point[1] == pytest.approx(0.25)
    assert square.inner_point(0.76) is None
    substitute(monkeypatch, "base.PROJECTIONS", 0)
    assert halves(0.0, state_set=lfo.Box(-1, 1), control_set=lfo.Box(-1, 1)).borders
    assert halves(0.0, 0.1).gap is not None


@pytest.mark.parametrize("seed", seeds(range(4)))
def test_coverage_against_random_points(seed):
    """Boxes of a grid, some left out: the domain is covered iff no random point says otherwise."""
    rng = np.random.default_rng(seed)
    edges = [np.sort(np.concatenate([[-1.0, 1.0], rng.uniform(-1, 1, 2)])) for _ in range(2)]
    boxes = [(edges[0][[i, i + 1]], edges[1][[j, j + 1]]) for i in range(3) for j in range(3)]
    cells = [Cell(np.vstack([np.eye(2), -np.eye(2)]), np.array([a[1], b[1], -a[0], -b[0]])) for a, b in boxes]
    domain = Cell(np.vstack([np.eye(2), -np.eye(2)]), np.ones(4))
    assert uncovered_point(domain, cells) is None
    for left_out in ({0}, {4}, {8}, {1, 7}, set(range(9))):
        kept = [cell for k, cell in enumerate(cells) if k not in left_out]
        point = uncovered_point(domain, kept)
        assert point is not None
        assert all((cell.limits < cell.normals @ point).any() for cell in kept)
        assert (np.abs(point) <= 1).all()


def test_rows_that_others_imply_are_left_out():
    rows = Cell(np.array([[1.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.6, 0.8]]), np.array([1.0, 1, 1, 1, 1.5]))
    kept = irredundant(rows, THICKNESS)
    assert len(kept) == 3
    assert set(kept) & {0, 1}
    assert set(kept) >= {2, 3}
