"""Modes by signs of guards, and modes linearised from nonlinear models, against the same systems written out."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lin_freq_ocp as lfo
from helpers.kinked_maps import problem_of, random_kinks
from helpers.seeds import examples

from_guards = lfo.PiecewiseAffineDynamics.from_guards
linearised = lfo.PiecewiseAffineDynamics.linearised
A, B = np.eye(2), np.array([[0.0], [1.0]])
C, S = 0.4, 0.8 * np.sin(np.pi / 3)
RIGHT, LEFT = np.array([[C, -S], [S, C]]), np.array([[C, S], [-S, C]])


# --- guards -----------------------------------------------------------------------------------------------------------


@settings(derandomize=True, max_examples=examples(15), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 3), kinks=st.integers(1, 3), varying=st.booleans())
def test_guards_give_the_regions_of_their_signs(seed, n, kinks, varying):
    rng = np.random.default_rng(seed)
    T = 4
    kinked = random_kinks(rng, n, 1, kinks, T if varying else 1, 10.0 ** rng.integers(-9, 9, n + 1))
    by_hand = kinked.dynamics()
    modes = {}
    for mode in by_hand.modes:
        signs = "".join("+" if sign == "1" else "-" for sign in mode.name if sign in "01")
        modes[signs] = (mode.linear.A, mode.linear.B, mode.linear.offset)
    G, H, d = kinked.h[:, :n], kinked.h[:, n:], kinked.d if varying else kinked.d[0]
    if varying:
        G = np.tile(G, (T, 1, 1))
    dynamics = from_guards(G, H, d, modes, sampling_time=0.1)
    assert dynamics.mode_names == tuple(modes)
    start, u = 0.5 * rng.normal(size=n) * kinked.sizes[:n], rng.normal(size=(T, 1)) * kinked.sizes[n:]
    replays = [lfo.simulate(problem_of(one, T, initial_state=start), u) for one in (dynamics, by_hand)]
    np.testing.assert_allclose(replays[0].x, replays[1].x, rtol=1e-13)
    np.testing.assert_array_equal(*(one.sequence_of(replays[0].x, u) for one in (dynamics, by_hand)))


def test_at_zero_both_signs_hold_and_the_first_listed_is_taken():
    for modes, first in (({"+": (RIGHT, B), "-": (LEFT, B)}, RIGHT), ({"-": (LEFT, B), "+": (RIGHT, B)}, LEFT)):
        dynamics = from_guards([[1.0, 0.0]], None, None, modes)
        replay = lfo.simulate(problem_of(dynamics, 1, initial_state=[0.0, 3.0]), [[0.5]])
        np.testing.assert_array_equal(replay.x[1], first @ [0.0, 3.0] + [0.0, 0.5])
        assert dynamics.modes[0].region.e.tolist() == [0.0]
        assert not np.signbit(dynamics.modes[1].region.C[dynamics.modes[1].region.C == 0]).any()


def test_a_star_is_any_sign_and_modes_bring_their_names():
    """Walls at -1 and 1: beyond both at once is nowhere, and needs no mode."""
    guards = {"G": [[1.0, 0.0], [-1.0, 0.0]], "H": None, "d": [1.0, 1.0]}
    free = lfo.AffineMode(A, B, name="free")
    dynamics = from_guards(**guards, modes={"--": free, "+*": lfo.AffineMode(A, B), "*+": (A, B, [0.0, 1.0])})
    assert dynamics.mode_names == ("free", "+*", "*+")
    assert [mode.region.rows for mode in dynamics.modes] == [2, 1, 1]
    assert len(problem_of(dynamics).borders) == 2
    assert from_guards(**guards, modes={"**": (A, B)}).modes[0].everywhere


def test_guards_on_controls():
    dynamics = from_guards(None, [[2.0]], [1.0], {"+": (A, B), "-": (2 * A, B)})
    (border,) = problem_of(dynamics).borders
    np.testing.assert_allclose([*border.h_x, *border.h_u, border.limit], [0, 0, -1, -0.5])
    assert lfo.simulate(problem_of(dynamics, 2, initial_state=[1.0, 1.0]), [[0.6], [0.4]]).x[2].tolist() == [2.0, 3.6]


def test_signs_may_be_left_out_on_purpose():
    guards = {"G": [[1.0, 0.0], [0.0, 1.0]], "H": None, "d": [0.0, 5.0]}
    modes = {"+-": (A, B), "--": (2 * A, B)}
    with pytest.raises(lfo.errors.ProblemError, match=r"no pattern for the signs '\+\+' *; .* state None for them"):
        from_guards(**guards, modes=modes)
    dynamics = from_guards(**guards, modes=modes | {"*+": None})
    assert len(dynamics.modes) == 2
    problem = problem_of(dynamics, state_set=lfo.Box(-1, 1))
    assert (len(problem.borders), problem.gap) == (1, None)
    assert problem_of(dynamics, state_set=lfo.Box(-6, 6)).gap is not None


@pytest.mark.parametrize(
    ("change", "field", "words"),
    [
        ({"modes": {}}, "guards.modes", "a mapping from signs"),
        ({"modes": [(A, B)]}, "guards.modes", "a mapping from signs"),
        ({"modes": {"++": None}}, "guards.modes", "one at least is not None"),
        ({"modes": {"+": (A, B)}}, "guards.modes", '\'+\'; expected 2 characters "+", "-" or "*"'),
        ({"modes": {"+0": (A, B)}}, "guards.modes", "'+0'"),
        ({"modes": {3: (A, B)}}, "guards.modes", "got 3"),
        ({"modes": {"+-": (A, B), "++": (A, B)}}, "guards.modes", "no pattern for the signs '-*'"),
        ({"modes": {"+*": (A, B), "*+": (A, B), "--": (A, B)}}, "guards.modes['*+']", "holds together with '+*'"),
        ({"modes": {"**": (A,)}}, "guards.modes['**']", "(A, B, offset)"),
        ({"modes": {"**": 3}}, "guards.modes['**']", "got 3"),
        ({"modes": {"**": (A, [[1.0]])}}, "guards.modes['**'].B", "shape (1, 1)"),
        ({"modes": {"**": (A, B, [1.0, np.nan])}}, "guards.modes['**'].offset[1]", "nan"),
        ({"modes": {"**": lfo.AffineMode(A, B, H=[[1.0]], h=[0.0])}}, "guards.modes['**']", "its own region"),
        ({"modes": {"+*": (A, B), "-*": ([[1.0]], [[1.0]])}}, "guards.modes['-*']", "1 state and"),
        ({"G": None, "H": None}, "guards.G", "neither G nor H"),
        ({"G": [1.0, 0.0]}, "guards.G", "expected shape (guards, 2)"),
        ({"G": [[1.0], [1.0]]}, "guards.G", "expected shape (2, 2), one row per guard"),
        ({"H": [[1.0]]}, "guards.H", "expected shape (2, 1)"),
        ({"d": [1.0]}, "guards.d", "expected shape (2)"),
        ({"d": 1.0}, "guards.d", "shape ()"),
        ({"G": np.zeros((3, 2, 2)), "d": np.zeros((4, 2))}, "guards.G", "3 times; expected 4"),
        ({"G": [[1.0, 0.0], [0.0, "a"]]}, "guards.G", "numbers"),
        ({"G": np.zeros((0, 2)), "modes": {"": (A, B)}, "d": None}, "guards.G", "shape (0, 2)"),
    ],
)
def test_bad_guards_are_refused(change, field, words):
    given = {"G": [[1.0, 0.0], [0.0, 1.0]], "H": None, "d": [0.0, 0.0], "modes": {"**": (A, B)}} | change
    with pytest.raises(lfo.errors.ProblemError) as caught:
        from_guards(**given)
    assert caught.value.field == field
    assert words in str(caught.value)


def test_many_guards_with_few_patterns_are_no_matter_of_all_signs():
    count = 30
    modes = {"-" * k + "+" + "*" * (count - k - 1): (A, B) for k in range(count)} | {"-" * count: (A, B)}
    G = np.column_stack([np.ones(count), np.zeros(count)])
    assert len(from_guards(G, None, np.arange(count, 0.0, -1), modes).modes) == count + 1


def test_guards_per_time_must_be_for_all_times():
    modes = {"+": (RIGHT, B), "-": (LEFT, B)}
    dynamics = from_guards(None, [[1.0]], np.zeros((4, 1)), modes)
    with pytest.raises(lfo.errors.ProblemError) as caught:
        problem_of(dynamics, 5)
    assert caught.value.field == "dynamics.modes[0].h"


# --- linearised pieces ------------------------------------------------------------------------------------------------

REFERENCE, RESISTANCE, RATIO = 1.0, 2.0, 0.25  # I_ref, R, and R Tc / L of the buck converter
DECAY = np.exp(-RATIO * RESISTANCE)
GAIN = (1 / DECAY - 1) / RESISTANCE
V_S = 2.35


def buck(update):
    return control.nlsys(
        lambda t, x, u, params: [update(x[0], u[0])], None, states=["i [A]"], inputs=["v [V]"], dt=True
    )


def excess(i, v):
    """Return e of the reference: how far the current is above the border."""
    return i + GAIN * v - REFERENCE / DECAY


PIECES = [
    lfo.dynamics.SmoothPiece(
        buck(lambda i, v: REFERENCE + DECAY * excess(i, v)),
        *([0.8], [V_S]),
        **{"G": [[1.0]], "H": [[GAIN]], "h": [REFERENCE / DECAY], "name": "rising"},
    ),
    lfo.dynamics.SmoothPiece(
        buck(lambda i, v: REFERENCE - DECAY * RESISTANCE * excess(i, v) / (v - REFERENCE * RESISTANCE)),
        *([REFERENCE / DECAY - GAIN * V_S], [V_S]),
        **{"G": [[-1.0]], "H": [[-GAIN]], "h": [-REFERENCE / DECAY], "name": "falling"},
    ),
]


def test_a_point_of_the_border_keeps_the_map_continuous():
    """The second mode of the buck converter, linearised where e = 0, is I_ref - k e with k = c / (v_s - r)."""
    dynamics = linearised(PIECES, sampling_time=2.5e-4)
    assert dynamics.mode_names == ("rising", "falling")
    assert (dynamics.state_names, dynamics.control_names) == (("i [A]",), ("v [V]",))
    slope = DECAY * RESISTANCE / (V_S - REFERENCE * RESISTANCE)
    falling = dynamics.modes[1].linear
    np.testing.assert_allclose([falling.A[0, 0], falling.B[0, 0]], [-slope, -slope * GAIN], rtol=1e-8)
    assert falling.offset[0] == pytest.approx(REFERENCE + slope * REFERENCE / DECAY, rel=1e-8)
    (border,) = problem_of(dynamics, state_set=lfo.Box(0, 1), control_set=lfo.Box(2.2, 6)).borders
    assert border.continuous
    length = np.hypot(1, GAIN)
    np.testing.assert_allclose(border.g, [(DECAY + slope) * length], rtol=1e-8)


def test_elsewhere_the_map_jumps_and_the_border_says_so():
    pieces = [
        PIECES[0],
        lfo.dynamics.SmoothPiece(PIECES[1].system, [0.9], [3.0], PIECES[1].G, PIECES[1].H, PIECES[1].h),
    ]
    (border,) = problem_of(linearised(pieces), state_set=lfo.Box(0, 1), control_set=lfo.Box(2.2, 6)).borders
    assert not border.continuous
    assert 1e-3 < border.jump < 1


def test_pieces_are_linearised_as_one_model_is():
    slope = [lambda t, x, u, params: [x[1], u[0] - params.get("k", 0.0) * np.sin(x[0])]] * 2
    systems = [control.nlsys(one, None, states=2, inputs=1, dt=0) for one in slope]
    x, u = np.linspace(0, 1, 10).reshape(5, 2), np.ones((4, 1))
    pieces = [
        lfo.dynamics.SmoothPiece(systems[0], [0.5, 0.0], [0.0], G=[[1.0, 0.0]], h=[1.0], params={"k": 2.0}),
        lfo.dynamics.SmoothPiece(systems[1], x, u, G=[[-1.0, 0.0]], h=[-1.0], integrator="Radau", state_scale=2.0),
    ]
    dynamics = linearised(pieces, 0.1, state_names=["a", "b"], control_names=["f"])
    alone = [
        lfo.LinearDynamics.linearised(systems[0], [0.5, 0.0], [0.0], 0.1, {"k": 2.0}),
        lfo.LinearDynamics.linearised(systems[1], x, u, 0.1, integrator="Radau", state_scale=2.0),
    ]
    for mode, one in zip(dynamics.modes, alone, strict=True):
        for part in ("A", "B", "offset"):
            np.testing.assert_array_equal(getattr(mode.linear, part), getattr(one, part))
    assert (dynamics.sampling_time, dynamics.state_names, dynamics.time_varying) == (0.1, ("a", "b"), True)
    assert problem_of(dynamics, 4).horizon == 4


GOOD, CONTINUOUS = PIECES[0], control.nlsys(lambda t, x, u, params: u - x, None, states=1, inputs=1, dt=0)


@pytest.mark.parametrize(
    ("pieces", "field", "words"),
    [
        ([], "pieces", "at least one SmoothPiece"),
        (GOOD, "pieces", "a list"),
        ([GOOD, 3], "pieces[1]", "a SmoothPiece"),
        ([GOOD, lfo.dynamics.SmoothPiece("model", [1.0], [1.0])], "pieces[1].system", "control.NonlinearIOSystem"),
        ([lfo.dynamics.SmoothPiece(CONTINUOUS, [1.0], [1.0])], "sampling_time", "The system is continuous"),
        ([lfo.dynamics.SmoothPiece(GOOD.system, [1.0, 1.0], [1.0])], "pieces[0].x, u", "shapes (2,) and (1,)"),
        (
            [lfo.dynamics.SmoothPiece(GOOD.system, [1.0], [1.0], G=[[1.0, 2.0]], h=[1.0])],
            "pieces[0].G",
            "expected shape (1, 1)",
        ),
        ([lfo.dynamics.SmoothPiece(GOOD.system, [1.0], [1.0], G=[[1.0]])], "pieces[0].h", "one limit per row"),
        (
            [lfo.dynamics.SmoothPiece(buck(lambda i, v: abs(i)), [1e-4], [1.0])],
            "pieces[0].system, t = 0",
            "a smooth model",
        ),
        (
            [
                GOOD,
                lfo.dynamics.SmoothPiece(
                    control.nlsys(lambda t, x, u, params: u, None, states=1, inputs=1, dt=0.5), [1], [1]
                ),
            ],
            "pieces[1].system.dt",
            "got 0.5; expected None, as in the first piece",
        ),
        (
            [
                GOOD,
                lfo.dynamics.SmoothPiece(
                    control.nlsys(lambda t, x, u, params: u[0] + x, None, states=2, inputs=1, dt=True), [1, 1], [1]
                ),
            ],
            "dynamics.modes[1]",
            "got 2 states and 1 control; expected 1 and 1, as in the first",
        ),
    ],
)
def test_bad_pieces_are_refused(pieces, field, words):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        linearised(pieces)
    assert caught.value.field == field
    assert words in str(caught.value)
