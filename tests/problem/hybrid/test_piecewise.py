"""Piecewise-affine dynamics: borders and replays against maps whose kinks are known, and everything that is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lin_freq_ocp as lfo
from helpers.kinked_maps import problem_of, random_kinks
from helpers.seeds import examples, seeds
from lin_freq_ocp.problem.hybrid import CONTINUITY_TOLERANCE
from lin_freq_ocp.transform.hybrid import piecewise_affine

SEEDS = st.integers(0, 2**32 - 1)


def random_sizes(rng, dimension, decades=9):
    return 10.0 ** rng.integers(-decades, decades, dimension)


def rotation(**named):
    """Return the switched rotation (Bemporad and Morari, Automatica 35, 1999), which jumps at x_0 = 0."""
    c, s = 0.8 * np.cos(np.pi / 3), 0.8 * np.sin(np.pi / 3)
    B = [[0.0], [1.0]]
    return lfo.PiecewiseAffineDynamics(
        [
            lfo.AffineMode([[c, -s], [s, c]], B, G=[[-1.0, 0.0]], h=[0.0], name="right"),
            lfo.AffineMode([[c, s], [-s, c]], B, G=[[1.0, 0.0]], h=[0.0], name="left"),
        ],
        **named,
    )


# --- borders ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_borders_are_the_kinks(seed):
    """Every pair of modes that differ by one kink, and meet at some random point of it, has a border, and no other."""
    rng = np.random.default_rng(seed)
    n, m, times = 1 + seed % 3, 1 + seed % 2, 1 if seed % 2 else 3
    kinked = random_kinks(rng, n, m, kinks=1 + seed % 3, times=times, sizes=random_sizes(rng, n + m))
    problem = problem_of(kinked.dynamics(), horizon=3, **kinked.boxes())
    found = {(border.time, border.first, border.second): border for border in problem.borders}
    assert len(found) == len(problem.borders)
    seen = set()
    for t in range(times):
        for k, normal in enumerate(kinked.h):
            points = kinked.points(rng, 2000)
            chosen = np.argmax(np.abs(normal * kinked.sizes))
            points[:, chosen] += (kinked.d[t, k] - points @ normal) / normal[chosen]
            inside = (np.abs(points) <= 2.97 * kinked.sizes).all(axis=1)
            signs = kinked.signs(t, points[inside])
            for on in np.unique(np.delete(signs, k, axis=1), axis=0):
                pair = [int(kinked.number(np.insert(on, k, side))) for side in (False, True)]
                time = t if times > 1 else None
                border = found[(time, *pair)]
                seen.add((time, *pair))
                length = np.linalg.norm(normal)
                h = np.concatenate([border.h_x, border.h_u])
                np.testing.assert_allclose(h, normal / length, rtol=1e-12, atol=1e-12)
                assert border.limit == pytest.approx(kinked.d[t, k] / length, rel=1e-9, abs=1e-12 / length)
                np.testing.assert_allclose(border.g, -kinked.g[k] * length, rtol=1e-9)
                modes = [piecewise_affine(problem).modes[i].linear for i in pair]
                slopes = [np.hstack(one.at(t)[:2]) for one in modes]
                np.testing.assert_allclose(
                    (slopes[0] - slopes[1]) * kinked.sizes / kinked.sizes[:n, None],
                    np.outer(border.g, h) * kinked.sizes / kinked.sizes[:n, None],
                    atol=1e-9,
                )
                assert border.continuous
                assert border.jump < 1e-12
    rare = set(found) - seen  # those that 2000 points did not meet: they must be small, so there are few
    assert len(rare) <= len(seen) / 4
    for _, first, second in rare:
        assert bin(first ^ second).count("1") == 1


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_a_jump_is_measured_relative_to_its_terms(seed):
    rng = np.random.default_rng(seed)
    sizes = random_sizes(rng, 3)
    kinked = random_kinks(rng, kinks=1, sizes=sizes)
    low, high = kinked.dynamics().modes
    linear, push = high.linear, 10.0 ** -(2 + seed) * sizes[1]
    pushed = lfo.AffineMode(
        linear.A, linear.B, linear.offset + np.array([0, push]), high.region.C, high.region.D, high.region.e
    )
    (border,) = problem_of(lfo.PiecewiseAffineDynamics([low, pushed]), **kinked.boxes()).borders
    largest = [np.abs(np.hstack([one.linear.A, one.linear.B])) @ (3 * sizes) for one in (low, pushed)]
    terms = sum(largest) + np.abs(low.linear.offset) + np.abs(pushed.linear.offset)
    assert border.jump == pytest.approx(push / terms[1], rel=1e-6)
    assert border.continuous == (border.jump <= CONTINUITY_TOLERANCE)


def test_the_rotation_jumps_by_what_its_columns_differ():
    (border,) = problem_of(rotation(), state_set=lfo.Box(-10, 10), control_set=lfo.Box(-1, 1)).borders
    assert (border.first, border.second, border.time) == (0, 1, None)
    np.testing.assert_allclose(np.append(border.h_x, border.h_u), [-1, 0, 0], atol=1e-12)
    c, s = 0.5, np.sin(np.pi / 3)  # 0.8 and 10 cancel
    assert border.jump == pytest.approx(2 * s / (2 * c + 2 * s), rel=1e-9)
    assert not border.continuous


def test_a_facet_between_two_others_is_no_border():
    """Modes 0 and 2 are apart by mode 1, though 0 repeats, needlessly, the facet of 2."""
    A, B = [[1.0]], [[1.0]]
    rows = [([[1.0], [1.0]], [0.0, 1.0]), ([[-1.0], [1.0]], [0.0, 1.0]), ([[-1.0]], [-1.0])]
    modes = [lfo.AffineMode(A, B, G=G, h=h) for G, h in rows]
    problem = problem_of(lfo.PiecewiseAffineDynamics(modes), state_set=lfo.Box(-3, 3), control_set=lfo.Box(-1, 1))
    assert [(border.first, border.second, border.limit) for border in problem.borders] == [(0, 1, 0.0), (1, 2, 1.0)]


def test_regions_that_touch_at_an_edge_have_no_border_there():
    A, B = np.eye(2), np.ones((2, 1))
    quadrants = [
        lfo.AffineMode(A, B, G=[[a, 0.0], [0.0, b]], h=[0.0, 0.0], name=f"{a} {b}") for a in (1, -1) for b in (1, -1)
    ]
    problem = problem_of(lfo.PiecewiseAffineDynamics(quadrants), state_set=lfo.Box(-1, 1), control_set=lfo.Box(-1, 1))
    assert {(border.first, border.second) for border in problem.borders} == {(0, 1), (0, 2), (1, 3), (2, 3)}


def test_a_border_beyond_the_sets_is_none():
    inside = {"state_set": lfo.Box(0.5, 10), "control_set": lfo.Box(-1, 1)}
    assert problem_of(rotation(), **inside).borders == ()
    polyhedron = {
        "state_set": lfo.sets.Polyhedron([[-1.0, 0.0]], [-0.5]) & lfo.Box(-9, 9),
        "control_set": lfo.Box(-1, 1),
    }
    assert problem_of(rotation(), **polyhedron).borders == ()
    assert len(problem_of(rotation()).borders) == 1


# --- replays ----------------------------------------------------------------------------------------------------------


@settings(derandomize=True, max_examples=examples(25), deadline=None)
@given(seed=SEEDS, n=st.integers(1, 3), m=st.integers(1, 2), kinks=st.integers(1, 3), varying=st.booleans())
def test_replays_are_the_map_itself(seed, n, m, kinks, varying):
    """Replay, mode sequence, and the linear problem of that sequence, against the map by maxima, in any units."""
    rng = np.random.default_rng(seed)
    T = 6
    kinked = random_kinks(rng, n, m, kinks, T if varying else 1, random_sizes(rng, n + m))
    dynamics = kinked.dynamics()
    start, u = 0.5 * rng.normal(size=n) * kinked.sizes[:n], rng.normal(size=(T, m)) * kinked.sizes[n:]
    problem = problem_of(dynamics, T, initial_state=start)
    x = [start]
    for t in range(T):
        x.append(kinked.value(t, np.concatenate([x[-1], u[t]])))
    x = np.array(x)
    replay = lfo.simulate(problem, u)
    np.testing.assert_allclose(replay.x / kinked.sizes[:n], x / kinked.sizes[:n], rtol=1e-9, atol=1e-9)
    sequence = dynamics.sequence_of(replay.x, u)
    expected = [kinked.number(kinked.signs(t, np.concatenate([replay.x[t], u[t]]))) for t in range(T)]
    np.testing.assert_array_equal(sequence, expected)
    fixed = problem.with_modes(sequence)
    np.testing.assert_array_equal(lfo.simulate(fixed, u).x, replay.x)
    rows = next(rows for rows in fixed.stage_rows if rows.name == "mode region")
    assert (rows.slack(replay.x, u) >= 0).all()
    along = problem.dynamics_along(replay)
    again = along.successors(replay.x, u)
    np.testing.assert_allclose(again / kinked.sizes[:n], replay.x[1:] / kinked.sizes[:n], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_on_a_border_a_replay_takes_the_first_mode_and_a_given_trajectory_its_own(order):
    listed = [rotation().modes[i] for i in order]
    dynamics = lfo.PiecewiseAffineDynamics(listed)
    problem = problem_of(dynamics, 1, initial_state=[0.0, 5.0])
    replay = lfo.simulate(problem, [[0.3]])
    first = listed[0].linear
    np.testing.assert_array_equal(replay.x[1], first.A @ [0.0, 5.0] + [0.0, 0.3])
    for i, mode in enumerate(listed):
        x = np.array([[0.0, 5.0], mode.linear.A @ [0.0, 5.0] + [0.0, 0.3]])
        assert dynamics.sequence_of(x, np.array([[0.3]])).tolist() == [i]
        assert dynamics.sequence_of(x + np.array([[1e-7, 0], [0, 0]]), np.array([[0.3]])).tolist() == [i]


def test_modes_that_lead_to_the_same_state_are_told_apart_by_their_order():
    kinked = random_kinks(np.random.default_rng(3), n=2, m=1, kinks=2)
    dynamics = kinked.dynamics()
    corner = np.linalg.lstsq(kinked.h, kinked.d[0], rcond=None)[0]
    x = np.array([corner[:2], kinked.value(0, corner)])
    assert dynamics.sequence_of(x, corner[None, 2:]).tolist() == [0]


def test_a_mode_is_recognised_in_components_of_unlike_size():
    """The modes differ in a state of 1e-6 beside one of 1e3, which the measurement has only to 1e-8 of its size."""
    modes = [
        lfo.AffineMode(np.diag([1.0, 1.0]), [[0.0], [0.0]], [sign * 1e-6, 0.0], G=[[-sign, 0.0]], h=[0.0], name=name)
        for sign, name in ((1.0, "up"), (-1.0, "down"))
    ]
    x = np.array([[0.0, 1e3], [-1e-6, 1e3 * (1 + 1e-8)]])
    assert lfo.PiecewiseAffineDynamics(modes).sequence_of(x, np.zeros((1, 1))).tolist() == [1]


def test_where_no_mode_holds_the_place_is_told():
    A, B = [[2.0]], [[1.0]]
    modes = [
        lfo.AffineMode(A, B, G=[[1.0], [-1.0]], h=[0.0, 1.0]),
        lfo.AffineMode(A, B, G=[[-1.0], [1.0]], h=[0.0, 1.0], name="right"),
    ]
    problem = problem_of(lfo.PiecewiseAffineDynamics(modes), 4, initial_state=[0.4], state_set=lfo.Box(-1, 1))
    with pytest.raises(lfo.errors.NumericalError, match=r"No mode .* at t = 2, x = \[1\.6\], u = \[0\.0\]"):
        lfo.simulate(problem, np.zeros((4, 1)))
    x = np.array([[0.4], [1.6], [3.2], [6.4], [12.8]])
    assert piecewise_affine(problem).sequence_of(x, np.zeros((4, 1))).tolist() == [1, 1, 1, 1]  # the nearest region's


def test_a_state_that_overflows_is_called_that():
    everywhere = lfo.PiecewiseAffineDynamics([lfo.AffineMode([[1e200]], [[1.0]])])
    with pytest.raises(lfo.errors.NumericalError, match="overflows at t = 2"):
        lfo.simulate(problem_of(everywhere, 4, initial_state=[1e10]), np.zeros((4, 1)))


def test_a_fixed_sequence_is_solved_within_its_regions():
    """Of the rotation, by enumeration in the reference: T = 5 from (1, 1), both ends of the tree known."""
    problem = problem_of(
        rotation(), 3, initial_state=[-2.0, 1.0], state_set=lfo.Box(-10, 10), control_set=lfo.Box(-1, 1)
    )
    for sequence in ([1, 0, 1], [1, 1, 0], [0, 0, 0]):
        result = lfo.solve(problem.with_modes(sequence), throw=False)
        if result.status == "optimal":
            signs = np.array([1.0 if mode == 0 else -1.0 for mode in sequence])
            assert (signs * result.trajectory.x[:3, 0] >= -1e-7).all()
        else:
            assert result.status == "infeasible"
            assert sequence[0] == 0 or len(set(sequence)) > 1


# --- what problems share with linear ones -----------------------------------------------------------------------------


def test_a_rate_limit_remembers_the_control_in_every_mode():
    kinked = random_kinks(np.random.default_rng(5), n=2, m=2, kinks=2, times=4)
    problem = problem_of(kinked.dynamics(state_names=["a", "b"]), 4, initial_state=[0.1, 0.2], **kinked.boxes())
    limited = lfo.rate_limited(problem, [0.5, None], previous=[0.25, 0.0])
    assert limited.state_names == ("a", "b", "u_0 before")
    assert piecewise_affine(limited).mode_names == piecewise_affine(problem).mode_names
    u = np.random.default_rng(6).normal(size=(4, 2))
    plain, wide = lfo.simulate(problem, u), lfo.simulate(limited, u)
    np.testing.assert_allclose(wide.x[:, :2], plain.x, rtol=1e-12)
    np.testing.assert_array_equal(wide.x[:, 2], np.append(0.25, u[:, 0]))
    sequences = limited.dynamics.sequence_of(wide.x, u), problem.dynamics.sequence_of(plain.x, u)
    np.testing.assert_array_equal(*sequences)
    rate = next(rows for rows in limited.stage_rows if rows.name == "rate limit")
    changes = np.abs(np.diff(np.append(0.25, u[:, 0])))
    np.testing.assert_allclose(rate.slack(wide.x, u).min(axis=1), 0.5 - changes, atol=1e-12)
    assert [(b.first, b.second, b.time) for b in limited.borders] == [
        (b.first, b.second, b.time) for b in problem.borders
    ]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lfo.to_cvxpy, r"problem\.with_modes\(sequence\)"),
        (lfo.SpectralSolver, r"problem\.with_modes\(sequence\)"),
        (lambda problem: lfo.solve(problem, method="spectral"), "spectral"),
        (lfo.explain, r"explain\(problem\.with_modes\(sequence\)\)"),
    ],
)
def test_what_needs_linear_dynamics_says_what_to_take(call, words):
    problem = problem_of(rotation(), 3, initial_state=[1.0, 1.0])
    with pytest.raises(lfo.errors.UnsupportedError, match=words):
        call(problem)


def test_signals_from_elsewhere_become_trajectories(tmp_path):
    problem = problem_of(rotation(sampling_time=0.1), 3, initial_state=[1.0, 1.0])
    replay = lfo.simulate(problem, [[0.1], [0.2], [-0.1]])
    again = lfo.from_time_response(lfo.io.to_time_response(problem, replay), problem)
    np.testing.assert_array_equal(again.x, replay.x)
    (tmp_path / "u.csv").write_text("u_0\n0.1\n0.2\n-0.1\n")
    np.testing.assert_array_equal(lfo.read_csv(tmp_path / "u.csv", problem).x, replay.x)


def test_a_run_that_ended_without_a_result_keeps_the_modes(tmp_path):
    from lin_freq_ocp.files import dump_run

    problem = problem_of(rotation(), 3, initial_state=[1.0, 1.0], name="rotation")
    dump_run(tmp_path / "run.zip", problem, {"method": "auto"}, error=lfo.errors.UnsupportedError("no"))
    loaded = lfo.load_run(tmp_path / "run.zip").problem
    assert str(loaded) == str(problem)
    assert "2 modes" in str(loaded)
    u = [[0.1], [0.2], [-0.1]]
    np.testing.assert_array_equal(lfo.simulate(loaded, u).x, lfo.simulate(problem, u).x)


# --- what is refused --------------------------------------------------------------------------------------------------

A, B = np.eye(2), np.ones((2, 1))


@pytest.mark.parametrize(
    ("given", "field", "words"),
    [
        ({"A": np.ones((2, 3))}, "mode.A", "square"),
        ({"A": [[1.0, np.nan], [0, 1]]}, "mode.A[0][1]", "nan"),
        ({"B": [1.0, 1.0]}, "mode.B", "a matrix (2, m)"),
        ({"offset": [1.0]}, "mode.offset", "shape (1,)"),
        ({"G": [[1.0, 0.0]]}, "mode.h", "got None; expected one limit per row of the region"),
        ({"H": [[1.0]]}, "mode.h", "got None"),
        ({"h": [1.0]}, "mode.G", "neither G nor H"),
        ({"G": [1.0, 0.0], "h": [1.0]}, "mode.G", "[[g_1, g_2, ...]]"),
        ({"G": [[1.0, 0.0]], "h": 1.0}, "mode.h", "shape ()"),
        ({"G": [[1.0, 0.0]], "h": [[[1.0]]]}, "mode.h", "shape (1, 1, 1)"),
        ({"G": np.zeros((0, 2)), "h": []}, "mode.h", "shape (0,)"),
        ({"G": [[1.0, 0.0, 0.0]], "h": [1.0]}, "mode.G", "expected shape (1, 2), one row per limit in h, or (T, 1, 2)"),
        ({"G": [[1.0, 0.0]], "H": [[1.0, 1.0]], "h": [1.0]}, "mode.H", "expected shape (1, 1)"),
        ({"G": [[1.0, 0.0]], "h": [1.0, 2.0]}, "mode.G", "expected shape (2, 2)"),
        ({"G": [[1.0, np.inf]], "h": [1.0]}, "mode.G[0][1]", "inf"),
        ({"G": [[1.0, 0.0]], "h": ["much"]}, "mode.h", "numbers"),
        ({"G": [[1.0, 0.0]], "h": [-np.inf]}, "mode.h[0]", "inf for no bound"),
        ({"name": 3}, "mode.name", "printable"),
        ({"name": "a\nb"}, "mode.name", "printable"),
        ({"name": "  "}, "mode.name", "printable"),
    ],
)
def test_a_bad_mode_is_refused_by_field(given, field, words):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.AffineMode(**{"A": A, "B": B} | given)
    assert caught.value.field == field
    assert words in str(caught.value)


ONE = lfo.AffineMode(A, B)


@pytest.mark.parametrize(
    ("modes", "field", "words"),
    [
        ([], "dynamics.modes", "at least one AffineMode"),
        (ONE, "dynamics.modes", "a list"),
        ([ONE, (A, B)], "dynamics.modes[1]", "an AffineMode"),
        ([ONE, lfo.AffineMode([[1.0]], [[1.0]])], "dynamics.modes[1]", "1 state and 1 control; expected 2 and 1"),
        ([lfo.AffineMode(A, B, name="a")] * 2, "dynamics.modes[1].name", "'a' a second time"),
        ([lfo.AffineMode(A, B, name="mode 1"), ONE], "dynamics.modes[1].name", "'mode 1' a second time"),
    ],
)
def test_modes_that_do_not_go_together_are_refused(modes, field, words):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.PiecewiseAffineDynamics(modes)
    assert caught.value.field == field
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("mode", "field"),
    [
        (lfo.AffineMode(np.tile(A, (4, 1, 1)), B), "dynamics.modes[1].A"),
        (lfo.AffineMode(A, B, np.zeros((4, 2))), "dynamics.modes[1].offset"),
        (lfo.AffineMode(A, B, G=np.zeros((4, 1, 2)), h=[1.0]), "dynamics.modes[1].G"),
        (lfo.AffineMode(A, B, H=np.zeros((4, 1, 1)), h=[1.0]), "dynamics.modes[1].H"),
        (lfo.AffineMode(A, B, H=[[1.0]], h=np.zeros((4, 1))), "dynamics.modes[1].h"),
        (lfo.AffineMode(A, B, H=[[0.0]], h=[-1.0]), "dynamics.modes[1].h"),
    ],
)
def test_what_is_given_for_other_times_is_refused(mode, field):
    dynamics = lfo.PiecewiseAffineDynamics([lfo.AffineMode(A, B, H=[[1.0]], h=[0.0]), mode])
    with pytest.raises(lfo.errors.ProblemError) as caught:
        problem_of(dynamics, 5)
    assert caught.value.field == field


@pytest.mark.parametrize("sequence", [[0, 0], [0, 1, 2], [0.0, 1.0, 0.0], ["a"] * 3, [[0], [0, 1]], None, [-1, 0, 0]])
def test_what_is_no_mode_sequence_is_refused(sequence):
    with pytest.raises(lfo.errors.ProblemError, match=r"sequence: got .*; expected 3 mode numbers from 0 to 1"):
        problem_of(rotation(), 3).with_modes(sequence)


def test_the_rows_of_regions_have_a_name_of_their_own():
    problem = problem_of(rotation(), 3)
    with pytest.raises(
        lfo.errors.ProblemError, match=r"stage_rows: got rows named 'mode region'; expected another name"
    ):
        replace(problem, stage_rows=lfo.StageRows([[1.0, 0.0]], None, [1.0], name="mode region"))
    linear = problem_of(lfo.LinearDynamics(A, B), 3)
    with pytest.raises(lfo.errors.UnsupportedError, match="expected PiecewiseAffineDynamics"):
        linear.with_modes([0, 0, 0])
    assert linear.borders == ()
