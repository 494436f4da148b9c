"""Every kind of slider against lfo.solve of the problem that it stands for, and which problems have which."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from lin_freq_ocp.pages import GROUPS, HORIZON, Session, sliders_of
from lin_freq_ocp.transform import changed_fields

PLANT = lfo.LinearDynamics(
    [[1.0, 0.1], [0.0, 1.0]],
    [[0.005], [0.1]],
    state_names=["position [m]", "speed [m/s]"],
    control_names=["force [N]"],
    sampling_time=0.1,
)
BEYOND = lfo.low_pass(cutoff_hz=1.0)
NOTCH = lfo.spectrum.notch(1.0, 0.4)  # rad/sample: 1.59 Hz and 0.64 Hz
ENDS = "initial_state", "terminal_state"
VIBRATION = lfo.library.printer_move().control_spectrum.limit
RAD = 1 / (2 * np.pi * 0.1)  # Hz per rad/sample


def move(**fields):
    """Return a move of 1 m within 40 steps."""
    given = {
        "cost": lfo.QuadraticCost(R=0.1),
        "control_set": lfo.Box(-2, 2),
        "initial_state": [1, 0],
        "terminal_state": [0, 0],
    }
    return lfo.OptimalControlProblem(PLANT, 40, **(given | fields))


def mask(level=0.5, **fields):
    return lfo.MagnitudeBound(level, band=fields.pop("band", BEYOND), **fields)


def energy(limit, band=BEYOND):
    return lfo.spectrum.EnergyBound(limit, band=band)


def on_force(constraint, cutoff=4.0):
    return lfo.spectrum.OutputSpectrum(D=[[1.0]], constraints=[lfo.low_pass(cutoff_hz=cutoff), constraint])


def rated(limit):
    return lfo.rate_limited(move(), limit, previous=0)


def decibels(level):
    return 10 ** (level / 20)


# Of every kind of slider: a problem, the slider, notches from its own value, and the problem at its value.
CASES = {
    "a mask's level": (
        move(control_spectrum=mask()),
        ("level.control_spectrum.0", -8),
        lambda level: move(control_spectrum=mask(0.5 * decibels(level))),
    ),
    "limits for each bin": (
        move(control_spectrum=mask(np.linspace(0.3, 0.6, 16))),
        ("level.control_spectrum.0", -8),
        lambda level: move(control_spectrum=mask(np.linspace(0.3, 0.6, 16) * decibels(level))),
    ),
    "limits over frequencies": (
        move(control_spectrum=mask([[1.0, 0.6], [5.0, 0.3]], every_frequency=True)),
        ("level.control_spectrum.0", -8),
        lambda level: move(
            control_spectrum=mask([[1.0, 0.6 * decibels(level)], [5.0, 0.3 * decibels(level)]], every_frequency=True)
        ),
    ),
    "an energy's level": (
        move(control_spectrum=energy(0.3)),
        ("level.control_spectrum.0", -8),
        lambda level: move(control_spectrum=energy(0.3 * decibels(level) ** 2)),
    ),
    "a level of windows": (
        move(control_spectrum=lfo.spectrum.Spectrogram(mask(), length=20)),
        ("level.control_spectrum.0", -8),
        lambda level: move(control_spectrum=lfo.spectrum.Spectrogram(mask(0.5 * decibels(level)), length=20)),
    ),
    "a vibration's level": (
        lfo.library.printer_move(),
        ("level.control_spectrum.0", 8),
        lambda level: lfo.library.printer_move(vibration_bound=VIBRATION * decibels(level)),
    ),
    "a mask's cut-off": (
        move(control_spectrum=mask()),
        ("edge.control_spectrum.0.1", -2),
        lambda cutoff: move(control_spectrum=mask(band=lfo.low_pass(cutoff_hz=cutoff))),
    ),
    "a notch's centre": (
        move(control_spectrum=NOTCH),
        ("edge.control_spectrum.0.0", -3),
        lambda centre: move(control_spectrum=lfo.spectrum.notch(centre / RAD, 0.4)),
    ),
    "a notch's width": (
        move(control_spectrum=NOTCH),
        ("edge.control_spectrum.0.1", 4),
        lambda width: move(control_spectrum=lfo.spectrum.notch(1.0, width / RAD)),
    ),
    "a notch at every frequency": (
        move(control_spectrum=mask(band=NOTCH, every_frequency=True)),
        ("edge.control_spectrum.0.1", 6),
        lambda width: move(control_spectrum=mask(band=lfo.spectrum.notch(1.0, width / RAD), every_frequency=True)),
    ),
    "a band pass's lower edge": (
        move(control_spectrum=lfo.spectrum.band_pass(lower_hz=0.25, upper_hz=3.0)),
        ("edge.control_spectrum.0.0", 1),
        lambda edge: move(control_spectrum=lfo.spectrum.band_pass(lower_hz=edge, upper_hz=3.0)),
    ),
    "a high pass's edge": (
        move(control_spectrum=lfo.spectrum.high_pass(cutoff_hz=0.3)),
        ("edge.control_spectrum.0.0", 1),
        lambda edge: move(control_spectrum=lfo.spectrum.high_pass(cutoff_hz=edge)),
    ),
    "a state's level": (
        move(state_spectrum=mask(0.5, component="speed", band=lfo.low_pass(cutoff_hz=0.5))),
        ("level.state_spectrum.0", -8),
        lambda level: move(
            state_spectrum=mask(0.5 * decibels(level), component="speed", band=lfo.low_pass(cutoff_hz=0.5))
        ),
    ),
    "an output's level": (
        move(output_spectrum=on_force(mask())),
        ("level.output_spectrum.0.1", -8),
        lambda level: move(output_spectrum=on_force(mask(0.5 * decibels(level)))),
    ),
    "an output's low pass": (
        move(output_spectrum=[on_force(mask())]),
        ("edge.output_spectrum.0.0.1", -10),
        lambda cutoff: move(output_spectrum=on_force(mask(), cutoff)),
    ),
    "a state's bound": (
        move(state_set=lfo.Box([None, -0.4], [None, 0.4])),
        ("state_bound.1", -5),
        lambda bound: move(state_set=lfo.Box([None, -bound], [None, bound])),
    ),
    "a state's lower bound": (
        move(state_set=lfo.Box([-0.3, -0.4], None) & lfo.sets.Ball(2)),
        ("state_lower.1", 5),
        lambda bound: move(state_set=lfo.Box([-0.3, bound], None) & lfo.sets.Ball(2)),
    ),
    "a state's upper bound": (
        move(state_set=lfo.Box(None, [None, 0.4]), initial_state=[0, 0], terminal_state=[1, 0]),
        ("state_upper.1", -5),
        lambda bound: move(state_set=lfo.Box(None, [None, bound]), initial_state=[0, 0], terminal_state=[1, 0]),
    ),
    "a rate limit": (rated(0.1), ("rows.0", -5), rated),
    "an end with a free component": (
        rated(0.5),
        ("terminal_state.0", 5),
        lambda end: replace(rated(0.5), terminal_state=lfo.Box([end, 0, None], [end, 0, None])),
    ),
    "an end in a box": (
        move(terminal_state=lfo.Box([-0.1, 0], [0.1, 0])),
        ("terminal_state.1", 1),
        lambda end: move(terminal_state=lfo.Box([-0.1, end], [0.1, end])),
    ),
    "different limits of rows": (
        move(stage_rows=[lfo.StageRows(C=[[0, -1], [0, 1]], e=[0.4, 0.6])]),
        ("rows.0", -4),
        lambda part: move(stage_rows=[lfo.StageRows(C=[[0, -1], [0, 1]], e=np.array([0.4, 0.6]) * part / 100)]),
    ),
}


@cache
def session_of(name):
    """Return the session of a case, which solves its problem and its moved problem once."""
    return Session(CASES[name][0])


@pytest.mark.parametrize("name", seeds(CASES))
def test_an_answer_is_that_of_the_problem_with_this_value(name):
    _, (key, notches), built = CASES[name]
    session = session_of(name)
    slider = next(one for one in session.sliders if one.key == key)
    value = slider.notch(notches)
    assert value != slider.value
    answer, expected = session.answer({key: value}), lfo.solve(built(value))
    assert answer["status"] == expected.status == "optimal"
    assert answer["cost"] == pytest.approx(expected.cost, rel=1e-5)
    assert answer["cost"] != pytest.approx(session.outcome(own(session)).cost, rel=1e-3)
    classical = session.outcome({**own(session), key: value}, classical=True) if slider.group == "frequency" else None
    assert classical is None or classical.cost < expected.cost


def test_two_values_of_the_same_constraint_are_moved_together():
    session = Session(move(control_spectrum=mask()))
    cutoff, level = (next(one for one in session.sliders if one.key.startswith(kind)) for kind in ("edge", "level"))
    values = {cutoff.key: cutoff.notch(-1), level.key: level.notch(-8)}
    built = move(control_spectrum=mask(0.5 * decibels(-4), band=lfo.low_pass(cutoff_hz=cutoff.notch(-1))))
    assert session.answer(values)["cost"] == pytest.approx(lfo.solve(built).cost, rel=1e-5)


def test_sliders_say_what_they_move_in_which_unit():
    problem = move(
        control_spectrum=[NOTCH, lfo.spectrum.notch(2.0, 0.4), mask()], state_set=lfo.Box([None, -0.4], [0.9, 0.4])
    )
    limited = lfo.rate_limited(problem, 0.5, previous=0)
    found = [f"{one.label} [{one.unit}]" for one in sliders_of(limited, None) if one.group not in ENDS]
    assert found == [
        "centre of the notch of force [Hz]",
        "width of the notch of force [Hz]",
        "centre of the notch of force (2) [Hz]",
        "width of the notch of force (2) [Hz]",
        "cut-off of the mask of force [Hz]",
        "level of the mask of force [dB]",
        "|force| \N{LESS-THAN OR EQUAL TO} [N]",
        "rate limit \N{LESS-THAN OR EQUAL TO} [N]",
        "position \N{LESS-THAN OR EQUAL TO} [m]",
        "|speed| \N{LESS-THAN OR EQUAL TO} [m/s]",
    ]


@expensive
def test_notches_are_within_the_limits_and_easier_ones_do_cost_less():
    for name, (_, (key, notches), _) in CASES.items():
        session = session_of(name)
        assert {slider.group for slider in session.sliders} <= set(GROUPS)
        slider = next(one for one in session.sliders if one.key == key)
        for end in (slider.low, slider.high):
            steps = (end - slider.value) / slider.step
            assert steps == pytest.approx(round(steps), abs=1e-6)
        if slider.relaxed != slider.value:  # not of a centre
            towards = np.sign(slider.relaxed - slider.value) * np.sign(notches)
            moved = session.outcome({**own(session), key: slider.notch(notches)}).cost
            assert np.sign(session.outcome(own(session)).cost - moved) == towards


def own(session):
    return {slider.key: slider.value for slider in session.sliders}


@pytest.mark.parametrize(
    "problem",
    [
        move(control_spectrum=lfo.spectrum.stop_band(bins=[3, 4])),
        move(control_spectrum=mask(0.0, band=lfo.spectrum.stop_band(bins=[3, 4]))),
        move(stage_rows=[lfo.StageRows(C=[[0, -1]], e=[np.inf])]),
        move(stage_rows=[lfo.StageRows(C=[[1, 0]], e=[-1.0])], terminal_state=[-1, 0], initial_state=[-1.5, 0]),
        move(state_set=[lfo.Box(-2, 2)] * 41),
        move(control_set=lfo.FiniteSet([-1, 0, 1], duty_cycles=True)),
    ],
)
def test_what_has_no_limit_that_can_be_scaled_has_no_slider(problem):
    bounds = () if isinstance(problem.control_set, lfo.FiniteSet) else ("bounds",)
    assert {slider.group for slider in sliders_of(problem, None)} - {"frequency", *ENDS} == set(bounds)
    assert not [one.key for one in sliders_of(problem, None) if one.group == "frequency" and one.key != "cutoff"]


def test_ends_that_are_more_than_boxes_have_no_sliders():
    def ends_of(**fields):
        return [slider.key for slider in sliders_of(move(**fields), None) if slider.group in ENDS]

    assert (
        ends_of(initial_state=lfo.Box([0.5, None], [0.5, None]) & lfo.sets.Ball(1), terminal_state=lfo.Periodic()) == []
    )
    assert ends_of(initial_state=lfo.Box([0.5, None], [0.5, None]), terminal_state=lfo.Box([None, 0], [None, 0])) == [
        "initial_state.0",
        "terminal_state.1",
    ]


@expensive
def test_an_infeasible_level_is_cured_by_a_higher_level():
    session = Session(lfo.library.printer_move())
    level = next(one for one in session.sliders if one.key.startswith("level"))
    given = {level.key: level.low}
    answer = session.answer(given)
    assert answer["status"] == "infeasible"
    assert any("residual vibration" in block for block in answer["conflict"])
    cure = session.cure(given, level.key)
    assert session.answer({level.key: cure["value"]})["status"] == "optimal"


def test_the_problems_own_values_are_the_problem_itself():
    for problem, _, _ in CASES.values():
        assert not changed_fields(problem, {})


def test_a_horizon_of_its_own_keeps_the_other_moves():
    session = Session(
        move(control_spectrum=mask()), lambda horizon: replace(move(control_spectrum=mask()), horizon=horizon)
    )
    level = next(one for one in session.sliders if one.key.startswith("level"))
    horizon = next(one for one in session.sliders if one.key == HORIZON).notch(8)
    built = replace(move(control_spectrum=mask(0.5 * decibels(-4))), horizon=int(horizon))
    answer = session.answer({HORIZON: horizon, level.key: level.notch(-8)})
    assert answer["cost"] == pytest.approx(lfo.solve(built).cost, rel=1e-5)
